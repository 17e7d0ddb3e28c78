"""The tasks: reach a target and stay there, and track one that moves."""

from __future__ import annotations

import math
from collections.abc import Collection
from functools import cached_property
from inspect import signature
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.environments.base import ArmTask
from lieednn_sim.environments.observations import Bounds, Target, goal_frames
from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_choice, as_count, as_positive, quoted
from lieednn_sim.values import Floats, StrPath

__all__ = ["TASKS", "Reach", "Track", "make_task"]

REST = 0.01  # a joint is at rest below this fraction of its velocity limit
_DRAWS = 40  # attempts to draw a random trajectory


class Closeness:
    """Closeness to a target: 1 within the tolerances, otherwise less.

    Half of it falls linearly with distance and angle, to 0 at the reach of the arm and at pi, so that it guides a
    learner from everywhere. The near part and the fine part, a quarter each, have narrow margins and are products of a
    term for the distance and one for the angle. A term is a tenth where its error exceeds the tolerance by the margin.
    Terms of further errors, whose tolerances and margins are ``more``, are factors of the fine part.
    """

    def __init__(self, task: ArmTask, *more: tuple[float, float]) -> None:
        self._farthest = np.array([task.arm.reach, np.pi])
        allowed = 2 * (task.position_tolerance, task.rotation_tolerance)
        # Margins of the near part, then of the fine part [m, rad].
        margins = 0.05, 0.1, 0.005, 0.01
        self._allowed, self._margins = np.array([*zip(allowed, margins, strict=True), *more]).T

    def __call__(self, distance: Floats, angle: Floats, *more: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Closeness at distances [m], angles [rad] and further errors, and whether all are allowed; all ``(...)``."""
        errors = np.array([distance, angle, distance, angle, *more]).T
        beyond = np.maximum(errors - self._allowed, 0.0)
        far, far_turn = np.minimum(beyond[..., :2] / self._farthest, 1.0).T
        # A term is 1 / (1 + 9 x^2) at x margins beyond the tolerance, as in dm_control.
        margins = beyond / self._margins
        near, near_turn, *fine = (1.0 / (1.0 + 9.0 * margins * margins)).T
        closeness = np.asarray(0.25 * (2.0 - far - far_turn + near * near_turn + math.prod(fine)))
        return closeness, np.asarray((errors <= self._allowed).all(axis=-1)).T


class Reach(ArmTask):
    """Task: come to rest at a random target that the arm can reach, drawn for each episode by `draw_target`.

    Success: the goal frames are within the tolerances, and no joint moves faster than `REST` of its limit. The reward
    is the closeness of distance, angle and rest; it is 1 exactly at success. To choose the target of an episode, begin
    it with the option ``target``, a joint position ``(n,)``.
    """

    @cached_property
    def _closeness(self) -> Closeness:
        # The reward for resting falls to a tenth at half the velocity limits beyond `REST`.
        return Closeness(self, (REST, 0.5))

    def draw(self, rng: np.random.Generator, options: dict[str, Any]) -> Target:
        """See `ArmTask`."""
        chosen = options.pop("target", None)
        _refuse("reset options", options, ["target"])
        # Drawn in any case, so that the generator's state does not depend on the options.
        seed = int(rng.integers(2**32))
        q = draw_target(self.arm, seed) if chosen is None else self.arm.check_position(chosen, "target")
        rows = q, goal_frames(self.arm, q, self.frames)
        # The target does not move.
        return Target(lambda _: q.copy(), tuple(np.broadcast_to(row, (self.steps + 1, *row.shape)) for row in rows))

    def judge(self, distance: Floats, angle: Floats, qd: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """See `ArmTask`; unchecked."""
        speed = np.maximum.reduce(np.abs(qd / self.arm.velocity_limits), axis=-1)
        return self._closeness(distance, angle, speed)


class Track(ArmTask):
    """Task: track a target that moves from ``home`` within the arm's limits and free of contact (`band_limited`).

    Additional observations are ``target_velocity`` ``(n,)`` and ``preview`` ``(P, n)``, the target positions at the
    ends of this and the following control steps. Success: the goal frames are within the tolerances now, by default
    half a centimetre, since no servo tracks exactly. The reward is the closeness, 1 exactly at success.

    Args:
        preview: number P of previewed target positions.
        arm, options: as in `ArmTask`.
    """

    position_tolerance, rotation_tolerance = 5e-3, float(np.deg2rad(0.5))

    def __init__(self, arm: str | Arm = "telescopic_pr", *, preview: int = 5, **options: Any) -> None:
        # Limited, since the targets must fit into a learner's memory.
        self.preview = as_count("preview", preview, most=10_000)
        super().__init__(arm, **options)

    def _more_bounds(self) -> Bounds:
        velocity = self.arm.velocity_limits
        low, high = (np.tile(limit, (self.preview, 1)) for limit in self.arm.position_limits.T)
        return {"target_velocity": (-velocity, velocity), "preview": (low, high)}

    @cached_property
    def _closeness(self) -> Closeness:
        return Closeness(self)

    def draw(self, rng: np.random.Generator, options: dict[str, Any]) -> Target:
        """See `ArmTask`."""
        _refuse("reset options", options)
        ends = self.control_timestep * np.arange(self.steps + self.preview + 1)
        path = band_limited(self.arm, rng, (self.steps + self.preview) * self.control_timestep)
        q = path(ends)
        now = slice(self.steps + 1)
        # Previews are overlapping windows, which are views and not copied.
        previews = sliding_window_view(q[1:].ravel(), self.preview * self.arm.n_joints)[:: self.arm.n_joints]
        rows = q[now], goal_frames(self.arm, q[now], self.frames), path(ends[now], 1), previews
        return Target(lambda time: path(np.clip(time, 0.0, path.x[-1])), rows)

    def judge(self, distance: Floats, angle: Floats, qd: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """See `ArmTask`; unchecked."""
        return self._closeness(distance, angle)


#: Tasks by name.
TASKS: dict[str, type[ArmTask]] = {"reach": Reach, "track": Track}


def make_task(task: str, arm: StrPath | Arm = "telescopic_pr", **options: Any) -> ArmTask:
    """Make a task of `TASKS` by its name, with its options; an `InputError` lists the names."""
    kind = TASKS[as_choice("task", task, TASKS)]
    # Options of the task itself, and of every task.
    known = {*signature(kind).parameters, *signature(ArmTask).parameters} - {"arm", "options"}
    _refuse(f"options of task {task!r}", set(options) - known, known)
    return kind(arm, **options)


def _refuse(what: str, unknown: Collection[str], known: Collection[str] = ()) -> None:
    if unknown:
        names = ", ".join(map(quoted, sorted(unknown, key=str)))
        raise InputError(f"unknown {what}: {names}; known: {', '.join(sorted(known)) or 'none'}")


def band_limited(arm: Arm, rng: np.random.Generator, duration: float) -> CubicHermiteSpline:
    """A random joint trajectory ``(n,)`` [rad, m] over time [s], within the limits and free of contact.

    q(t) = home + r(t) (m + h u(t) - home), elementwise, where u is a sum of three sines of 0.1 to 0.5 Hz with random
    weights, frequencies and phases, |u| <= 1; m - h and m + h are random positions within the limits; r rises from 0,
    at rest at ``home``, to 1 by the minimum-jerk law. A trajectory that exceeds half the velocity or acceleration
    limits is slowed down as a whole. `NoSolutionError` if every attempt touches something.
    """
    total = as_positive("duration", duration)
    # The spread, a fraction of the joint ranges, is reduced after a contact.
    home, spread = arm.keyframe("home"), 0.8
    for _ in range(_DRAWS):
        trajectory = _draw(arm, rng, home, total, spread)
        checked = trajectory(np.linspace(0.0, total, int(np.ceil(10.0 * total)) + 1))
        if not any(arm.contacts(q) for q in checked):
            return trajectory
        spread *= 0.85
    raise NoSolutionError(f"no random trajectory of arm {arm.name!r} is free of contact; use another scene or seed")


def _draw(arm: Arm, rng: np.random.Generator, home: Floats, total: float, spread: float) -> CubicHermiteSpline:
    n = len(home)
    low, high = arm.position_limits.T.copy()
    for ball in arm.space.balls:
        # Limits of the cube inscribed in the ball.
        low[ball], high[ball] = low[ball] / np.sqrt(3.0), high[ball] / np.sqrt(3.0)
    # Closer to home as the spread shrinks; convex combinations stay within the limits.
    ends = np.sort(home + spread * (rng.uniform(low, high, (2, n)) - home), axis=0)
    middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
    weights = rng.dirichlet(np.ones(3), n)
    omega = 2.0 * np.pi * rng.uniform(0.1, 0.5, (n, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (n, 3))
    # The times are long enough even if the trajectory is not slowed down.
    t = np.linspace(0.0, total, int(np.ceil(total / 0.02)) + 1)
    angle = omega * t[:, None, None] + phase
    wave = middle + half * (weights * np.sin(angle)).sum(axis=-1) - home
    wave_rate = half * (weights * omega * np.cos(angle)).sum(axis=-1)
    onset = min(1.5, total)
    rise, slope = (values[:, None] for values in minimum_jerk_law(np.minimum(t / onset, 1.0)))
    q, qd = home + rise * wave, slope / onset * wave + rise * wave_rate
    factor = max(1.0, slowdown(arm, t, qd, 0.5))
    return CubicHermiteSpline(t * factor, q, qd / factor)


def slowdown(arm: Arm, t: Floats, qd: Floats, fraction: float) -> float:
    """Factor of time at which the fastest joint just reaches a fraction of its limits; 0 if nothing moves."""
    velocity = (np.abs(qd) / arm.velocity_limits).max()
    acceleration = (np.abs(np.gradient(qd, t, axis=0)) / arm.acceleration_limits).max()
    return float(max(velocity / fraction, np.sqrt(acceleration / fraction)))


typecheck_public(globals())
