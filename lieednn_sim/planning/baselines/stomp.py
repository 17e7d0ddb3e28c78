"""STOMP: stochastic trajectory optimisation, which updates each waypoint by the noise that lowered its cost.

Kalakrishnan, Chitta, Theodorou, Pastor and Schaal, ICRA 2011. A path theta has N waypoints between start and target.
Its second differences are A theta, up to a constant, and R = A' A. Every round draws K paths with smooth noise from
N(0, R^-1). At each waypoint, the noise is averaged with weights proportional to exp(-h S), where S is the cost there,
scaled from 0 for the best of the K to 1 for the worst; it is zero if all costs are equal. The average is smoothed by M,
which is R^-1 with every column scaled to a maximum of 1 / N. No derivative of the cost is needed.

This version differs where the paper leaves a choice, or where a plain round seldom finds a passage:

- The paper's A includes rows at its ends that bring the path to rest. Here the minimum-jerk time law does so: without
  obstacles, the path of least second differences is straight with even spacing, and the motion is minimum jerk.
- A waypoint's cost is the worst lack of clearance on its two edges; otherwise noise could jump over thin obstacles.
- The best noisy path replaces the average if it costs less in total; neither is taken unless it improves the path. The
  noise grows while nothing is better; after a few such rounds the search restarts from the straight path.
- On a clear path, only the paper's second term theta' R theta is left, a sum over the joints. It needs no noise:
  implicit steps multiply a joint's deviation from the straight path by (1 + lambda R)^-1 while the path stays clear.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solve_triangular

from lieednn_sim.budget import check_time
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.joint_space import SPLINE_DEGREE, ProblemClearance, clamped_knots, joint_motion, sweeps
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem, in_time
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.values import Floats

_TESTS_PER_CHECK = 100  # configurations tested between two checks of the time budget


@dataclass(frozen=True)
class StompOptions(PlannerOptions):
    """Options of the planner ``stomp``.

    Their defaults were chosen on problems with seeds from 100 on.

    Attributes:
        margin: clearance of paths, reduced where start or target is closer to something [m].
        spacing: largest distance that a link frame moves between configurations tested, about, from 0.001 to 1 m. If
            the motion is refused, as for a contact in between, the search starts again with half of it.
        waypoints: number of waypoints between start and target, from 4 to 500; enough for a path around an obstacle.
        rollouts: number of noisy paths in a round, the paper's K; more find better paths, in proportionally more time.
        spread: standard deviation of the initial noise in the middle of the path, as a fraction of each joint's range;
            small, for short detours, since it grows while no path is better.
        rounds: largest number of rounds before the planner gives up.
        steps: number of implicit smoothing steps for each joint, which reduce theta' R theta.
    """

    margin: float = 0.01
    spacing: float = field(default=0.1, metadata={"range": (1e-3, 1.0)})
    waypoints: int = field(default=32, metadata={"range": (4, 500)})
    rollouts: int = field(default=6, metadata={"range": (1, 1000)})
    spread: float = 0.1
    rounds: int = 60
    steps: int = 5


def stomp(problem: PlanningProblem, options: StompOptions) -> Motion:
    """The motion along the first clear path, after smoothing; `PlanError` if there is none, or it breaks a limit."""
    rng = np.random.default_rng(problem.seed)
    refusals = [PlanError(f"no path of {options.rounds} rounds is clear; try another seed or target")]
    for spacing in (options.spacing, 0.5 * options.spacing):
        search = StompSearch(problem, options, spacing, rng)
        path = search.clear_path()
        if path is None:
            break
        try:
            return in_time(motion_along, problem, search.smoothed(path))
        except PlanError as error:
            refusals = [error.with_traceback(None)]  # as in `plan`
    raise refusals.pop()


def motion_along(problem: PlanningProblem, path: Floats) -> Motion:
    """The checked motion along a B-spline in the convex hull of ends and waypoints ``(N, n)``, by minimum jerk."""
    points = np.concatenate([problem.start[None], path, problem.target[None]])
    fraction = np.linspace(0.0, 1.0, len(points))
    knots = clamped_knots(len(points))
    # With control points at the means of their knots, an evenly spaced straight path gives a curve of constant speed.
    means = np.lib.stride_tricks.sliding_window_view(knots[1:-1], SPLINE_DEGREE).mean(axis=1)
    curve = BSpline(knots, np.stack([np.interp(means, fraction, joint) for joint in points.T], axis=1), SPLINE_DEGREE)
    t = problem.times()
    u, rate = minimum_jerk_law(t / t[-1])
    return joint_motion(problem, curve(u), curve(u, nu=1) * (rate / t[-1])[:, None], u)


class StompSearch:
    """The search for one problem's path, with configurations tested at a spacing [m] and noise by a generator.

    Attributes:
        metric: R, ``(N, N)``.
        smoother: M, ``(N, N)``.
        straight: ``(N, n)`` waypoints of the straight path, which has the least second differences.
        path: ``(N, n)`` waypoints of the best path since the last restart.
        cost: ``(N,)`` costs of its waypoints.
    """

    def __init__(
        self, problem: PlanningProblem, options: StompOptions, spacing: float, rng: np.random.Generator
    ) -> None:
        self.problem, self.options, self.rng, n = problem, options, rng, options.waypoints
        # The excess of a ball joint is that of its angle, repeated for its three coordinates.
        self._weights = np.ones(problem.arm.n_joints)
        self._weights[problem.arm.space.balls] = 1.0 / 3.0
        self._clear, self._density = ProblemClearance(problem, options.margin), sweeps(problem.arm) / spacing
        differences = np.eye(n, k=-1) - 2.0 * np.eye(n) + np.eye(n, k=1)
        self.metric = differences.T @ differences
        inverse = np.linalg.inv(self.metric)
        self._root, self._deviation = np.linalg.cholesky(self.metric).T, np.sqrt(inverse.diagonal().max())
        self.smoother = inverse / (n * inverse.max(axis=0))
        fraction = np.arange(1, n + 1)[:, None] / (n + 1)
        self.straight = problem.start + fraction * (problem.target - problem.start)
        self.path = self.straight
        self.cost = self.costs(self.path)

    def noise(self, count: int) -> Floats:
        """``count`` samples ``(count, N, n)`` of N(0, R^-1) for each joint, over the largest standard deviation."""
        n, joints = self.straight.shape
        # With R = L L', white noise times L'^-1 has the covariance R^-1.
        drawn = solve_triangular(self._root, self.rng.normal(size=(n, count * joints))) / self._deviation
        return np.asarray(drawn.reshape(n, count, joints).transpose(1, 0, 2))

    def costs(self, path: Floats) -> Floats:
        """Costs ``(N,)``: the worst sum of lacking clearance [m] and limit excess [rad, m] on a waypoint's edges."""
        points = np.concatenate([self.problem.start[None], path, self.problem.target[None]])
        edges = np.diff(points, axis=0)
        counts = np.maximum(np.ceil(np.abs(edges) @ self._density), 1).astype(int)
        first = np.cumsum(counts) - counts
        fraction = (np.arange(counts.sum()) - np.repeat(first, counts) + 1) / np.repeat(counts, counts)
        configurations = np.repeat(points[:-1], counts, axis=0) + fraction[:, None] * np.repeat(edges, counts, axis=0)
        lack = np.empty(len(configurations))
        for begin in range(0, len(configurations), _TESTS_PER_CHECK):
            check_time()
            part = slice(begin, begin + _TESTS_PER_CHECK)
            # Of the coordinates' own limits; what else has a range, `ClearanceTest` counts.
            excess = self.problem.arm.limit_excess(configurations[part])[:, : len(self._weights)]
            lack[part] = self._clear.lack(configurations[part]) + np.maximum(excess, 0.0) @ self._weights
        worst = np.maximum.reduceat(lack, first)
        return np.maximum(worst[:-1], worst[1:])

    def clear_path(self) -> Floats | None:
        """Waypoints ``(N, n)`` of a path of zero cost, or None if all rounds find none."""
        options, spread, stalled = self.options, self.options.spread, 0
        for _ in range(options.rounds):
            if not self.cost.any():
                break
            better = self._round(spread)
            stalled = 0 if better else stalled + 1
            spread = 0.95 * spread if better else min(1.2 * spread, 0.5)
            if stalled == 10:
                self.path, spread, stalled = self.straight, options.spread, 0
                self.cost = self.costs(self.path)
        return None if self.cost.any() else self.path

    def _round(self, spread: float) -> bool:
        """Do a round with noise of this spread; return whether it improved the path."""
        arm = self.problem.arm
        low, high = arm.position_limits.T
        paths = np.clip(self.path + spread * arm.ranges * self.noise(self.options.rollouts), low, high)
        costs = np.array([self.costs(path) for path in paths])
        step = np.einsum("kt,ktj->tj", noise_weights(costs), paths - self.path)
        average = np.clip(self.path + self.smoother @ step, low, high)
        best = int(costs.sum(axis=1).argmin())
        tried = ((average, self.costs(average)), (paths[best], costs[best]))
        result = min(tried, key=lambda pair: float(pair[1].sum()))
        better = bool(result[1].sum() < self.cost.sum())
        if better:
            self.path, self.cost = result
        return better

    def smoothed(self, path: Floats) -> Floats:
        """A clear path ``(N, n)`` after steps that reduce theta' R theta joint by joint, as far as it stays clear."""
        values, vectors = np.linalg.eigh(self.metric)
        # First straight; then lambda in units that halve the lowest mode, raised after a clear step, else reduced.
        damping = np.full(path.shape[1], np.inf)
        for _ in range(self.options.steps):
            for joint in range(path.shape[1]):
                bends = vectors.T @ (path[:, joint] - self.straight[:, joint])
                if not bends.any():
                    continue
                trial = path.copy()
                damped = bends / (1.0 + damping[joint] * values / values[0])
                trial[:, joint] = self.straight[:, joint] + vectors @ damped
                clear = not self.costs(trial).any()
                path = trial if clear else path
                damping[joint] = 1.0 if np.isinf(damping[joint]) else damping[joint] * (2.0 if clear else 0.25)
        return path


def noise_weights(costs: Floats) -> Floats:
    """Weights ``(K, N)`` of K noise samples at each waypoint, from costs ``(K, N)``; zero where all are the same."""
    least, span = costs.min(axis=0), np.ptp(costs, axis=0)
    # With h = 10, as in the paper.
    weights = np.exp(-10.0 * (costs - least) / np.where(span > 0.0, span, 1.0))
    return np.where(span > 0.0, weights / weights.sum(axis=0), 0.0)
