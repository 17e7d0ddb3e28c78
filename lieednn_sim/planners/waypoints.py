"""Intermediate postures around obstacles: two random trees that grow towards each other, and shortcuts.

The trees are those of RRT-Connect (Kuffner and LaValle, IEEE ICRA 2000), on joint positions in units of their ranges.
Only the postures where the way turns are kept: what moves the arm from one to the next is a network.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.arm.collision import Collisions
from lieednn_sim.validation import as_count, as_floats, as_generator

Floats = NDArray[np.float64]

# Distance in joint coordinates between two looks on a straight way [rad, m].
_RESOLUTION = 0.04
# Largest extension of a tree in units of the ranges.
_EXTENSION = 0.25
_SHORTCUTS = 60
# Distance that parts of the arm keep from each other [m].
_OWN_MARGIN = 1e-3


def find_waypoints(
    collisions: Collisions,
    start: ArrayLike,
    target: ArrayLike,
    *,
    margin: float = 0.02,
    seed: int | np.random.Generator = 0,
    looks: int = 6000,
) -> list[Floats] | None:
    """Postures ``(n,)`` between which, start and target the straight ways are free; None when none were found.

    Args:
        collisions: of the arm.
        start: joint position ``(n,)``.
        target: joint position ``(n,)``.
        margin: distance kept from the surroundings on the way [m], start and target apart.
        seed: of the search.
        looks: postures looked at before giving up.

    Raises:
        InputError: a value is malformed.
    """
    n = collisions.arm.n_joints
    first, last = as_floats("start", start, (n,)), as_floats("target", target, (n,))
    rng, budget = as_generator("seed", seed), [as_count("looks", looks)]
    low, high = collisions.arm.position_limits.T
    ranges = high - low

    def free(q: Floats) -> bool:
        budget[0] -= 1
        if collisions.arm.limit_excess(q).max() > 0.0:
            return False
        # Near the ends the margin shrinks to what they have.
        ends = min(np.abs((q - first) / ranges).max(), np.abs((q - last) / ranges).max())
        return collisions.free(q, margin * min(1.0, ends / 0.1) + min(1e-3, margin), own=min(_OWN_MARGIN, margin))

    def straight(a: Floats, b: Floats) -> bool:
        count = int(np.ceil(np.abs(b - a).max() / _RESOLUTION))
        # The middle first: it is the likeliest to touch something.
        order = sorted(range(1, count), key=lambda k: abs(2 * k - count))
        return all(free(a + k / count * (b - a)) for k in order)

    trees = _Tree(first, ranges), _Tree(last, ranges)
    grown, other = trees
    while budget[0] > 0:
        drawn = low + rng.uniform(size=n) * ranges
        origin = grown.nearest(drawn)
        step = drawn - grown.points[origin]
        new = grown.points[origin] + step * min(1.0, _EXTENSION / float(np.abs(step / ranges).max()))
        if free(new) and straight(grown.points[origin], new):
            grown.add(new, origin)
            near = other.nearest(new)
            if straight(other.points[near], new):
                other.add(new, near)
                way = trees[0].branch(-1)[::-1] + trees[1].branch(-1)[1:]
                return _shortened(way, straight, rng)[1:-1]
        grown, other = other, grown
    return None


class _Tree:
    def __init__(self, root: Floats, ranges: Floats) -> None:
        self.points, self._parents, self._ranges = [root], [-1], ranges

    def nearest(self, q: Floats) -> int:
        return int((((np.array(self.points) - q) / self._ranges) ** 2).sum(axis=1).argmin())

    def add(self, q: Floats, parent: int) -> None:
        self.points.append(q)
        self._parents.append(parent)

    def branch(self, index: int) -> list[Floats]:
        """From a point to the root."""
        way = [self.points[index]]
        parent = self._parents[index]
        while parent >= 0:
            way.append(self.points[parent])
            parent = self._parents[parent]
        return way


def _shortened(way: list[Floats], straight: Callable[[Floats, Floats], bool], rng: np.random.Generator) -> list[Floats]:
    """The way without corners that a straight piece can pass by."""
    way = list(way)
    # Greedily from the start, then random pieces in between.
    at = 0
    while at < len(way) - 2:
        for far in range(len(way) - 1, at + 1, -1):
            if straight(way[at], way[far]):
                del way[at + 1 : far]
                break
        at += 1
    for _ in range(_SHORTCUTS if len(way) > 2 else 0):
        corner = int(rng.integers(1, len(way) - 1))
        before, after = rng.uniform(size=2)
        a = way[corner] + before * (way[corner - 1] - way[corner])
        b = way[corner] + after * (way[corner + 1] - way[corner])
        # A corner pulled in to the middle of the piece that passes by it: shorter, and as many.
        middle = 0.5 * (a + b)
        if straight(way[corner - 1], middle) and straight(middle, way[corner + 1]):
            way[corner] = middle
    return way
