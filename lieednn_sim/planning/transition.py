"""Transitions of a moving arm to a new target or onto a new path, with continuous velocity and acceleration.

To a base motion b(t) from rest to rest, corrections are added that fade to zero until the time T_c. With s = t / T_c in
[0, 1] and the differences e, v and a of position, velocity and acceleration at t = 0,

    q(t) = b(t) + e (1 - 10 s^3 + 15 s^4 - 6 s^5) + v T_c (s - 6 s^3 + 8 s^4 - 3 s^5)
         + a T_c^2 / 2 (s^2 - 3 s^3 + 3 s^4 - s^5).

To a target, the base is the straight minimum-jerk motion. If T_c is its duration, q(t) is the quintic of both states.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PPoly

from lieednn_sim.arm import Arm
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.motion import LIMIT_TOLERANCE, Motion
from lieednn_sim.values import Floats

# Coefficients in s of the corrections for unit e, v and a, the lowest power first.
_FADING = np.array(
    [[1.0, 0.0, 0.0, -10.0, 15.0, -6.0], [0.0, 1.0, 0.0, -6.0, 8.0, -3.0], [0.0, 0.0, 0.5, -1.5, 1.5, -0.5]]
).T.copy()
_POWERS = np.arange(6.0)[:, None]
# Maps the coefficients of a polynomial, the lowest power first, to those of itself and its first two derivatives:
# ``(18, 6)``, the three rows of each power next to each other.
_DERIVATIVES = np.hstack([np.linalg.matrix_power(np.diag(np.arange(1.0, 6.0), 1), k) for k in range(3)]).reshape(18, 6)
# Fraction of the limits of velocity and acceleration that a base may use alone, and together with the corrections.
BASE_FRACTION, FRACTION = 0.5, 0.8
# What is tried: factors on the base's duration, and ratios of the fade's duration to the transition's.
_SLOWER, _SHARES = (1.0, 1.25, 1.6, 2.2, 3.0), (1.0, 0.5, 0.25, 0.12, 0.06)
# Samples of a transition, and of a shorter fade.
EVEN, _OF_FADE = np.linspace(0.0, 1.0, 97), np.linspace(0.0, 1.0, 16)


def _powers(s: Floats) -> Floats:
    """``(K, 6)`` powers of ``(K,)``, the lowest first."""
    powers = np.empty((6, len(s)))
    powers[0], powers[1:] = 1.0, s
    return np.asarray(np.multiply.accumulate(powers, out=powers).T)


_EVEN_POWERS = _powers(EVEN)


class Straight:
    """The straight minimum-jerk motion, with the attributes of a `PPoly` used here, at a tenth of the access time.

    Attributes:
        x: ``(2,)`` times of its begin, 0, and end [s].
        c: ``(6, 1, n)`` coefficients, the highest power first.
    """

    def __init__(self, start: Floats, target: Floats, duration: float) -> None:
        self.x, self.c = np.array([0.0, duration]), np.zeros((6, 1, len(start)))
        for k, factor in enumerate((6.0, -15.0, 10.0)):
            self.c[k] = factor / duration ** (5 - k) * (target - start)
        self.c[5] = start

    def __call__(self, t: Floats, nu: int = 0) -> Floats:
        """Configurations ``(K, n)``, or their derivatives of order ``nu`` up to 2, at times ``(K,)`` up to the end."""
        return np.asarray(_powers(t) @ (_DERIVATIVES[nu::3] @ self.c[::-1, 0]))


# A motion from rest to rest; a piecewise polynomial is a planned motion, given or searched for (`along`).
BaseMotion: TypeAlias = PPoly | Straight


@dataclass(frozen=True, eq=False)
class Transition:
    """A motion of the joints from a moving state to rest, twice continuously differentiable where its base is."""

    base: Any  # b, a `BaseMotion` over [0, its last breakpoint], or an object with the same attributes
    slower: float  # factor on its duration
    differences: Floats  # ``(3, n)`` e, v and a
    fade: float  # T_c [s]

    @cached_property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.base.x[-1]) * self.slower

    @property
    def end(self) -> Floats:
        """Joint coordinates ``(n,)`` at the end."""
        return np.asarray(self.base(self.base.x[-1:])[0])

    @cached_property
    def even(self) -> Floats:
        """What a call returns at 97 even times from 0 to the duration."""
        return self(self.duration * EVEN) if self._own is None else self._sum(_EVEN_POWERS)

    def __call__(self, t: Floats, orders: int = 3) -> Floats:
        """Joint coordinates, rates and accelerations ``(3, K, n)`` at times ``(K,)``, or only the first ``orders``.

        It rests after its end.
        """
        result = self._sum(_powers(np.minimum(np.maximum(t / self.fade, 0.0), 1.0)), orders)
        if self._own is None:
            self._add_base(result, t)
        return result

    def acceleration(self, time: float) -> Floats:
        """Accelerations ``(n,)`` at a time."""
        if self._own is None:
            return np.asarray(self(np.array([time]))[2, 0])
        powers = min(time / self.fade, 1.0) ** _POWERS[:, 0]
        return np.asarray(powers @ self._factors[:, -self.differences.shape[1] :])

    def _sum(self, powers: Floats, orders: int = 3) -> Floats:
        """The corrections, or the whole motion, from powers of s ``(K, 6)``, the lowest first."""
        factors = self._factors[:, : orders * self.differences.shape[1]]
        return np.asarray(powers @ factors).reshape(len(powers), orders, -1).swapaxes(0, 1)

    @cached_property
    def _own(self) -> Floats | None:
        """The base's coefficients ``(6, n)``, the lowest first, if it is straight and the corrections take as long."""
        # In this case the whole motion is one polynomial.
        return self.base.c[::-1, 0] if self.fade == self.duration and isinstance(self.base, Straight) else None

    @cached_property
    def _factors(self) -> Floats:
        """``(6, 3 n)`` coefficients in s of the corrections, their rates and accelerations, or of the whole motion."""
        times = self.fade ** _POWERS[:3]
        factors = _FADING @ (self.differences * times)
        if self._own is not None:
            factors += self._own * (self.duration / self.slower) ** _POWERS
        return np.asarray((_DERIVATIVES @ factors).reshape(6, 3, -1) / times).reshape(6, -1)

    def _add_base(self, result: Floats, t: Floats) -> None:
        """Add the base and its first derivatives to ``(orders, K, n)`` at times ``(K,)``."""
        own = np.minimum(np.maximum(t / self.slower, 0.0), self.base.x[-1])
        for order, part in enumerate(result):
            part += self.base(own, nu=order) / self.slower**order


