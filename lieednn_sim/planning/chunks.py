"""Chunks of joint targets, as learned policies emit them: reading them, judging them, and repairing what is wrong."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm, solve_ik
from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.planning.chunk_motion import ChunkCurve
from lieednn_sim.planning.motion import LIMIT_TOLERANCE
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats

# Chunks with more jumps than this are no motion; with more targets, the first fit of a length would take too long.
MOST_JUMPS, MOST_TARGETS = 4, 256


@dataclass(frozen=True)
class Finding:
    """Something wrong with a chunk.

    Attributes:
        kind: ``shape``, ``nan``, ``times``, ``stale``, ``limits``, ``outlier``, ``jump``, ``speed``, ``acceleration``,
            ``contact``, ``reach``, ``unproved``; ``motion`` if there is another reason why it cannot be followed.
        text: what is wrong, in words.
        repaired: whether it was repaired; otherwise the chunk was refused.
        row: the target, counted from 0; -1 if it is the chunk as a whole.
        joint: name of the joint; empty if the finding is about no single joint.
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


class RefusedError(Exception):
    """A chunk cannot be followed, as a `Finding` says."""

    def __init__(self, finding: Finding) -> None:
        self.finding = finding


def read(
    arm: Arm, chunk: Any, t0: float, dt: float, near: Floats, now: float, newest: float
) -> tuple[Floats, float, float]:
    """The targets ``(H, n)``, the time of the first one, and that between two; raises `RefusedError`.

    If the chunk is a `RigidTransform` of poses, each becomes the joint target nearest to the one before; the first,
    the one nearest to ``near`` ``(n,)``. The chunk must not begin before the ``newest`` one, nor be over ``now`` [s].
    """
    kind, n = "shape", arm.n_joints
    try:
        if hasattr(chunk, "as_matrix"):
            kind, q = "reach", near
            chunk = np.array([q := solve_ik(arm, pose.translation, pose.rotation, start=q) for pose in chunk])
        kind = "nan" if np.shape(chunk)[1:] == (n,) and 1 <= np.shape(chunk)[0] <= MOST_TARGETS else "shape"
        targets = as_floats("chunk", chunk, ("H", n))
        if arm.continuous.any():  # models often learn turns within half a turn of zero
            targets = np.array([near := arm.nearest_turn(row, near) for row in targets])
        if kind == "shape":
            raise InputError(f"chunk must have from 1 to {MOST_TARGETS} targets, got {len(targets)}")
        kind = "times"
        begin, step = float(as_floats("t0", t0, ())), as_positive("dt", dt)
    except (InputError, NoSolutionError, TypeError, ValueError) as error:
        raise RefusedError(Finding(kind, str(error))) from None
    last, kind, old = begin + (len(targets) - 1) * step, "stale", ""
    if last < now - 1e-9:
        old = f"its last target was for {last:.3f} s, it is {now:.3f} s"
    elif begin < newest:
        old = f"it begins at {begin:.3f} s, one that begins at {newest:.3f} s came before"
    elif last > now + 120.0:  # times of another clock, or in another unit
        kind, old = "times", f"its last target is for {last:.1f} s, now is {now:.1f} s; t0 is as policy.now, dt in s"
    if old:
        raise RefusedError(Finding(kind, old))
    return targets, begin, step


