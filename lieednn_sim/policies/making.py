"""Policies by name: the task that one is made for, `make_policy`, and registering one's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning import Motion, Plan, plan
from lieednn_sim.planning.motion import usual_rate
from lieednn_sim.planning.options import PlannerOptions, given_options
from lieednn_sim.policies.base import Policy
from lieednn_sim.policies.feedback import FEEDBACK, Feedback
from lieednn_sim.registry import POLICIES
from lieednn_sim.validation import Seed, as_positive, as_seed
from lieednn_sim.values import Floats, check_fields

#: Policies of the package that need a planned motion, and those that follow one if it is given.
PLANNED = "dmp", "tracker"
FOLLOWERS = "lieednn-chunks", "lieednn-replanning", *PLANNED

_Make = TypeVar("_Make", bound=Callable[..., Policy])


@dataclass(frozen=True, eq=False)
class PolicyTask:
    """The task for which a policy is made.

    Its fields are the arguments of `make_policy`, with joint coordinates ``(n,)`` for start and first target, and
    ``given`` for a plan or motion that was given.
    """

    arm: Arm
    start: Floats
    target: Floats
    rate: float = 100.0
    feedback: Feedback | None = FEEDBACK
    convergence_rate: float = 2.0
    seed: int = 0
    given: Motion | Plan | None = None

    def __post_init__(self) -> None:
        check_fields(self, lambda name, value: self.arm.check_position(value, name), "start", "target")
        check_fields(self, as_positive, "rate", "convergence_rate")
        check_fields(self, as_seed, "seed")

    @cached_property
    def motion(self) -> Motion:
        """The motion to track or to imitate: the one that was given, or one that the default planner makes."""
        given = self.given or plan(self.arm, self.target, start=self.start, seed=self.seed)
        return given.motion if isinstance(given, Plan) else given


def register_policy(name: str, options: type[PlannerOptions] | None = None) -> Callable[[_Make], _Make]:
    """Decorator that registers a function of a `PolicyTask` that makes a `Policy`, for `make_policy`.

    An installed package declares its policies as entry points of the group ``lieednn_sim.policies``; a function
    declared like this needs the decorator only if it takes options.

    Args:
        name: name of the policy, in lower-case letters, digits and hyphens.
        options: class of its options, which are its second argument.

    Raises:
        InputError: the name is malformed or taken.
    """
    return POLICIES.register(name, options)


def make_policy(
    name: str,
    arm: Arm,
    target: ArrayLike | str | Plan | Motion,
    *,
    rate: float | None = None,
    start: ArrayLike | str = "home",
    feedback: Feedback | None = FEEDBACK,
    convergence_rate: float = 2.0,
    options: PlannerOptions | None = None,
    seed: Seed = 0,
) -> Policy:
    """Make a policy by name, reset at the start; `FilteredPolicy` puts a safety filter around it.

    Args:
        name: a name of `POLICIES`, or ``file.py:function`` of one's own.
        arm: the arm, in its scene.
        target: joint coordinates ``(n,)``, or a keyframe's name, for which networks are made; a step may have another
            target. Or a plan or a motion that ends there: ``tracker`` tracks it, and ``dmp``, ``lieednn-replanning``
            and ``lieednn-chunks`` begin with it. Without one these plan their own; other policies refuse it.
        rate: control rate [Hz]; by default 100, or the nearest rate that divides that of the model's steps.
        start: joint coordinates ``(n,)`` at the beginning, or a keyframe's name.
        feedback: settings of the feedback from the measured joints; None for no feedback.
        convergence_rate: rate at which a policy without a motion approaches the target [1/s].
        options: options of the policy, of its class in `POLICIES`; by default that class's defaults.
        seed: seed of random draws; the same seed gives the same policy.

    Raises:
        InputError: a value is malformed, the policy is unknown, or the options belong to another one.
        NotCertifiedError: no network could be certified.
        PlanError: no motion was found.
    """
    entry = POLICIES.find(name)
    given = given_options(f"the policy {name!r}", entry.options, options)
    planned = target if isinstance(target, Plan | Motion) else None
    if isinstance(target, Plan):
        target = target.target if len(target.target) else target.motion
    end = target.q[-1] if isinstance(target, Motion) else target
    ends = arm.check_start(start), arm.configuration(end, "target")
    rate = usual_rate(arm.timestep) if rate is None else rate
    task = PolicyTask(arm, *ends, rate, feedback, convergence_rate, as_seed("seed", seed), planned)
    policy = entry.load()(task, *given)
    if not isinstance(policy, Policy):
        raise InputError(f"policy {name!r} must be a Policy, its function returned {type(policy).__name__}")
    policy.reset(task.start)
    if planned and "motion" not in vars(task):
        others = f"{', '.join(sorted(FOLLOWERS))}, or a NetworkPolicy of the plan's network"
        raise InputError(f"policy {name!r} would go to the end of this motion on a way of its own; take {others}")
    return policy
