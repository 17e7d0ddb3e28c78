"""The registry of policies, and `make_policy`, which makes any of them by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import Motion, Plan, ShapedOptions, plan
from lieednn_sim.planning.network_planners import without_weights
from lieednn_sim.planning.options import NetworkOptions, PlannerOptions, given_options
from lieednn_sim.planning.safety_filter import FilterOptions
from lieednn_sim.policies.base import Policy
from lieednn_sim.policies.fabric import Fabric, FabricOptions
from lieednn_sim.policies.feedback import FEEDBACK, Feedback
from lieednn_sim.policies.filtered import FilteredPolicy
from lieednn_sim.policies.network_policy import NetworkPolicy
from lieednn_sim.policies.path_integral import PathIntegral, PathIntegralOptions
from lieednn_sim.policies.primitive import MovementPrimitive, PrimitiveOptions
from lieednn_sim.policies.replanning import ReplanningOptions, ReplanningPolicy
from lieednn_sim.policies.tracker import MotionTracker
from lieednn_sim.registration import Registry
from lieednn_sim.synthesis import synthesize
from lieednn_sim.validation import Seed, as_choice, as_positive, as_seed
from lieednn_sim.values import Floats, check_fields

_Make = TypeVar("_Make", bound=Callable[..., Policy])


@dataclass(frozen=True, eq=False)
class PolicyTask:
    """The task for which a policy is made; the arguments are those of `make_policy`.

    Attributes:
        arm: the arm, in its scene.
        start: ``(n,)`` joint position at the beginning.
        target: ``(n,)`` the first target.
        rate: control rate [Hz].
        feedback: settings of the feedback from the measured joints; None for no feedback.
        convergence_rate: rate at which a policy without a motion approaches the target [1/s].
        seed: seed of random draws.
        given: the motion or plan given to track or to imitate, or None.

    Raises:
        InputError: a value is malformed.
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


@dataclass(frozen=True)
class CertifiedPolicyOptions(NetworkOptions):
    """Options of the policy ``lieednn-certified``.

    Attributes:
        bias_magnitude: magnitude of the network's bias [gamma/mu].

    Raises:
        InputError: a value is out of range.
    """

    bias_magnitude: float = 0.25


class PolicyKind(NamedTuple):
    """A function that makes policies, and the class of its options.

    Attributes:
        make: takes a `PolicyTask`, and options if there are any.
        options: class of the options; None for policies without options.
    """

    make: Callable[..., Policy]
    options: type[PlannerOptions] | None = None


def _shaped(task: PolicyTask, options: ShapedOptions) -> Policy:
    how: dict[str, Any] = {"planner": "lieednn-shaped", "options": options, "seed": task.seed}
    made = plan(task.arm, task.target, start=task.start, **how).network
    assert isinstance(made, LieEDNN)
    # Its clock is the slowest.
    return _network(task, made, task.convergence_rate / options.rate)


def _certified(task: PolicyTask, options: CertifiedPolicyOptions) -> Policy:
    xi = task.arm.encode(task.target)
    made = synthesize(
        xi,
        bias="sign-matched",
        bias_magnitude=options.bias_magnitude,
        activation=options.activation,
        seed=task.seed,
    ).unwrap()
    slowest = -float(np.linalg.eigvals(made.jacobian(xi)).real.max())
    return _network(task, made, task.convergence_rate / slowest)


def _linear(task: PolicyTask) -> Policy:
    return _network(task, without_weights(task.arm.encode(task.target)), task.convergence_rate)


def _network(task: PolicyTask, network: LieEDNN, speed: float) -> Policy:
    return NetworkPolicy(task.arm, network, task.rate, speed=speed, feedforward=False, feedback=task.feedback)


def _primitive(task: PolicyTask, options: PrimitiveOptions) -> Policy:
    return MovementPrimitive(task.arm, task.motion, task.rate, options=options, feedback=task.feedback)


def _fabric(task: PolicyTask, options: FabricOptions) -> Policy:
    return Fabric(task.arm, task.rate, options=options, feedback=task.feedback)


def _path_integral(task: PolicyTask, options: PathIntegralOptions) -> Policy:
    how: dict[str, Any] = {"convergence_rate": task.convergence_rate, "feedback": task.feedback, "seed": task.seed}
    return PathIntegral(task.arm, task.rate, options=options, **how)


