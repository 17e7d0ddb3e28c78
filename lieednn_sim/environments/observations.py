"""Observations of many environments at once: a row each, which holds named arrays with bounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieednn_sim.environments.bounds import Bounds
from lieednn_sim.environments.frames import to_go
from lieednn_sim.values import Floats


class Observations:
    """Computes rows that hold the observations of a task, clipped to their bounds.

    A row is clipped and copied in the time that each of its arrays would take.

    Args:
        bounds: bounds by name: those of `common_bounds`, then those of a task's additional observations.
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
            frames: goal frames ``(..., F, 16)`` of the arm, see `SiteFrames`.
            q: joint positions ``(..., n)``.
            qd: joint velocities ``(..., n)``.
            command: commanded positions ``(..., n)``.
            target: positions ``(..., n)``, frames ``(..., F, 16)``, and a task's additional observations, flat.
        """
        wanted, goals, *more = target
        twist, distance, angle = to_go(frames, goals)
        values = [q, qd, command, wanted - q, twist.reshape(*q.shape[:-1], -1), *more]
        # Twice as fast as np.clip.
        clipped = np.minimum(np.maximum(np.concatenate(values, axis=-1), self._low), self._high)
        return clipped, distance, angle

    def split(self, rows: Floats) -> dict[str, Floats]:
        """The observations by name, views of rows ``(..., size)``."""
        batch = rows.shape[:-1]
        parts = {name: rows[..., part] for name, part, _ in self._parts}
        return parts | {name: parts[name].reshape(*batch, *shape) for name, _, shape in self._parts if len(shape) > 1}
