"""Demonstrations made for the tests: a bend in a plane, and the same bend while turning."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lieednn_sim.learning.demonstrations import Demonstration, Demonstrations, align


def bends(dof: int) -> Demonstrations:
    """Three of them, from 0.5 m away, each with a start of its own."""
    s = np.linspace(0.0, 1.0, 120)
    law = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    made = []
    for k in (-1.0, 0.0, 1.0):
        x, y = 0.5 * (1.0 - law), (0.2 + 0.02 * k) * np.sin(np.pi * law) + 0.03 * k * (1.0 - law)
        columns = np.column_stack([x, y])
        if dof == 6:
            turn = np.outer(1.0 - law, [1.0 + 0.1 * k, 0.3, 0.2]) + np.outer(np.sin(np.pi * law), [0.0, 0.4, 0.0])
            columns = np.column_stack([columns, 0.1 * s * x, Rotation.from_rotvec(turn).as_quat(scalar_first=True)])
        made.append(Demonstration.from_samples(columns, 2.0 * s))
    return align(made)


@pytest.fixture(scope="session")
def planar():
    return bends(2)


@pytest.fixture(scope="session")
def posed():
    return bends(6)
