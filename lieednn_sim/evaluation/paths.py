"""Errors between two paths of a frame, independent of their timing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from lieednn_sim.learning.demonstrations.alignment import LEVER, displacement, warp
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats

# Samples of each path, at equal steps of its length: as many as in a demonstration of the LASA data set.
SAMPLES = 1000


@dataclass(frozen=True)
class PathErrors:
    """Errors of a path against the one it should follow, both sampled at `SAMPLES` equal steps of their length.

    Samples are paired by dynamic time warping (`warping.warp`), whatever the timing; a radian counts as the lever.

    Attributes:
        rms_mm: root mean square distance of the pairs' positions.
        rms_deg: root mean square angle between the pairs.
        dtwd_mm: dynamic-time-warping distance: the sum of the distances of all pairs.
        frechet_mm: discrete Frechet distance.
        goal_mm: distance of the ends.
        goal_deg: angle between the ends.
    """

    rms_mm: float
    rms_deg: float
    dtwd_mm: float
    frechet_mm: float
    goal_mm: float
    goal_deg: float


def path_errors(reproduced: ArrayLike, shown: ArrayLike, lever: float = LEVER) -> PathErrors:
    """Compare two paths of twists ``(K, 6)`` and ``(L, 6)`` [rad, m]; a radian counts as ``lever`` metres of length."""
    lever = as_positive("lever", lever)
    given = {"reproduced": reproduced, "shown": shown}
    path, reference = (_spaced(displacement(as_floats(name, x, ("K", 6))), lever) for name, x in given.items())
    scale = np.array([lever] * 3 + [1.0] * 3)
    matched = warp(path * scale, reference * scale)
    first, second = path[matched.pairs[:, 0]], reference[matched.pairs[:, 1]]
    apart = np.linalg.norm(first[:, 3:] - second[:, 3:], axis=1)
    turned = (Rotation.from_rotvec(first[:, :3]) * Rotation.from_rotvec(second[:, :3]).inv()).magnitude()
    return PathErrors(
        rms_mm=1e3 * float(np.sqrt(np.mean(apart**2))),
        rms_deg=float(np.rad2deg(np.sqrt(np.mean(turned**2)))),
        dtwd_mm=1e3 * matched.total,
        frechet_mm=1e3 * matched.frechet,
        goal_mm=1e3 * float(apart[-1]),
        goal_deg=float(np.rad2deg(turned[-1])),
    )


def _spaced(displaced: Floats, lever: float) -> Floats:
    """Rotation vectors and positions ``(K, 6)`` at `SAMPLES` equal steps of the length."""
    turn = Rotation.from_rotvec(displaced[:, :3])
    turned = lever * (turn[1:] * turn[:-1].inv()).magnitude()
    steps = np.hypot(np.linalg.norm(np.diff(displaced[:, 3:], axis=0), axis=1), turned)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, length[-1], SAMPLES)
    return np.stack([np.interp(at, length, entry) for entry in displaced.T], axis=-1)
