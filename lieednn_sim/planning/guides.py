"""The guide of a shaped network: a motion that is short, smooth and clear of everything, found quickly.

Candidates are optimised (`guide_optimisation`), and the one with the least measure is the guide. They are the straight
motion, though it touches something, and the paths of a few searches by RRT-Connect with balanced trees (`trees`),
shortened. All work is counted in configurations tested and steps, so a guide depends on no clock and, unless everything
fails, on no optional library.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from operator import itemgetter

import numpy as np

from lieednn_sim.budget import check_time, cpu_time
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.baselines import interpolation, sampling
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions
from lieednn_sim.planning.baselines.search_space import EdgeTest
from lieednn_sim.planning.baselines.trees import connected
from lieednn_sim.planning.guide_optimisation import GuideOptimisation
from lieednn_sim.planning.joint_space import Workspace
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.path_constraints import outside, projected
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.values import Floats

_RRT = RrtConnectOptions()
# Least weight of a joint in the distances of the trees, as a fraction of that of the joint that moves links most.
_LEAST_SWEEP = 0.1


@dataclass(frozen=True)
class GuideOptions(PlannerOptions):
    """Options for the guide's motion, which the planner ``lieednn-shaped`` follows.

    Attributes:
        optimised: whether to optimise candidates; otherwise RRT-Connect's motion is taken if minimum jerk is not free.
        clearance_weight: kappa, the weight of clearance in the measure of `guide_optimisation`: twice the clearance is
            worth 0.7 kappa of the sum of jerk and path length.
        searches: number of paths searched for.
        collision_checks: largest number of configurations tested in a search.
        margin: clearance of paths, reduced where start or target is closer to something [m].
        spacing: largest distance that a link frame moves between configurations tested in a search, about [m].
        longest_edge: longest edge that a tree grows, as a fraction of the joint space's diagonal.
        shortcuts: number of shortcuts tried on a path.
        intervals: number of intervals of the optimised splines.
        instants: number of instants at which distances from obstacles are measured in a step of the optimisation.
        steps: largest number of steps of an optimisation.
        search: options of RRT-Connect, which is asked if no candidate can be followed.
    """

    optimised: bool = True
    clearance_weight: float = 0.15
    searches: int = field(default=2, metadata={"range": (1, 100)})
    collision_checks: int = 20_000
    margin: float = 0.01
    spacing: float = field(default=0.06, metadata={"range": (1e-3, 1.0)})
    longest_edge: float = field(default=0.1, metadata={"range": (1e-3, 1.0)})
    shortcuts: int = 40
    intervals: int = field(default=8, metadata={"range": (2, 1000)})
    instants: int = field(default=96, metadata={"range": (1, 10_000)})
    steps: int = 12
    search: RrtConnectOptions = _RRT


def best_guide(problem: PlanningProblem, options: GuideOptions) -> Plan:
    """The guide's plan, under the name of the planner whose motion it is, with ", optimised" if it was.

    Minimum jerk is the guide at once if it is free of contact: no motion is shorter or smoother. Otherwise it is the
    optimised candidate with the least measure that keeps all limits and the arm's clearance, at last RRT-Connect's
    motion.

    Raises:
        LieEDNNError: RRT-Connect is asked, but OMPL is not installed.
        PlanError: no guide finds a motion; the message has the reason of each.
    """
    begin, refusals = cpu_time(), list[str]()
    for name, solve in _motions(problem, options):
        try:
            return Plan(solve(), target=problem.target, planner=name, cpu_time=cpu_time() - begin)
        except PlanError as error:
            refusals.append(f"{name}: {error}")
    if problem.path_constraint is not None:
        refusals.append("no other way within it was found")
    raise PlanError(f"no guide finds a motion; {'; '.join(refusals)}")


def _motions(problem: PlanningProblem, options: GuideOptions) -> Iterator[tuple[str, Callable[[], Motion]]]:
    """What makes and checks a guide's motion, by the name of its planner, the one to ask first at the beginning."""
    yield "minimum-jerk", partial(_straight, problem)
    if options.optimised or problem.path_constraint is not None:
        search = (_Search if problem.path_constraint is None else _ConstrainedSearch)(problem, options)
        for _, name, motion in sorted(search.optimised(), key=itemgetter(0)):
            yield f"{name}, optimised", motion
    if problem.path_constraint is None:
        yield "rrt-connect", partial(sampling.rrt_connect, problem, options.search)


def _straight(problem: PlanningProblem) -> Motion:
    """The motion by minimum jerk, in the region to keep, if any."""
    if problem.path_constraint is not None:
        some = np.linspace(problem.start, problem.target, 200)
        # A small part of what is allowed; the rest is for the network that follows it.
        if outside(problem.arm, problem.path_constraint, some) > 0.01:
            raise PlanError("the straight motion leaves the region to keep")
    return interpolation.minimum_jerk(problem)


