"""Obstacles that move in a simulation, along given places, whatever they touch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, set_fields


@dataclass(frozen=True)
class MovingObstacle:
    """An obstacle that moves along straight lines between given places, at constant speed on each of them.

    It rests before the first time and after the last one. It is a body without joints that is put to its new place in
    each step: contacts act where it is, but know nothing of its velocity, so it drags nothing along by friction.

    Attributes:
        body: name of a body of the scene without joints.
        times: ``(K,)`` increasing times since the start of the rollout [s].
        positions: ``(K, 3)`` positions of the body at these times, in the frame of its parent [m].

    Raises:
        InputError: the times do not increase, or a value is malformed.
    """

    body: str
    times: tuple[float, ...]
    positions: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        times = as_floats("times", self.times, ("K",))
        positions = as_floats("positions", self.positions, (len(times), 3))
        if not len(times) or (np.diff(times) <= 0.0).any():
            raise InputError(f"times must hold at least one time, and increase, got {self.times}")
        set_fields(self, times=tuple(times.tolist()), positions=tuple(map(tuple, positions.tolist())))

    def at(self, time: float) -> Floats:
        """Position of the body ``(3,)`` at a time [s]; `InputError` if that is no finite number."""
        now = float(as_floats("time", time, ()))
        return np.array([np.interp(now, self.times, column) for column in zip(*self.positions, strict=True)])
