"""What every planner is given: an arm, where it is, where it shall be, and how long that may take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.budget import DEFAULT_TIME_BUDGET, as_time_budget
from lieednn_sim.errors import InputError
from lieednn_sim.planning.motion import count_steps, slowed_down
from lieednn_sim.validation import as_positive, as_seed

Floats = NDArray[np.float64]
_Made = TypeVar("_Made")

# A motion takes at most this many of the problem's durations.
LONGEST = 3.0


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """A motion to plan from rest to rest; what is stored is what was checked.

    Attributes:
        arm: the arm.
        start: ``(n,)`` joint position at rest [rad, m].
        target: ``(n,)`` joint position to come to rest at [rad, m].
        duration: of the motion [s]; it may take up to `LONGEST` times as long where the arm's limits need it.
        seed: of planners that draw; the same seed gives the same motion.
        time_budget: CPU time that a planner may take [s]; infinity for no limit. One that needs less makes the same
            motion whatever the budget and the machine, one that needs more makes none.

    Raises:
        InputError: a value is malformed, or start or target are out of the arm's reach: beyond a limit, or where
            something comes closer than `PLANNED_CLEARANCE`.
    """

    arm: Arm
    start: Floats
    target: Floats
    duration: float = 4.0
    seed: int = 0
    time_budget: float = DEFAULT_TIME_BUDGET

    def __post_init__(self) -> None:
        if not isinstance(self.arm, Arm):
            raise InputError(f"arm must be an Arm, got {type(self.arm).__name__}; see Arm.load")
        for name in ("start", "target"):
            position = self.arm.check_reachable(getattr(self, name), name).copy()
            position.setflags(write=False)
            object.__setattr__(self, name, position)
        object.__setattr__(self, "duration", as_positive("duration", self.duration))
        object.__setattr__(self, "seed", as_seed("seed", self.seed))
        object.__setattr__(self, "time_budget", as_time_budget("time_budget", self.time_budget))
        count_steps(self.duration, self.timestep)

    @property
    def timestep(self) -> float:
        """Time step of the arm's model, the sampling period of every motion [s]."""
        return float(self.arm.model.opt.timestep)

    def times(self) -> Floats:
        """Sampling times ``(K,)`` from 0 to the duration, rounded to a whole number of time steps [s]."""
        count = count_steps(self.duration, self.timestep) + 1
        return self.timestep * np.arange(count, dtype=np.float64)


def in_time(make: Callable[[PlanningProblem], _Made], problem: PlanningProblem) -> _Made:
    """What ``make`` gives for a problem, or with the least duration that it asks for, up to `LONGEST` times as long.

    Raises:
        TooFastError: even that is not enough.
    """
    return slowed_down(
        lambda duration: make(replace(problem, duration=duration)), problem.duration, LONGEST * problem.duration
    )
