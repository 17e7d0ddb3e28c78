"""Several demonstrations at equal phases: their mean, its time law, and their spread; and paths matched by warping."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations.recording import Demonstration, as_dof
from lieednn_sim.lie import exp
from lieednn_sim.lie.se3 import transforms, turns_near, twist_of
from lieednn_sim.validation import as_choice, as_count, as_floats, as_positive, as_times
from lieednn_sim.values import Floats, frozen

Indices = NDArray[np.intp]
PHASES = ("length", "time")
GOALS = ("aligned", "kept")
LEVER = 0.2  # metres that a radian counts for: 2 mm and 0.5 degrees weigh about the same


@frozen
class Demonstrations:
    """Demonstrations of one motion, relative to their goal, at K equal steps of the phase.

    Usually goals are aligned: every demonstration is seen from its own goal and ends at the twist zero (see
    `Demonstration.twists`), wherever in the world it ended. If they are kept, all are seen from the mean goal.

    Attributes:
        goal: world pose at which the motion ends: the mean of the recorded ends.
        t: ``(K,)`` mean time at which a phase is reached, from 0 to the mean duration [s].
        twists: ``(n, K, 6)`` [rad, m].
        dof: degrees of freedom that were recorded: 2, 3 or 6.
        lever: metres that a radian counts for, in lengths and distances.
        goals_kept: whether demonstrations keep their own goals.

    Raises:
        InputError: an entry is not finite, times do not increase, or shapes do not fit.
    """

    goal: RigidTransform
    t: Floats
    twists: Floats
    dof: int
    lever: float = LEVER
    goals_kept: bool = False

    def __post_init__(self) -> None:
        as_floats("twists", self.twists, ("n", len(as_times("t", self.t)), 6))
        as_positive("lever", self.lever)
        as_dof(self.dof)

    def __len__(self) -> int:
        """The number of demonstrations."""
        return len(self.twists)

    @property
    def duration(self) -> float:
        """Mean duration [s]."""
        return float(self.t[-1])

    @property
    def scale(self) -> Floats:
        """Metres ``(6,)`` that a unit of each coordinate counts for."""
        return np.array([self.lever] * 3 + [1.0] * 3)

    @cached_property
    def mean(self) -> Floats:
        """Mean twists ``(K, 6)``: the motion to reproduce."""
        return self.twists.mean(axis=0)

    @property
    def spread(self) -> Floats:
        """Standard deviation of the twists ``(K, 6)`` [rad, m]; zero for a single demonstration."""
        return self.twists.std(axis=0)

    @cached_property
    def extent(self) -> float:
        """Largest side of the bounding box of all positions, or of all rotations times the lever [m]."""
        turns, positions = (np.ptp(part.reshape(-1, 3), axis=0).max() for part in np.split(self.displaced, 2, axis=-1))
        return float(max(positions, self.lever * turns))

    @cached_property
    def displaced(self) -> Floats:
        """Rotation vectors and positions relative to the goal ``(n, K, 6)`` [rad, m], along the world's axes."""
        return displacement(self.twists)

    def without(self, index: int) -> Demonstrations:
        """The demonstrations without the one at ``index``; the times stay the same."""
        if len(self) < 2:
            raise InputError("the only demonstration cannot be left out")
        kept = np.arange(len(self)) != as_count("index", index, 0, len(self) - 1)
        return replace(self, twists=self.twists[kept])


