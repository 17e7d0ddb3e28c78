"""How far a push takes an arm off its path, and how long and how far it goes until it is back on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

# Back on the path is who is within this share of the largest distance from it, for good.
BACK = 0.1
# Postures of the path that are compared with, even over its length.
_SAMPLES = 2000


@dataclass(frozen=True)
class Return:
    """After a disturbance; distances of postures are the largest difference of a joint, as a share of its range.

    Attributes:
        off: largest distance from the path.
        time_s: from the disturbance's end until the distance stays within a tenth of that; None when it does not.
        share: of the path that was left when the disturbance began, how much was gone then; None likewise.
    """

    off: float
    time_s: float | None
    share: float | None


class Path:
    """The way ``(K, n)`` that an arm goes undisturbed."""

    def __init__(self, arm: Arm, q: Floats) -> None:
        self._range = arm.ranges
        length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q / self._range, axis=0), axis=1) + 1e-12))
        self._shares = np.linspace(0.0, 1.0, _SAMPLES)
        even = np.interp(self._shares, length / length[-1], np.arange(len(q)))
        at = even.astype(int)
        after, rest = np.minimum(at + 1, len(q) - 1), (even - at)[:, None]
        self._points = ((1.0 - rest) * q[at] + rest * q[after]) / self._range

    def nearest(self, q: Floats) -> tuple[Floats, Floats]:
        """Distances ``(K,)`` of postures ``(K, n)``, and which share of the path's length its nearest points are at."""
        found = np.array([self._nearest(posture) for posture in q / self._range])
        return found[:, 0], found[:, 1]

    def recovery(self, t: Floats, q: Floats, begin: float, end: float) -> Return:
        """Of postures ``(K, n)`` at times ``(K,)``, disturbed from ``begin`` to ``end`` [s]."""
        after = np.flatnonzero(t >= begin)
        distance, at = self.nearest(q[after])
        off = float(distance.max())
        outside = np.flatnonzero(distance > BACK * off)
        last = int(outside[-1]) + 1 if outside.size else 0
        if last >= len(after):
            return Return(off, None, None)
        back, first = max(last, int(np.searchsorted(t[after], end))), float(at[0])
        back = min(back, len(after) - 1)
        share = (float(at[back]) - first) / max(1.0 - first, 1e-9)
        return Return(off, max(float(t[after][back] - end), 0.0), share)

    def _nearest(self, posture: Floats) -> tuple[float, float]:
        away = np.abs(self._points - posture)
        distance = away.max(axis=1)
        # Many points are as near in the joint that is furthest away: of these the one that is nearest in all.
        index = int((distance + 1e-6 * np.linalg.norm(away, axis=1)).argmin())
        return float(distance[index]), float(self._shares[index])
