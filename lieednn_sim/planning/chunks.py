"""Chunks of joint targets, as learned policies emit them: what is wrong with one, and the smooth motion that it means.

The targets y_k at times k h become a uniform cubic B-spline with control points c, the minimum of

    |B c - y|^2 + s |D c|^2,

where B c are its values at these times and D takes third differences (P-splines: Eilers and Marx, Statistical Science
11(2), 1996), with s for each joint by generalised cross-validation: next to nothing for smooth targets. Such a curve
stays within the convex hull of its control points: where these keep the position limits, it does so at every instant.

A chunk that is too fast is slowed down as a whole, by a factor f. It ends at rest: over a time D its own time u goes on
ever more slowly, u' = (1 - 10 x^3 + 15 x^4 - 6 x^5) / f with x from 0 to 1, up to the last target.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.motion import LIMIT_TOLERANCE
from lieednn_sim.planning.transition import Transition
from lieednn_sim.values import Floats

# Weights of a segment's four control points from the powers of its time, and those of its first two derivatives.
_CUBIC = np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6.0
_POWERS = np.diag([1.0, 2.0, 3.0], 1)
_SEGMENT = np.concatenate([np.linalg.matrix_power(_POWERS, k) @ _CUBIC for k in range(3)], axis=1)
# Weights s that are tried; the greatest one whose score is at most this multiple of the best is taken.
_WEIGHTS, _NEARLY = np.logspace(-3.0, 7.0, 21), 1.3
# Factors on the least duration of a chunk and on that of the fade onto it, those tried first that delay it least.
_TRIED = sorted(product((1.0, 1.15, 1.4, 2.0, 3.0, 5.0, 8.0), (1.0, 1.4, 2.0, 3.0, 5.0)), key=math.prod)
# Chunks with more jumps than this are no motion; with more targets, the first of a length would take long to fit.
MOST_JUMPS, MOST_TARGETS = 4, 256


@dataclass(frozen=True)
class Finding:
    """Something wrong with a chunk.

    Attributes:
        kind: ``shape``, ``nan``, ``times``, ``stale``, ``limits``, ``outlier``, ``jump``, ``speed``, ``acceleration``,
            ``contact``, ``reach``; ``motion`` where nothing is known that could be done.
        text: what is wrong, in words.
        repaired: whether it was repaired; otherwise the chunk was refused.
        row: the target, counted from 0; -1 if it is the chunk as a whole.
        joint: name of the joint; empty if it is none.
        value: what was found, in the joint's unit; of a contact the distance [m].
        limit: what is allowed.
    """

    kind: str
    text: str
    repaired: bool = False
    row: int = -1
    joint: str = ""
    value: float = math.nan
    limit: float = math.nan

    def __str__(self) -> str:
        return f"{self.kind}: {self.text}"


class ChunkCurve:
    """The curve of a chunk over its own time u, from 0 to its duration.

    Args:
        control: ``(H + 2, n)`` control points of H targets [rad, m].
        step: h, time between two targets [s].

    Attributes:
        step: h.
        duration: [s].
        end: ``(n,)`` the last configuration.
    """

    def __init__(self, control: Floats, step: float) -> None:
        self._control, self.step = control, step
        self._windows = np.lib.stride_tricks.sliding_window_view(control, 4, axis=0)
        self.duration = step * len(self._windows)
        self.end = control[-3:].T @ [1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0]

    @classmethod
    def through(cls, arm: Arm, targets: Floats, step: float) -> ChunkCurve:
        """The curve of targets ``(H, n)``, smoothed if they are noisy, within the position limits."""
        targets = targets if len(targets) > 1 else targets.repeat(2, axis=0)
        control, modes, bending = _fitting(len(targets))
        parts, weighted = modes.T @ targets, _WEIGHTS[:, None] * bending
        lost = weighted / (1.0 + weighted)
        score = lost**2 @ parts**2 / (lost.sum(axis=1) ** 2)[:, None]
        # The greatest weight with nearly the best score.
        best = (np.arange(len(score))[:, None] * (score <= _NEARLY * score.min(axis=0))).max(axis=0)
        kept = modes @ (parts * (1.0 - lost[best].T))
        low, high = arm.position_limits.T
        points = np.clip(arm.within_angles(np.concatenate([control @ kept, kept[[0, -1]]])), low, high)
        # The first segment is a convex combination of its begin and its last three control points; the last, likewise.
        points[0] = 6.0 * points[-2] - 4.0 * points[1] - points[2]
        points[-3] = 6.0 * points[-1] - 4.0 * points[-4] - points[-5]
        return cls(points[:-2], step)

    def __call__(self, u: Floats) -> Floats:
        """Configurations and their first two derivatives in u ``(3, K, n)``, at times ``(K,)``."""
        segment = np.clip((u / self.step).astype(int), 0, len(self._windows) - 1)
        s = (u / self.step - segment)[:, None] ** np.arange(4.0)
        weights = (s @ _SEGMENT).reshape(-1, 3, 4) / self.step ** np.arange(3.0)[:, None]
        return (weights @ self._windows[segment].swapaxes(1, 2)).swapaxes(0, 1)

    def nearest(self, q: Floats, latest: float) -> float:
        """The time of the curve, of 65 up to a latest one, at which it is nearest to a configuration ``(n,)``."""
        u = np.linspace(0.0, latest, 65)
        return float(u[np.square(self(u)[0] - q).sum(axis=1).argmin()])

    def excess(self, arm: Arm, begin: float) -> list[tuple[float, int, int]]:
        """Largest parts of the limits of velocity and acceleration from its time ``begin`` on, joints and rows."""
        first = min(int(begin / self.step), len(self._windows) - 1)
        rates = np.diff(self._control[first:], axis=0) / self.step
        # In the middle between two knots, and at the knots.
        middle, at = (rates[:-2] + 6.0 * rates[1:-1] + rates[2:]) / 8.0, 0.5 * (rates[1:] + rates[:-1])
        parts = np.abs(np.concatenate([at, middle])) / arm.velocity_limits
        bends = np.abs(np.diff(rates, axis=0)) / self.step / arm.acceleration_limits
        found = ((part, *divmod(int(part.argmax()), part.shape[1])) for part in (parts, bends))
        return [(float(part[k, joint]), joint, first + k % len(at)) for part, k, joint in found]


class Ramped:
    """A curve from one of its times to another, slowed down, at rest at its end.

    Args:
        curve: the curve.
        begin, end: its own times u there [s].
        slower: f.
        ramp: D [s].

    Attributes:
        x: ``(2,)`` begin and end of its time [s], as of a `PPoly`; it rests if it is asked for later ones.
        ramps_at: time at which it begins to slow down [s].
    """

    def __init__(self, curve: ChunkCurve, begin: float, end: float, slower: float, ramp: float) -> None:
        self.curve, self.begin, self.end, self.slower, self.ramp = curve, begin, end, slower, max(ramp, 1e-9)
        self.ramps_at = max(slower * (end - begin) - 0.5 * ramp, 0.0)
        self.x = np.array([0.0, self.ramps_at + ramp])

    def clock(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """The curve's own time u ``(K,)`` at times ``(K,)``, and its first two derivatives."""
        x = np.clip((t - self.ramps_at) / self.ramp, 0.0, 1.0)
        gone, rate, bend = _ramp(x)
        u = self.begin + (np.minimum(t, self.ramps_at) + self.ramp * gone) / self.slower
        return np.minimum(u, self.end), rate / self.slower, bend / (self.slower * self.ramp)

    def states(self, t: Floats) -> Floats:
        """Joint coordinates, rates and accelerations ``(3, K, n)`` at times ``(K,)``."""
        u, rate, bend = self.clock(t)
        q, slope, turn = self.curve(u)
        return np.stack([q, slope * rate[:, None], turn * (rate * rate)[:, None] + slope * bend[:, None]])

    def __call__(self, t: float) -> Floats:
        """Joint coordinates ``(n,)`` at a time."""
        return self.states(np.array([t]))[0, 0]


