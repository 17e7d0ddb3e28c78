"""How near two paths of a frame are to each other, whatever their pace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations.alignment import LEVER, displacement
from lieednn_sim.validation import as_floats, as_positive

Floats = NDArray[np.float64]

# Samples of each path, at equal steps of its length: as many as a demonstration of the LASA data set has.
SAMPLES = 1000


@dataclass(frozen=True)
class PathErrors:
    """A path against the one it should follow, both at `SAMPLES` equal steps of their length.

    Attributes:
        rms_mm: root mean square of the distances at equal shares of the length.
        rms_deg: the same of the angles between them.
        dtwd_mm: dynamic-time-warping distance of the positions: a sum over some thousand pairs.
        frechet_mm: discrete Frechet distance of the positions.
        goal_mm: distance of their ends.
        goal_deg: angle between their ends.
    """

    rms_mm: float
    rms_deg: float
    dtwd_mm: float
    frechet_mm: float
    goal_mm: float
    goal_deg: float


def path_errors(reproduced: ArrayLike, shown: ArrayLike, lever: float = LEVER) -> PathErrors:
    """Compare two paths of twists ``(K, 6)`` and ``(L, 6)`` [rad, m]; a radian counts as ``lever`` metres of length."""
    one, other = (
        _spaced(displacement(as_floats(name, path, ("K", 6))), as_positive("lever", lever))
        for name, path in (("reproduced", reproduced), ("shown", shown))
    )
    dtwd, frechet = _warped(one[:, 3:], other[:, 3:])
    apart = np.linalg.norm(one[:, 3:] - other[:, 3:], axis=1)
    turned = (Rotation.from_rotvec(one[:, :3]) * Rotation.from_rotvec(other[:, :3]).inv()).magnitude()
    return PathErrors(
        rms_mm=1e3 * float(np.sqrt(np.mean(apart**2))),
        rms_deg=float(np.rad2deg(np.sqrt(np.mean(turned**2)))),
        dtwd_mm=1e3 * dtwd,
        frechet_mm=1e3 * frechet,
        goal_mm=1e3 * float(apart[-1]),
        goal_deg=float(np.rad2deg(turned[-1])),
    )


def dtw_distance(one: ArrayLike, other: ArrayLike) -> float:
    """Dynamic-time-warping distance of samples ``(K, D)`` and ``(L, D)``.

    The least sum of distances over all ways to run through both, at each step further in one or in both of them
    (Sakoe and Chiba, IEEE T-ASSP 26(1), 1978); not divided by the number of pairs.
    """
    return _warped(one, other)[0]


def frechet_distance(one: ArrayLike, other: ArrayLike) -> float:
    """Discrete Frechet distance of samples ``(K, D)`` and ``(L, D)``: as `dtw_distance`, with the largest for the sum.

    Eiter and Mannila, Computing discrete Frechet distance, 1994.
    """
    return _warped(one, other)[1]


def _warped(one: ArrayLike, other: ArrayLike) -> tuple[float, float]:
    """The least sum and the least largest distance over all ways to run through both."""
    first, second = (as_floats(name, path, ("K", "D")) for name, path in (("one", one), ("other", other)))
    if not len(first) or not len(second) or first.shape[1] != second.shape[1]:
        raise InputError(f"paths must have samples of the same size, got {first.shape} and {second.shape}")
    # Pairs (i, k - i) of one sum k at a time: they depend on those of the two sums before it alone. By i + 1 there are
    # kept the least sums in the first row, the least largest distances in the second.
    n, m, backwards = len(first), len(second), second[::-1]
    older, last = np.full((2, 2, n + 1), np.inf)
    older[:, 0] = 0.0
    for k in range(n + m - 1):
        low, high = max(0, k - m + 1), min(n - 1, k) + 1
        gap = first[low:high] - backwards[low + m - 1 - k : high + m - 1 - k]
        apart = np.sqrt(np.einsum("ij,ij->i", gap, gap))
        nearest = np.minimum(np.minimum(last[:, low + 1 : high + 1], last[:, low:high]), older[:, low:high])
        older, last = last, np.full((2, n + 1), np.inf)
        last[0, low + 1 : high + 1] = apart + nearest[0]
        last[1, low + 1 : high + 1] = np.maximum(apart, nearest[1])
    return float(last[0, n]), float(last[1, n])


def _spaced(displaced: Floats, lever: float) -> Floats:
    """Turns and positions ``(K, 6)`` at `SAMPLES` equal steps of the length; of no length all are the same."""
    turn = Rotation.from_rotvec(displaced[:, :3])
    steps = np.hypot(
        np.linalg.norm(np.diff(displaced[:, 3:], axis=0), axis=1), lever * (turn[1:] * turn[:-1].inv()).magnitude()
    )
    way = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, way[-1], SAMPLES)
    return np.stack([np.interp(at, way, entry) for entry in displaced.T], axis=-1)
