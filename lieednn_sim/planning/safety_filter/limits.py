"""Limits of the joints, as bounds of their velocities at the end of a control step of constant acceleration."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

# Without acceleration limits, joints reach their velocity limits in this time [s].
_ACCELERATION_TIME = 0.25
# Without a velocity limit, a joint crosses its range in this time [s].
_RANGE_TIME = 1.0


class Limit(ABC):
    """Bounds of the joint velocities at the end of a step.

    Attributes:
        yields: whether the limits before this one take precedence over it where both cannot hold.
    """

    yields = True

    @abstractmethod
    def bounds(self, q: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Lower and upper bounds ``(n,)`` for a step that begins at ``q`` with ``velocity``, both ``(n,)``."""

    def allow(self, positions: Floats) -> None:  # noqa: B027 (few limits need it)
        """Adapt the limit to positions ``(P, n)`` that must be allowed."""

    def name(self, joint: int) -> str:
        """Name of the limit for messages about what holds a joint back; empty to leave it out."""
        return ""


class VelocityLimit(Limit):
    """Velocity limits: |v'| <= limits ``(n,)``."""

    yields = False

    def __init__(self, limits: Floats) -> None:
        self.limits = limits

    def bounds(self, q: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """See `Limit`."""
        return -self.limits, self.limits


class AccelerationLimit(Limit):
    """Acceleration limits: |v' - v| <= a h with limits a ``(n,)`` and a step of h seconds."""

    yields = False

    def __init__(self, limits: Floats, timestep: float) -> None:
        self._change = limits * timestep

    def bounds(self, q: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """See `Limit`."""
        return velocity - self._change, velocity + self._change


class PositionLimit(Limit):
    """The braking rule: v'^2 / (2 a) + h (v + v') / 2 <= d for the distance d to a position limit.

    A joint that keeps the rule can still stop before its limit. The rule is an upper bound of v'; if v satisfies it,
    braking does, too, so it never contradicts the limits of velocity and acceleration. Such bounds, which make position
    limits viable under bounded accelerations, are due to Flacco, De Luca and Khatib (ICRA 2012; IEEE Transactions on
    Robotics 31(3), 2015), and in discrete time to Del Prete (Joint position and velocity bounds in discrete-time
    acceleration/torque control of robot manipulators, IEEE Robotics and Automation Letters 3(1), 2018).

    Attributes:
        limits: ``(n, 2)`` position limits in use [rad, m].

    Args:
        arm: the arm.
        acceleration_limits: a, ``(n,)``.
        timestep: h [s].
    """

    def __init__(self, arm: Arm, acceleration_limits: Floats, timestep: float) -> None:
        self._arm, self._acceleration, self._timestep = arm, acceleration_limits, timestep
        self.limits = arm.position_limits.copy()

    def bounds(self, q: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """See `Limit`. A joint outside its limits, as after a bad start, returns as fast as the other limits allow."""
        low, high = self.limits.T
        return -self.stopping(q - low, -velocity), self.stopping(high - q, velocity)

    def stopping(self, distance: Floats, velocity: Floats) -> Floats:
        """Largest velocities ``(n,)`` at the end of the step from which the distance suffices to brake."""
        h, a = self._timestep, self._acceleration
        left = distance - 0.5 * h * velocity
        root = np.sqrt(np.maximum((0.5 * a * h) ** 2 + 2.0 * a * left, 0.0)) - 0.5 * a * h
        return np.where(left >= 0.0, root, 2.0 * left / h)

    def allow(self, positions: Floats) -> None:
        """Tighten the limits, but not beyond ``positions``, so that joints that reverse keep the arm's limits."""
        inset = self._acceleration * self._timestep**2 / 4.0
        low, high = self._arm.position_limits.T
        lower = np.maximum(np.minimum(low + inset, positions.min(axis=0)), low)
        upper = np.minimum(np.maximum(high - inset, positions.max(axis=0)), high)
        self.limits = np.stack([lower, upper], axis=1)

    def name(self, joint: int) -> str:
        """See `Limit`."""
        return f"the position limit of joint {self._arm.joint_names[joint]!r}"


def finite_rates(arm: Arm) -> tuple[Floats, Floats]:
    """Velocity and acceleration limits, both ``(n,)``, with finite values in place of those that the arm lacks."""
    velocity = np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, arm.ranges / _RANGE_TIME)
    named = np.isfinite(arm.acceleration_limits)
    return velocity, np.where(named, arm.acceleration_limits, velocity / _ACCELERATION_TIME)
