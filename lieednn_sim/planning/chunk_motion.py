"""The smooth curve through a chunk of joint targets, and the motion of an arm onto it.

The targets y_k at times k h become a uniform cubic B-spline with control points c, the minimum of

    |B c - y|^2 + s |D c|^2,

where B c are its values at these times and D takes third differences (P-splines: Eilers and Marx, Statistical Science
11(2), 1996). Generalised cross-validation chooses s for each joint; it is nearly zero for smooth targets. Such a curve
stays within the convex hull of its control points: if these keep the position limits, it does so at every instant.

A chunk that is too fast is slowed down as a whole by a factor f: its own time u advances at the rate u' = 1 / f. It
ends at rest: over the last time D this rate falls as 1 - 10 x^3 + 15 x^4 - 6 x^5, with x from 0 to 1.
"""

from __future__ import annotations

import math
from contextlib import suppress
from functools import cached_property, lru_cache
from itertools import product

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.motion import LIMIT_TOLERANCE
from lieednn_sim.planning.transition import EVEN, Transition
from lieednn_sim.values import Floats

# Weights of a segment's four control points from the powers of its time, and those of its first two derivatives.
_CUBIC = np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6.0
_POWERS = np.diag([1.0, 2.0, 3.0], 1)
_SEGMENT = np.concatenate([np.linalg.matrix_power(_POWERS, k) @ _CUBIC for k in range(3)], axis=1)
_FOUR, _ORDERS = np.arange(4), np.arange(3).repeat(4)
# Weights s that are tried; the greatest one whose score is at most this multiple of the best is taken.
_WEIGHTS, _NEARLY = np.logspace(-3.0, 7.0, 21), 1.3
# Factors on the least durations of a chunk and of the fade onto it, ordered by how much they delay it.
_TRIED = sorted(product((1.0, 1.15, 1.4, 2.0, 3.0, 5.0, 8.0), (1.0, 1.4, 2.0, 3.0, 5.0)), key=math.prod)
# A ramp from speed 1 to rest, for x from 0 to 1: way, speed and the derivative of the speed, from the powers of x.
# Then, at nine values of x, the way that is left, the squared speed, and the derivative of the speed.
_RAMP = np.array([[0, 1, 0, 0, -2.5, 3, -1], [1, 0, 0, -10, 15, -6, 0], [0, 0, -30, 60, -30, 0, 0]])
_WAY, _SPEED, _BEND = _RAMP @ np.linspace(0.0, 1.0, 9) ** np.arange(7.0)[:, None]
_LEFT, _SQUARE = 0.5 - _WAY, (_SPEED**2)[:, None]


