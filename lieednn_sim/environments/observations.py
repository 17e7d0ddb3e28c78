"""What is observed of arms, of many environments at once: a row each, of arrays with names and bounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieednn_sim.environments.bounds import Bounds
from lieednn_sim.environments.frames import to_go
from lieednn_sim.values import Floats


class Observations:
    """Rows that hold the observations of a task, clipped to their bounds.

    One row is clipped and copied at once, where its arrays would take as long each.

    Args:
        bounds: of the observations by name: those of `common_bounds`, then what a task adds.
    """

    def __init__(self, bounds: Bounds) -> None:
        lows, highs = zip(*bounds.values(), strict=True)
        self._low, self._high = (np.concatenate([limit.ravel() for limit in limits]) for limits in (lows, highs))
        self.size = len(self._low)
        self._parts: list[tuple[str, slice, tuple[int, ...]]] = []
        begin = 0
        for name, (low, _) in bounds.items():
            self._parts.append((name, slice(begin, begin + low.size), low.shape))
            begin += low.size

    def rows(
        self, frames: Floats, q: Floats, qd: Floats, command: Floats, target: Sequence[Floats]
    ) -> tuple[Floats, Floats, Floats]:
        """Rows ``(..., size)``, and the largest distance [m] and angle [rad] ``(...)`` of a frame from its goal.

        Args:
            frames: ``(..., F, 16)``, see `SiteFrames`.
            q: ``(..., n)``.
            qd: ``(..., n)``.
            command: ``(..., n)``.
            target: position ``(..., n)``, frames ``(..., F, 16)``, and what a task adds, flat.
        """
        wanted, goals, *more = target
        twist, distance, angle = to_go(frames, goals)
        values = [q, qd, command, wanted - q, twist.reshape(*q.shape[:-1], -1), *more]
        # As np.clip, twice as fast.
        clipped = np.minimum(np.maximum(np.concatenate(values, axis=-1), self._low), self._high)
        return clipped, distance, angle

    def split(self, rows: Floats) -> dict[str, Floats]:
        """The observations by name, views of rows ``(..., size)``."""
        batch = rows.shape[:-1]
        return {name: rows[..., part].reshape(*batch, *shape) for name, part, shape in self._parts}