class ChunkMotion(Transition):
    """A transition onto a chunk's curve; ``base`` is a `Ramped`."""

    @property
    def duration(self) -> float:
        """Duration [s]; the fade may outlast the base."""
        return max(super().duration, self.fade)

    @property
    def _one(self) -> bool:
        return False

    def _along(self, own: Floats) -> Floats:
        return self.base.states(own)


def _ramp(x: Floats) -> tuple[Floats, Floats, Floats]:
    """Way, speed and its derivative of a ramp from speed 1 to rest, at x from 0 to 1."""
    rate = 1.0 - x**3 * (10.0 - x * (15.0 - 6.0 * x))
    return x - x**4 * (2.5 - x * (3.0 - x)), rate, -30.0 * (x * (1.0 - x)) ** 2


def judge(
    arm: Arm, targets: Floats, step: float, passed: float, reference: Floats, repaired: Collection[str]
) -> tuple[list[tuple[float, ChunkCurve]], list[Finding]]:
    """What is wrong with a chunk, and the curves of its parts between jumps, mended.

    Joints beyond their limits are moved to them, and single targets far off their neighbours between these. Far is
    what neither the limits of acceleration nor the noise of the others explain.

    Args:
        arm: the arm.
        targets: ``(H, n)`` finite targets [rad, m].
        step: h, time between two of them [s].
        passed: time since the first one [s]; how fast the curve was before does not count.
        reference: ``(n,)`` where the arm should be now [rad, m].
        repaired: kinds of findings that are repaired.

    Returns:
        For each part the time of its first target and its curve; and the findings, at most one of a kind and joint.
    """
    names, findings = arm.joint_names, dict[tuple[str, int], Finding]()

    def note(kind: str, text: str, row: int, joint: int, value: float, limit: float, unit: str = "") -> None:
        name, unit = names[joint], arm.unit(joint) + unit
        said = f"joint {name!r} {text} {value:.3g} {unit} in row {row}, allowed is {limit:.3g} {unit}"
        findings.setdefault((kind, joint), Finding(kind, said, kind in repaired, row, name, value, limit))

    low, high = arm.position_limits.T
    mended = np.clip(arm.within_angles(targets), low, high)
    for row, joint in np.argwhere(np.abs(mended - targets) > LIMIT_TOLERANCE).tolist():
        note("limits", "is at", row, joint, float(targets[row, joint]), float(mended[row, joint]))
    speed = np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, 10.0)
    most = np.minimum(2.0 * step * arm.acceleration_limits, speed) * step
    bends, jumps = np.abs(np.diff(mended, n=2, axis=0)), np.zeros((len(mended) - 1, arm.n_joints), dtype=bool)
    # Where nothing bends more than that, nothing jumps either.
    if (bends > most).any():
        most, across = most + 6.0 * np.median(bends, axis=0), np.abs(mended[2:] - mended[:-2])
        # The neighbours of an outlier are bent half as much.
        largest = np.maximum(bends, np.maximum(np.roll(bends, 1, axis=0), np.roll(bends, -1, axis=0)))
        for row, joint in np.argwhere((bends > most) & (2.0 * across < bends) & (bends > 0.9 * largest)).tolist():
            note("outlier", "is off its neighbours by", row + 1, joint, 0.5 * bends[row, joint], 0.5 * most[joint])
            mended[row + 1, joint] = 0.5 * (mended[row, joint] + mended[row + 2, joint])
        steps = np.diff(mended, axis=0)
        usual = 0.5 * (np.concatenate([steps[1:], steps[-1:]]) + np.concatenate([steps[:1], steps[:-1]]))
        jumps = (np.abs(steps) > 2.0 * step * speed) & (np.abs(steps - usual) > np.maximum(most, 0.5 * np.abs(steps)))
    for row, joint in np.argwhere(jumps).tolist():
        jump = abs(mended[row + 1, joint] - mended[row, joint])
        note("jump", "jumps by", row + 1, joint, jump, step * speed[joint])
    edges = [0, *(np.flatnonzero(jumps.any(axis=1)) + 1).tolist(), len(mended)]
    parts = [(a * step, ChunkCurve.through(arm, mended[a:b], step)) for a, b in pairwise(edges[: MOST_JUMPS + 2])]
    if len(edges) > MOST_JUMPS + 2:
        text = f"it jumps {len(edges) - 2} times, more than {MOST_JUMPS} are no motion"
        findings["motion", -1] = Finding("motion", text)
    for begin, curve in [part for part in parts if part[0] <= passed][-1:]:
        u = min(passed - begin, curve.duration)
        away = np.abs(curve(np.array([u]))[0, 0] - reference)
        for joint in np.flatnonzero(away > step * speed).tolist():
            note("jump", "begins away by", round((begin + u) / step), joint, away[joint], step * speed[joint])
    for (begin, curve), (a, b) in zip(parts, pairwise(edges), strict=False):
        off = np.abs(curve(step * np.arange(float(b - a)))[0] - mended[a:b])
        for row, joint in np.argwhere(off > step * speed).tolist():
            note("outlier", "is off the smooth curve by", a + row, joint, off[row, joint], step * speed[joint])
        for kind, limits, unit, (part, joint, row) in zip(
            ("speed", "acceleration"),
            (arm.velocity_limits, arm.acceleration_limits),
            ("/s", "/s^2"),
            curve.excess(arm, min(max(passed - begin, 0.0), curve.duration)),
            strict=True,
        ):
            if part > 1.001:
                row, limit = round((begin + row * curve.step) / step), float(limits[joint])
                note(kind, f"is {part:.3g} times too fast, with", row, joint, part * limit, limit, unit)
    return parts, list(findings.values())


