"""RRT-Connect with balanced trees and dynamic domains.

Kuffner and LaValle's (ICRA 2000), of whose two trees always the smaller one grows (theirs, 2005), and from a node that
an extension has failed at only towards samples nearby (Yershova, Jaillet, Simeon and LaValle, ICRA 2005). Where one end
is in a narrow place both keep the work there: else the tree in the open grows to thousands of nodes, each of which
tries in vain to reach the other one.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from lieednn_sim.values import Floats

# Radius of the domain of a node that an extension failed at, in longest edges; as VAMP's.
_DOMAIN = 4.0
# Samples drawn at once: those in the domain of the node nearest to them are grown to in turn until a tree changes, or
# else the one that is least beyond.
_DRAWN = 64


def connected(
    start: Floats,
    target: Floats,
    *,
    bounds: Floats,
    longest_edge: float,
    clear: Callable[[Floats, Floats], bool],
    over: Callable[[], bool],
    seed: int | np.random.SeedSequence,
) -> Floats | None:
    """Corners ``(M, n)`` from start to target, or None when the search is over before they are found.

    Args:
        start: ``(n,)``, clear.
        target: ``(n,)``, clear.
        bounds: ``(n, 2)`` of samples.
        longest_edge: by the Euclidean norm.
        clear: whether the edge from a point that is clear to another point is, its end included.
        over: asked before each extension.
        seed: of the samples.
    """
    if clear(start, target):
        return np.stack([start, target])
    rng = np.random.default_rng(seed)
    first = grown = _Tree(start)
    other = _Tree(target)

    def extension() -> tuple[int, Floats] | None:
        """The node to grow from and the point to grow to, if one of some samples allows it."""
        samples = rng.uniform(bounds[:, 0], bounds[:, 1], (_DRAWN, len(bounds)))
        near, distance = grown.nearest(samples)
        inside = distance <= grown.radius[near]
        for index in np.flatnonzero(inside) if inside.any() else [np.argmin(distance / grown.radius[near])]:
            node, length = near[index], distance[index]
            # The domain may have become smaller meanwhile.
            if inside[index] and length > grown.radius[node]:
                continue
            if over():
                break
            point = grown.points[node]
            new = point + (samples[index] - point) * (longest_edge / max(length, longest_edge))
            if clear(point, new):
                return int(node), new
            grown.radius[node] = _DOMAIN * longest_edge
        return None

    while not over():
        # Both try in turn while neither grows.
        if len(grown) >= len(other):
            grown, other = other, grown
        found = extension()
        if found is None:
            continue
        near, new = found
        node = grown.add(new, near)
        met = int(other.nearest(new[None])[0][0])
        goal = other.points[met]
        steps = max(1, math.ceil(float(np.linalg.norm(goal - new)) / longest_edge))
        for step in range(1, steps + 1):
            ahead = goal if step == steps else new + step / steps * (goal - new)
            if not clear(grown.points[node], ahead):
                break
            node = grown.add(ahead, node)
        else:
            # Both end in the same point.
            corners = np.concatenate([grown.branch(node)[:-1], other.branch(met)[::-1]])
            return corners if grown is first else corners[::-1]
    return None


class _Tree:
    """Nodes, each with its parent and the radius of its domain."""

    def __init__(self, root: Floats) -> None:
        self._points, self._radius, self._parents = root[None].copy(), np.full(1, np.inf), [-1]

    def __len__(self) -> int:
        return len(self._parents)

    @property
    def points(self) -> Floats:
        """``(M, n)``."""
        return self._points[: len(self)]

    @property
    def radius(self) -> Floats:
        """``(M,)``, to be written to; infinite of nodes that no extension has failed at."""
        return self._radius[: len(self)]

    def add(self, point: Floats, parent: int) -> int:
        """The number of a new node."""
        node = len(self)
        if node == len(self._points):
            self._points = np.concatenate([self._points, np.empty_like(self._points)])
            self._radius = np.concatenate([self._radius, np.empty_like(self._radius)])
        self._points[node], self._radius[node] = point, np.inf
        self._parents.append(parent)
        return node

    def nearest(self, points: Floats) -> tuple[NDArray[np.intp], Floats]:
        """The node nearest to each point ``(K, n)``, and its distance."""
        distances = cdist(points, self.points)
        nodes = distances.argmin(axis=1)
        return nodes, distances[np.arange(len(points)), nodes]

    def branch(self, node: int) -> Floats:
        """Points from the root to a node, ``(M, n)``."""
        numbers = []
        while node >= 0:
            numbers.append(node)
            node = self._parents[node]
        return self.points[numbers[::-1]]
