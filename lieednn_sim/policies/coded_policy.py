"""Policies that follow coded motions of one certified network, and may change to another motion at any time.

With the universal network's time z, its field F, and the clock's rate r(t) of a coded motion, the visible state obeys

    x_v' = p r(t) F_v(x) + k d (xi(q) - xi(q_r)),    x_h' = p r(t) F_h(x),    t' = p,

with s, k and d of `feedback`, and a pace p <= s that keeps the joints' accelerations within their limits, both while
speeding up and while slowing down. A change to another motion replaces the code, that is the hidden state, and the
bias. The visible state stays the same, and the code keeps its velocity and acceleration, too (`transition`).

What is proved: the certificate covers every code and every bias. After the last change, once the arm keeps up (s > 0
and no pull) and need not rest (p > 0), x' = p r F(x) has the network's orbits, which all end at the target. Whether a
transition keeps limits is only checked, at samples.

Before a time t_r at which the arm must rest, p <= (2 c (t_r - t))^(1/2), with the deceleration c that limits allow.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from types import MappingProxyType

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.arm.local_retraction import LocalRetraction
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.timed_path import TimedPath
from lieednn_sim.planning.transition import BaseMotion, Transition, straight, transition
from lieednn_sim.policies.feedback import FEEDBACK, Feedback, FeedbackPolicy
from lieednn_sim.synthesis.shaping.encoder import CurveEncoder
from lieednn_sim.values import Floats

RESTS = 1e-3  # pace below which the arm rests
# Least time in which the pace falls from 1 to 0, and duration of the shortest motions [s].
SOONEST = 0.25
GENTLY = 0.35  # fraction of the acceleration limits that is used when the pace falls before the arm must rest


class CodedPolicy(FeedbackPolicy):
    """Base class of policies along coded motions of one network; a subclass defines `_decide`.

    Args:
        arm, rate, feedback: as for `FeedbackPolicy`.

    Attributes:
        changes: number of codes taken since the reset.
        course: the present motion.
        time: time of the present motion [s].
        rest_at: t_r, infinite while the arm need not rest; to be set by `_decide`.
        pace: factor p of the last period.
        drawn: ``(n,)`` configuration of the network's state; the reference is the same within the position limits.
    """

    certified = True
    channel_units = MappingProxyType({**FeedbackPolicy.channel_units, "changes": "1"})
    # Fractions of the acceleration limits: of what a new motion takes over at most, and what changes of pace may use.
    _taken_over, _used = 0.5, 0.85
    # How far the network may be beyond a position limit before the rates of joints held there are set to zero.
    _beyond = 0.0
    # Set with each new motion: t_r, the network's time z, the deceleration c, and the velocity at a pace of 1.
    rest_at: float
    _z: float
    _braking: float
    _velocity: Floats

    def __init__(self, arm: Arm, rate: float = 100.0, *, feedback: Feedback | None = FEEDBACK) -> None:
        super().__init__(arm, rate, feedback=feedback)
        self._encoder = CurveEncoder(arm.n_links)

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        super().begin(q)
        self._retraction = LocalRetraction(self.arm, q)
        self.drawn, self._waiting, self._pace_rate = q, 1.0, 0.0
        rest = np.stack([q, np.zeros_like(q), np.zeros_like(q)])
        stay = transition(self.arm, rest, straight(self.arm, q, q, SOONEST))
        self.changes = -1
        self._follow(TimedPath(self.arm, self._encoder, stay, self.arm.encode(q)))

    @abstractmethod
    def _decide(self, target: Floats) -> None:
        """Take another motion, or set when to rest, as the target ``(n,)`` requires; called in each period."""

    @property
    def network(self) -> LieEDNN:
        """The certified network with its present code and bias."""
        return self.course.network

    @property
    def state(self) -> Floats:
        """``(N, 6)`` state of the visible neurons, one for each link."""
        return self.course.state.x.reshape(-1, 6)

    def act(self, measured: Floats | None, target: Floats) -> tuple[Floats, Floats]:
        """See `Policy`; unchecked."""
        self._decide(target)
        self._waiting, pulled = self._listen(measured, self.drawn)
        course, ahead = self.course, self.rest_at - self.time
        wish = self._waiting * min(1.0, math.sqrt(2.0 * self._braking * max(ahead, 0.0)))
        change, most = self.qd - pulled[1] if pulled else self.qd, self._used * self._max_gain
        bounds = (change - most).tolist(), (change + most).tolist()
        guess = self._within_acceleration(wish, *bounds)
        self.time += 0.5 * self.period * (self.pace + guess)
        z, rate = course.clock(self.time)
        self._retraction.q = self.drawn + self.period * guess * self._velocity
        if pulled:
            course.state.x = course.state.x + self.period * pulled[0]
            self._retraction.q += self.period * pulled[1]
        course.state.advance(z - self._z)
        self._z = z
        drawn, slope = self._retraction(course.state.x.reshape(-1, 6), course.state.flow.reshape(-1, 6))
        self._velocity = rate * slope
        pace = self._within_acceleration(wish, *bounds)
        desired = pace * self._velocity
        if pulled:
            desired += pulled[1]
        slower = 1.0 / max(1.0, float(np.maximum.reduce(np.abs(desired) / self.allowed())))
        self._limited = slower * pace < 0.99 * self._waiting
        self._pace_rate, self.pace = (slower * pace - self.pace) / self.period, slower * pace
        self.drawn, inside = drawn, self._within_limits(drawn)
        return inside, np.where(np.abs(inside - drawn) <= self._beyond, slower * desired, 0.0)

    def _within_acceleration(self, wish: float, least: list[float], most: list[float]) -> float:
        """The pace nearest to a wish at which the joints' velocities along the motion are within bounds."""
        low, high = 0.0, math.inf
        # For a few joints, a loop is quicker than arrays.
        for v, below, above in zip(self._velocity.tolist(), least, most, strict=True):
            if abs(v) > 1e-9:
                slowest, fastest = (below / v, above / v) if v > 0.0 else (above / v, below / v)
                low, high = max(low, slowest), min(high, fastest)
        # If no pace keeps all limits, since the arm is pulled, take one between those that keep some of them.
        return max(min(wish, max(low, high)), min(low, high, self._waiting))

    def take(self, base: BaseMotion, clear: Callable[[Floats], str | None]) -> None:
        """Change to a base motion (`transition`); raises `PlanError` if there is no clear transition or no code."""
        self._go_along(lambda now: transition(self.arm, now, base, clear))

    def _go_along(self, make: Callable[[Floats], Transition], most: float = math.inf) -> None:
        """Follow the transition that ``make`` returns for the present state ``(3, n)``, see `TimedPath`.

        Raises `PlanError` as `take` does.
        """
        # The present state of the joints in the time of the new motion, which begins at this pace.
        pace = max(self._waiting, self.pace, RESTS)
        ratio = self.pace / pace
        limits = self._taken_over * self.arm.acceleration_limits
        qdd = ratio**2 * self.course.transition.acceleration(self.time) + self._pace_rate / pace**2 * self._velocity
        now = np.array([self.drawn, ratio * self._velocity, np.minimum(np.maximum(qdd, -limits), limits)])
        try:
            course = TimedPath(self.arm, self._encoder, make(now), self.state, most)
        except InputError as error:
            raise PlanError(f"the network cannot follow the motion: {error}") from None
        self.pace, self._pace_rate = pace, 0.0
        self._follow(course)

    @property
    def stopping(self) -> float:
        """How long the present motion goes on, in its own time, until the arm can rest [s]."""
        return self.pace**2 / (2.0 * self._braking)

    def _follow(self, course: TimedPath) -> None:
        """Follow a course from its beginning."""
        self.course = course
        self.time, self._z, self.rest_at = 0.0, 0.0, math.inf
        self.changes += 1
        _, qd, _ = course.transition.even
        self._velocity = qd[0]
        swift = np.abs(qd).max(axis=0) / self.arm.acceleration_limits
        self._braking = GENTLY / max(float(swift.max()), GENTLY * SOONEST)

    def _at(self, times: Floats) -> Floats:
        """Configurations ``(K, n)`` at times of the present motion."""
        return self.course.transition(times, 1)[0]

    def channels(self) -> Floats:
        """See `Policy`."""
        return np.append(super().channels(), self.changes)
