"""Policies in joint space: y' = l (s v(y) + k d (q - y)), with s, k and d of `feedback`, and l as for networks.

A subclass only defines the velocity v towards the target.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.policies.feedback import FEEDBACK, Feedback, FeedbackPolicy
from lieednn_sim.values import Floats


class JointPolicy(FeedbackPolicy):
    """Base class of policies in joint space; a subclass defines `velocity`.

    Args:
        arm: the arm.
        rate: control rate [Hz].
        feedback: settings of the feedback from the measured joints; None for no feedback.

    Attributes:
        y: ``(n,)`` state y, joint coordinates [rad, m].
        pace: factor l s of the last period.
        behind: error e of `feedback` at the beginning of the last period.
    """

    def __init__(self, arm: Arm, rate: float = 100.0, *, feedback: Feedback | None = FEEDBACK) -> None:
        super().__init__(arm, rate, feedback)

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        super().begin(q)
        self.y = q

    def act(self, measured: Floats | None, target: Floats) -> tuple[Floats, Floats]:
        """See `Policy`; unchecked."""
        waiting, strength = self._response(measured, self.y)
        desired = waiting * self.velocity(target, waiting)
        if measured is not None:
            desired = desired + strength * (measured - self.y)
        slower = 1.0 / max(1.0, float((np.abs(desired) / self.allowed()).max()))
        self.pace, self._limited = slower * waiting, slower < 1.0
        self.elapse(self.pace * self.period)
        self.y = y = self._within_limits(self.y + self.period * slower * desired)
        return y, np.where((y[:, None] == self.arm.position_limits).any(axis=1), 0.0, slower * desired)

    @abstractmethod
    def velocity(self, target: Floats, waiting: float) -> Floats:
        """The velocity v ``(n,)`` towards a target ``(n,)``, where time runs at the rate s; unchecked."""

    def elapse(self, time: float) -> None:
        """Advance the policy's own time [s]; unchecked."""

    @property
    def state(self) -> Floats:
        """``(n,)``, as `y`."""
        return self.y
