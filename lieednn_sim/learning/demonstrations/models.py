"""The protocol of models of demonstrations, the simplest model, and integration for the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from lieednn_sim.budget import check_time
from lieednn_sim.learning.demonstrations.alignment import Demonstrations
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.values import Floats

DECAY = float(np.log(100.0))  # decay rate, per duration, that leaves a hundredth


class MotionModel(Protocol):
    """A model of a motion to the twist zero, relative to its goal as in `Demonstration.twists`."""

    @property
    def name(self) -> str:
        """Name of the kind of model."""

    @property
    def n_parameters(self) -> int:
        """The number of fitted parameters."""

    @property
    def durations(self) -> float:
        """Time after which the motion is almost at its end, in durations of the demonstrations."""

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """Twists ``(..., K, 6)`` at increasing times ``(K,)`` from 0 [s], starting at rest at twists ``(..., 6)``."""


@dataclass(frozen=True)
class LinearAttractor:
    """xi' = -k xi: straight in the chart, with k that leaves a hundredth after the demonstrations' duration."""

    duration: float
    name: ClassVar[str] = "linear-attractor"
    n_parameters: ClassVar[int] = 1
    durations: ClassVar[float] = 3.0

    @classmethod
    def fit(cls, demonstrations: Demonstrations, n_parameters: int = 1) -> LinearAttractor:
        """Fit k to the duration of the demonstrations; there is always one parameter."""
        return cls(demonstrations.duration)

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """As `MotionModel.reproduce`."""
        return start[..., None, :] * np.exp(-DECAY / self.duration * t)[:, None]


def run_field(
    field: Callable[[Floats], Floats], start: Floats, grid: Floats, t: Floats, kept: int | None = None
) -> Floats:
    """States ``(n, K, d)`` of x' = field(x) at times ``(K,)``, from states ``(n, d)`` at the first time of a grid.

    The classical Runge-Kutta method on the grid ``(G,)``, with linear interpolation. Of each state only the first
    ``kept`` coordinates are returned, by default all.
    """
    state = start
    states = [state[:, :kept]]
    for step in np.diff(grid):
        check_time()
        state = runge_kutta_step(field, state, step)
        states.append(state[:, :kept].copy())  # not a view, which would keep the whole state
    return at_times(np.stack(states, axis=1), grid, t)


def even_grid(end: float, step: float) -> Floats:
    """Evenly spaced times from 0 to at least ``end``."""
    return step * np.arange(float(np.ceil(end / step)) + 1.0)


def at_times(states: Floats, grid: Floats, t: Floats) -> Floats:
    """Linear interpolation of states ``(n, G, d)`` on increasing times ``(G,)`` to times ``(K,)``."""
    index = np.clip(np.searchsorted(grid, t, side="right") - 1, 0, len(grid) - 2)
    fraction = np.clip((t - grid[index]) / (grid[index + 1] - grid[index]), 0.0, 1.0)[:, None]
    return (1.0 - fraction) * states[:, index] + fraction * states[:, index + 1]
