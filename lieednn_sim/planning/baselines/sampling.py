"""Sampling-based planners of OMPL in joint space; they need the extra `rivals` (ompl).

RRT-Connect is Kuffner and LaValle's, ICRA 2000; RRT* Karaman and Frazzoli's, Int. J. Robotics Research 30(7), 2011;
Informed RRT* Gammell, Srinivasa and Barfoot's, IROS 2014, and BIT* theirs, ICRA 2015; AORRTC Wilson, Thomason, Kingston
and Gammell's, IEEE Robotics and Automation Letters, 2025; the library Sucan, Moll and Kavraki's, IEEE Robotics and
Automation Magazine 19(4), 2012. Paths are measured in joint coordinates over velocity limits; their length is a time.
They are shortened, rounded and timed by `smoothing`. RRT-Connect with balanced trees, which OMPL lacks, is in `trees`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np

from lieednn_sim.budget import check_time, out_of_time
from lieednn_sim.errors import PlanError, TooFastError
from lieednn_sim.planning.baselines.joint_space import Workspace, joint_scale, sweeps
from lieednn_sim.planning.baselines.smoothing import SmoothingOptions, motion_along
from lieednn_sim.planning.baselines.trees import connected
from lieednn_sim.planning.extras import optional_module
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem, in_time
from lieednn_sim.values import Floats

# OMPL's names. PRM* has no place here: OMPL's builds its roadmap by the clock and in two threads, so that its paths
# depend on the machine.
METHODS = {
    "rrt-connect": "RRTConnect",
    "rrt-star": "RRTstar",
    "informed-rrt-star": "InformedRRTstar",
    "bit-star": "BITstar",
    "aorrtc": "AORRTC",
}
# In place of OMPL's name: the search of `trees`.
BALANCED = "balanced RRT-Connect"
# Joints that hardly move a link count in its distances by this share of the one that moves links most.
_LEAST_SWEEP = 0.1
# Times that a search looks whether it is over, for each test that it may make: usually once for a test or more.
_LOOKS = 2
# A path of this many times the length of the straight one is straight, up to rounding.
_STRAIGHT = 1.0 + 1e-9


@dataclass(frozen=True)
class SearchOptions(PlannerOptions):
    """How paths are searched for.

    Attributes:
        margin: what paths keep away from everything, unless start or target are closer to something [m]; motions along
            them are rounded, and checked for less.
        tests: postures tested at most, not seconds, for results must not depend on the machine's speed; while nothing
            is found the search goes on to the next number. Planners that improve what they found spend the first on it.
        shortcuts: tried on the path that was found.
        reach: longest edge that a tree grows at once, as a share of the joint space's diagonal; OMPL's own by default.
        spacings: a link frame moves at most about this far from one posture tested along an edge to the next, from
            0.001 to 1 m. What slips through is found by the dense test of the motion; then the next attempt is made,
            with the next one.
    """

    margin: float = 0.01
    tests: tuple[int, ...] = (120_000,)
    shortcuts: int = 60
    reach: float = field(default=0.2, metadata={"range": (1e-3, 1.0)})
    spacings: tuple[float, ...] = field(default=(0.04, 0.02), metadata={"range": (1e-3, 1.0)})


@dataclass(frozen=True)
class PathOptions(SearchOptions, SmoothingOptions):
    """How paths are searched for and rounded; see the two classes that it is made of."""


@dataclass(frozen=True)
class RrtConnectOptions(PathOptions):
    """Of the planner ``rrt-connect``; as `PathOptions`.

    Attributes:
        balanced: search as `trees` does, by distances in the workspace, in place of OMPL's RRTConnect: out of narrow
            places with a small part of the tests.
    """

    balanced: bool = False


@dataclass(frozen=True)
class RrtStarOptions(PathOptions):
    """Of the planners ``rrt-star``, ``informed-rrt-star`` and ``aorrtc``; as `PathOptions`."""

    tests: tuple[int, ...] = (80_000, 160_000)


@dataclass(frozen=True)
class BitStarOptions(PathOptions):
    """Of the planner ``bit-star``; as `PathOptions`.

    A test takes several times as long as RRT*'s, and the longer the more samples there are.
    """

    tests: tuple[int, ...] = (5_000, 10_000, 20_000, 40_000)


def sampling_planner(name: str) -> Callable[[PlanningProblem, PathOptions], Motion]:
    """The planner of a name of `METHODS`.

    RRT-Connect grows two trees from start and target until they meet. Those that improve the path for a fixed amount of
    work: RRT* rewires one tree, Informed RRT* draws only where a shorter path may be, BIT* searches batches of samples
    in the order of the length that they promise, and AORRTC runs RRT-Connect again and again, each time for a shorter
    path.

    The planner raises:
        LieEDNNError: OMPL is not installed.
        PlanError: no path was found within the work allowed, or it cannot be followed in time.
    """

    def planner(problem: PlanningProblem, options: PathOptions) -> Motion:
        balanced = isinstance(options, RrtConnectOptions) and options.balanced
        return _plan(problem, options, BALANCED if balanced else METHODS[name])

    return planner


rrt_connect = sampling_planner("rrt-connect")


def _plan(problem: PlanningProblem, options: PathOptions, planner: str) -> Motion:
    # Paths have no part in time: none is searched for again when the motion along it needs more.
    path = cache(partial(connecting_path, problem, Workspace(problem, options.margin), options, planner))
    blocked = {attempt: dict[int | None, PlanError]() for attempt in range(len(options.spacings))}

    def motion(asked: PlanningProblem) -> Motion:
        refusal: PlanError | None = None
        for attempt, curves in blocked.items():
            corners = path(attempt)
            if corners is None:
                break
            try:
                return motion_along(asked, corners, options, curves)
            except PlanError as error:
                refusal = error
                if isinstance(error, TooFastError) and error.duration <= asked.longest * asked.duration:
                    break
        raise refusal or PlanError(f"{planner} found no path free of contact; try another seed or target")

    return in_time(motion, problem)


def connecting_path(
    problem: PlanningProblem, workspace: Workspace, options: SearchOptions, planner: str, attempt: int
) -> Floats | None:
    """Corners ``(M, n)`` of a shortened path from start to target, clear in the workspace; or None.

    It is the same whatever ran before.

    Args:
        problem: start, target and seed.
        workspace: of the problem, with the margin.
        options: of the search.
        planner: OMPL's name of it, or `BALANCED`.
        attempt: another one draws others, and looks more closely.

    Raises:
        LieEDNNError: OMPL is not installed.
    """
    util = optional_module("ompl.util")
    workspace.clear.tests = 0
    level = util.getLogLevel()
    util.setLogLevel(util.LOG_NONE)
    try:
        # Every generator made from here on draws its seed from this one. OMPL warns of that for those that exist
        # already, which are not ours. It takes no seed of zero.
        seed = np.random.SeedSequence([problem.seed, attempt])
        util.RNG.setSeed(1 + int(seed.generate_state(1)[0] % (2**31)))
        spacing = options.spacings[min(attempt, len(options.spacings) - 1)]
        return _path(problem, workspace, options, planner, spacing, seed)
    finally:
        util.setLogLevel(level)


def _path(
    problem: PlanningProblem,
    workspace: Workspace,
    options: SearchOptions,
    planner: str,
    spacing: float,
    seed: np.random.SeedSequence,
) -> Floats | None:
    """Corners ``(M, n)`` of a shortened path, or None."""
    base, geometric = optional_module("ompl.base"), optional_module("ompl.geometric")
    n, scale = problem.arm.n_joints, joint_scale(problem.arm)
    space = base.RealVectorStateSpace(n)
    bounds = base.RealVectorBounds(n)
    for joint, (low, high) in enumerate(problem.arm.position_limits / scale[:, None]):
        bounds.setLow(joint, float(low))
        bounds.setHigh(joint, float(high))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    swept = scale * sweeps(problem.arm)
    density = swept / spacing
    balls = len(problem.arm.space.balls) > 0
    known = set[bytes]()

    # No exception may pass through the library: out of time nothing is free, so that it ends soon.
    def inside(q: Floats) -> bool:
        # A ball joint's angle is limited, whose limits are no box; but convex, so that ends speak for edges. The box of
        # the others is what the space draws from.
        return not (out_of_time() or (balls and (problem.arm.limit_excess(q) > 0.0).any()))

    def free(state: Any) -> bool:
        values = np.array(state[0:n])
        if not (inside(scale * values) and workspace.clear(scale * values)):
            return False
        known.add(values.tobytes())
        return True

    def passable(first: Floats, second: Floats) -> bool:
        """Tests an edge at postures that are evenly spaced in the workspace, not in joint space."""
        if not inside(scale * second):
            return False
        count = max(1, math.ceil(float(np.abs(second - first) @ density)))
        # The first end is valid, and the other is where a tree grows back from it; still it counts as work.
        end = second.tobytes()
        shares = _shares(count)[end in known :]
        workspace.clear.tests += end in known
        if workspace.clear.first_blocked(scale * (first + shares[:, None] * (second - first))) is not None:
            return False
        known.add(end)
        return True

    class Edges(base.MotionValidator):  # type: ignore[misc,name-defined]
        def checkMotion(self, first: Any, second: Any) -> bool:
            return passable(np.array(first[0:n]), np.array(second[0:n]))

    information.setStateValidityChecker(free)
    information.setMotionValidator(Edges(information))
    information.setup()
    # A tree grows out of a narrow place more easily than into one.
    ends = sorted((problem.start, problem.target), key=workspace.collisions.clearance)
    looks = itertools.count()

    def spent(tests: int) -> bool:
        # Where no path can be shorter than the one that is known, nothing is tested any more.
        return next(looks) >= _LOOKS * tests or workspace.clear.tests >= tests or out_of_time()

    def simplified(path: Any) -> Floats:
        simplifier = geometric.PathSimplifier(information)
        simplifier.reduceVertices(path, options.shortcuts, options.shortcuts)
        simplifier.partialShortcutPath(path, options.shortcuts, options.shortcuts)
        simplifier.collapseCloseVertices(path)
        check_time()
        corners = scale * np.array([path.getState(i)[0:n] for i in range(path.getStateCount())])
        if ends[0] is not problem.start:
            corners = corners[::-1].copy()
        corners[0], corners[-1] = problem.start, problem.target
        return corners

    if planner == BALANCED:
        weight = np.maximum(swept, _LEAST_SWEEP * swept.max())
        box = weight[:, None] * problem.arm.position_limits / scale[:, None]
        found = connected(
            *(weight * q / scale for q in ends),
            bounds=box,
            reach=options.reach * float(np.linalg.norm(np.ptp(box, axis=1))),
            clear=lambda first, second: passable(first / weight, second / weight),
            over=partial(spent, max(options.tests)),
            seed=seed,
        )
        check_time()
        if found is None:
            return None
        path = geometric.PathGeometric(information)
        for corner in found / weight:
            path.append(_state(space, corner))
        return simplified(path)
    definition = base.ProblemDefinition(information)
    definition.setStartAndGoalStates(*(_state(space, q / scale) for q in ends))
    # The straight way is the shortest there is: who finds it is done.
    objective = base.PathLengthOptimizationObjective(information)
    objective.setCostThreshold(base.Cost(_STRAIGHT * float(np.linalg.norm((ends[1] - ends[0]) / scale))))
    definition.setOptimizationObjective(objective)
    method = getattr(geometric, planner)(information)
    if hasattr(method, "setRange"):
        method.setRange(options.reach * space.getMaximumExtent())
    method.setProblemDefinition(definition)
    method.setup()
    for tests in options.tests:
        if not definition.hasExactSolution():
            method.solve(base.PlannerTerminationCondition(partial(spent, tests)))
            check_time()
    if not definition.hasExactSolution():
        return None
    return simplified(definition.getSolutionPath())


@lru_cache(maxsize=4096)
def _shares(count: int) -> Floats:
    """1/count .. count/count, the last first and the others by halving, so that what is in the way is found soon."""
    order, gaps = [count], [(0, count)]
    for low, high in gaps:
        middle = (low + high) // 2
        if low < middle:
            order.append(middle)
            gaps += [(low, middle), (middle, high)]
    return np.array(order) / count


def _state(space: Any, values: Floats) -> Any:
    state = space.allocState()
    state[0 : len(values)] = values.tolist()
    return state
