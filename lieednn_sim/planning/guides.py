"""The guide of a shaped network: a motion that is short, smooth and clear of everything, found quickly.

Candidates are optimised (`guide_optimisation`), and the one with the least measure is the guide. The candidates are the
straight motion, even if it touches something, and the shortened paths of a few searches by RRT-Connect with balanced
trees (`trees`). All work is limited by numbers of tested configurations and of steps, so that a guide depends on no
clock and, unless everything fails, on no optional library.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter

import numpy as np

from lieednn_sim.budget import check_time, cpu_time
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.baselines import interpolation, sampling
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions
from lieednn_sim.planning.baselines.search_space import EdgeTest
from lieednn_sim.planning.baselines.smoothing import slow_motion
from lieednn_sim.planning.baselines.trees import connected
from lieednn_sim.planning.guide_optimisation import GuideOptimisation
from lieednn_sim.planning.joint_space import ProblemClearance
from lieednn_sim.planning.motion import Motion, travelled
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.path_constraints import outside, projected
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.values import Floats


@dataclass(frozen=True)
class GuideOptions(PlannerOptions):
    """Options for the guide's motion, which the planner ``lieednn-shaped`` follows.

    Attributes:
        optimised: whether to optimise candidates; else the guide is RRT-Connect's motion if minimum jerk is not free.
        clearance_weight: kappa, the weight of clearance in the measure of `guide_optimisation`: doubling the clearance
            is worth a fraction 0.7 kappa of the sum of jerk and path length, and more where it is a few millimetres.
        searches: number of paths searched for.
        collision_checks: largest number of configurations tested in a search.
        margin: clearance of the searched paths, reduced where start or target is closer to something [m].
        spacing: about the largest distance that a link frame moves between configurations tested in a search [m].
        longest_edge: longest edge that a tree grows, as a fraction of the joint space's diagonal.
        shortcuts: number of shortcuts tried on a path.
        intervals: number of intervals of the optimised splines.
        instants: number of instants at which distances from obstacles are measured in a step of the optimisation.
        steps: largest number of steps of an optimisation.
        search: options of RRT-Connect, which is run if no candidate can be followed.
    """

    optimised: bool = True
    clearance_weight: float = 0.5
    searches: int = field(default=2, metadata={"range": (1, 100)})
    collision_checks: int = 20_000
    margin: float = 0.01
    spacing: float = field(default=0.15, metadata={"range": (1e-3, 1.0)})
    longest_edge: float = field(default=0.1, metadata={"range": (1e-3, 1.0)})
    shortcuts: int = 20
    intervals: int = field(default=8, metadata={"range": (2, 1000)})
    instants: int = field(default=96, metadata={"range": (1, 10_000)})
    steps: int = 24
    search: RrtConnectOptions = field(default=RrtConnectOptions())


def followed(problem: PlanningProblem, options: GuideOptions, follow: Callable[[Plan], Plan], seeds: int = 1) -> Plan:
    """The plan that follows the first guide that can be followed.

    A guide's plan has the name of the planner that found it, with ", optimised" appended if it was. Minimum jerk comes
    first: no motion is shorter or smoother. Then come the optimised candidates, those with the least measure first, and
    at last RRT-Connect's motion. All of them keep the limits, but are tested for contact at some samples only. Where
    the fastest motion is sought (`SmoothingOptions.fastest`), slow motions along RRT-Connect's curves come before it.

    Args:
        problem, options: the problem, and how guides are found.
        follow: makes a checked plan that follows a guide, or raises `PlanError`.
        seeds: largest number of seeds to look for guides with, as long as none of those found can be followed.

    Raises:
        LieEDNNError: RRT-Connect is run, but OMPL is not installed.
        PlanError: no guide finds a motion that can be followed; the message has the reason of each.
    """
    begin = cpu_time()
    for attempt in range(seeds):
        refusals, others = list[str](), False
        for name, solve in _motions(replace(problem, seed=problem.seed + attempt) if attempt else problem, options):
            try:
                guide = Plan(solve(), target=problem.target, planner=name, cpu_time=cpu_time() - begin)
                # Minimum jerk is the same for all seeds.
                others |= name != "minimum-jerk"
                return follow(guide)
            except PlanError as error:
                refusals.append(f"{name}: {error}")
        if not others:
            break
    if problem.path_constraint is not None:
        refusals.append("no other way within it was found")
    raise PlanError(f"no guide finds a motion that a network follows; {'; '.join(refusals)}")


def _motions(problem: PlanningProblem, options: GuideOptions) -> Iterator[tuple[str, Callable[[], Motion]]]:
    """Names of planners, each with a function that makes a guide's motion, in the order in which they are tried."""
    yield "minimum-jerk", partial(_straight, problem)
    if options.optimised or problem.path_constraint is not None:
        search = _Search(problem, options)
        for _, name, optimisation, guess in sorted(search.optimised(), key=itemgetter(0)):
            free = guess if search.constrained else optimisation.descend(guess, options.steps)[1]
            yield f"{name}, optimised", partial(in_time, optimisation.motion, problem, free)
            # If the result touches something, a finer optimisation that starts from it can still keep clear.
            yield f"{name}, optimised", partial(search.finer, free)
    if problem.path_constraint is None:
        rrt, path = options.search, partial(sampling.paths, problem, options.search, "rrt-connect")
        for corners in map(path(), range(len(rrt.spacings))) if rrt.fastest else ():
            if corners is None:
                break
            for count in rrt.control_points:
                yield "rrt-connect", partial(slow_motion, problem, corners, count, rrt.bend)
        yield "rrt-connect", partial(sampling.rrt_connect, problem, rrt)