class _Search:
    """Optimised motions of a problem whose straight motion is blocked."""

    def __init__(self, problem: PlanningProblem, options: GuideOptions) -> None:
        self.problem, self.options, arm = problem, options, problem.arm
        self.workspace = Workspace(problem, options.margin)
        self.edges = EdgeTest(arm, self.workspace, options.spacing)
        self.ends = min(map(self.workspace.collisions.clearance, (problem.start, problem.target)))
        self.intervals, self.checks, self.shortcuts = options.intervals, options.collision_checks, options.shortcuts

    def enough(self, cost: float) -> bool:
        """Whether a clear motion of this cost ends the search for more."""
        # The straight motion, which none is below, costs 2.
        return cost <= 1.05 * 2.0

    def onto(self, scale: Floats) -> Callable[[Floats], Floats] | None:
        """What moves points of a tree, in units of ``scale`` ``(n,)``, to where they may be; None for anywhere."""
        return None

    def optimisation(self, *, own: bool) -> GuideOptimisation:
        """With the arm's distances from itself, at twice the instants; without them, at a fraction of the cost."""
        return GuideOptimisation(
            self.problem,
            self.edges.swept / self.edges.scale,
            self.ends,
            weight=self.options.clearance_weight,
            intervals=self.intervals,
            instants=(1 + own) * self.options.instants,
            own=own,
        )

    def optimised(self) -> Iterator[tuple[float, str, Callable[[], Motion]]]:
        """Measure, name, and the function that makes and checks the motion of each candidate that is clear."""
        optimisation = self.optimisation(own=False)
        for name, guess in self.guesses(optimisation):
            measure, free, clear = optimisation.descend(optimisation.near_constraint(guess), self.options.steps)
            if clear:
                yield measure, name, partial(self.motion, optimisation, free)
                if self.enough(optimisation.cost(free)):
                    break

    def motion(self, optimisation: GuideOptimisation, free: Floats) -> Motion:
        """The checked motion; if it is refused, that of a finer optimisation from there."""
        try:
            return in_time(optimisation.motion, self.problem, free)
        except PlanError:
            finer = self.optimisation(own=True)
            return in_time(finer.motion, self.problem, finer.descend(free, self.options.steps)[1])

    def guesses(self, optimisation: GuideOptimisation) -> Iterator[tuple[str, Floats]]:
        """The straight motion, and those near paths that are searched for, each with its planner's name."""
        yield "minimum-jerk", optimisation.straight
        for attempt in range(self.options.searches):
            if (corners := self.path(attempt)) is not None:
                yield "rrt-connect", optimisation.near(corners)

    def path(self, attempt: int) -> Floats | None:
        """Corners ``(M, n)`` of a shortened path; each attempt has a seed and as many tests of its own."""
        options, edges = self.options, self.edges
        weight = np.maximum(edges.swept, _LEAST_SWEEP * edges.swept.max())
        box, scale = weight[:, None] * edges.bounds, edges.scale / weight

        def clear(first: Floats, second: Floats) -> bool:
            return edges.passable(first / weight, second / weight)

        search, shortcuts = np.random.SeedSequence([self.problem.seed, attempt]).spawn(2)
        corners = connected(
            self.problem.start / scale,
            self.problem.target / scale,
            bounds=box,
            longest_edge=options.longest_edge * float(np.linalg.norm(np.ptp(box, axis=1))),
            clear=clear,
            over=partial(edges.over, (attempt + 1) * self.checks),
            seed=search,
            onto=self.onto(scale),
        )
        check_time()
        if corners is None:
            return None
        return scale * shortened(corners, clear, self.shortcuts, np.random.default_rng(shortcuts))


class _ConstrainedSearch(_Search):
    """The same where a region is kept on the way: the first clear motion will do."""

    def __init__(self, problem: PlanningProblem, options: GuideOptions) -> None:
        super().__init__(problem, options)
        # A projection takes as long as five tests. Straight shortcuts would leave the region.
        self.intervals, self.checks, self.shortcuts = 24, self.checks // 5, 0

    def enough(self, cost: float) -> bool:
        """See `_Search`."""
        return True

    def onto(self, scale: Floats) -> Callable[[Floats], Floats]:
        """See `_Search`."""
        arm, path_constraint = self.problem.arm, self.problem.path_constraint
        assert path_constraint is not None
        return lambda point: projected(arm, (scale * point)[None], path_constraint)[0] / scale


def shortened(
    corners: Floats, clear: Callable[[Floats, Floats], bool], attempts: int, rng: np.random.Generator
) -> Floats:
    """A path with corners ``(M, n)`` after attempts to connect two random points of it by a straight edge.

    Args:
        corners: the path.
        clear: returns whether the edge between two clear points is clear.
        attempts: number of pairs of points, drawn evenly along the path.
        rng: generator of the points.
    """
    for _ in range(attempts):
        length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
        at = np.sort(rng.uniform(0.0, length[-1], 2))
        first, second = np.clip(np.searchsorted(length, at, side="right") - 1, 0, len(corners) - 2)
        if first == second:
            continue
        points = np.stack([np.interp(at, length, joint) for joint in corners.T], axis=1)
        if clear(*points):
            corners = np.concatenate([corners[: first + 1], points, corners[second + 1 :]])
    return corners
