"""Clearance of a motion at every instant: a continuous-time collision certificate.

Between samples, a motion is the cubic through their positions and velocities. In an interval of time of half width h,
it is q + c p + r with |c| <= 1, where q is the position in the middle, p is h times the rate there, and |r| is at most
h^2 / 2 times the largest acceleration, which is linear on each step of the cubic. For all such joints,
`arm.clearance_bounds` gives a lower bound of the distances of all geoms; intervals in which it does not suffice are
divided. Samples can step over a thin obstacle, a bound cannot.

The proof assumes that MuJoCo's kinematics are right, that it overlooks nothing near, and that geoms are convex, as
MuJoCo takes meshes to be. Near height fields, moving parts count with their whole reach. Nothing is proved about parts
that closed loops or curves move (`Arm.dependents`), or where there are flexes or geoms of the type sdf.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.arm.clearance_bounds import ClearanceBounds
from lieednn_sim.budget import check_time
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.values import Floats, frozen, weakly_cached

# Least number of first intervals; the longest way in one of them, beyond which a proof is rare [rad, m]; and how many
# bounds are worth while, besides one for every fourth sample.
_FIRST, _WAY, _MOST = 16, 0.2, 256
# Intervals shorter than this fraction of a step are not divided.
_SHORTEST = 1.0 / 4096.0
# Distance beyond which nothing is measured, and the least cutoff of measurements [m]; and the fraction of the least
# measured distance that the proved clearance must reach.
FAR, NEAR, _SHARP = 0.1, 1e-4, 0.95


@frozen
class Clearance:
    """What is proved about the distances from contact along a motion.

    Attributes:
        bound: lower bound of all distances at all instants outside of `unproved`, up to 0.1 [m]; -inf if there is none.
        t: the instant [s] near which the bound is attained.
        pair: names of the geoms; empty if nothing comes nearer than 0.1 m.
        unproved: ``(U, 2)`` begin and end [s] of stretches where contact is excluded at the samples only.
        doubtful: names of geoms that may touch in an unproved stretch; empty if there is none.
        proved_fraction: the fraction of the motion's time outside of `unproved`.
        reason: why nothing can be proved about the arm; empty if something can.
        others: where the arm's own parts are the nearest pair, the clearance of all other pairs.
    """

    bound: float
    t: float
    pair: tuple[str, ...]
    unproved: Floats
    proved_fraction: float = 1.0
    reason: str = ""
    doubtful: tuple[str, ...] = ()
    others: Clearance | None = None

    @property
    def proved(self) -> bool:
        """Whether no contact at any instant is proved."""
        return not len(self.unproved)

    def at(self, time: float | None = None) -> str:
        """What is proved at a time [s], or at all times, in a few words."""
        if any(time is None or begin <= time <= end for begin, end in self.unproved):
            return "clearance not proved"
        return f"at least {1e3 * self.bound:.3g} mm clear, proved"

    def __str__(self) -> str:
        least = f"at least {self._least()}"
        if self.others is not None:
            least = f"at least {self._least(' between parts of the arm')}; {self.others._least(' from all else')}"
        if self.proved:
            return f"{least}, proved at every instant"
        if self.bound == -np.inf:
            return self.reason or "not proved at any instant"
        some = ", ".join(f"{begin:.3f} to {end:.3f} s" for begin, end in self.unproved[:3])
        more = f" and {len(self.unproved) - 3} more stretches" if len(self.unproved) > 3 else ""
        return f"not proved from {some}{more}; elsewhere {least}"

    def _least(self, between: str = "") -> str:
        by = f", {self.pair[0]!r} from {self.pair[1]!r} at {self.t:.2f} s" if self.pair else ""
        return f"{1e3 * self.bound:.3g} mm{between}{by}"


class Cubics:
    """The cubics between the samples of a motion, at times ``(K,)`` in equal steps.

    Args:
        step: time between samples [s].
        q: ``(K, n)`` positions [rad, m].
        qd: ``(K, n)`` rates [rad/s, m/s].
        off: ``(K, n)`` how far joints may be from the motion at the samples, linear in between [rad, m].
    """

    def __init__(self, step: float, q: Floats, qd: Floats, off: Floats | None = None) -> None:
        self._q, self._moved, self._off = q, step * qd, off
        chords, before, after = q[1:] - q[:-1], self._moved[:-1], self._moved[1:]
        # Accelerations at the ends of each step, times its square.
        self._ends = np.array([6.0 * chords - 4.0 * before - 2.0 * after, 4.0 * after + 2.0 * before - 6.0 * chords])
        self._largest = np.maximum(*np.abs(self._ends))

    def turns(self) -> Floats:
        """Instants ``(I,)`` between samples, in steps, at which the velocity of a joint changes its sign."""
        before, after, (first, last) = self._moved[:-1], self._moved[1:], self._ends
        bent = np.minimum(before * after, first * last) < -1e-30  # more than rounding
        at = k, _ = np.divmod(np.flatnonzero(bent), bent.shape[1])
        rate, first, jerk = before[at], first[at], (last - first)[at]
        with np.errstate(divide="ignore", invalid="ignore"):
            # Both roots of rate + first s + jerk s^2 / 2, without cancellation.
            half = -0.5 * (first + np.copysign(np.sqrt(first**2 - 2.0 * rate * jerk), first))
            roots = np.array([2.0 * half / jerk, rate / half])
        return (k + roots)[(roots > 0.0) & (roots < 1.0)]

    def fastest(self) -> Floats:
        """Largest rates ``(K - 1, n)`` between samples, times the step; 0 where those at the samples are larger."""
        first, last = self._ends
        inside, result = np.divmod(np.flatnonzero(first * last < 0.0), first.shape[1]), np.zeros_like(first)
        result[inside] = self._moved[inside] - 0.5 * first[inside] ** 2 / (last[inside] - first[inside])
        return result

    def at(self, times: ArrayLike) -> tuple[Floats, Floats]:
        """Joint positions, and rates times the step, both ``(I, n)``, at instants ``(I,)`` in steps."""
        instants = np.asarray(times, dtype=float)
        k = np.minimum(instants.astype(int), len(self._largest) - 1)
        s = (instants - k)[:, None]
        q, moved, first, last = self._q[k], self._moved[k], *self._ends[:, k]
        jerk = last - first
        return q + s * (moved + s * (0.5 * first + s * jerk / 6.0)), moved + s * (first + 0.5 * s * jerk)

    def around(self, begin: ArrayLike, end: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Midpoints of intervals and directions, both ``(I, n)``, and bounds of how far joints deviate from these.

        The bounds ``(I, 2, n)`` are those in the interval and at its middle. Begin and end ``(I,)`` are in steps.
        """
        begin, end = np.asarray(begin, dtype=float), np.asarray(end, dtype=float)
        middle, half = 0.5 * (begin + end), 0.5 * (end - begin)[:, None]
        at, rate = self.at(middle)
        # The range of steps that each interval touches.
        count, ends = len(self._largest), zip(begin.tolist(), end.tolist(), strict=True)
        steps = [(min(int(a), count - 1), min(max(math.ceil(b), int(a) + 1), count)) for a, b in ends]
        widest = np.array([np.maximum.reduce(self._largest[a:b]) for a, b in steps]).reshape(at.shape)
        if self._off is None:
            left = np.zeros_like(at)
        else:
            # The first term is the distance of a chord from its cubic within a step.
            left = 0.125 * widest + [np.maximum.reduce(self._off[a : b + 1]) for a, b in steps]
        return at, half * rate, np.stack([0.5 * half**2 * widest + left, left], axis=1)


