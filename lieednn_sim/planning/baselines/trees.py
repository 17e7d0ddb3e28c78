"""RRT-Connect with balanced trees and dynamic domains.

RRT-Connect is Kuffner and LaValle's (ICRA 2000). Here the smaller of the two trees grows (theirs, 2005), and after a
failed extension a node grows only towards samples nearby (Yershova, Jaillet, Simeon and LaValle, ICRA 2005). If one end
is in a narrow place, both measures keep the work there; otherwise the tree in the open would grow to thousands of
nodes that all fail to reach the other tree.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from lieednn_sim.values import Floats

_DOMAIN = 4.0  # radius of a node's domain after a failed extension, in longest edges; as VAMP's
_STRETCHED = 2.0  # longest edge after a projection, in longest edges
# Samples drawn at once. Extensions towards those within the domains of their nearest nodes are tried in turn until one
# succeeds; if there are none, towards the sample that is least outside.
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
    onto: Callable[[Floats], Floats] | None = None,
) -> Floats | None:
    """Corners ``(M, n)`` of a path from start to target, or None if the search ends before one is found.

    Args:
        start: ``(n,)``, clear.
        target: ``(n,)``, clear.
        bounds: ``(n, 2)`` bounds of the samples.
        longest_edge: longest edge to grow, in the Euclidean norm.
        clear: returns whether the edge from a clear point to another point is clear, including its end.
        over: returns whether the search must end; called before each extension.
        seed: seed of the samples.
        onto: projects a point onto the set in which the corners of the path are, such as that of a constraint (CBiRRT,
            Berenson et al., ICRA 2009); by default they may be anywhere.
    """
    if onto is None and clear(start, target):
        return np.stack([start, target])
    rng = np.random.default_rng(seed)
    first = grown = _Tree(start)
    other = _Tree(target)

    def near_enough(point: Floats, new: Floats) -> bool:
        """A projection may lead far away."""
        return onto is None or bool(np.linalg.norm(new - point) < _STRETCHED * longest_edge)

    def extension() -> tuple[int, Floats] | None:
        """A node and the new point that it can be extended to, or None if no extension succeeds."""
        samples = rng.uniform(bounds[:, 0], bounds[:, 1], (_DRAWN, len(bounds)))
        near, distance = grown.nearest(samples)
        inside = distance <= grown.radius[near]
        for index in np.flatnonzero(inside) if inside.any() else [np.argmin(distance / grown.radius[near])]:
            node, length = near[index], distance[index]
            # The domain may have shrunk meanwhile.
            if inside[index] and length > grown.radius[node]:
                continue
            if over():
                break
            point = grown.points[node]
            new = point + (samples[index] - point) * (longest_edge / max(length, longest_edge))
            if onto is not None:
                new = onto(new)
            if near_enough(point, new) and clear(point, new):
                return int(node), new
            grown.radius[node] = _DOMAIN * longest_edge
        return None

    while not over():
        # Trees of equal size take turns.
        if len(grown) >= len(other):
            grown, other = other, grown
        result = extension()
        if result is None:
            continue
        near, new = result
        node = grown.add(new, near)
        met = int(other.nearest(new[None])[0][0])
        goal = other.points[met]
        steps = max(1, math.ceil(float(np.linalg.norm(goal - new)) / longest_edge))
        for step in range(1, steps + 1):
            ahead = goal if step == steps else new + step / steps * (goal - new)
            if onto is not None and step < steps:
                ahead = onto(ahead)
            if not (near_enough(grown.points[node], ahead) and clear(grown.points[node], ahead)):
                break
            node = grown.add(ahead, node)
        else:
            # The two branches end at the same point.
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
        """``(M,)`` radii of the domains, writable; infinite until an extension of the node fails."""
        return self._radius[: len(self)]

    def add(self, point: Floats, parent: int) -> int:
        """Add a node; return its number."""
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
