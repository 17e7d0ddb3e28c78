"""Rollouts by hand: what a test says nothing of is at rest, without forces, and as the kinematics have it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.simulation import Rollout


def make_rollout(arm: Arm, q: NDArray[np.float64] | None = None, **given: Any) -> Rollout:
    """A rollout with joint positions ``q`` ``(K, n)``, by default three at the home position, every 0.01 s.

    Args:
        arm: the arm.
        q: the simulated positions.
        given: any attributes of the rollout; references are by default what was simulated.
    """
    q = np.tile(arm.keyframe("home"), (3, 1)) if q is None else q
    qd, zeros, poses = given.get("qd", np.zeros_like(q)), np.zeros_like(q), arm.link_poses(q)
    values: dict[str, Any] = {
        "t": 0.01 * np.arange(len(q)),
        "qd": qd,
        "q_ref": q,
        "qd_ref": qd,
        "ctrl": np.zeros((len(q), arm.model.nu)),
        "force": zeros,
        "constraint_force": zeros,
        "link_position": poses.translation,
        "link_quaternion": poses.rotation.as_quat(scalar_first=True),
        "contacts": np.zeros(len(q), dtype=int),
        "contact_force": np.zeros(len(q)),
        "qpos": arm.qpos(q),
        "motion_end": 0.0,
    }
    return Rollout(arm=arm, q=q, **{**values, **given})