def check_clearance(arm: Arm, t: Floats, q: Floats, qd: Floats, cubics: Cubics | None = None) -> None:
    """Check that a motion keeps the arm's `clearance`.

    It is proved over intervals. Those without a proof are tested at their samples; where even contact is not excluded,
    instants between the samples are tested, too.

    Args:
        arm: the arm, in its scene.
        t: ``(K,)`` evenly spaced times [s].
        q: ``(K, n)`` joint positions [rad, m].
        qd: ``(K, n)`` their rates [rad/s, m/s].
        cubics: its `Cubics`, if at hand.

    Raises:
        PlanError: something is nearer; the message names it, and the time.
    """
    bounds, step = bounds_of(arm, own=True), float(t[1] - t[0])
    cubics = Cubics(step, q, qd) if cubics is None else cubics
    begin, end = _edges(q)
    tested = 0
    # Most motions that touch something do so at these instants, and a test costs a fiftieth of a bound.
    _test(arm, step, cubics, begin)
    while len(begin):
        check_time()
        if isinstance(bounds, str) or tested > _MOST + len(t) // 4:
            every = [np.arange(np.floor(a), np.ceil(b) + 1.0) for a, b in zip(begin, end, strict=True)]
            _test(arm, step, cubics, np.unique(np.concatenate(every)))
            return
        tested += len(begin)
        least, _, _ = bounds.least(*cubics.around(begin, end), arm.clearance)
        begin, end, least = (values[least < arm.clearance] for values in (begin, end, least))
        middle, whole = 0.5 * (begin + end), end - begin > 1.0
        _test(arm, step, cubics, np.concatenate([np.floor(middle[whole]), begin[~whole], end[~whole]]))
        begin, end = _divided(begin, end, whole | (least <= 0.0))