class ChunkCurve:
    """The curve of a chunk over its own time u, from 0 to ``duration`` [s]; it ends at ``end`` ``(n,)``.

    It has ``(H + 2, n)`` control points [rad, m] for H targets, which are a time ``step`` h apart [s].
    """

    def __init__(self, control: Floats, step: float) -> None:
        self._control, self.step, self._last = control, step, len(control) - 4
        #: Configurations ``(H, n)`` at the times of the targets.
        self.values: Floats = (control[:-2] + 4.0 * control[1:-1] + control[2:]) / 6.0
        self._segment, self._excess = _SEGMENT / step**_ORDERS, dict[int, list[tuple[float, int, int]]]()
        self.duration = step * (self._last + 1)
        self._at: tuple[float, Floats] = (math.nan, control[:0])
        self.end = self.values[-1]

    @classmethod
    def through(cls, arm: Arm, targets: Floats, step: float) -> ChunkCurve:
        """The curve of targets ``(H, n)``, smoothed if they are noisy, within the position limits."""
        targets = targets if len(targets) > 1 else targets.repeat(2, axis=0)
        control, modes, lost, scores = _fitting(len(targets))
        parts = modes.T @ targets
        score = scores @ (parts * parts)
        # The greatest weight with nearly the best score.
        best = len(score) - 1 - (score <= _NEARLY * score.min(axis=0))[::-1].argmax(axis=0)
        kept = modes @ (parts * (1.0 - lost[best].T))
        low, high = arm.position_limits.T
        points = arm.within_angles(np.concatenate([control @ kept, kept[[0, -1]]]))
        points = np.minimum(np.maximum(points, low), high)
        # The curve's ends were limited in place of the outermost control points: the first segment is a convex
        # combination of its begin and its last three control points, and likewise for the last segment.
        points[0] = 6.0 * points[-2] - 4.0 * points[1] - points[2]
        points[-3] = 6.0 * points[-1] - 4.0 * points[-4] - points[-5]
        return cls(points[:-2], step)

    def __call__(self, u: Floats, orders: int = 3) -> Floats:
        """Configurations and their first derivatives in u ``(orders, K, n)``, at times ``(K,)``."""
        parts = u / self.step
        segment = np.minimum(parts.astype(int), self._last)
        powers = np.empty((len(u), 4))
        powers[:, 0], powers[:, 1:] = 1.0, (parts - segment)[:, None]
        factors = self._segment[:, : 4 * orders]
        weights = (np.multiply.accumulate(powers, axis=1, out=powers) @ factors).reshape(-1, orders, 4)
        return (weights @ self._control[segment[:, None] + _FOUR]).swapaxes(0, 1)

    def at(self, u: float) -> Floats:
        """The configuration and its derivatives ``(3, n)`` at one time; the last result is cached."""
        if u != self._at[0]:
            segment = min(int(u / self.step), self._last)
            weights = ((u / self.step - segment) ** _FOUR) @ self._segment
            self._at = u, weights.reshape(3, 4) @ self._control[segment : segment + 4]
        return self._at[1]

    def nearest(self, q: Floats, latest: float) -> float:
        """The time, of 65 even ones up to ``latest``, at which the curve is nearest to a configuration ``(n,)``."""
        u = np.linspace(0.0, latest, 65)
        return float(u[np.square(self(u, 1)[0] - q).sum(axis=1).argmin()])

    def places(self, begin: float, apart: float) -> tuple[Floats, Floats]:
        """Times ``(K,)`` from ``begin`` on and the configurations ``(K, n)`` then, at most about ``apart`` apart."""
        steps, first = self.values[1:] - self.values[:-1], math.ceil(begin / self.step - 1e-9)
        parts = math.ceil(math.sqrt(np.vecdot(steps, steps).max()) / apart)
        if parts <= 1:
            return self.step * np.arange(float(first), len(self.values)), self.values[first:]
        u = np.linspace(begin, self.duration, parts * (len(self.values) - first) + 1)
        return u, self(u, 1)[0]

    def excess(self, arm: Arm, begin: float) -> list[tuple[float, int, int]]:
        """Largest fractions of the velocity and acceleration limits used from ``begin`` on, with joints and rows."""
        first = min(int(begin / self.step), self._last)
        if first in self._excess:
            return self._excess[first]
        rates = (self._control[first + 1 :] - self._control[first:-1]) / self.step
        # Rates in the middle between two knots, and at the knots.
        middle, at = (rates[:-2] + 6.0 * rates[1:-1] + rates[2:]) / 8.0, 0.5 * (rates[1:] + rates[:-1])
        parts = np.abs(np.concatenate([at, middle])) / arm.velocity_limits
        bends = np.abs(rates[1:] - rates[:-1]) / self.step / arm.acceleration_limits
        found = ((part, *divmod(int(part.argmax()), part.shape[1])) for part in (parts, bends))
        self._excess[first] = [(float(part[k, joint]), joint, first + k % len(at)) for part, k, joint in found]
        return self._excess[first]


