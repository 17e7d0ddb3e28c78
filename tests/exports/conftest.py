"""A rollout that every export takes."""

from __future__ import annotations

import numpy as np
import pytest
from rollouts import make_rollout

from lieednn_sim.arm import Arm


@pytest.fixture(scope="session")
def rollout():
    """Half a second by hand: 51 samples at 100 Hz, of which the motion takes 0.4 s; planned and measured differ."""
    arm = Arm.load("telescopic_pr")
    s = np.linspace(0.0, 1.0, 51)[:, None]
    q = arm.keyframe("home") + s * (arm.keyframe("extended") - arm.keyframe("home")) / 3.0
    return make_rollout(arm, q, q_ref=q + 1e-7, qd=0.1 + q, qd_ref=0.2 + q, motion_end=0.4)
