"""Sampling-based planners of OMPL in joint space; they need the extra `rivals` (ompl).

RRT-Connect is Kuffner and LaValle's, ICRA 2000; RRT* Karaman and Frazzoli's, Int. J. Robotics Research 30(7), 2011;
Informed RRT* Gammell, Srinivasa and Barfoot's, IROS 2014, and BIT* theirs, ICRA 2015; AORRTC Wilson, Thomason, Kingston
and Gammell's, IEEE Robotics and Automation Letters, 2025; the library Sucan, Moll and Kavraki's, IEEE Robotics and
Automation Magazine 19(4), 2012. Paths are measured in joint coordinates over velocity limits; their length is a time.
They are shortened, rounded and timed by `smoothing`. RRT-Connect with balanced trees, which OMPL lacks, is in `trees`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any, TypeAlias

import numpy as np

from lieednn_sim.budget import check_time
from lieednn_sim.planning.baselines.joint_space import Workspace
from lieednn_sim.planning.baselines.search_space import SearchSpace
from lieednn_sim.planning.baselines.smoothing import SmoothingOptions, motion_along_first
from lieednn_sim.planning.baselines.trees import connected
from lieednn_sim.planning.extras import optional_module
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem
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
# Joints that hardly move a link count in its distances by this share of the one that moves links most.
_LEAST_SWEEP = 0.1
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
        longest_edge: that a tree grows at once, as a share of the joint space's diagonal; OMPL's own by default.
        spacings: a link frame moves at most about this far from one posture tested along an edge to the next, from
            0.001 to 1 m. What slips through is found by the dense test of the motion; then the next attempt is made,
            with the next one.
    """

    margin: float = 0.01
    tests: tuple[int, ...] = (120_000,)
    shortcuts: int = 60
    longest_edge: float = field(default=0.1, metadata={"range": (1e-3, 1.0)})
    spacings: tuple[float, ...] = field(default=(0.04, 0.02), metadata={"range": (1e-3, 1.0)})


@dataclass(frozen=True)
class PathOptions(SearchOptions, SmoothingOptions):
    """How paths are searched for and rounded; see the two classes that it is made of."""


@dataclass(frozen=True)
class RrtConnectOptions(PathOptions):
    """Options of the planner ``rrt-connect``; as `PathOptions`.

    Attributes:
        balanced: search as `trees` does, by distances in the workspace, in place of OMPL's RRTConnect: out of narrow
            places with a small part of the tests.
    """

    balanced: bool = False


@dataclass(frozen=True)
class RrtStarOptions(PathOptions):
    """Options of the planners ``rrt-star`` and ``aorrtc``; as `PathOptions`."""

    tests: tuple[int, ...] = (80_000, 160_000)


@dataclass(frozen=True)
class InformedRrtStarOptions(RrtStarOptions):
    """Options of the planner ``informed-rrt-star``; as `RrtStarOptions`, with edges that soon make the straight way."""

    longest_edge: float = field(default=0.2, metadata={"range": (1e-3, 1.0)})


@dataclass(frozen=True)
class BitStarOptions(PathOptions):
    """Options of the planner ``bit-star``; as `PathOptions`.

    A test takes several times as long as RRT*'s, and the longer the more samples there are.
    """

    tests: tuple[int, ...] = (5_000, 10_000, 20_000, 40_000)


# From a space, options and a seed to a path of OMPL's, or None.
Search: TypeAlias = Callable[[SearchSpace, SearchOptions, np.random.SeedSequence], Any]


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
        return _plan(problem, options, balanced_search if balanced else ompl_search(name), name)

    return planner


rrt_connect = sampling_planner("rrt-connect")


def _plan(problem: PlanningProblem, options: PathOptions, search: Search, name: str) -> Motion:
    path = cache(partial(connecting_path, problem, Workspace(problem, options.margin), options, search))
    return motion_along_first(problem, path, len(options.spacings), options, name)


def connecting_path(
    problem: PlanningProblem, workspace: Workspace, options: SearchOptions, search: Search, attempt: int
) -> Floats | None:
    """Corners ``(M, n)`` of a shortened path from start to target, clear in the workspace; or None.

    It is the same whatever ran before.

    Args:
        problem: start, target and seed.
        workspace: of the problem, with the margin.
        options: of the search.
        search: `balanced_search`, or `ompl_search` of a name.
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
        space = SearchSpace(problem, workspace, options.spacings[min(attempt, len(options.spacings) - 1)])
        found = search(space, options, seed)
        return None if found is None else space.corners(found, options.shortcuts)
    finally:
        util.setLogLevel(level)


def ompl_search(name: str) -> Search:
    """The search of one of `METHODS` by OMPL."""

    def search(space: SearchSpace, options: SearchOptions, _: np.random.SeedSequence) -> Any:
        base, geometric = optional_module("ompl.base"), optional_module("ompl.geometric")
        definition = base.ProblemDefinition(space.information)
        definition.setStartAndGoalStates(*(space.state(q / space.edges.scale) for q in space.ends))
        # The straight way is the shortest there is: who finds it is done.
        objective = base.PathLengthOptimizationObjective(space.information)
        straight = float(np.linalg.norm((space.ends[1] - space.ends[0]) / space.edges.scale))
        objective.setCostThreshold(base.Cost(_STRAIGHT * straight))
        definition.setOptimizationObjective(objective)
        planner = getattr(geometric, METHODS[name])(space.information)
        if hasattr(planner, "setRange"):
            planner.setRange(options.longest_edge * space.information.getMaximumExtent())
        planner.setProblemDefinition(definition)
        planner.setup()
        for tests in options.tests:
            if not definition.hasExactSolution():
                planner.solve(base.PlannerTerminationCondition(partial(space.edges.over, tests)))
                check_time()
        return definition.getSolutionPath() if definition.hasExactSolution() else None

    return search


def balanced_search(space: SearchSpace, options: SearchOptions, seed: np.random.SeedSequence) -> Any:
    """The search of `trees`, by distances in the workspace."""
    edges = space.edges
    weight = np.maximum(edges.swept, _LEAST_SWEEP * edges.swept.max())
    box = weight[:, None] * edges.limits / edges.scale[:, None]
    found = connected(
        *(weight * q / edges.scale for q in space.ends),
        bounds=box,
        longest_edge=options.longest_edge * float(np.linalg.norm(np.ptp(box, axis=1))),
        clear=lambda first, second: edges.passable(first / weight, second / weight),
        over=partial(edges.over, max(options.tests)),
        seed=seed,
    )
    check_time()
    return None if found is None else space.path(found / weight)