def go_over(arm: Arm, now: Floats, curve: ChunkCurve, begin: float, end: float, fade: float) -> ChunkMotion:
    """The transition from a state onto a curve, as fast as the arm's limits allow.

    Velocities and accelerations are checked at samples, against the limits, and positions too.

    Args:
        arm: the arm.
        now: ``(3, n)`` joint coordinates, rates and accelerations at the beginning.
        curve: the curve.
        begin, end: its own times u at which it is joined, and at which the motion rests [s].
        fade: least time in which what the state differs from the curve is made up for [s].

    Raises:
        PlanError: none of those tried keeps the limits.
    """
    v, a = arm.velocity_limits, arm.acceleration_limits
    (fast, *_), (bent, *_) = curve.excess(arm, begin)
    least = max(1.0, fast, math.sqrt(bent))
    bases = dict[float, tuple[Ramped | None, Floats, float]]()
    for more, longer in _TRIED:
        if more not in bases:
            bases[more] = _onto(arm, now, curve, begin, end, least * more)
        base, differences, soonest = bases[more]
        if base is None:
            continue
        result = ChunkMotion(base, 1.0, differences, longer * max(fade, soonest))
        q, qd, qdd = result(np.linspace(0.0, result.fade, 33))
        if (
            (np.abs(qd) <= 1.001 * v).all()
            and (np.abs(qdd) <= 1.001 * a).all()
            and (arm.limit_excess(q) <= LIMIT_TOLERANCE).all()
        ):
            return result
    raise PlanError("no transition onto the chunk keeps the limits of the joints")


