"""The input and result of every planner, and the rule for motions that are too fast."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.budget import DEFAULT_TIME_BUDGET, as_time_budget
from lieednn_sim.errors import InputError, TooFastError
from lieednn_sim.network import ComponentwiseNetwork
from lieednn_sim.planning.motion import Motion, count_steps
from lieednn_sim.validation import as_positive, as_seed
from lieednn_sim.values import Floats, check_fields, frozen

_Made = TypeVar("_Made")

# Factor on the duration that a too fast motion needs, since that is estimated from samples.
_SLOWER = 1.02


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """A motion to plan from rest to rest; values as for `plan`, stored as they were checked.

    Attributes:
        arm: the arm.
        start: ``(n,)`` joint position at rest [rad, m].
        target: ``(n,)`` joint position at rest at the end [rad, m].
        duration: duration of the motion [s].
        seed: seed of randomised planners.
        time_budget: CPU time that a planner may take [s].
        longest: largest duration that the motion may take, as a multiple of `duration`.
        progress: called with (done, total) after every candidate, by planners that draw a fixed number of them.

    Raises:
        InputError: a value is malformed, or start or target cannot be used: beyond a limit, or closer to contact than
            the arm's `clearance`.
    """

    arm: Arm
    start: Floats
    target: Floats
    duration: float = 4.0
    seed: int = 0
    time_budget: float = DEFAULT_TIME_BUDGET
    longest: float = 3.0
    progress: Callable[[int, int], None] | None = None

    def __post_init__(self) -> None:
        for name in ("start", "target"):
            position = self.arm.check_reachable(getattr(self, name), name).copy()
            position.setflags(write=False)
            object.__setattr__(self, name, position)
        check_fields(self, as_positive, "duration", "longest")
        if self.longest < 1.0:
            raise InputError(f"longest must be at least 1, the duration itself, got {self.longest:g}")
        check_fields(self, as_seed, "seed")
        check_fields(self, as_time_budget, "time_budget")
        count_steps(self.duration, self.timestep)

    @property
    def timestep(self) -> float:
        """Time step of the arm's model, the sampling period of every motion [s]."""
        return self.arm.timestep

    def times(self) -> Floats:
        """Sampling times ``(K,)`` from 0 to the duration, rounded to a whole number of time steps [s]."""
        count = count_steps(self.duration, self.timestep) + 1
        return self.timestep * np.arange(count, dtype=np.float64)


@frozen
class Plan:
    """Result of a planner; `plan` adds the target, the planner's name and the time.

    Attributes:
        motion: from rest at the start to rest at the target, within limits and free of contact (`motion.check_motion`).
        network: the network that made the motion, with the target as its equilibrium; None for planners without one.
        candidates: number of networks synthesised by ``lieednn-certified``; None for other planners.
        within_limits: number of these whose transient keeps the position limits.
        target: ``(n,)`` joint target [rad, m].
        planner: name of the planner.
        cpu_time: CPU time that planning took [s].
        teacher: for a shaped network, the plan that it follows, with its planner's name.
        deviation: largest distance of the end effector's path from the teacher's [m].
        fit_time: CPU time of the shaping [s].
    """

    motion: Motion
    network: ComponentwiseNetwork | None = None
    candidates: int | None = None
    within_limits: int | None = None
    target: Floats = field(default_factory=lambda: np.empty(0), repr=False)
    planner: str = ""
    cpu_time: float = math.nan
    teacher: Plan | None = None
    deviation: float | None = None
    fit_time: float | None = None


def in_time(make: Callable[..., _Made], problem: PlanningProblem, *options: Any) -> _Made:
    """The result of ``make(problem, *options)``; if the motion is too fast, of another call with the duration it needs.

    All planners share this rule, so that a comparison does not depend on the duration asked for.

    Raises:
        TooFastError: even ``problem.longest`` durations are not enough.
    """
    latest = problem.longest * problem.duration
    while True:
        try:
            return make(problem, *options)
        except TooFastError as error:
            slower = _SLOWER * max(error.duration, problem.duration)
            if slower > latest:
                raise
            problem = replace(problem, duration=slower, longest=latest / slower)
