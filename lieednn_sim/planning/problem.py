"""The input and result of every planner, and the rule for motions that are too fast."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from lieednn_sim.arm import Arm, TaskSpaceRegion
from lieednn_sim.errors import InputError, TooFastError
from lieednn_sim.network import ComponentwiseNetwork
from lieednn_sim.planning.clearance import Clearance, proved_clearance
from lieednn_sim.planning.load_clearance import load_clearance
from lieednn_sim.planning.motion import Motion, count_steps
from lieednn_sim.planning.path_constraints import end_outside
from lieednn_sim.validation import as_floats, as_positive, as_seed
from lieednn_sim.values import Floats, check_fields, frozen, read_only, set_fields

_Made = TypeVar("_Made")

#: The duration of a motion [s], or a pair: that and the longest duration that it may take.
Duration = float | tuple[float, float]
#: The one of plans for which none is given: slow arms get the time that they need.
USUAL_DURATION = 4.0, 60.0


def durations(value: Duration) -> tuple[float, float]:
    """The duration and the longest one allowed, by default three times as long; `InputError` for anything else."""
    if isinstance(value, tuple | list):
        shortest, longest = as_floats("duration, a pair of it and of the longest,", value, (2,))
        if longest < shortest:
            raise InputError(f"the longest duration must be at least the duration, {shortest:g} s, got {longest:g}")
        return as_positive("duration", float(shortest)), float(longest)
    shortest = as_positive("duration", value)
    return shortest, 3.0 * shortest


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """What a planner has to solve: the arm, start, target and duration of a motion from rest to rest.

    The arguments are those of `plan`. They are checked when the problem is made.

    Attributes:
        arm: the arm.
        start: ``(n,)`` joint position at rest [rad, m].
        target: ``(n,)`` joint position at the end, at rest [rad, m].
        duration: duration of the motion [s].
        seed: seed of randomised planners.
        longest: largest duration that the motion may take if limits require it [s]; by default three times as long.
        path_constraint: region in which the end effector stays on the way; none if it may go anywhere.

    Raises:
        InputError: a value is malformed, or start or target cannot be used, since it is beyond a limit, closer to
            contact than the arm's `clearance`, or outside the region to keep.
    """

    arm: Arm
    start: Floats
    target: Floats
    duration: float = 4.0
    seed: int = 0
    longest: float = math.nan
    path_constraint: TaskSpaceRegion | None = None

    def __post_init__(self) -> None:
        set_fields(self, **{name: self.arm.check_reachable(getattr(self, name), name) for name in ("start", "target")})
        for name in ("start", "target"):
            if off := end_outside(self.arm, self.path_constraint, getattr(self, name)):
                raise InputError(f"at the {name} the end effector is outside the region to keep: by {off}")
        if self.longest != self.longest:
            set_fields(self, longest=3.0 * as_positive("duration", self.duration))
        check_fields(self, as_positive, "duration", "longest")
        check_fields(self, as_seed, "seed")
        count_steps(self.duration, self.timestep)

    @property
    def timestep(self) -> float:
        """Time step of the arm's model, the sampling period of every motion [s]."""
        return self.arm.timestep

    def times(self) -> Floats:
        """Sampling times ``(K,)`` from 0 to the duration, rounded to a whole number of time steps [s]."""
        return self.timestep * np.arange(count_steps(self.duration, self.timestep) + 1, dtype=np.float64)


@frozen
class Plan:
    """A planned motion, the network that made it if there is one, and how it was planned.

    Planners return it with the first three attributes; `plan` adds the others.

    Attributes:
        motion: from rest at the start to rest at the target, within limits and free of contact (`motion.check_motion`).
        network: the network that made the motion, with the target as its equilibrium; None for planners without one.
        details: further results of some planners: `certified.CertifiedDetails` or `shaped.ShapedDetails`.
        target: ``(n,)`` joint target [rad, m].
        planner: name of the planner.
        cpu_time: CPU time that planning took [s].
        guide: the plan that the motion follows, with its planner's name, only partly checked; None if it follows none.
        arm: the arm that it was planned for.
        leaves: what is nearer than the arm's clearance at the start, and how near, in words; empty where nothing is.
    """

    motion: Motion
    network: ComponentwiseNetwork | None = None
    details: Any = None
    target: Floats = field(default_factory=lambda: np.empty(0), repr=False)
    planner: str = ""
    cpu_time: float = math.nan
    guide: Plan | None = None
    arm: Arm | None = field(default=None, repr=False, compare=False)
    leaves: str = ""

    @property
    def certificate(self) -> str:
        """What the network's certificate says, in a few words; for what is proved about contact see `clearance`."""
        return "no network, no proof" if self.network is None else str(self.network.certificate or "not certified")

    def __repr__(self) -> str:
        return f"<Plan by {self.planner or 'a planner'}: {self.motion!r}, {self.network!r}>"

    def __str__(self) -> str:
        if self.arm is None:
            return repr(self)
        tip = ", ".join(f"{value:.3f}" for value in self.arm.tip(self.motion.q[-1]))
        moved = f"{self.planner}: {self.arm.name} in {self.t[-1]:g} s, end effector to ({tip}) m"
        return f"{moved}\n{self.certificate}\nclearance: {self.clearance}"

    @property
    def t(self) -> Floats:
        """``(K,)`` times from 0 [s]."""
        return self.motion.t

    @cached_property
    def qpos(self) -> Floats:
        """``(K, nq)`` positions of the arm's model; in a view's model, what is not part of the arm stays in place."""
        return read_only(self._of_arm().qpos(self.motion.q))

    @cached_property
    def qvel(self) -> Floats:
        """``(K, nv)`` velocities of the arm's model; zero for what does not belong to the arm."""
        return read_only(self._of_arm().qvel(self.motion.q, self.motion.qd))

    @cached_property
    def clearance(self) -> Clearance:
        """A proved lower bound of the distances from contact at every instant, computed when it is first asked for."""
        return proved_clearance(self._of_arm(), self.t, self.motion.q, self.motion.qd, others=True)

    @cached_property
    def load_clearance(self) -> Clearance | None:
        """The `clearance` of a hanging load as it swings, by a linear model; None where nothing swings."""
        return load_clearance(self._of_arm(), self.motion)

    @property
    def proved(self) -> bool:
        """Whether it is proved that nothing touches at any instant; `clearance` says in which stretches it is not."""
        return self.clearance.proved

    def _of_arm(self) -> Arm:
        if self.arm is None:
            raise InputError("only a plan of `plan` knows its arm; take arm.qpos(plan.motion.q)")
        return self.arm


def in_time(make: Callable[..., _Made], problem: PlanningProblem, *options: Any) -> _Made:
    """Call ``make(problem, *options)``; if the motion is too fast, again with the duration that it needs.

    All planners follow this rule, so that a comparison does not depend on the duration asked for. `TooFastError` if
    even ``problem.longest`` is not enough.
    """
    time_reserve = 1.02  # factor on the duration that the motion needs, which is estimated from samples
    while True:
        try:
            return make(problem, *options)
        except TooFastError as error:
            slower = time_reserve * max(error.duration, problem.duration)
            if slower > problem.longest:
                raise
            problem = replace(problem, duration=slower)
