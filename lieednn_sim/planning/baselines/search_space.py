"""Joint space for sampling-based planners: tests of configurations and edges, and the end of the search.

Points are joint coordinates over velocity limits, so the length of a path is a time.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable
from functools import cache, lru_cache
from typing import Any

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.budget import check_time, out_of_time
from lieednn_sim.planning.joint_space import ClearanceTest, ProblemClearance, sweeps
from lieednn_sim.planning.motion import joint_scale
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.registry import optional_module
from lieednn_sim.values import Floats


class EdgeTest:
    """Tests of points and edges, which counts the configurations tested; independent of OMPL.

    On an edge, a link frame moves by at most about ``spacing`` [m] from one tested configuration to the next.

    Attributes:
        scale: ``(n,)`` units of the coordinates of points [rad, m].
        limits: ``(n, 2)`` position limits of the joints [rad, m].
        bounds: ``(n, 2)`` the same in the units of points.
        swept: ``(n,)`` largest distance that a unit of a coordinate moves a link frame [m].
        weight: ``(n,)`` the same, but at least a tenth of its largest entry: weights for distances in the workspace.
    """

    def __init__(self, arm: Arm, clear: ClearanceTest, spacing: float) -> None:
        self._arm, self._clear = arm, clear
        self.scale, self.limits = joint_scale(arm), arm.position_limits
        self.bounds = self.limits / self.scale[:, None]
        self.swept = self.scale * sweeps(arm)
        self.weight = np.maximum(self.swept, 0.1 * self.swept.max())
        self._density = self.swept / spacing
        self._balls = len(arm.space.balls) > 0
        self._known, self._looks = set[bytes](), itertools.count()

    def weighted(self) -> Callable[[Floats, Floats], bool]:
        """Another `passable`, for points times `weight`."""
        test = copy.copy(self)
        test.scale, test._density, test._known = self.scale / self.weight, self._density / self.weight, set()
        return test.passable

    def free(self, point: Floats) -> bool:
        """Whether a point ``(n,)`` is clear."""
        q = self.scale * point
        # Samples are drawn within the box of the limits, but the angle limit of a ball joint is not a box. It is
        # convex, so an edge is within it if its ends are.
        if (self._balls and (self._arm.limit_excess(q) > 0.0).any()) or not self._clear(q):
            return False
        self._known.add(point.tobytes())
        return True

    def passable(self, first: Floats, second: Floats) -> bool:
        """Whether the edge from a clear point ``(n,)`` to another one is clear, at evenly spaced configurations."""
        # An end found clear before is not tested again, but counts as work. Most blocked edges are blocked there.
        if second.tobytes() in self._known:
            self._clear.tests += 1
        elif not self.free(second):
            return False
        change = second - first
        between = bisecting(max(1, math.ceil(float(np.abs(change) @ self._density))))[1:, None]
        return not len(between) or self._clear.first_blocked(self.scale * (first + between * change)) is None

    def over(self, tests: int) -> bool:
        """Whether a search must end that may test ``tests`` configurations; the search asks in its loop."""
        # Calls count, too: most come with a test, but a planner that knows the shortest path tests nothing any more.
        # The clock is read now and then, since that takes as long as half a test.
        if (calls := next(self._looks)) % 16 == 0 and out_of_time():
            self._clear.tests = tests
        return calls >= 2 * tests or self._clear.tests >= tests


class SearchSpace:
    """The joint space of a problem for OMPL.

    Attributes:
        edges: tests of points and edges.
        ends: start and target in joint coordinates, the one with less clearance first: a tree grows out of a narrow
            place more easily than into one.
        information: OMPL's space information.
    """

    def __init__(self, problem: PlanningProblem, clear: ProblemClearance, spacing: float) -> None:
        base, n = optional_module("ompl.base"), problem.arm.n_joints
        self._problem = problem
        # Callbacks must not hold OMPL's objects: such reference cycles are never collected.
        self.edges = edges = EdgeTest(problem.arm, clear, spacing)
        ends = problem.start, problem.target
        self.ends = ends if clear.distances[0] <= clear.distances[1] else ends[::-1]
        self._space = base.RealVectorStateSpace(n)
        bounds = base.RealVectorBounds(n)
        for joint, (low, high) in enumerate(edges.bounds):
            bounds.setLow(joint, float(low))
            bounds.setHigh(joint, float(high))
        self._space.setBounds(bounds)
        self.information = base.SpaceInformation(self._space)
        # No exception may pass through the library; when time is out nothing is free, so that it ends soon.
        self.information.setStateValidityChecker(lambda state: not out_of_time() and edges.free(np.array(state[0:n])))
        self.information.setMotionValidator(_validator_class(base)(self.information, edges))
        self.information.setup()

    def state(self, point: Floats) -> Any:
        """OMPL's state at a point ``(n,)``."""
        state = self._space.allocState()
        state[0 : len(point)] = point.tolist()
        return state

    def path(self, points: Floats) -> Any:
        """OMPL's path through points ``(M, n)``."""
        path = optional_module("ompl.geometric").PathGeometric(self.information)
        for point in points:
            path.append(self.state(point))
        return path

    def corners(self, path: Any, shortcuts: int) -> Floats:
        """Joint coordinates ``(M, n)`` from start to target of one of OMPL's paths, after attempts to shorten it."""
        simplifier = optional_module("ompl.geometric").PathSimplifier(self.information)
        simplifier.reduceVertices(path, shortcuts, shortcuts)
        simplifier.partialShortcutPath(path, shortcuts, shortcuts)
        simplifier.collapseCloseVertices(path)
        check_time()
        problem, n = self._problem, self._problem.arm.n_joints
        corners = self.edges.scale * np.array([path.getState(i)[0:n] for i in range(path.getStateCount())])
        if self.ends[0] is not problem.start:
            corners = corners[::-1].copy()
        corners[0], corners[-1] = problem.start, problem.target
        return corners


@cache
def _validator_class(base: Any) -> type[Any]:
    # Made once, since each class is a reference cycle, which would keep its problem until cycles are collected.
    class EdgeValidator(base.MotionValidator):  # type: ignore[misc]
        def __init__(self, information: Any, edges: EdgeTest) -> None:
            super().__init__(information)
            self._edges, self._n = edges, len(edges.scale)

        def checkMotion(self, first: Any, second: Any) -> bool:
            return not out_of_time() and self._edges.passable(*(np.array(end[0 : self._n]) for end in (first, second)))

    return EdgeValidator


@lru_cache(maxsize=4096)
def bisecting(count: int) -> Floats:
    """Fractions 1/count to 1, the last one first, the others by bisection, so that contacts are found early."""
    order, gaps = [count], [(0, count)]
    for low, high in gaps:
        middle = (low + high) // 2
        if low < middle:
            order.append(middle)
            gaps += [(low, middle), (middle, high)]
    return np.array(order) / count