class Ramped:
    """A curve from its own time ``begin`` to ``end`` [s], ``slower`` by f, that comes to rest by a ``ramp`` of D [s].

    Like the breakpoints of a `PPoly`, ``x`` ``(2,)`` has its times at begin and end [s]; after the end it rests. The
    ramp begins at ``ramps_at`` [s]; without a ramp it rests all the time.
    """

    def __init__(self, curve: ChunkCurve, begin: float, end: float, slower: float, ramp: float) -> None:
        self.curve, self.begin, self.end, self.slower, self._ramp = curve, begin, end, slower, max(ramp, 1e-9)
        self.ramps_at = max((end - begin) * slower - 0.5 * self._ramp, 0.0)
        self._full, self.x = 1.0 / slower if ramp else 0.0, np.array([0.0, self.ramps_at + self._ramp])
        self._factors = self._full * _RAMP * [[self._ramp], [1.0], [1.0 / self._ramp]]

    def clock(self, t: Floats, orders: int = 3) -> Floats:
        """The curve's own time u at times ``(K,)``, and its first two derivatives ``(3, K)``, or the first of these."""
        powers = np.empty((7, len(t)))
        powers[0], powers[1:] = 1.0, np.minimum(np.maximum((t - self.ramps_at) / self._ramp, 0.0), 1.0)
        result = self._factors[:orders] @ np.multiply.accumulate(powers, out=powers)
        result[0] = np.minimum(result[0] + (self.begin + self._full * np.minimum(t, self.ramps_at)), self.end)
        return result

    def states(self, t: Floats, orders: int = 3) -> Floats:
        """Joint coordinates, rates and accelerations ``(3, K, n)`` at times ``(K,)`` from 0 on, or coordinates."""
        u, *rates = self.clock(t, orders)
        states = self.curve(u, orders)
        if orders == 1:
            return states
        (rate, bend), (_, slope, turn) = rates, states
        turn *= (rate * rate)[:, None]
        turn += slope * bend[:, None]
        slope *= rate[:, None]
        return states

    def __call__(self, t: float) -> Floats:
        """Joint coordinates ``(n,)`` at a time."""
        return self.states(np.array([t]), 1)[0, 0]


class ChunkMotion(Transition):
    """A transition onto a chunk's curve; ``base`` is a `Ramped`."""

    @cached_property
    def duration(self) -> float:
        """Duration [s]; the fade may outlast the base."""
        return max(float(self.base.x[-1]) * self.slower, self.fade)

    @property
    def in_time(self) -> bool:
        """Whether the fade is over before the curve ends."""
        return self.fade <= float(self.base.x[-1])

    def acceleration(self, time: float) -> Floats:
        """Accelerations ``(n,)`` at a time, interpolated linearly between those at 97 even times."""
        place = min(time / self.duration, 1.0) * (len(EVEN) - 1)
        k = min(int(place), len(EVEN) - 2)
        before, after = self.even[2][k : k + 2]
        return np.asarray(before + (place - k) * (after - before))

    def _add_base(self, result: Floats, t: Floats) -> None:
        result += self.base.states(t, len(result))

    def until(self, time: float) -> Floats:
        """Joint coordinates, rates and accelerations ``(3, K, n)`` at 13 to 97 times up to ``time``."""
        count, faded = len(EVEN), time / self.duration
        if faded > 0.12:
            return self.even[:, : math.ceil((count - 1) * faded) + 1]
        # Together with those of `even`, which others ask for.
        states = self(np.concatenate([self.duration * EVEN, time * EVEN[::3]]))
        vars(self)["even"] = states[:, :count]
        return states[:, count:]


def go_over(arm: Arm, now: Floats, curve: ChunkCurve, begin: float, most: float, fade: float) -> ChunkMotion:
    """The transition from a state onto a curve, as fast as the arm's limits allow.

    From ``now``, ``(3, n)`` joint coordinates, rates and accelerations, it goes over to the curve, beginning at the
    curve's time ``begin`` [s], in at least ``fade`` [s]; it follows the curve for ``most`` [s] of its time, and
    ends at rest. If the state is so far behind that the curve would end before the fade, the curve is joined earlier,
    at the earliest where it is nearest to the state; if even that is too late, it is slowed down. Positions, velocities
    and accelerations are checked at samples; `PlanError` if no transition tried keeps the limits.
    """
    back = 0.0
    for late in (0.0, 0.25, 0.5, 0.75, 1.0):
        motion = _joined(arm, now, curve, begin - late * back, most, fade)
        if motion.in_time:
            return motion
        back = back or begin - curve.nearest(now[0], begin)
        if not back:
            break
    # A state that is ahead of the curve would have to go back first.
    if curve.nearest(now[0], curve.duration) < begin + 0.25 * fade:
        with suppress(PlanError):
            return _joined(arm, now, curve, begin - back, most, fade, slows=True)
    return motion