def _straight(problem: PlanningProblem) -> Motion:
    """The motion by minimum jerk, in the region to keep, if any."""
    if problem.path_constraint is not None:
        some = np.linspace(problem.start, problem.target, 200)
        # The straight motion may use a small part of the tolerance; the rest is for the network that follows it.
        if outside(problem.arm, problem.path_constraint, some) > 0.01:
            raise PlanError("the straight motion leaves the region to keep")
    return in_time(partial(interpolation.minimum_jerk, guiding=True), problem)


class _Search:
    """Optimised motions of a problem whose straight motion is blocked."""

    def __init__(self, problem: PlanningProblem, options: GuideOptions) -> None:
        self.problem, self.options, self.constrained = problem, options, problem.path_constraint is not None
        clear = ProblemClearance(problem, options.margin)
        self.edges, self.ends = EdgeTest(problem.arm, clear, options.spacing), min(clear.distances)

    def optimisation(self, *, own: bool) -> GuideOptimisation:
        """An optimisation; with the arm's ``own`` distances it has twice the instants and costs many times as much."""
        return GuideOptimisation(
            self.problem,
            self.edges.swept / self.edges.scale,
            self.ends,
            weight=self.options.clearance_weight,
            intervals=24 if self.constrained else self.options.intervals,
            instants=(1 + own) * self.options.instants,
            own=own,
        )

    def optimised(self) -> Iterator[tuple[float, str, GuideOptimisation, Floats]]:
        """Measure, name, optimisation and control points of each candidate that is clear."""
        optimisation = self.optimisation(own=False)
        for name, guess in self.guesses(optimisation):
            guess = optimisation.near_constraint(guess)
            # A rough descent suffices to find out which candidate is best.
            measure, free, clear = optimisation.descend(guess, self.options.steps, rough=not self.constrained)
            if clear:
                yield measure, name, optimisation, free
                # No motion costs less than 2, as the straight one does. If a region is kept, any clear motion will do.
                if self.constrained or optimisation.cost(free) <= 1.15 * 2.0:
                    break

    def finer(self, free: Floats) -> Motion:
        """The motion of an optimisation from ``free`` on, at more instants and with the arm's distances from itself."""
        optimisation = self.optimisation(own=True)
        return in_time(optimisation.motion, self.problem, optimisation.descend(free, self.options.steps)[1])

    def guesses(self, optimisation: GuideOptimisation) -> Iterator[tuple[str, Floats]]:
        """The straight motion, and motions near the paths of searches, each with its planner's name."""
        yield "minimum-jerk", optimisation.straight
        for attempt in range(self.options.searches):
            if (corners := self.path(attempt)) is not None:
                yield "rrt-connect", optimisation.near(corners)

    def path(self, attempt: int) -> Floats | None:
        """Corners ``(M, n)`` of a shortened path, or None; each attempt has its own seed and number of tests."""
        problem, options, edges = self.problem, self.options, self.edges
        region, weight, checks = problem.path_constraint, edges.weight, options.collision_checks
        box, scale, clear = weight[:, None] * edges.bounds, edges.scale / weight, edges.weighted()
        search, shortcuts = np.random.SeedSequence([problem.seed, attempt]).spawn(2)
        corners = connected(
            problem.start / scale,
            problem.target / scale,
            bounds=box,
            longest_edge=options.longest_edge * float(np.linalg.norm(np.ptp(box, axis=1))),
            clear=clear,
            # With a region, each test includes a projection, which takes as long as five tests.
            over=partial(edges.over, (attempt + 1) * (checks if region is None else checks // 5)),
            seed=search,
            onto=None if region is None else lambda at: projected(problem.arm, (scale * at)[None], region)[0] / scale,
        )
        check_time()
        # Straight shortcuts would leave the region.
        if corners is not None and region is None:
            corners = shortened(corners, clear, options.shortcuts, np.random.default_rng(shortcuts))
        return None if corners is None else scale * corners


def shortened(
    corners: Floats, clear: Callable[[Floats, Floats], bool], attempts: int, rng: np.random.Generator
) -> Floats:
    """Shorten a path with corners ``(M, n)`` by attempts to connect two random points of it by a straight edge.

    The points are drawn evenly along the path; ``clear`` returns whether the edge between two clear points is clear.
    """
    for _ in range(attempts):
        length = travelled(corners)
        at = np.sort(rng.uniform(0.0, length[-1], 2))
        first, second = np.clip(np.searchsorted(length, at, side="right") - 1, 0, len(corners) - 2)
        if first == second:
            continue
        points = np.stack([np.interp(at, length, joint) for joint in corners.T], axis=1)
        if clear(*points):
            corners = np.concatenate([corners[: first + 1], points, corners[second + 1 :]])
    return corners
