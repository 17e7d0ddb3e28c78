"""What a policy by name is made for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from lieednn_sim.arm import Arm
from lieednn_sim.planning import Motion, Plan, plan
from lieednn_sim.policies.feedback import FEEDBACK, Feedback
from lieednn_sim.validation import as_positive, as_seed
from lieednn_sim.values import Floats, check_fields


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
