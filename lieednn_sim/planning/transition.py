"""Transitions of a moving arm to a new target or onto a new path, with continuous velocity and acceleration.

A base motion b(t) from rest to rest gets corrections that vanish at the time T_c of the fade. With s = t / T_c in
[0, 1] and the differences e, v and a of position, velocity and acceleration at t = 0,

    q(t) = b(t) + e (1 - 10 s^3 + 15 s^4 - 6 s^5) + v T_c (s - 6 s^3 + 8 s^4 - 3 s^5)
         + a T_c^2 / 2 (s^2 - 3 s^3 + 3 s^4 - s^5).

To a target the base is the straight minimum-jerk motion; with T_c its duration, q(t) is the quintic polynomial between
the two states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PPoly

from lieednn_sim.arm import Arm
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.motion import LIMIT_TOLERANCE, Motion
from lieednn_sim.values import Floats

# Coefficients of the corrections for unit e, v and a in s, the lowest power first.
_FADING = np.array(
    [[1.0, 0.0, 0.0, -10.0, 15.0, -6.0], [0.0, 1.0, 0.0, -6.0, 8.0, -3.0], [0.0, 0.0, 0.5, -1.5, 1.5, -0.5]]
)
# Fraction of the limits of velocity and acceleration that a base may take; together with the corrections.
BASE_FRACTION, FRACTION = 0.5, 0.8


@dataclass(frozen=True, eq=False)
class Transition:
    """A motion of the joints from a moving state to rest, twice continuously differentiable where its base is.

    Attributes:
        base: b, a piecewise polynomial from rest to rest over [0, its last breakpoint].
        slower: factor on its duration.
        differences: ``(3, n)`` e, v and a.
        fade: T_c [s].
    """

    base: PPoly
    slower: float
    differences: Floats
    fade: float

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.base.x[-1]) * self.slower

    @property
    def end(self) -> Floats:
        """Joint coordinates ``(n,)`` at the end."""
        return np.asarray(self.base(self.base.x[-1]))

    def __call__(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Joint coordinates, rates and accelerations, each ``(K, n)``, at times ``(K,)``; at rest after the end."""
        own = np.clip(t / self.slower, 0.0, self.base.x[-1])
        s = np.clip(t / self.fade, 0.0, 1.0)[:, None] ** np.arange(6)
        scaled = self.differences * self.fade ** np.arange(3.0)[:, None]
        results = []
        factors = _FADING
        for order, part in enumerate(self._along(own)):
            results.append(
                part / self.slower**order + s[:, : factors.shape[1]] @ (factors.T @ scaled) / self.fade**order
            )
            factors = factors[:, 1:] * np.arange(1.0, factors.shape[1])
        return results[0], results[1], results[2]

    def _along(self, own: Floats) -> Floats:
        """The base and its first two derivatives ``(3, K, n)`` at its times ``(K,)``."""
        return np.stack([self.base(own, nu=order) for order in range(3)])


def transition(arm: Arm, now: Floats, base: PPoly, clear: Callable[[Floats], str | None] | None = None) -> Transition:
    """The fastest tried transition from a state onto a base motion that keeps the arm's limits and clearance.

    Positions, velocities and accelerations are checked at samples, the latter two against `FRACTION` of their limits.

    Args:
        arm: the arm.
        now: ``(3, n)`` joint coordinates, rates and accelerations at the beginning.
        base: motion from rest to rest, such as `straight` or `along` make.
        clear: says what is in the way at configurations ``(K, n)``, or None; by default nothing is checked.

    Raises:
        PlanError: no transition tried keeps the limits and the clearance.
    """
    # The base's own acceleration may be left out: it begins at rest, and a spline's is no exact one.
    differences = now - np.stack([base(0.0), base(0.0, nu=1), np.zeros_like(now[2])])
    refusal = "no transition keeps the limits of the joints"
    # Durations of the fade over the transition's.
    shares = (1.0, 0.5, 0.25, 0.12, 0.06) if (np.abs(differences) > 1e-12).any() else (1.0,)
    for slower, share in product((1.0, 1.25, 1.6, 2.2, 3.0), shares):
        duration = slower * float(base.x[-1])
        fade = share * duration
        result = Transition(base, slower, differences, fade)
        of_fade = np.linspace(0.0, fade, 16)
        t = np.concatenate([of_fade, np.linspace(0.0, duration, 48)])
        q, qd, qdd = result(t)
        if (
            (np.abs(qd) > FRACTION * arm.velocity_limits).any()
            or (np.abs(qdd) > FRACTION * arm.acceleration_limits).any()
            or (arm.limit_excess(q) > LIMIT_TOLERANCE).any()
        ):
            continue
        # All samples of a fade that takes the whole motion are there twice.
        blocked = None if clear is None else clear(q[len(of_fade) * (share == 1.0) :])
        if blocked is None:
            return result
        refusal = f"no transition keeps clear of {blocked}"
    raise PlanError(refusal)


def straight(arm: Arm, start: Floats, target: Floats, least: float) -> PPoly:
    """The straight minimum-jerk motion within `BASE_FRACTION` of the limits, in at least ``least`` [s]."""
    distance = np.abs(target - start)
    # The law's largest speed and acceleration on [0, 1].
    duration = max(least, _slower(arm, 1.875 * distance, 10.0 / np.sqrt(3.0) * distance))
    powers = np.array([6.0, -15.0, 10.0, 0.0, 0.0, 0.0]) / duration ** np.arange(5.0, -1.0, -1.0)
    factors = powers[:, None, None] * (target - start)
    factors[-1] += start
    return PPoly(factors, [0.0, duration])


def along(arm: Arm, motion: Motion) -> PPoly:
    """A planned motion as a base, slowed down until it keeps `BASE_FRACTION` of the limits."""
    spline = CubicHermiteSpline(motion.t, motion.q, motion.qd)
    slower = max(1.0, _slower(arm, motion.qd, np.diff(motion.qd, axis=0) / motion.timestep))
    powers = slower ** -np.arange(3.0, -1.0, -1.0)
    return PPoly(spline.c * powers[:, None, None], slower * spline.x)


def _slower(arm: Arm, rates: Floats, accelerations: Floats) -> float:
    """How many times longer a motion of these rates must take to keep `BASE_FRACTION` of the limits."""
    fast = (np.abs(rates) / (BASE_FRACTION * arm.velocity_limits)).max()
    return float(max(fast, np.sqrt((np.abs(accelerations) / (BASE_FRACTION * arm.acceleration_limits)).max())))