def align(
    demonstrations: Sequence[Demonstration],
    *,
    phase: str = "length",
    samples: int = 200,
    lever: float = LEVER,
    goals: str = "aligned",
) -> Demonstrations:
    """Resample demonstrations at equal phases.

    Args:
        demonstrations: at least one, all with the same dof.
        phase: ``"length"`` or ``"time"``, the fraction of which is the phase; length ignores speed and pauses.
        samples: K.
        lever: metres that a radian counts for in lengths.
        goals: ``"aligned"``, every demonstration is seen from its own goal, or ``"kept"``, all from the mean goal.

    Raises:
        InputError: there are no demonstrations, or they record different quantities.
    """
    as_choice("phase", phase, PHASES)
    kept = as_choice("goals", goals, GOALS) == "kept"
    lever = as_positive("lever", lever)
    fractions = np.linspace(0.0, 1.0, as_count("samples", samples, 2, most=100_000))
    if not demonstrations or len({demonstration.dof for demonstration in demonstrations}) > 1:
        raise InputError("align needs at least one demonstration, and all must record the same quantities")
    goal, found = mean_goal(demonstrations), []
    for item in demonstrations:
        seen = item.twists_from(goal.translation, goal.rotation.as_matrix()) if kept else item.twists
        # Points that are as far apart as the poses; only large turns become chords.
        points = np.hstack([item.position, item.rotation.reshape(-1, 9) * lever / np.sqrt(2.0)])
        found.append(at_phases(fractions, seen, item.t, phase, points, partial(item.steps, lever)))
    twists, times = map(np.array, zip(*found, strict=True))
    return Demonstrations(goal, times.mean(axis=0), twists, demonstrations[0].dof, lever, kept)


def mean_goal(demonstrations: Sequence[Demonstration]) -> RigidTransform:
    """The mean of the poses at which demonstrations end."""
    turns = Rotation.from_matrix(np.stack([shown.rotation[-1] for shown in demonstrations]))
    place = np.mean([shown.position[-1] for shown in demonstrations], axis=0)
    return RigidTransform.from_components(place, turns.mean())


def goal_distance(demonstrations: Sequence[Demonstration]) -> float:
    """Largest distance of a demonstration's end from the mean one [m], a radian counting for `LEVER` metres."""
    goal = mean_goal(demonstrations)
    turns = [(Rotation.from_matrix(shown.rotation[-1]) * goal.rotation.inv()).magnitude() for shown in demonstrations]
    apart = [np.linalg.norm(demonstration.position[-1] - goal.translation) for demonstration in demonstrations]
    return float(np.hypot(apart, LEVER * np.array(turns)).max())


def at_phases(
    fractions: Floats, samples: Floats, t: Floats, phase: str, points: Floats, lengths: Callable[[Indices], Floats]
) -> tuple[Floats, Floats]:
    """Samples ``(K, D)`` and times ``(K,)`` of a demonstration at fractions ``(K,)`` of its length or of its duration.

    The phase is a name of `PHASES`; the fractions increase from 0 to 1. ``samples`` are ``(L, D)`` at times ``(L,)``,
    and ``points`` ``(L, M)`` have about the same distances from each other. ``lengths`` gives the lengths ``(n - 1,)``
    of the steps between the n samples with given indices.
    """
    passed = t
    if phase == "length":
        kept, t = moving(points, t)
        passed, samples = np.concatenate([[0.0], np.cumsum(lengths(kept))]), samples[kept]
    fraction = passed / passed[-1]
    reached = np.stack([np.interp(fractions, fraction, entry) for entry in samples.T], axis=-1)
    return reached, np.interp(fractions, fraction, t)


def moving(points: Floats, t: Floats) -> tuple[Indices, Floats]:
    """Indices of the points ``(L, M)`` that are further from the last one taken than the noise, and their times.

    With all points, the noise of sensors would add length in every pause. The time of a pause counts to the motion
    after it; a pause at the end is left out.
    """
    extent = np.ptp(points, axis=0).max()
    least = 1e-12 * extent
    # Third differences of white noise have 20 times its variance, those of a smooth path are nearly zero.
    third = [entry[entry > least] for entry in np.abs(np.diff(points, n=3, axis=0)).T]
    noise = [np.median(entry) / (0.6745 * np.sqrt(20.0)) if len(entry) else 0.0 for entry in third]
    # Two samples at rest are further apart than this about once in ten thousand times, for any number of columns.
    radius = np.clip(np.sqrt(2.0) * (np.linalg.norm(noise) + 2.5 * max(noise)), least, 0.02 * extent)
    kept = [0]
    for k, point in enumerate(points):
        if np.linalg.norm(point - points[kept[-1]]) > radius:
            kept.append(k)
    left = np.linalg.norm(points[kept] - points[-1], axis=1)
    # One sample of a pause at the end is enough.
    kept = kept[: max(2, int(np.flatnonzero(left > radius)[-1]) + 2)]
    times = t[kept]
    if left[len(kept) - 1] > least:
        kept.append(len(points) - 1)
        # The rest of an approach with a bounded jerk takes up to 3.85 times as long as the last step before it.
        times = np.append(times, min(t[-1], times[-1] + 4.0 * (times[-1] - times[-2])))
    return np.array(kept), times