def judge(
    arm: Arm, targets: Floats, step: float, passed: float, reference: Floats, repaired: Collection[str]
) -> tuple[list[tuple[float, ChunkCurve]], list[Finding]]:
    """What is wrong with a chunk, and the curves of its parts between jumps, mended.

    Joints beyond their limits are moved to them, unless one is beyond by more than its range, as in a wrong unit.
    Single targets far from their neighbours are moved between these; far means that neither the acceleration limits nor
    the noise of the others explain it.

    Args:
        arm: the arm.
        targets: ``(H, n)`` finite targets [rad, m].
        step: h, time between two of them [s].
        passed: time since the first target [s]; the curve's speed before that does not count.
        reference: ``(n,)`` where the arm should be now [rad, m].
        repaired: kinds of findings that are repaired.

    Returns:
        For each part, the time of its first target and its curve; and the findings, at most one per kind and joint.
    """
    findings = dict[tuple[str, int], Finding]()

    def note(kind: str, text: str, row: int, joint: int, value: float, limit: float, unit: str = "") -> None:
        name, unit = arm.joint_names[joint], arm.unit(joint) + unit
        said = f"joint {name!r} {text} {value:.3g} {unit} in row {row}, allowed is {limit:.3g} {unit}"
        findings.setdefault((kind, joint), Finding(kind, said, kind in repaired, row, name, float(value), float(limit)))

    low, high = arm.position_limits.T
    mended = np.minimum(np.maximum(arm.within_angles(targets), low), high)
    moved = np.abs(mended - targets)
    beyond = _where(moved > LIMIT_TOLERANCE)
    if far := beyond and _where(moved > arm.ranges):  # name these rather than a smaller excess before them
        beyond, repaired = far, [kind for kind in repaired if kind != "limits"]
    for row, joint in beyond:
        note("limits", "is at", row, joint, targets[row, joint], mended[row, joint])
    speed = arm.jump_speeds
    most = np.minimum(2.0 * step * arm.acceleration_limits, speed) * step
    steps, jumps = mended[1:] - mended[:-1], list[list[int]]()
    bends = np.abs(steps[1:] - steps[:-1])
    # If no bend exceeds this, there are no jumps either.
    if (bends > most).any():
        most, across = most + 6.0 * np.median(bends, axis=0), np.abs(mended[2:] - mended[:-2])
        # At the neighbours of an outlier the bend is half as large.
        largest = np.maximum(bends, np.maximum(np.roll(bends, 1, axis=0), np.roll(bends, -1, axis=0)))
        for row, joint in _where((bends > most) & (2.0 * across < bends) & (bends > 0.9 * largest)):
            note("outlier", "is off its neighbours by", row + 1, joint, 0.5 * bends[row, joint], 0.5 * most[joint])
            mended[row + 1, joint] = 0.5 * (mended[row, joint] + mended[row + 2, joint])
        steps = np.diff(mended, axis=0)
        # The usual step is the mean of both neighbours; for the first and the last step, their only neighbour.
        usual = 0.5 * (np.concatenate([steps[1:], steps[-2:-1]]) + np.concatenate([steps[1:2], steps[:-1]]))
        sizes = np.abs(steps)
        jumps = _where((sizes > 2.0 * step * speed) & (np.abs(steps - usual) > np.maximum(most, 0.5 * sizes)))
    for row, joint in jumps:
        jump = abs(mended[row + 1, joint] - mended[row, joint])
        note("jump", "jumps by", row + 1, joint, jump, step * speed[joint])
    edges = [0, *sorted({row + 1 for row, _ in jumps}), len(mended)]
    parts = [(a * step, ChunkCurve.through(arm, mended[a:b], step)) for a, b in pairwise(edges[: MOST_JUMPS + 2])]
    if len(edges) > MOST_JUMPS + 2:
        text = f"it jumps {len(edges) - 2} times, more than {MOST_JUMPS} are no motion"
        findings["motion", -1] = Finding("motion", text)
    for begin, curve in [part for part in parts if part[0] <= passed][-1:]:
        u = min(passed - begin, curve.duration)
        away = np.abs(curve.at(u)[0] - reference)
        for [joint] in _where(away > step * speed):
            note("jump", "begins away by", round((begin + u) / step), joint, away[joint], step * speed[joint])
    rates = ("speed", arm.velocity_limits, "/s"), ("acceleration", arm.acceleration_limits, "/s^2")
    for (begin, curve), (a, b) in zip(parts, pairwise(edges), strict=False):
        off = np.abs(curve.values[: b - a] - mended[a:b])
        for row, joint in _where(off > step * speed):
            note("outlier", "is off the smooth curve by", a + row, joint, off[row, joint], step * speed[joint])
        excess = curve.excess(arm, min(max(passed - begin, 0.0), curve.duration))
        for (kind, limits, unit), (part, joint, row) in zip(rates, excess, strict=True):
            if part > 1.001:
                row, limit = round((begin + row * curve.step) / step), float(limits[joint])
                note(kind, f"is {part:.3g} times too fast, with", row, joint, part * limit, limit, unit)
    return parts, list(findings.values())


def _where(found: NDArray[np.bool_]) -> list[list[int]]:
    """Rows and joints where something is found, nearly always nowhere."""
    return np.argwhere(found).tolist() if found.any() else []