def transition(
    arm: Arm, now: Floats, base: BaseMotion, clear: Callable[[Floats], str | None] | None = None
) -> Transition:
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
    # The base's acceleration is left out: it begins at rest, and a spline's acceleration is not exact.
    differences, lasts = now.copy(), float(base.x[-1])
    differences[:2] -= base.c[:-3:-1, 0]
    refusal, looked = "no transition keeps the limits of the joints", EVEN[::2]

    # After the fade all transitions are on the base's path, so its rest after each share is tested only once.
    known: dict[float, str | None] = {_SHARES[0]: None}

    def blocked_after(share: float) -> str | None:
        if clear is not None and share not in known:
            before = _SHARES[_SHARES.index(share) - 1]
            rest = lasts * looked[(share < looked) & (looked <= before)]
            known[share] = blocked_after(before) or clear(base(rest))
        return known.get(share)

    moves = bool((np.abs(differences) > 1e-12).any())
    limits = FRACTION * np.array([arm.velocity_limits, arm.acceleration_limits])[:, None]
    for slower, share in product(_SLOWER, _SHARES if moves else _SHARES[:1]):
        blocked = blocked_after(share)
        if not blocked:
            result = Transition(base, slower, differences, share * slower * lasts)
            states = result.even
            if share < 1.0:
                of_fade = result(result.fade * _OF_FADE)
                seen = np.concatenate([of_fade[0], states[0, ::2][looked <= share]])
                states = np.concatenate([of_fade, states], axis=1)
            if (np.abs(states[1:]) > limits).any() or (arm.limit_excess(states[0]) > LIMIT_TOLERANCE).any():
                continue
            blocked = None if clear is None else clear(seen if share < 1.0 else _evenly(states[0]))
            if blocked is None:
                return result
        refusal = f"no transition keeps clear of {blocked}"
        if not moves:
            # Without corrections, all transitions take the same path.
            break
    raise PlanError(refusal)


def _evenly(q: Floats) -> Floats:
    """Evenly spaced configurations along ``(K, n)``, apart by at most twice the largest step between these."""
    steps = q[1:] - q[:-1]
    ways = np.sqrt(np.vecdot(steps, steps))
    way = np.add.accumulate(ways)
    count = math.ceil(way[-1] / (2.0 * np.maximum.reduce(ways) + 1e-12))
    at = way[-1] / max(count, 1) * np.arange(1.0, count)
    k = way.searchsorted(at)
    return np.concatenate([q[:1], q[k + 1] - ((way[k] - at) / ways[k])[:, None] * steps[k], q[-1:]])


def straight(arm: Arm, start: Floats, target: Floats, least: float) -> Straight:
    """The straight minimum-jerk motion within `BASE_FRACTION` of the limits, in at least ``least`` [s]."""
    distance = np.abs(target - start)
    # The factors are the minimum-jerk law's largest speed and acceleration on [0, 1].
    return Straight(start, target, max(least, _slower(arm, 1.875 * distance, 10.0 / math.sqrt(3.0) * distance)))


def along(arm: Arm, motion: Motion) -> PPoly:
    """A planned motion as a base motion, slowed down until it keeps `BASE_FRACTION` of the limits."""
    spline = CubicHermiteSpline(motion.t, motion.q, motion.qd)
    slower = max(1.0, _slower(arm, motion.qd, np.diff(motion.qd, axis=0) / motion.timestep))
    powers = slower ** -np.arange(3.0, -1.0, -1.0)
    return PPoly(spline.c * powers[:, None, None], slower * spline.x)


def _slower(arm: Arm, rates: Floats, accelerations: Floats) -> float:
    """The factor on the duration of a motion with these rates with which it keeps `BASE_FRACTION` of the limits."""
    fast, bent = np.abs(rates) / arm.velocity_limits, np.abs(accelerations) / arm.acceleration_limits
    return max(float(fast.max()) / BASE_FRACTION, math.sqrt(bent.max() / BASE_FRACTION))
