"""Sampling-based planners of OMPL in joint space; they need the extra `rivals` (ompl).

RRT-Connect is Kuffner and LaValle's, ICRA 2000; RRT* Karaman and Frazzoli's, Int. J. Robotics Research 30(7), 2011;
Informed RRT* Gammell, Srinivasa and Barfoot's, IROS 2014, and BIT* theirs, ICRA 2015; AORRTC Wilson, Thomason, Kingston
and Gammell's, IEEE Robotics and Automation Letters, 2025; the library Sucan, Moll and Kavraki's, IEEE Robotics and
Automation Magazine 19(4), 2012. Paths are measured in joint coordinates over velocity limits, so a length is a time.
They are shortened, then smoothed and timed by `smoothing`. `trees` has RRT-Connect with balanced trees, unlike OMPL.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any, TypeAlias

import numpy as np

from lieednn_sim.budget import check_time
from lieednn_sim.planning.baselines.search_space import SearchSpace
from lieednn_sim.planning.baselines.smoothing import Paths, SmoothingOptions, motion_along_first
from lieednn_sim.planning.baselines.trees import connected
from lieednn_sim.planning.joint_space import ProblemClearance
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.registry import optional_module
from lieednn_sim.values import Floats

# OMPL's names. PRM* is left out: it builds its roadmap against the clock, in two threads; paths depend on the machine.
METHODS = {
    "rrt-connect": "RRTConnect",
    "rrt-star": "RRTstar",
    "informed-rrt-star": "InformedRRTstar",
    "bit-star": "BITstar",
    "aorrtc": "AORRTC",
}


@dataclass(frozen=True)
class PathOptions(SmoothingOptions):
    """Options for how paths are searched for, besides those of `SmoothingOptions`.

    Attributes:
        margin: clearance of paths, reduced where start or target is closer to something [m], and for smoothed motions.
        max_collision_checks: largest number of configurations tested (not seconds, so that results do not depend on the
            machine). While no path is found, the search goes on to the next number; planners that improve their paths
            stop at the first at which they have one.
        shortcuts: number of shortcuts tried on the path.
        longest_edge: longest edge that a tree grows at once, as a fraction of the joint space's diagonal.
        spacings: largest distances that a link frame moves between configurations tested on an edge, about, from 0.001
            to 1 m. If the dense test of the motion finds a contact in between, the next attempt takes the next one.
    """

    margin: float = 0.01
    max_collision_checks: tuple[int, ...] = (120_000,)
    shortcuts: int = 60
    longest_edge: float = field(default=0.1, metadata={"range": (1e-3, 1.0)})
    spacings: tuple[float, ...] = field(default=(0.04, 0.02), metadata={"range": (1e-3, 1.0)})


@dataclass(frozen=True)
class RrtConnectOptions(PathOptions):
    """Options of the planner ``rrt-connect``, besides those of `PathOptions`.

    Attributes:
        balanced: search by `trees`, with distances in the workspace, instead of OMPL's RRTConnect; it leaves narrow
            places with a fraction of the tests.
    """

    balanced: bool = False


@dataclass(frozen=True)
class RrtStarOptions(PathOptions):
    """Options of the planners ``rrt-star`` and ``aorrtc``; as `PathOptions`."""

    max_collision_checks: tuple[int, ...] = (80_000, 160_000)


@dataclass(frozen=True)
class InformedRrtStarOptions(RrtStarOptions):
    """Options of the planner ``informed-rrt-star``; as `RrtStarOptions`, with longer edges for straighter paths."""

    longest_edge: float = field(default=0.2, metadata={"range": (1e-3, 1.0)})


@dataclass(frozen=True)
class BitStarOptions(PathOptions):
    """Options of the planner ``bit-star``; as `PathOptions`.

    A test takes several times as long as with RRT*, and longer as the number of samples grows.
    """

    max_collision_checks: tuple[int, ...] = (5_000, 10_000, 20_000, 40_000)


# Returns a path of OMPL's, or None.
Search: TypeAlias = Callable[[SearchSpace, PathOptions, np.random.SeedSequence], Any]


def sampling_planner(name: str) -> Callable[..., Motion]:
    """The planner with a name of `METHODS`: a function of a problem and options, which raises as `motion_along_first`.

    RRT-Connect grows two trees from start and target until they meet. The others improve the path with a fixed amount
    of work: RRT* rewires one tree, Informed RRT* samples only where a shorter path is possible, BIT* searches batches
    of samples in the order of the path lengths that they promise, and AORRTC repeats RRT-Connect, each time for a
    shorter path. `LieEDNNError` if OMPL is not installed.
    """

    def planner(problem: PlanningProblem, options: PathOptions) -> Motion:
        return motion_along_first(problem, paths(problem, options, name), len(options.spacings), options, name)

    return planner


def paths(problem: PlanningProblem, options: PathOptions, name: str) -> Paths:
    """The paths of the planner with a name of `METHODS`."""
    balanced = isinstance(options, RrtConnectOptions) and options.balanced
    search = balanced_search if balanced else ompl_search(name)
    return cache(partial(connecting_path, problem, ProblemClearance(problem, options.margin), options, search))


rrt_connect = sampling_planner("rrt-connect")
rrt_star = sampling_planner("rrt-star")
informed_rrt_star = sampling_planner("informed-rrt-star")
bit_star = sampling_planner("bit-star")
aorrtc = sampling_planner("aorrtc")


def connecting_path(
    problem: PlanningProblem, clear: ProblemClearance, options: PathOptions, search: Search, attempt: int
) -> Floats | None:
    """Corners ``(M, n)`` of a shortened path from start to target, clear with the margin; or None.

    The search is `balanced_search`, or `ompl_search` of a name. Each attempt has other samples, and later ones a finer
    spacing; earlier calls change nothing. `LieEDNNError` if OMPL is not installed.
    """
    util = optional_module("ompl.util")
    clear.tests = 0
    level = util.getLogLevel()
    util.setLogLevel(util.LOG_NONE)
    try:
        # Seeds all generators made from here on; OMPL warns about those of others. Zero is not allowed.
        seed = np.random.SeedSequence([problem.seed, attempt])
        util.RNG.setSeed(1 + int(seed.generate_state(1)[0] % (2**31)))
        space = SearchSpace(problem, clear, options.spacings[attempt])
        waypoints = search(space, options, seed)
        return None if waypoints is None else space.corners(waypoints, options.shortcuts)
    finally:
        util.setLogLevel(level)


def ompl_search(name: str) -> Search:
    """The search of one of `METHODS` by OMPL."""

    def search(space: SearchSpace, options: PathOptions, _: np.random.SeedSequence) -> Any:
        base, geometric = optional_module("ompl.base"), optional_module("ompl.geometric")
        definition = base.ProblemDefinition(space.information)
        definition.setStartAndGoalStates(*(space.state(q / space.edges.scale) for q in space.ends))
        # No path is shorter than the straight one, so a planner that finds it, up to rounding, stops.
        objective = base.PathLengthOptimizationObjective(space.information)
        straight = float(np.linalg.norm((space.ends[1] - space.ends[0]) / space.edges.scale))
        objective.setCostThreshold(base.Cost((1.0 + 1e-9) * straight))
        definition.setOptimizationObjective(objective)
        # Informed RRT* fails where start and target are one: there is no ellipsoid to sample in.
        planner = getattr(geometric, METHODS[name if straight > 0.0 else "rrt-connect"])(space.information)
        if hasattr(planner, "setRange"):
            planner.setRange(options.longest_edge * space.information.getMaximumExtent())
        planner.setProblemDefinition(definition)
        planner.setup()
        for tests in options.max_collision_checks:
            if not definition.hasExactSolution():
                planner.solve(base.PlannerTerminationCondition(partial(space.edges.over, tests)))
                check_time()
        return definition.getSolutionPath() if definition.hasExactSolution() else None

    return search


def balanced_search(space: SearchSpace, options: PathOptions, seed: np.random.SeedSequence) -> Any:
    """The search by `trees`, with distances in the workspace."""
    edges, weight = space.edges, space.edges.weight
    box = weight[:, None] * edges.limits / edges.scale[:, None]
    result = connected(
        *(weight * q / edges.scale for q in space.ends),
        bounds=box,
        longest_edge=options.longest_edge * float(np.linalg.norm(np.ptp(box, axis=1))),
        clear=edges.weighted(),
        over=partial(edges.over, max(options.max_collision_checks)),
        seed=seed,
    )
    check_time()
    return None if result is None else space.path(result / weight)
