"""Feedback from the arm to its network: measured joints pull the visible state, and the network's time waits for them.

At every control period the follower compares the measured joints q with its own reference q_r of that instant.
With e = max |q - q_r| / range, the state x = (visible, hidden and clock) obeys

    x_v' = l (s c F_v(x) + x'_ff + k d (xi(q) - xi(q_r))),    x_h' = l s c F_h(x),

where F is the field of the network retargeted to the present target, c its speed, xi the arm's encoding, and

    s = max(1 / (1 + (e / e_1)^2), s_0)    the clock waits for an arm that does not keep up,
    d = max(0, 1 - e_0 / e)                errors within the tolerance e_0 are left to the controller,
    l <= 1                                 keeps the joints within their limits of velocity and, while speeding up, of
                                           acceleration.

The proof is kept. Without the coupling (k d = 0) and behind a target at rest x' = r(t) F(x) with a factor
r = l s c > 0: in the time integral of r it is the network itself, so x runs along the same orbits, and the network's
Lyapunov function V decreases, dV/dt = r grad V . F < 0, until the target is reached, since s and l never vanish for
good. The whole field must be scaled: slowing the hidden neurons or the clock alone would give another system, which no
certificate covers. The coupling is an input of the visible neurons. It vanishes when the arm comes within the tolerance
of its reference; from then on the certified network runs from whatever state it was pulled to. The hidden neurons of a
cascade have no input from it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.blas import idamax

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.local_retraction import LocalRetraction
from lieednn_sim.errors import InputError
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.stepping import Stepping
from lieednn_sim.planning.filtering import FilterOptions
from lieednn_sim.planning.network_path import require_fit
from lieednn_sim.simulation.reference import PeriodReference
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats

# Least s: a clock that stopped would keep the network from arriving.
_SLOWEST = 0.01
# For joints without limits, a target faster than this has jumped [rad/s, m/s].
_FASTEST = 10.0
# Largest |l s c| T in the certificate's norm and largest change of a switch's argument in a Runge-Kutta step, and the
# largest number of such steps.
_LARGEST_STEP, _LARGEST_SWITCHING, _MOST_STEPS = 0.5, 0.5, 100
# A period is run again, this often, if velocities at its end exceed their limits by more than this share.
_TOO_FAST, _TRIES = 1e-3, 4


@dataclass(frozen=True)
class Feedback:
    """Settings of the feedback from the arm to its network; see the module for the equations.

    Attributes:
        rate: k, rate at which the visible state is pulled to the measured joints [1/s]; with 0 only the clock waits.
        tolerance: e_0, error up to which the arm does not pull, as a share of the joints' ranges.
        patience: e_1, error at which the network runs at half its speed, as a share of the joints' ranges.
        safety: options of a filter of limits and clearance between network and reference; None for no filter.

    Raises:
        InputError: a value is out of range.
    """

    rate: float = 5.0
    tolerance: float = 0.01
    patience: float = 0.002
    safety: FilterOptions | None = None

    def __post_init__(self) -> None:
        rate = float(as_floats("rate", self.rate, ()))
        if not 0.0 <= rate <= 1e3:
            raise InputError(f"rate must be from 0 to 1000 per second, got {rate:g}")
        object.__setattr__(self, "rate", rate)
        for name in ("tolerance", "patience"):
            object.__setattr__(self, name, as_positive(name, getattr(self, name)))

    def response(self, behind: float) -> tuple[float, float]:
        """The factors s and k d [1/s] for an error e."""
        behind = float(as_floats("behind", behind, ()))
        waiting = max(1.0 / (1.0 + (behind / self.patience) ** 2), _SLOWEST)
        return waiting, self.rate * max(0.0, 1.0 - self.tolerance / max(behind, 1e-300))


class FeedbackFollower:
    """A certified network that follows a target with feedback from the arm; see the module.

    Args:
        arm: encodes targets; states are decoded by `LocalRetraction`.
        network: certified, with as many visible neurons as the arm has links.
        start: joint coordinates ``(n,)``, where the arm is.
        steps: simulation steps in a control period.
        speed: the network's rate c [1/s].
        feedforward: whether to add the target's velocity, by the difference of its last two samples.
        feedback: settings.

    Attributes:
        xi: ``(N, 6)`` state of all neurons.
        reference: what the arm is to follow.
        jumped: whether the last target was faster than the joints' limits.
        share: l of the last period.
        pace: l s of the last period, as a share of the speed c.
        behind: e, at the beginning of the last period.
        limit_excess: as of `following.Following`.

    Raises:
        InputError: network and arm differ in size, the network has no proof and need not follow, the speed is too high
            for the control rate, or something touches at the start where there is a filter.
    """

    channel_units: Mapping[str, str] = MappingProxyType({"pace": "1", "behind": "ranges"})

    def __init__(
        self,
        arm: Arm,
        network: LieEDNN,
        start: ArrayLike,
        *,
        steps: int,
        speed: float,
        feedforward: bool,
        feedback: Feedback,
    ) -> None:
        require_fit(arm, network, certified=True)
        self._arm, self._network, self._feedback = arm, network, feedback
        self._speed, self._feedforward = as_positive("speed", speed), feedforward
        self.reference = PeriodReference(arm, arm.check_position(start, "start"), steps, feedback.safety)
        self._period = self.reference.period
        self._stepping, self._visible = Stepping(network), 6 * network.n_visible
        self.xi = network.start(arm.encode(self.reference.q))
        self._stiffness = network.gamma + network.mu * _certified_norm(network)
        self._low, self._high = arm.position_limits.T
        self._range, self._balls = arm.ranges, arm.space.balls
        self._widest = self._high[self._balls[:, 0]].tolist()
        self._fastest = np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, _FASTEST)
        self._retraction = LocalRetraction(arm, self.reference.q)
        # The last target with its goal, and whether the field is that of this goal, not of one ahead of it.
        self._target: tuple[Floats, Floats] | None = None
        self._still = np.zeros(self.xi.size), np.zeros(arm.n_joints)
        self._settled = False
        # Where the network is, what drives it there, its field, and the first and the last in joint coordinates.
        self._x = self.xi.ravel()
        self._drive, self._flow = self._stepping.drive(self._x), np.zeros(self.xi.size)
        self._drawn, self._flow_rate = self.reference.q, self.reference.qd
        # The pull towards the network's rest state.
        self._pull = np.zeros(self.xi.size)
        self.jumped, self.share, self.pace, self.behind = False, 1.0, 1.0, 0.0
        self.limit_excess, self._gap = -np.inf, np.zeros((arm.n_links, 2))

    @property
    def gap_rotation(self) -> float:
        """See `following.Following`."""
        return float(self._gap[:, 0].max())

    @property
    def gap_translation(self) -> float:
        """See `following.Following`."""
        return float(self._gap[:, 1].max())

    def advance(self, target: Floats, measured: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """Run for a control period after a target ``(n,)``, with the joints measured ``(n,)`` at its beginning.

        Without a measurement the arm is taken to be where it should.

        Returns:
            Joint coordinates and rates ``(m, n)`` after each of the period's m steps, and the state ``(1, N, 6)`` at
            the end.
        """
        period = self._period
        drift, rate = self._aim(target)
        waiting, pull = self._listen(measured)
        scale = waiting * self._speed
        if pull is not None:
            drift, rate = drift + pull[0], rate + pull[1]
        allowed = self.reference.allowed()
        wanted = scale * self._flow_rate + rate
        share = 1.0 / max(1.0, _largest(wanted / allowed))
        for _ in range(_TRIES):
            x, drive, flow = self._integrate(share * scale, drift / scale)
            drawn, flow_rate = self._decode(x, flow, self._drawn + share * period * wanted)
            qd = share * (scale * flow_rate + rate)
            excess = _largest(qd / allowed)
            if excess <= 1.0 + _TOO_FAST:
                break
            share /= excess
        self._x, self._drive, self._flow, self._flow_rate = x, drive, flow, flow_rate
        self.xi, self.share, self.pace = x.reshape(self.xi.shape), share, share * waiting
        self._gap = np.maximum(self._gap, self._retraction.gap)
        outside = max(np.maximum(self._low - drawn, drawn - self._high).tolist())
        self.limit_excess = max(self.limit_excess, outside)
        if outside > 0.0 or self._turned_far(drawn):
            inside = np.minimum(np.maximum(self._arm.within_angles(drawn), self._low), self._high)
            drawn, qd = inside, np.where(inside == drawn, qd, 0.0)
        self._drawn = drawn
        return (*self.reference(drawn, qd), self.xi[None])

    def sample(self, data: mujoco.MjData) -> Floats:
        """See `log.ChannelSource`."""
        return np.array([self.pace, self.behind])

    def channel_values(self, samples: Floats) -> tuple[Floats, ...]:
        """See `log.ChannelSource`."""
        return tuple(samples.T)

    def _aim(self, target: Floats) -> tuple[Floats, Floats]:
        """Set the goal of all neurons, in the middle of the period; its velocity, flat, and the joints' with it."""
        before, self.jumped = self._target, False
        moving = self._still
        if before is not None and self._settled and target.tolist() == before[0].tolist():
            return moving
        goal = self._network.goal(self._arm.encode(target)).ravel()
        self._target, aim = (target.copy(), goal), goal
        if before is not None:
            rate = (target - before[0]) / self._period
            self.jumped = bool((np.abs(rate) > self._fastest).any())
            if self._feedforward and not self.jumped and rate.any():
                moving = (goal - before[1]) / self._period, rate
                aim = goal + 0.5 * self._period * moving[0]
        self._settled = aim is goal
        self._pull = aim - self._stepping.drive(aim)
        self._flow = self._field(self._x, self._drive)
        if before is None or self.jumped:
            _, self._flow_rate = self._decode(self._x, self._flow, self._drawn)
        return moving

    def _listen(self, measured: Floats | None) -> tuple[float, tuple[Floats, Floats] | None]:
        """How far the clock waits for the measured joints, and how they pull the flat state and its posture."""
        feedback = self._feedback
        if measured is None:
            return 1.0, None
        off = measured - self._drawn
        self.behind = _largest(off / self._range)
        waiting, strength = feedback.response(self.behind)
        if strength == 0.0:
            return waiting, None
        there, here = self._arm.encode(np.stack([measured, self._drawn]))
        pull = np.zeros(self.xi.size)
        pull[: self._visible] = strength * (there - here).ravel()
        return waiting, (pull, strength * off)

    def _turned_far(self, q: Floats) -> bool:
        """Whether a ball joint is beyond its largest angle."""
        if not self._widest:
            return False
        return any(
            math.hypot(*turn) > widest for turn, widest in zip(q[self._balls].tolist(), self._widest, strict=True)
        )

    def _field(self, x: Floats, drive: Floats) -> Floats:
        """Flat field F at a state with its drive."""
        return self._network.gamma * (self._pull + drive - x)

    def _integrate(self, scale: float, drift: Floats) -> tuple[Floats, Floats, Floats]:
        """The state after a period of x' = scale (F(x) + drift), by RK4, and its drive and F there."""
        x, drive, gamma = self._x, self._drive, self._network.gamma
        switching = _largest(self._flow[self._visible :])
        extent = scale * self._period * max(self._stiffness / _LARGEST_STEP, switching / _LARGEST_SWITCHING)
        count = min(math.ceil(extent), _MOST_STEPS) or 1
        pull, z = self._pull + drift / gamma, gamma * scale * self._period / count
        for _ in range(count):
            x, drive = self._stepping.step(x, drive, pull, z)
        return x, drive, self._field(x, drive)

    def _decode(self, x: Floats, flow: Floats, near: Floats) -> tuple[Floats, Floats]:
        """Posture of a flat state, near another one, and its rates along a field, both ``(n,)``."""
        self._retraction.q, seen = near, slice(self._visible)
        return self._retraction(x[seen].reshape(-1, 6), flow[seen].reshape(-1, 6))


def _largest(values: Floats) -> float:
    """Of their magnitudes, 0 of none; of a few numbers in a tenth of the time of NumPy's."""
    return float(abs(values[idamax(values)])) if len(values) else 0.0


def _certified_norm(network: LieEDNN) -> float:
    """||S W_R S^-1||_2 with the certificate's P = S^2: of W in the norm in which translations count for nothing."""
    scale = np.sqrt(np.asarray(network.lyapunov_diagonal))
    return float(np.linalg.norm(scale[:, None] * network.certifiable_weight / scale, 2))