def _replanning(task: PolicyTask, options: ReplanningOptions) -> Policy:
    how: dict[str, Any] = {"options": options, "feedback": task.feedback, "seed": task.seed}
    return ReplanningPolicy(task.arm, task.rate, motion=task.motion, **how)


def _tracker(task: PolicyTask) -> Policy:
    return MotionTracker(task.arm, task.motion, task.rate)


#: All policies by name, including those added by `register_policy`.
POLICIES: dict[str, PolicyKind] = {
    "lieednn-shaped": PolicyKind(_shaped, ShapedOptions),
    "lieednn-certified": PolicyKind(_certified, CertifiedPolicyOptions),
    "lieednn-replanning": PolicyKind(_replanning, ReplanningOptions),
    "linear-attractor": PolicyKind(_linear),
    "dmp": PolicyKind(_primitive, PrimitiveOptions),
    "fabric": PolicyKind(_fabric, FabricOptions),
    "mppi": PolicyKind(_path_integral, PathIntegralOptions),
    "tracker": PolicyKind(_tracker),
}


def _policy(name: str, make: Callable[..., Policy], options: type[PlannerOptions] | None = None) -> PolicyKind:
    if not callable(make):
        raise InputError(f"policy {name!r} must be a function of a PolicyTask, got {type(make).__name__}")

    def checked(task: PolicyTask, *given: PlannerOptions) -> Policy:
        made = make(task, *given)
        if not isinstance(made, Policy):
            raise InputError(f"policy {name!r} must be a Policy, its function returned {type(made).__name__}")
        return made

    return PolicyKind(checked, options)


REGISTRY = Registry("policy", POLICIES, _policy, "lieednn_sim.policies")


def register_policy(name: str, options: type[PlannerOptions] | None = None) -> Callable[[_Make], _Make]:
    """Decorator that registers a function that makes policies, for `make_policy`.

    The function takes a `PolicyTask` and returns a `Policy`.

    An installed package declares its policies as entry points::

        [project.entry-points."lieednn_sim.policies"]
        my-policy = "my_package.my_module:my_function"

    A function declared like this needs the decorator only if it takes options.

    Args:
        name: name of the policy, in lower-case letters, digits and hyphens.
        options: class of its options, which are its second argument.

    Raises:
        InputError: the name is malformed or taken.
    """
    return REGISTRY.register(name, options)


def policies() -> Mapping[str, PolicyKind]:
    """All policies by name: `POLICIES`, and those of the entry points of installed packages.

    An entry point that cannot be loaded is left out, with a warning that names its package.
    """
    return REGISTRY.all()


def make_policy(
    name: str,
    arm: Arm,
    target: ArrayLike | str,
    *,
    rate: float = 100.0,
    start: ArrayLike | str = "home",
    motion: Motion | Plan | None = None,
    feedback: Feedback | None = FEEDBACK,
    safety: FilterOptions | None = None,
    convergence_rate: float = 2.0,
    options: PlannerOptions | None = None,
    seed: Seed = 0,
) -> Policy:
    """Make a policy by name, reset at the start.

    Args:
        name: a name of `POLICIES`.
        arm: the arm, in its scene.
        target: joint coordinates ``(n,)``, or a keyframe's name, for which networks are made. The target given in each
            step may differ.
        rate: control rate [Hz].
        start: joint coordinates ``(n,)`` at the beginning, or a keyframe's name.
        motion: what ``tracker`` tracks and ``dmp`` imitates, from start to target; by default a planned one.
        feedback: settings of the feedback from the measured joints; None for no feedback.
        safety: settings of a safety filter around the policy; None for none.
        convergence_rate: rate at which a policy without a motion approaches the target [1/s].
        options: options of the policy, of its class in `POLICIES`; by default that class's defaults.
        seed: seed of random draws; the same seed gives the same policy.

    Raises:
        InputError: a value is malformed, the policy is unknown, or the options are those of another one.
        NotCertifiedError: no network could be certified.
        PlanError: no motion was found.
    """
    known = policies()
    make, kind = known[as_choice("name", name, known)]
    given = given_options(f"the policy {name!r}", kind, options)
    ends = arm.configuration(start, "start"), arm.configuration(target, "target")
    task = PolicyTask(arm, *ends, rate, feedback, convergence_rate, as_seed("seed", seed), motion)
    made = make(task, *given)
    if safety is not None:
        made = FilteredPolicy(made, safety)
    made.reset(task.start)
    return made
