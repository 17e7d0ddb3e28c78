"""Recovery from a disturbance: deviation from the path and time until the arm is back, and the force of a push."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

# An arm is back on its path while its distance from it is below this fraction of the largest one.
BACK = 0.1
# A push: its duration [s], the deviation of a joint that it shall cause [ranges], and the relative tolerance of that.
PUSH_TIME, PUSH_DEVIATION, _TOLERANCE = 0.2, 0.1, 0.2
# The search for its force: first guess [N], number of trials, largest force [N].
_GUESS, _TRIALS, _MOST = 300.0, 12, 2e4
# Number of configurations at which the path is sampled, evenly over its length.
_SAMPLES = 2000
# Weight of the Euclidean distance, which breaks ties between configurations with equal largest joint distance.
_TIE = 1e-6


@dataclass(frozen=True)
class PathRecovery:
    """How an arm recovered from a disturbance.

    The distance of two configurations is the largest difference of a joint in units of its range.

    Attributes:
        deviation: largest distance from the path.
        time_s: time from the disturbance's end until the distance stays below a tenth of that; None if it never does.
        fraction: of the path that was left when the disturbance began, the fraction covered by then; None likewise.
    """

    deviation: float
    time_s: float | None
    fraction: float | None


class UndisturbedPath:
    """The undisturbed path ``(K, n)`` of an arm."""

    def __init__(self, arm: Arm, q: Floats) -> None:
        self._range = arm.ranges
        length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q / self._range, axis=0), axis=1) + 1e-12))
        self._fractions = np.linspace(0.0, 1.0, _SAMPLES)
        even = np.interp(self._fractions, length / length[-1], np.arange(len(q)))
        at = even.astype(int)
        after, rest = np.minimum(at + 1, len(q) - 1), (even - at)[:, None]
        self._points = ((1.0 - rest) * q[at] + rest * q[after]) / self._range
        self._tree = KDTree(self._points)

    def nearest(self, q: Floats) -> tuple[Floats, Floats]:
        """Distances ``(K,)`` of configurations ``(K, n)`` from the path, and the nearest places on it in [0, 1]."""
        scaled = q / self._range
        least, _ = self._tree.query(scaled, p=np.inf)
        # The Euclidean distance is at most sqrt(n) times the largest of a joint, so points further away cannot win.
        within = least * (1.0 + 2.0 * _TIE * np.sqrt(scaled.shape[1])) + _TIE**2
        near = self._tree.query_ball_point(scaled, within, p=np.inf)
        found = np.array([self._nearest(*one) for one in zip(scaled, map(np.sort, near), strict=True)])
        return found[:, 0], found[:, 1]

    def recovery(self, t: Floats, q: Floats, begin: float, end: float) -> PathRecovery:
        """How an arm disturbed from ``begin`` to ``end`` [s] recovers; ``q`` is ``(K, n)`` at the times ``t``."""
        after = np.flatnonzero(t >= begin)
        distance, at = self.nearest(q[after])
        deviation = float(distance.max())
        outside = np.flatnonzero(distance > BACK * deviation)
        last = int(outside[-1]) + 1 if outside.size else 0
        if last >= len(after):
            return PathRecovery(deviation, None, None)
        back, first = max(last, int(np.searchsorted(t[after], end))), float(at[0])
        back = min(back, len(after) - 1)
        fraction = (float(at[back]) - first) / max(1.0 - first, 1e-9)
        return PathRecovery(deviation, max(float(t[after][back] - end), 0.0), fraction)

    def _nearest(self, scaled: Floats, among: NDArray[np.int_]) -> tuple[float, float]:
        away = np.abs(self._points[among] - scaled)
        distance = away.max(axis=1)
        # Many points may be equally near in the furthest joint: the Euclidean distance breaks the tie.
        index = int((distance + _TIE * np.linalg.norm(away, axis=1)).argmin())
        return float(distance[index]), float(self._fractions[among[index]])


def pushing_force(deviation_under: Callable[[float], float]) -> float:
    """Force [N] that makes a joint deviate by 8 to 12 % of its range, or the last one tried; at most 20 kN.

    It must be found in the run itself. Drives resist a growing force almost rigidly up to their limits, then yield
    suddenly: half as much force again throws the arm ten times as far. Where that begins depends on the configuration,
    on the forces that the motion itself takes, and on the policy.

    Args:
        deviation_under: maps a force to the largest deviation of a joint from the undisturbed path in units of its
            range.
    """
    force, low, high = _GUESS, (0.0, 0.0), (np.inf, np.inf)
    # Bracketing, then false position in the logarithms.
    for _ in range(_TRIALS):
        found = deviation_under(force)
        if abs(found / PUSH_DEVIATION - 1.0) < _TOLERANCE or (found < PUSH_DEVIATION and force >= _MOST):
            break
        if found < PUSH_DEVIATION:
            low = force, found
        else:
            high = force, found
        if not np.isfinite(high[0]):
            force = min(force * float(np.clip(PUSH_DEVIATION / max(found, 1e-6), 1.2, 4.0)), _MOST)
        elif low[0] == 0.0:
            force *= float(np.clip(PUSH_DEVIATION / found, 0.1, 0.8))
        else:
            exponent = float(np.clip(np.log(PUSH_DEVIATION / low[1]) / np.log(high[1] / low[1]), 0.1, 0.9))
            force = low[0] * (high[0] / low[0]) ** exponent
    return force
