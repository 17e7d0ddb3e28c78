"""The protocol of leaders, and the base class of those that move in joint space."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.planning.motion import Motion
from lieednn_sim.simulation import Feedback, Simulation
from lieednn_sim.simulation.reference import PeriodReference
from lieednn_sim.values import Floats, frozen

# Joint positions and rates ``(m, n)`` after each of a period's m steps.
Setpoints = tuple[Floats, Floats]
Leader = Callable[[Floats, Simulation], Setpoints]

# Rate at which leaders without a time law approach their target [1/s].
PACE = 2.0


@frozen
class Assignment:
    """The task of a leader.

    Attributes:
        arm: the arm among its obstacles.
        start: ``(n,)`` joint position.
        target: ``(n,)`` joint position.
        motion: the teacher's motion from start to target, which trackers track and primitives imitate.
        steps: number of simulation steps in a control period.
        feedback: settings common to all leaders.
        seed: seed of random draws.
    """

    arm: Arm
    start: Floats
    target: Floats
    motion: Motion
    steps: int
    feedback: Feedback
    seed: int


class JointLeader(ABC):
    """A leader in joint space: y' = l (s v(y) + k d (q - y)), with the same s, k d and l as networks."""

    def __init__(self, task: Assignment, feedback: Feedback | None = None) -> None:
        self.arm, self._feedback = task.arm, feedback or task.feedback
        self._reference = PeriodReference(task.arm, task.start, task.steps, self._feedback.safety)
        self.period, self.y = self._reference.period, task.start
        self.low, self.high = task.arm.position_limits.T
        self.range = task.arm.ranges

    def __call__(self, target: Floats, simulation: Simulation) -> Setpoints:
        """See `Leader`."""
        off = simulation.measured()[0] - self.y
        waiting, strength = self._feedback.response(float((np.abs(off) / self.range).max()))
        wanted = waiting * self.velocity(target, waiting) + strength * off
        share = 1.0 / max(1.0, float((np.abs(wanted) / self._reference.allowed()).max()))
        self.went(share * waiting * self.period)
        y = np.clip(self.arm.within_angles(self.y + self.period * share * wanted), self.low, self.high)
        qd, self.y = np.where((y == self.low) | (y == self.high), 0.0, share * wanted), y
        return self._reference(y, qd)

    @abstractmethod
    def velocity(self, target: Floats, waiting: float) -> Floats:
        """The velocity v ``(n,)`` at the end of the period."""

    def went(self, time: float) -> None:  # noqa: B027 (most have no time of their own)
        """Advance the leader's own time [s]."""