def _joined(
    arm: Arm, now: Floats, curve: ChunkCurve, begin: float, most: float, fade: float, slows: bool = False
) -> ChunkMotion:
    """The transition that joins a curve at ``begin``, and rests at most ``most`` later; see `go_over`."""
    end = min(begin + most, curve.duration)
    v, a = limits = np.array([arm.velocity_limits, arm.acceleration_limits])
    (fast, *_), (bent, *_) = curve.excess(arm, begin)
    least, ramps = max(1.0, fast, math.sqrt(bent)), dict[float, float | None]()
    there, slope, turn = curve.at(begin)
    for more, longer in _TRIED:
        slower = least * more
        if more not in ramps:
            ramps[more] = _shortest_ramp(arm, curve, begin, end, slower)
        if (ramp := ramps[more]) is None:
            continue
        base = Ramped(curve, begin, end, slower, ramp)
        away = np.abs(differences := now - [there, slope / slower * (ramp > 0.0), turn / slower**2 * (ramp > 0.0)])
        soonest = _soonest(away, 0.5 * limits)
        if soonest > fade:
            taken = np.abs(base.states(np.linspace(0.0, float(base.x[-1]), 33))[1:]).max(axis=1)
            soonest = _soonest(away, np.maximum(limits - taken, 0.5 * limits))
        result = ChunkMotion(base, 1.0, differences, longer * max(fade, soonest))
        if slows and not result.in_time:
            continue
        q, qd, qdd = result.until(result.fade)
        fits = (np.abs(qd) <= 1.001 * v).all() and (np.abs(qdd) <= 1.001 * a).all()
        # The present state itself may be beyond a limit, since its code is not exact.
        beyond = arm.limit_excess(q)
        if fits and (beyond <= LIMIT_TOLERANCE + np.maximum(beyond[0], 0.0)).all():
            return result
    raise PlanError("no transition onto the chunk keeps the limits of the joints")


def _soonest(away: Floats, left: Floats) -> float:
    """About the least time [s] for differences ``(3, n)`` to fade, using velocities and accelerations ``(2, n)``."""
    v, a = left
    # The largest derivatives of the corrections of `transition` for differences in position and in velocity.
    return float(max((1.875 * away[0] / v).max(), math.sqrt((5.78 * away[0] / a).max()), (4.0 * away[1] / a).max()))


def _shortest_ramp(arm: Arm, curve: ChunkCurve, begin: float, end: float, slower: float) -> float | None:
    """The shortest ramp D [s] tried in which a curve comes to rest at its time ``end`` within the limits, if any."""
    most = 2.0 * slower * (end - begin)
    if most < 1e-6:
        return 0.0
    # Increasing durations, from at least 0.04 s on.
    tried = most * 0.75 ** np.arange(max(math.log(most / 0.04) / math.log(4.0 / 3.0), 0.0) // 1.0 + 1.0)[::-1]
    times = tried[:, None] / slower
    _, slope, turn = curve(np.maximum(end - times * _LEFT, begin).ravel()).reshape(3, len(tried), 9, -1)
    qdd = turn * _SQUARE + slope * (_BEND / times)[..., None]
    fits = (np.abs(qdd) <= slower**2 * arm.acceleration_limits).all(axis=(1, 2))
    return float(tried[fits.argmax()]) if fits.any() else None


@lru_cache(maxsize=64)
def _fitting(count: int) -> tuple[Floats, Floats, Floats, Floats]:
    """For ``count`` targets, the map from values to control points of the smoothest curve, and the curve's modes.

    These are ``(count + 2, count)`` and orthonormal ``(count, count)``. Then, for each of `_WEIGHTS`, the part of each
    mode that smoothing removes, and the factor on the mode's square in the score of generalised cross-validation.
    """
    values = (np.eye(count, count + 2) + 4.0 * np.eye(count, count + 2, 1) + np.eye(count, count + 2, 2)) / 6.0
    firsts, thirds = (np.diff(np.eye(count + 2), n=order, axis=0) for order in (1, 3))
    # Lagrange's conditions for the least |D c|^2 with B c = y; the small term decides where two targets would not.
    system = np.block([[thirds.T @ thirds + 1e-9 * firsts.T @ firsts, values.T], [values, np.zeros((count, count))]])
    control = np.linalg.solve(system, np.eye(2 * count + 2)[:, count + 2 :])[: count + 2]
    bent = thirds @ control
    bending, modes = np.linalg.eigh(bent.T @ bent)
    weighted = _WEIGHTS[:, None] * np.maximum(bending, 0.0)
    lost = weighted / (1.0 + weighted)
    return control, modes, lost, (lost / np.maximum(lost.sum(axis=1, keepdims=True), 1e-300)) ** 2
