"""RRT-Connect with balanced trees and dynamic domains.

RRT-Connect is Kuffner and LaValle's (ICRA 2000). Here the smaller of the two trees grows (theirs, 2005), and after a
failed extension a node grows only towards samples nearby (Yershova, Jaillet, Simeon and LaValle, ICRA 2005). If one end
is in a narrow place, both measures keep the work there; otherwise the tree in the open would grow to thousands of
nodes that all fail to reach the other tree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.values import Floats

_DOMAIN = 4.0  # radius of a node's domain after a failed extension, in longest edges; as VAMP's


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
    """Corners ``(M, n)`` of a path from start to target ``(n,)``, both clear, or None if the search ends before.

    Args:
        start, target, seed: the ends, and the seed of the samples.
        bounds: ``(n, 2)`` bounds of the samples.
        longest_edge: longest edge to grow, in the Euclidean norm.
        clear: returns whether the edge from a clear point to another point is clear, including its end.
        over: returns whether the search must end; called before each extension.
        onto: projects a point onto the set in which the corners of the path are, such as that of a constraint (CBiRRT,
            Berenson et al., ICRA 2009); by default they may be anywhere.
    """
    if onto is None and clear(start, target):
        return np.stack([start, target])
    samples_of = _samples(bounds, seed)
    first = grown = _Tree(start)
    other = _Tree(target)

    def near_enough(point: Floats, new: Floats) -> bool:
        """A projection may lead far away."""
        return onto is None or bool(np.linalg.norm(new - point) < 2.0 * longest_edge)

    def extension() -> tuple[int, Floats] | None:
        """A node and the new point that it can be extended to, or None if no extension succeeds."""
        samples = next(samples_of)
        near, distance = grown.nearest(samples)
        # Try samples within the domains of their nearest nodes in turn or, if there are none, the one least outside.
        outside = distance / grown.radius[near]
        inside = (outside <= 1.0).nonzero()[0]
        for index in inside.tolist() if len(inside) else [int(outside.argmin())]:
            node, length = int(near[index]), float(distance[index])
            # The domain may have shrunk meanwhile.
            if len(inside) and length > grown.radius[node]:
                continue
            if over():
                break
            point = grown.points[node]
            new = point + (samples[index] - point) * (longest_edge / max(length, longest_edge))
            if onto is not None:
                new = onto(new)
            if near_enough(point, new) and clear(point, new):
                return node, new
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


def _samples(bounds: Floats, seed: int | np.random.SeedSequence) -> Iterator[Floats]:
    """Samples ``(64, n)`` within bounds ``(n, 2)``, drawn for some extensions at once."""
    rng = np.random.default_rng(seed)
    while True:
        yield from bounds[:, 0] + np.ptp(bounds, axis=1) * rng.random((16, 64, len(bounds)))


class _Tree:
    """Points, their parents, and radii of their domains, infinite until an extension fails; with room for more."""

    def __init__(self, root: Floats) -> None:
        self.points, self.radius, self._parents = np.empty((256, len(root))), np.full(256, np.inf), list[int]()
        self._planes = np.empty((len(root) + 1, 256))
        self.add(root, -1)

    def __len__(self) -> int:
        return len(self._parents)

    def add(self, point: Floats, parent: int) -> int:
        """Add a node; return its number."""
        if (node := len(self)) == len(self.points):
            self.points = np.concatenate([self.points, self.points])
            self.radius = np.append(self.radius, np.full(node, np.inf))
            self._planes = np.concatenate([self._planes, self._planes], axis=1)
        self.points[node], self._planes[:-1, node], self._planes[-1, node] = point, -2.0 * point, point @ point
        self._parents.append(parent)
        return node

    def nearest(self, points: Floats) -> tuple[NDArray[np.intp], Floats]:
        """The node nearest to each point ``(K, n)``, and its distance."""
        # The nearest node p has the least |p|^2 - 2 x . p: one matrix product, in a fifth of the time of all distances.
        lifted = np.ones((len(points), len(self._planes)))
        lifted[:, :-1] = points
        nodes = (lifted @ self._planes[:, : len(self)]).argmin(axis=1)
        away = np.ascontiguousarray((points - self.points.take(nodes, axis=0)).T)
        return nodes, np.sqrt(np.add.reduce(np.square(away, out=away), axis=0))

    def branch(self, node: int) -> Floats:
        """Points from the root to a node, ``(M, n)``."""
        numbers = []
        while node >= 0:
            numbers.append(node)
            node = self._parents[node]
        return self.points[numbers[::-1]]