def in_world(twists: Floats, goal: RigidTransform) -> RigidTransform:
    """World poses of twists ``(..., 6)`` relative to a goal."""
    seen = exp(twists)
    turned = seen.rotation.as_matrix() @ goal.rotation.as_matrix()
    return transforms(turned, seen.translation + goal.translation)


def from_goal(pose: RigidTransform, goal: RigidTransform, near: Floats) -> Floats:
    """The twist ``(6,)`` of a world pose relative to a goal, the inverse of `in_world`, with a turn near another."""
    turn = turns_near((pose.rotation * goal.rotation.inv()).as_rotvec(), near)
    return twist_of(np.concatenate([turn, pose.translation - goal.translation]))


def shown_part(dof: int) -> slice:
    """The entries of a twist that were recorded, given their number."""
    return slice(0, 6) if dof == 6 else slice(3, 3 + dof)


def displacement(twists: Floats) -> Floats:
    """Rotation vectors and positions (omega, J(omega) v), ``(..., 6)`` [rad, m], of twists ``(..., 6)``."""
    return np.concatenate([twists[..., :3], exp(twists).translation], axis=-1)


@frozen
class Warp:
    """A match of the samples of two paths."""

    #: Dynamic-time-warping distance: the least sum of distances over all alignments, each step of which advances in one
    #: path or both (Sakoe and Chiba, IEEE T-ASSP 26(1), 1978); not normalised.
    total: float
    #: Discrete Frechet distance: the least maximal distance over these alignments (Eiter and Mannila, 1994).
    frechet: float
    pairs: NDArray[np.intp]  #: (L, 2) indices of the samples matched by the alignment of least sum


def warp(path: ArrayLike, other: ArrayLike) -> Warp:
    """Match samples ``(K, D)`` and ``(L, D)`` of two paths; `InputError` if one has none, or another dimension."""
    first, second = (as_floats(name, samples, ("K", "D")) for name, samples in (("path", path), ("other", other)))
    n, m, backwards = len(first), len(second), second[::-1]
    if not n or not m or first.shape[1] != second.shape[1]:
        raise InputError(f"paths must have samples of the same size, got {first.shape} and {second.shape}")
    # Antidiagonals (i, k - i) in turn: each depends only on the two before it. At index i + 1, the first row holds the
    # least sums, the second row the least maximal distances.
    older, last = np.full((2, 2, n + 1), np.inf)
    older[:, 0] = 0.0
    came = np.zeros((n + m - 1, n), dtype=np.int8)
    for k in range(n + m - 1):
        low, high = max(0, k - m + 1), min(n - 1, k) + 1
        gap = first[low:high] - backwards[low + m - 1 - k : high + m - 1 - k]
        apart = np.sqrt(np.einsum("ij,ij->i", gap, gap))
        before = np.stack([older[:, low:high], last[:, low:high], last[:, low + 1 : high + 1]])
        came[k, low:high] = np.argmin(before[:, 0], axis=0)
        sums, largest = before.min(axis=0)
        older, last = last, np.full((2, n + 1), np.inf)
        last[0, low + 1 : high + 1] = apart + sums
        last[1, low + 1 : high + 1] = np.maximum(apart, largest)
    i, j = n - 1, m - 1
    pairs = [(i, j)]
    while i or j:
        step = came[i + j, i]
        i, j = i - (step != 2), j - (step != 1)
        pairs.append((i, j))
    return Warp(float(last[0, n]), float(last[1, n]), np.array(pairs[::-1]))