def _test(arm: Arm, step: float, cubics: Cubics, at: Floats) -> None:
    """Raise `PlanError` where something is nearer than the arm's clearance, at times ``(I,)`` in steps."""
    at = at[np.argsort(np.arange(len(at)) % _FIRST != 0, kind="stable")]
    check_contact(arm, step * at, cubics.at(at)[0])


def check_contact(arm: Arm, t: Floats, q: Floats) -> None:
    """Raise `PlanError` where something is nearer than the arm's clearance, at times ``(I,)`` [s]."""
    for time, touching in zip(t, arm.near_contacts_along(q), strict=True):
        if touching:
            near = f"come within {1e3 * arm.clearance:g} mm of" if arm.clearance else "touch"
            raise PlanError(f"{touching[0][0]!r} would {near} {touching[0][1]!r} at t = {time:.2f} s")


def proved_clearance(
    arm: Arm,
    t: Floats,
    q: Floats,
    qd: Floats,
    off: Floats | None = None,
    *,
    far: float = FAR,
    own: bool = True,
    others: bool = False,
    slack: float = 0.0,
) -> Clearance:
    """Bound the distances from contact along a motion, at every instant; a held body may touch what it stands on.

    Args:
        arm, t, q, qd: as for `check_clearance`.
        off: ``(K, n)`` how far joints may be from the motion at its samples, such as a run's tracking errors [rad, m].
        far: distance beyond which nothing is measured [m].
        own: whether the arm's own parts, its base included, count against each other.
        others: whether `Clearance.others` is found, for those who read it.
        slack: by how much geoms may be nearer to each other than the joints have them [m].
    """
    bounds, step = bounds_of(arm.unsupported, own=own), float(t[1] - t[0])
    if isinstance(bounds, str):
        return Clearance(-np.inf, 0.0, (), t[None, [0, -1]], 0.0, bounds)
    cubics = Cubics(step, q, qd, off)
    begin, end = _edges(q)
    nearest, bound, time, pair, doubtful = far, far, 0.0, (-1, -1), (-1, -1)
    unproved: list[tuple[float, float]] = []
    measured, coarse = 0, 0.1 if off is None else len(t) / 32.0
    while len(begin):
        check_time()
        measured += len(begin)
        least, there, pairs = bounds.least(*cubics.around(begin, end), nearest + slack)
        least, there = least - slack, there - slack
        nearest = max(float(there[there > 0.0].min(initial=nearest)), NEAR)
        done = (least > 0.0) & ((least >= _SHARP * nearest) | (end - begin <= 1.0))
        if measured > _MOST + len(t) // 4:
            done |= least > 0.0
        worst = int(np.where(done, least, np.inf).argmin())
        if done[worst] and least[worst] < bound:
            bound, time = float(least[worst]), 0.5 * step * float(begin[worst] + end[worst])
            pair = tuple(pairs[worst].tolist())
        # Give up an interval whose middle may touch; earlier with errors `off`, which hardly differ in its parts.
        last = (end - begin < _SHORTEST) | ((there <= 0.0) & (end - begin < coarse)) | (measured > 4 * (_MOST + len(t)))
        last &= ~done
        doubtful = next(map(tuple, pairs[last].tolist()), doubtful)
        unproved += zip(begin[last].tolist(), end[last].tolist(), strict=True)
        begin, end = _divided(begin, end, ~done & ~last)
    stretches = step * _joined(unproved)
    proved = 1.0 - float(np.ptp(stretches, axis=1).sum()) / float(t[-1] - t[0])
    # Without any time that is proved, up to rounding, there is no bound.
    bound = bound if proved > 1e-9 else -np.inf
    near, touching = (bounds.names(two) if two[0] >= 0 else () for two in (pair, doubtful))
    apart = None
    if others and near and bounds.owns(pair):
        apart = proved_clearance(arm, t, q, qd, off, far=far, own=False, slack=slack)
    return Clearance(bound, time, near, stretches, proved, doubtful=touching, others=apart)


