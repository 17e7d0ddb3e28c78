"""Targets, states and observations of episodes; observations are named arrays with bounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

Observation = dict[str, Floats]
# Lower and upper bounds by name.
Bounds = dict[str, tuple[Floats, Floats]]

# Observed positions exceed their limits by at most this fraction of their range, and velocities are at most this
# multiple of their limits: servos overshoot slightly, and contacts push.
_POSITION_SLACK_FRACTION, _VELOCITY_LIMIT_FACTOR = 0.1, 5.0


def common_bounds(arm: Arm, frames: int) -> Bounds:
    """Bounds of the observations that all tasks have, with this number of goal frames."""
    low, high = arm.position_limits.T
    slack = _POSITION_SLACK_FRACTION * (high - low)
    velocity = _VELOCITY_LIMIT_FACTOR * arm.velocity_limits
    span = high - low + 2.0 * slack
    # |v| <= (pi / 2) |p| for a pose with translation p, whose length is at most twice the reach.
    twist = np.tile(np.repeat([np.pi, np.pi * reach(arm)], 3), (frames, 1))
    return {
        "position": (low - slack, high + slack),
        "velocity": (-velocity, velocity),
        "command": (low.copy(), high.copy()),
        "position_error": (-span, span),
        "approach": (-np.ones_like(span), np.ones_like(span)),
        "pose_error": (-twist, twist),
    }


def reach(arm: Arm) -> float:
    """Upper bound of the distance of link frames from the base [m]: lengths between frames plus travel of slides."""
    lengths = np.linalg.norm(arm.mounts.translation, axis=-1) + np.linalg.norm(arm.tips.translation, axis=-1)
    slides = np.array([unit == "m" for unit in arm.space.units])
    return float(lengths.sum() + np.abs(arm.position_limits[slides]).max(axis=1).sum())


class Target(NamedTuple):
    """The target of an episode, which may move.

    Attributes:
        position: joint target ``(n,)`` at a time of the episode [s].
        rows: after each number of control steps, from 0 to S: joint targets ``(S + 1, n)``, goal frames
            ``(S + 1, F, 16)`` as rows of `LinkFrames`, and a task's additional observations ``(S + 1, k)``.
    """

    position: Callable[[float], Floats]
    rows: tuple[Floats, ...]

    def after(self, steps: int) -> list[Floats]:
        """The rows after some control steps."""
        return [values[steps] for values in self.rows]


class State(NamedTuple):
    """The state of one episode after a control step or, with leading axes, of many, but for the physics in MuJoCo.

    Attributes:
        steps: numbers of control steps done ``(...)``.
        command: commanded positions ``(..., n)``.
        row: observations ``(..., size)``, see `Observations.rows`.
        reward: rewards ``(...)`` in [0, 1].
        success: whether the arm is at its target ``(...)``.
        distance: largest distance of a goal frame from its target ``(...)`` [m].
        angle: the same as an angle ``(...)`` [rad].
        failure: reasons ``(...)`` for which the next step failed in the simulation, or empty.
    """

    steps: Any
    command: Floats
    row: Floats
    reward: Floats
    success: NDArray[np.bool_]
    distance: Floats
    angle: Floats
    failure: Any = ""

    def over(self, steps: int) -> Any:
        """Whether episodes that last ``steps`` control steps are over ``(...)``."""
        return (self.failure != "") | (self.steps >= steps)

    def info(self) -> dict[str, Any]:
        """Of one episode: ``success``, ``distance`` [m], ``angle`` [rad]; and ``failure``, the reason if it failed."""
        info = {"success": bool(self.success), "distance": float(self.distance), "angle": float(self.angle)}
        return info | {"failure": self.failure} if self.failure else info


class Observations:
    """Computes rows that hold all observations of a task, clipped to their bounds.

    Clipping and copying one row takes as long as it would for one of its arrays alone. The bounds are those of
    `common_bounds`, then those of a task's additional observations.
    """

    def __init__(self, bounds: Bounds) -> None:
        lows, highs = zip(*bounds.values(), strict=True)
        self._low, self._high = (np.concatenate([limit.ravel() for limit in limits]) for limits in (lows, highs))
        self.size = len(self._low)
        ends = np.cumsum([low.size for low in lows]).tolist()
        parts = zip(bounds, lows, ends, strict=True)
        self._parts = [(name, slice(end - low.size, end), low.shape) for name, low, end in parts]

    def rows(self, *values: Floats) -> Floats:
        """Rows ``(..., size)`` from arrays ``(..., k)``, one for each name in the order of the bounds."""
        # Twice as fast as np.clip.
        return np.minimum(np.maximum(np.concatenate(values, axis=-1), self._low), self._high)

    def split(self, rows: Floats) -> Observation:
        """The observations by name, views of rows ``(..., size)``."""
        batch = rows.shape[:-1]
        return {
            name: rows[..., part] if len(shape) == 1 else rows[..., part].reshape(*batch, *shape)
            for name, part, shape in self._parts
        }