def _onto(
    arm: Arm, now: Floats, curve: ChunkCurve, begin: float, end: float, slower: float
) -> tuple[Ramped | None, Floats, float]:
    """A base, what the state differs from it ``(3, n)``, and about the least time in which that can fade [s]."""
    if (ramp := _shortest_ramp(arm, curve, begin, end, slower)) is None:
        return None, now, 0.0
    base, limits = Ramped(curve, begin, end, slower, ramp), np.stack([arm.velocity_limits, arm.acceleration_limits])
    states = base.states(np.linspace(0.0, float(base.x[-1]), 33))
    away = np.abs(differences := now - states[:, 0])
    v, a = np.maximum(1.0 - np.abs(states[1:]).max(axis=1) / limits, 0.5) * limits
    # Largest derivatives of the corrections of `transition`, of differences in position and in velocity.
    times = (1.875 * away[0] / v).max(), math.sqrt((5.78 * away[0] / a).max()), (4.0 * away[1] / a).max()
    return base, differences, float(max(times))


def _shortest_ramp(arm: Arm, curve: ChunkCurve, begin: float, end: float, slower: float) -> float | None:
    """The shortest of the tried D [s] in which a curve comes to rest at its time ``end`` within the limits, if any."""
    most = 2.0 * slower * (end - begin)
    if most < 1e-6:
        return 0.0
    # From the shortest on, at least 0.04 s.
    tried = most * 0.75 ** np.arange(max(math.log(most / 0.04) / math.log(4.0 / 3.0), 0.0) // 1.0 + 1.0)[::-1]
    gone, rate, bend = _ramp(np.linspace(0.0, 1.0, 9))
    times = tried[:, None] / slower
    _, slope, turn = curve(np.maximum(end - times * (0.5 - gone), begin).ravel()).reshape(3, len(tried), 9, -1)
    qdd = (turn * (rate**2)[:, None] + slope * (bend / times)[..., None]) / slower**2
    fits = (np.abs(qdd) <= arm.acceleration_limits).all(axis=(1, 2))
    return float(tried[fits.argmax()]) if fits.any() else None


@lru_cache(maxsize=64)
def _fitting(count: int) -> tuple[Floats, Floats, Floats]:
    """Of ``count`` targets: control points of the smoothest curve through values, its modes, and how bent these are.

    These are ``(count + 2, count)``, orthonormal ``(count, count)`` and ``(count,)``.
    """
    values = (np.eye(count, count + 2) + 4.0 * np.eye(count, count + 2, 1) + np.eye(count, count + 2, 2)) / 6.0
    firsts, thirds = (np.diff(np.eye(count + 2), n=order, axis=0) for order in (1, 3))
    # Lagrange's conditions of the least |D c|^2 with B c = y; two targets do not determine it.
    system = np.block([[thirds.T @ thirds + 1e-9 * firsts.T @ firsts, values.T], [values, np.zeros((count, count))]])
    control = np.linalg.solve(system, np.eye(2 * count + 2)[:, count + 2 :])[: count + 2]
    bent = thirds @ control
    bending, modes = np.linalg.eigh(bent.T @ bent)
    return control, modes, np.maximum(bending, 0.0)