class ProofAhead:
    """A proof that a motion is clear of contact, which grows from its beginning on, interval by interval.

    Args:
        arm, t, q, qd, off: as for `proved_clearance`.

    Attributes:
        pair: names of the geoms that may touch where the proof finally ends; empty while it can go on.
    """

    def __init__(self, arm: Arm, t: Floats, q: Floats, qd: Floats, off: Floats) -> None:
        self._arm, self._step = arm, float(t[1] - t[0])
        self._cubics = Cubics(self._step, q, qd, off)
        # The intervals that are left, the earliest last.
        self._left = list(zip(*(edge[::-1].tolist() for edge in _edges(q, 4)), strict=True))
        self.pair: tuple[str, ...] = ()

    @property
    def time(self) -> float:
        """Time up to which it is proved that nothing touches [s]; infinite once that is the whole motion."""
        return self._step * self._left[-1][0] if self._left else math.inf

    def advance(self) -> None:
        """Evaluate the bound of one more interval, or divide it."""
        bounds = bounds_of(self._arm, own=True)
        if self.pair or not self._left or isinstance(bounds, str):
            return
        begin, end = self._left[-1]
        (least,), _, (pair,) = bounds.least(*self._cubics.around([begin], [end]), NEAR)
        if least <= 0.0 and end - begin < 1.0 / 64.0:
            self.pair = bounds.names(pair) if pair[0] >= 0 else ("a loop", "itself")
            return
        self._left.pop()
        if least <= 0.0:
            edges = np.linspace(begin, end, 5)[::-1]
            self._left += zip(edges[1:].tolist(), edges[:-1].tolist(), strict=True)


def _edges(q: Floats, least: int = _FIRST) -> tuple[Floats, Floats]:
    """Begin and end, in steps, of the ``least`` or more intervals into which a motion ``(K, n)`` is first divided."""
    steps = q[1:] - q[:-1]
    way = float(np.sqrt(np.vecdot(steps, steps)).sum())
    count = min(max(least, math.ceil(way / _WAY)), len(q) - 1)
    edges = (np.arange(count + 1.0) * ((len(q) - 1) / count)).round()
    return edges[:-1], edges[1:]


def _divided(begin: Floats, end: Floats, chosen: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Begin and end of the four parts of each chosen interval; they end at samples if it is longer than a step."""
    parts = [np.zeros(1)]
    for a, b in zip(begin[chosen], end[chosen], strict=True):
        if b - a >= _SHORTEST:
            edges = np.linspace(a, b, 5)
            parts.append(np.unique(edges.round()) if b - a > 1.0 else edges)
    return np.concatenate([part[:-1] for part in parts]), np.concatenate([part[1:] for part in parts])


def _joined(intervals: list[tuple[float, float]]) -> Floats:
    """The intervals ``(U, 2)`` in order, with adjacent ones joined."""
    edges = np.array(sorted(intervals), dtype=float).reshape(-1, 2)
    apart = edges[1:, 0] != edges[:-1, 1]
    first, last = (np.append(*ends)[: len(edges)] for ends in ((True, apart), (apart, True)))
    return np.column_stack([edges[first, 0], edges[last, 1]])


@weakly_cached
def bounds_of(arm: Arm, *, own: bool) -> ClearanceBounds | str:
    """The bounds of an arm's distances, or why there are none; whether those of its own parts count."""
    n = arm.n_joints
    try:
        return ClearanceBounds(replace(arm.without_visuals), [(np.arange(n), np.ones(n))], own=own)
    except InputError as error:
        return str(error)
