"""Recovery from a disturbance: deviation from the path and time until the arm is back, and the force of a push."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

# A push: its duration [s], and the deviation of a joint that it shall cause [ranges].
PUSH_TIME, PUSH_DEVIATION = 0.2, 0.1


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
    """The undisturbed path ``(K, n)`` of an arm, sampled evenly over its length."""

    def __init__(self, arm: Arm, q: Floats) -> None:
        self._range = arm.ranges
        scaled = q / self._range
        length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(scaled, axis=0), axis=1) + 1e-12))
        self._fractions = np.linspace(0.0, 1.0, 2000)
        columns = [np.interp(self._fractions, length / length[-1], column) for column in scaled.T]
        self._points = np.stack(columns, axis=1)

    def nearest(self, q: Floats) -> tuple[Floats, Floats]:
        """Distances ``(K,)`` of configurations ``(K, n)`` from the path, and the nearest places on it in [0, 1]."""
        distance = cdist(q / self._range, self._points, "chebyshev")
        # Many points may be equally near in the furthest joint: the Euclidean distance breaks the tie.
        index = (distance + 1e-6 * cdist(q / self._range, self._points)).argmin(axis=1)
        return distance[np.arange(len(q)), index], self._fractions[index]

    def recovery(self, t: Floats, q: Floats, begin: float, end: float) -> PathRecovery:
        """How an arm disturbed from ``begin`` to ``end`` [s] recovers; ``q`` is ``(K, n)`` at the times ``t``."""
        after = np.flatnonzero(t >= begin)
        distance, at = self.nearest(q[after])
        deviation = float(distance.max())
        outside = np.flatnonzero(distance > 0.1 * deviation)
        last = int(outside[-1]) + 1 if outside.size else 0
        if last >= len(after):
            return PathRecovery(deviation, None, None)
        back, first = max(last, int(np.searchsorted(t[after], end))), float(at[0])
        back = min(back, len(after) - 1)
        fraction = (float(at[back]) - first) / max(1.0 - first, 1e-9)
        return PathRecovery(deviation, max(float(t[after][back] - end), 0.0), fraction)


def pushing_force(deviation_under: Callable[[float], float]) -> float:
    """Force [N] that makes a joint deviate by 8 to 12 % of its range, or the last one tried; at most 20 kN.

    It must be found in the run itself. Drives resist a growing force almost rigidly up to their limits, then yield
    suddenly: half as much force again throws the arm ten times as far. Where that begins depends on the configuration,
    on the forces that the motion itself takes, and on the policy.

    Args:
        deviation_under: maps a force to the largest deviation of a joint from the undisturbed path in units of its
            range.
    """
    # A guess [N], largest force [N], and the brackets: force and deviation.
    force, most, low, high = 300.0, 2e4, (0.0, 0.0), (np.inf, np.inf)
    # Bracketing, then false position in the logarithms.
    for _ in range(12):
        result = deviation_under(force)
        if abs(result / PUSH_DEVIATION - 1.0) < 0.2 or (result < PUSH_DEVIATION and force >= most):
            break
        if result < PUSH_DEVIATION:
            low = force, result
        else:
            high = force, result
        if not np.isfinite(high[0]):
            force = min(force * float(np.clip(PUSH_DEVIATION / max(result, 1e-6), 1.2, 4.0)), most)
        elif low[0] == 0.0:
            force *= float(np.clip(PUSH_DEVIATION / result, 0.1, 0.8))
        else:
            exponent = float(np.clip(np.log(PUSH_DEVIATION / low[1]) / np.log(high[1] / low[1]), 0.1, 0.9))
            force = low[0] * (high[0] / low[0]) ** exponent
    return force
