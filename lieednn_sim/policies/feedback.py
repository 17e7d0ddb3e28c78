"""Feedback from the arm to its policy: measured joints pull the policy's state, and its clock waits for them.

With the measured joints q, the reference q_r of the same instant and e = max |q - q_r| / range, a policy runs s times
as fast, and its state is pulled to q at the rate k d,

    s = max(1 / (1 + (e / e_1)^2), s_0)    it waits for an arm that does not keep up,
    d = max(0, 1 - e_0 / e)                errors within the tolerance e_0 are left to the controller.

A policy in joint space with its own velocity v moves by y' = l (s v(y) + k d (q - y)), with l as for networks.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.policies.base import Policy
from lieednn_sim.validation import as_floats, as_nonnegative, as_positive
from lieednn_sim.values import Floats, check_fields, rounded


@dataclass(frozen=True)
class Feedback:
    """Settings of the feedback from the measured joints to the state of a policy.

    Attributes:
        rate: k, rate at which the state is pulled to the measured joints [1/s]; with 0 only the clock waits.
        tolerance: e_0, error up to which the arm does not pull, as a fraction of the joints' ranges.
        patience: e_1, error at which the policy runs at half its speed, as a fraction of the joints' ranges.
    """

    rate: float = 5.0
    tolerance: float = 0.01
    patience: float = 0.002

    def __post_init__(self) -> None:
        check_fields(self, as_nonnegative, "rate", largest=1e3)
        check_fields(self, as_positive, "tolerance", "patience")

    def response(self, behind: float) -> tuple[float, float]:
        """The policy's speed s and the pull k d [1/s] for an error e, a fraction of the joints' ranges; unchecked."""
        # With s_0 = 0.01: a policy that stopped would never arrive.
        waiting = max(1.0 / (1.0 + (behind / self.patience) ** 2), 0.01)
        return waiting, self.rate * max(0.0, 1.0 - self.tolerance / max(behind, 1e-300))


FEEDBACK = Feedback()  # the default of all policies


class FeedbackPolicy(Policy):
    """Base class of policies that wait for an arm that does not keep up, and report how far it is behind.

    Attributes:
        range: ``(n,)`` lengths of the joints' ranges [rad, m].
        pace: factor l s of the last period.
        behind: error e at the beginning of the last period.
    """

    channel_units: Mapping[str, str] = MappingProxyType({"pace": "1", "behind": "ranges"})

    def __init__(self, arm: Arm, rate: float = 100.0, *, feedback: Feedback | None = FEEDBACK) -> None:
        super().__init__(arm, rate)
        self._feedback, self.range = feedback, arm.ranges

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        # Whether joint limits slowed the policy down in the last period.
        self.pace, self.behind, self._limited = 1.0, 0.0, False

    def _response(self, measured: Floats | None, drawn: Floats) -> tuple[float, float]:
        """The factors s and k d [1/s] for the measured joints and the reference of the same instant; sets `behind`."""
        if measured is None or self._feedback is None:
            return 1.0, 0.0
        self.behind = float((np.abs(measured - drawn) / self.range).max())
        return self._feedback.response(self.behind)

    def _listen(self, measured: Floats | None, drawn: Floats) -> tuple[float, tuple[Floats, Floats] | None]:
        """The factor s, and the pull of the measured joints, if any, in flat coordinates of the links and in joints."""
        waiting, strength = self._response(measured, drawn)
        if measured is None or strength == 0.0:
            return waiting, None
        there, here = self.arm.encode(np.stack([measured, drawn]))
        return waiting, (strength * (there - here).ravel(), strength * (measured - drawn))

    def _within_limits(self, q: Floats) -> Floats:
        """Joint coordinates ``(n,)``, moved to the position limits where they are beyond."""
        (low, high), balls = self.arm.position_limits.T, self.arm.space.balls
        # Joints are seldom beyond, and the check in `within_angles` of its argument takes longer than this.
        if len(balls) and (self.arm.space.angles(q) > high[balls[:, 0]]).any():
            q = self.arm.within_angles(q)
        return np.minimum(np.maximum(q, low), high)

    @property
    def message(self) -> str:
        """See `Policy`."""
        if self.pace > 0.99:
            return super().message
        slowed = f"moves at {100 * self.pace:.2g} % of its speed"
        if self._limited:
            return f"{slowed}, within the joints' limits"
        return f"{slowed}, waiting for a joint {rounded(100 * self.behind)} % of its range away"

    def channels(self) -> Floats:
        """See `Policy`."""
        return np.array([self.pace, self.behind])


class JointPolicy(FeedbackPolicy):
    """Base class of policies in joint space; a subclass defines `velocity`.

    Args:
        arm: the arm.
        rate: control rate [Hz].
        feedback: settings of the feedback from the measured joints; None for no feedback.

    Attributes:
        y: ``(n,)`` state y, joint coordinates [rad, m].
    """

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        super().begin(q)
        self.y = q

    def act(self, measured: Floats | None, target: Floats) -> tuple[Floats, Floats]:
        """See `Policy`; unchecked."""
        waiting, strength = self._response(measured, self.y)
        desired = waiting * as_floats("the policy's velocity", self.velocity(target, waiting), target.shape)
        if measured is not None:
            desired = desired + strength * (measured - self.y)
        slower = 1.0 / max(1.0, float((np.abs(desired) / self.allowed()).max()))
        self.pace, self._limited = slower * waiting, slower < 1.0
        self.elapse(self.pace * self.period)
        self.y = y = self._within_limits(self.y + self.period * slower * desired)
        return y, np.where((y[:, None] == self.arm.position_limits).any(axis=1), 0.0, slower * desired)

    @abstractmethod
    def velocity(self, target: Floats, waiting: float) -> Floats:
        """The velocity v ``(n,)`` towards a target ``(n,)``, where time runs at the rate s [rad/s, m/s]."""

    def elapse(self, time: float) -> None:
        """Advance the policy's own time [s]; unchecked."""

    @property
    def state(self) -> Floats:
        """``(n,)``, as `y`."""
        return self.y
