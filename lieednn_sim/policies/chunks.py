"""A certified network that follows chunks of joint targets, as learned policies emit them: late, and with faults.

A chunk is judged before anything moves (`planning.chunks`): it is repaired if that is safe; otherwise it is refused,
and the old one goes on. The reference goes over to the new curve at the present time (`go_over`), and earlier targets
are dropped. When chunks run out, it rests at the last target. On limits, arrival and contact see
`docs/howto/action_chunks.md`.

A code ends at the last target or, for a long chunk, at a point of its curve from which the rest is coded later. In each
period it is proved for a few intervals ahead that nothing touches, with joints within a tolerance of the motion, which
is smaller at the beginning; if the network is found further off, another code is made. Nothing is proved for arms whose
loops move parts (`Arm.dependents`), nor among obstacles that were seen to move.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.planning.chunk_motion import ChunkCurve, ChunkMotion, go_over
from lieednn_sim.planning.chunks import Finding, RefusedError, judge, read
from lieednn_sim.planning.clearance import ProofAhead, bounds_of
from lieednn_sim.planning.timed_path import TimedPath
from lieednn_sim.planning.transition import EVEN
from lieednn_sim.policies.bounds import braking_in_time
from lieednn_sim.policies.coded_policy import GENTLY
from lieednn_sim.policies.replanning import ReplanningOptions, ReplanningPolicy
from lieednn_sim.validation import quoted
from lieednn_sim.values import Floats

# Kinds of findings that are repaired by default; and the way between samples at which contact is looked for [rad, m].
_REPAIRED = ("limits", "outlier", "jump", "speed", "acceleration")
_APART = 0.05
_FADE, _HORIZON = 0.2, 1.5  # least time of going over to a chunk, and longest part of one that is coded at once [s]
_TOLERANCE = 1e-3  # how far the network may be from the motion whose clearance is proved [rad, m]


@dataclass(frozen=True)
class ChunkOptions(ReplanningOptions):
    """Options of the policy ``lieednn-chunks``.

    Attributes:
        repaired: kinds of a `Finding` that are repaired; chunks with others are refused. With ``contact``, if a chunk
            touches something, the arm goes to its end by another way, straight or searched for.
        newest: weight of the newest chunk where an earlier one has targets, too. The earlier one, itself blended, has
            the rest (temporal ensembling with weights that fall exponentially with age).
    """

    repaired: tuple[str, ...] = field(default=_REPAIRED, metadata={"choices": (*_REPAIRED, "contact")})
    newest: float = field(default=1.0, metadata={"range": (0.0, 1.0)})


@dataclass(frozen=True)
class ChunkVerdict:
    """What became of a chunk, and why.

    Attributes:
        accepted: whether it is followed; otherwise what went on before goes on.
        findings: what is wrong with it.
        dropped: number of targets whose time had passed.
        slower: factor by which it takes longer; 1 if it and the way onto it are within the limits, or it begins later.
        fade: time in which the reference goes over to it [s]; 0 if it begins later.
    """

    accepted: bool
    findings: tuple[Finding, ...] = ()
    dropped: int = 0
    slower: float = 1.0
    fade: float = 0.0

    def __str__(self) -> str:
        return "; ".join(["accepted" if self.accepted else "refused", *map(str, self.findings)])


# The time of the first target of a chunk, or of its part after a jump, and its curve.
_Part = tuple[float, ChunkCurve]


class ChunkPolicy(ReplanningPolicy):
    """A policy that follows chunks of joint targets; see the module.

    Until the first chunk it goes to the target of its steps, as `ReplanningPolicy` does. Later the newest command
    counts, whether it is a chunk or another target. It logs how many chunks it ``accepted`` and ``refused``, and for
    how long ahead its motion is ``proved`` to be clear. Its arguments are those of `ReplanningPolicy`.

    Attributes:
        source: a function to be set, None at first. It is called in each period with `now` and the measured joints
            ``(n,)``, or the reference if nothing is measured, and returns None, or the arguments of `accept`.
        verdict: that of the last chunk; later ``unproved`` may be added, or a finding that refuses what is left.
        counts: findings of each kind since the reset, ``unproved`` motions, and chunks ``accepted`` and ``refused``.
    """

    channel_units = MappingProxyType({**ReplanningPolicy.channel_units, "accepted": "1", "refused": "1", "proved": "s"})
    _taken_over, _used = 1.0, 1.0
    _beyond = _TOLERANCE  # the error of a code
    source: Callable[[float, Floats], tuple[ArrayLike | RigidTransform, float, float] | None] | None = None
    _defaults = ChunkOptions
    _options: ChunkOptions
    _proof: ProofAhead | None

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        self.verdict, self.counts = ChunkVerdict(accepted=True), Counter[str]()
        self._asked: Floats | None = None
        # The curve of the newest chunk, with its begin in the policy's time, and later parts of the chunk.
        self._curve: _Part | None = None
        self._later: list[_Part] = []
        self._newest, self._left = -math.inf, 0.0
        super().begin(q)
        bounds_of(self.arm, own=True)  # made now, since the first time takes long

    @property
    def now(self) -> float:
        """The policy's time since its reset [s], in which the times of chunks are given."""
        return self._periods * self.period

    @property
    def chunk_time(self) -> float:
        """The time of the chunk that the reference has reached [s]; if it follows none, the last such time.

        It is before `now` if the reference is late, slower, or waits for the arm.
        """
        if self._curve is None:
            return self._left
        (begin, curve), motion = self._curve, self.course.transition
        if not isinstance(motion, ChunkMotion):  # on another way to its end
            return begin + curve.duration * (self.time >= motion.duration)
        return begin + float(motion.base.clock(np.array([self.time]), 1)[0, 0])

    def accept(self, chunk: ArrayLike | RigidTransform, t0: float, dt: float) -> ChunkVerdict:
        """Follow a chunk from now on, or refuse it, even if malformed; call this between two steps, or use `source`.

        Args:
            chunk: ``(H, n)`` joint targets [rad, m], at most 256; or H poses of the end effector in the world, each of
                which becomes the joint target nearest to the one before (`solve_ik`), in about a millisecond.
            t0: time of the first target, on the clock of `now` [s]. If it is in the future, the present motion goes on
                until then. The last target may be up to two minutes ahead.
            dt: time between two targets [s].

        Raises:
            InputError: the policy was never reset.
        """
        if "q" not in vars(self):
            raise InputError("the policy was never reset: call reset(q), or step with measured joints, before accept")
        findings, dropped, motion = list[Finding](), 0, None
        try:
            targets, begin, step = read(self.arm, chunk, t0, dt, self.q, self.now, self._newest)
            passed = self.now - begin
            dropped = min(max(math.ceil(passed / step - 1e-9), 0), len(targets))
            blended, repaired = self._blended(targets, begin, step), self._options.repaired
            parts, findings = judge(self.arm, blended, step, passed, self.drawn, repaired)
            if all(finding.repaired for finding in findings):
                findings += self._turn_onto([(begin + first, curve) for first, curve in parts])
                self._newest, motion = begin, self.course.transition
        except RefusedError as refused:
            findings.append(refused.finding)
        more = (motion.base.slower, motion.fade) if isinstance(motion, ChunkMotion) and passed >= -1e-9 else ()
        self.verdict = ChunkVerdict(motion is not None, tuple(findings), dropped, *more)
        for kind in (*(finding.kind for finding in findings), "accepted" if motion else "refused"):
            self.counts[kind] += 1
        return self.verdict

    def _blended(self, targets: Floats, begin: float, step: float) -> Floats:
        """Targets ``(H, n)``, blended with those of earlier chunks."""
        if self._curve is None or self._options.newest == 1.0:
            return targets
        then, curve = self._curve
        u = begin - then + step * np.arange(len(targets))
        # The weight of earlier ones falls to zero where they end.
        left = np.clip((curve.duration - u) / max(curve.duration - (self.now - then), _FADE), 0.0, 1.0)
        weight = (1.0 - self._options.newest) * (left * left * (3.0 - 2.0 * left))[:, None]
        return (1.0 - weight) * targets + weight * curve(np.clip(u, 0.0, curve.duration), 1)[0]

    def _turn_onto(self, parts: list[_Part]) -> list[Finding]:
        """Follow parts or, if they touch something and that is allowed, go to their end by another way."""
        try:
            self._begin_parts(parts)
        except RefusedError as refused:
            end = parts[-1][1].end
            asked = refused.finding.kind == "contact" and "contact" in self._options.repaired
            if not asked or self._surroundings.blocked(end[None]):
                raise
            self._command(end, parts[-1])
            self._turn(end)
            return [replace(refused.finding, repaired=True)]
        return []

    def _command(self, end: Floats, curve: _Part | None) -> None:
        """Take note of what is followed and where it ends."""
        if curve is None:
            self._left = self.chunk_time
        self._wanted = self._goal = end
        self._curve, self._later, self._search, self._path = curve, [], None, None

    def _begin_parts(self, parts: list[_Part]) -> None:
        """Follow the last part whose time has come, and keep the later ones; raises `RefusedError`."""
        due = sum(begin <= self.now + 1e-9 for begin, _ in parts)
        for begin, curve in parts[due:]:
            u, q = curve.places(0.0, _APART)
            self._require_clear(q, begin - self.now + u)
        if due:
            begin, curve = parts[due - 1]
            self._join(curve, min(self.now - begin, curve.duration), whole=True)
            self._command(curve.end, parts[due - 1])
        self._later = parts[due:]

    def _join(self, curve: ChunkCurve, begin: float, share: float = 1.0, *, whole: bool = False) -> None:
        """Go over to a curve at one of its times, for a share of the horizon; raises `RefusedError`.

        The part that is coded is tested for contact or, if ``whole``, all that is left of the curve.
        """

        def onto(now: Floats) -> ChunkMotion:
            motion = go_over(self.arm, now, curve, begin, horizon, _FADE)
            q, times, end = motion.even[0], motion.duration * EVEN, motion.base.end
            if whole and end < curve.duration:
                u, rest = curve.places(end, _APART)
                q, times = np.concatenate([q, rest]), np.concatenate([times, motion.duration - end + u])
            self._require_clear(q, times)
            return motion

        # A shorter part has a smaller code, which is more exact. If even that is off, further codes lead back.
        for part, most in ((1.0, 0.5 * _TOLERANCE), (0.5, _TOLERANCE), (0.25, np.inf)):
            horizon = part * share * _HORIZON
            try:
                self._go_along(onto, most)
                break
            except PlanError as refused:
                if most == np.inf:
                    raise RefusedError(Finding("motion", str(refused))) from None
        self._clear_way()
        if not self._surroundings.places and not isinstance(bounds_of(self.arm, own=True), str):
            motion = self.course.transition
            q, qd = (part[::3] for part in motion.even[:2])
            t = motion.duration * EVEN[::3]
            # The motion begins at the state, maybe beyond a limit; the reference keeps within the limits.
            low, high = self.arm.position_limits.T
            beyond = np.maximum(np.maximum(low - q, q - high), 0.0)
            off = _TOLERANCE * np.minimum(t / _FADE, 1.0)[:, None] + beyond
            self._proof = ProofAhead(self.arm, t, q, qd, off)

    def _require_clear(self, q: Floats, after: Floats) -> None:
        """Raise `RefusedError` if something is in the way at ``(K, n)``, ``(K,)`` s ahead; tests are `_APART` apart."""
        steps = q[1:] - q[:-1]
        count = (np.add.accumulate(np.sqrt(np.vecdot(steps, steps))) / _APART).astype(int)
        seen = np.concatenate([[0], (count[1:] > count[:-1]).nonzero()[0] + 1, [len(q) - 1]])
        if (result := self._surroundings.blocked(q[seen])) is not None:
            row = int(seen[result[0]])
            first, second, distance = self._surroundings.nearest(q[row])
            text = f"{first!r} would be {1e3 * distance:.3g} mm from {second!r} {after[row]:.2f} s from now"
            raise RefusedError(Finding("contact", text, value=distance, limit=self.arm.clearance))

    def _prove(self) -> None:
        """Extend the proof of the present motion until the arm need not brake for lack of it, and rest before its end.

        At least one interval is looked at in each period, and eight at most.
        """
        if (proof := self._proof) is None:
            return
        # The deceleration of the pace in braking, which uses 0.8 of the acceleration limits.
        most, half = 0.8 / GENTLY * self._braking, 0.5 * self.period
        enough = self.time + 4.0 * half * self.pace + self.pace**2 / (2.0 * most)
        for k in range(8):
            if proof.pair or (k and proof.time > enough):
                break
            proof.advance()
            if proof.pair:
                self.counts["unproved"] += 1
                known = self.verdict.findings
                if self.verdict.accepted and all(finding.kind != "unproved" for finding in known):
                    first, second = proof.pair
                    text = f"rests in {proof.time - self.time:.2f} s, before {first!r} may touch {second!r}"
                    self.verdict = replace(self.verdict, findings=(*known, Finding("unproved", text)))
        # The pace p at the end of the period from which the arm can rest in time, although p falls in steps.
        left = max(proof.time - self.time - half * (self.pace + 0.5 * half * most), 0.0)
        p = most * (math.sqrt(half**2 + 2.0 * left / most) - half)
        self.rest_at = min(self.rest_at, self.time + p**2 / (2.0 * self._braking))

    def _follow(self, course: TimedPath) -> None:
        super()._follow(course)
        self._proof = None

    def _seek(self, goal: Floats) -> None:
        if self._curve is None or "contact" in self._options.repaired:
            super()._seek(goal)

    def act(self, measured: Floats | None, target: Floats) -> tuple[Floats, Floats]:
        """See `Policy`; unchecked."""
        given = self.source and self.source(self.now, self.q if measured is None else measured)
        if given is not None:
            if not isinstance(given, tuple | list) or len(given) != 3:
                raise InputError(f"a source must return None, or a chunk, t0 and dt, got {quoted(given)}")
            self.accept(*given)
        inside, qd = super().act(measured, target)
        half, v, most = 0.5 * self.period, self.arm.velocity_limits, self._max_gain
        held = self.q + half * self.qd
        # A reference that limits have held back returns to the network at 20 / s.
        rate = np.minimum(np.maximum(qd + 20.0 * (inside - held - half * qd), self.qd - most), self.qd + most)
        rate = np.minimum(np.maximum(rate, -v), v)
        rate = braking_in_time(self.arm, held, rate, self.qd, self.period)
        return self._within_limits(held + half * rate), rate

    def _listen(self, measured: Floats | None, drawn: Floats) -> tuple[float, tuple[Floats, Floats] | None]:
        waiting, pulled = super()._listen(measured, drawn)
        # The pace falls gently: servos that lag a little could not follow a sudden wait, and would lag more.
        return max(waiting, self.pace - self.period * self._braking), pulled

    def _decide(self, target: Floats) -> None:
        """Follow the newest command; see `ReplanningPolicy`."""
        if target is not self._asked:
            # The first target after a reset is no newer than a chunk that came before it.
            if self._asked is not None:
                self._left, self._curve, self._later = self.chunk_time, None, []
            if self._curve is None:
                self._wanted = target
            self._asked = target
        try:
            self._go_on()
        except RefusedError as refused:
            # The arm rests at the end of the motion that it follows.
            self._command(self.course.transition.end, None)
            self.verdict = replace(self.verdict, findings=(*self.verdict.findings, refused.finding))
            self.counts[refused.finding.kind] += 1
        super()._decide(self._wanted)
        self._prove()

    def _go_on(self) -> None:
        """Begin a part whose time has come, code the rest of a long one, or code anew; raises `RefusedError`."""
        motion = self.course.transition
        if self._later and self._later[0][0] <= self.now + 1e-9:
            self._begin_parts(self._later)
        elif self._curve is not None and isinstance(motion, ChunkMotion):
            base, at = motion.base, np.array([self.time])
            # The rest is coded before the motion begins to slow down.
            ends = base.end < base.curve.duration and self.time + self.period > max(base.ramps_at, motion.fade)
            looks = self._periods % self._options.look_every == 0 and 0.0 < self.time < motion.duration
            # Once the motion slows down, another code would speed it up again.
            most = (0.5 if self.time < base.ramps_at else 1.0) * _TOLERANCE
            # The network may be off because its code is not exact, or joints pull.
            if ends or (looks and np.abs(motion(at, 1)[0] - self.drawn).max() > most):
                self._join(base.curve, float(base.clock(at, 1)[0, 0]), 1.0 if ends else 0.5)

    @property
    def message(self) -> str:
        """See `Policy`."""
        if self._proof is not None and self._proof.pair:
            return "rests before {!r} may touch {!r}, which is not proved".format(*self._proof.pair)
        return super().message

    def channels(self) -> Floats:
        """See `Policy`."""
        ahead = 0.0 if self._proof is None else min(self._proof.time, self.course.transition.duration) - self.time
        return np.append(super().channels(), [self.counts["accepted"], self.counts["refused"], max(ahead, 0.0)])
