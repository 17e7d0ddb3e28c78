"""STOMP: a path improved by noisy ones, each waypoint by the noise that did well there.

Kalakrishnan, Chitta, Theodorou, Pastor and Schaal, ICRA 2011. A path theta has N waypoints between start and target;
A theta are its second differences, up to a constant, and R = A' A. Every round draws K paths with noise from
N(0, R^-1), which is smooth. At each waypoint the noises are averaged with weights exp(-h S), S the cost there on a
scale from 0, the best of the K, to 1, the worst; where all cost the same nothing is changed. The average is smoothed by
M, which is R^-1 with every column scaled to a maximum of 1 / N. No derivative of the cost is needed.

Ours differs where the paper leaves the way open, or a plain round seldom finds a passage:

- The paper's A ends with the rows that bring the path to rest. Here the law of time does, minimum jerk: without
  obstacles the path of least second differences is straight, run through evenly, and the motion is minimum jerk.
- A waypoint costs what geoms lack of the margin, the worst along its two edges: else noise jumps over what is thin.
- A round's best path as a whole is taken where it costs less than the average, and neither where the path before does.
  The noise grows while nothing is better; after a few such rounds all begins anew, from the straight path.
- A clear path has only the paper's second term left, theta' R theta, a sum over the joints: no noise is needed for
  implicit steps down, (1 + lambda R)^-1 of a joint's deviation from the straight path, as long as the path stays clear.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solve_triangular

from lieednn_sim.budget import check_time
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.baselines.joint_space import SPLINE_DEGREE, Workspace, clamped_knots, joint_motion, sweeps
from lieednn_sim.planning.laws import minimum_jerk_law
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem, in_time
from lieednn_sim.values import Floats

# Postures from one look at the clock to the next.
_POSTURES = 100


@dataclass(frozen=True)
class StompOptions(PlannerOptions):
    """Options of the planner ``stomp``; tuned on seeds from 100 on, which no table uses.

    Attributes:
        margin: what paths keep away from everything, unless start or target are closer to something [m].
        spacing: a link frame moves at most about this far from one posture tested to the next, from 0.001 to 1 m; what
            slips through is found by the dense test of the motion, and with a half of it all begins anew.
        waypoints: between start and target, from 4 to 500: enough for a passage on both sides of an obstacle.
        rollouts: noisy paths in a round, the paper's K; more find better ones, in as many times the time.
        sensitivity: the paper's h, ten there, too.
        spread: standard deviation of the first noise in the middle of the path, in units of each joint's range: small,
            for the least detour; it grows where that does not do.
        grow: factor of the spread after a round without a better path.
        shrink: after one with a better path.
        widest: the spread grows no further.
        stalled: rounds without a better path after which all begins anew.
        rounds: at most.
        steps: down the second term, of each joint.
    """

    margin: float = 0.01
    spacing: float = field(default=0.1, metadata={"range": (1e-3, 1.0)})
    waypoints: int = field(default=32, metadata={"range": (4, 500)})
    rollouts: int = field(default=6, metadata={"range": (1, 1000)})
    sensitivity: float = 10.0
    spread: float = 0.1
    grow: float = field(default=1.2, metadata={"range": (1.0, 10.0)})
    shrink: float = field(default=0.95, metadata={"range": (0.0, 1.0)})
    widest: float = 0.5
    stalled: int = 10
    rounds: int = 60
    steps: int = 5


def stomp(problem: PlanningProblem, options: StompOptions) -> Motion:
    """The motion along the first clear path, smoothed.

    Raises:
        PlanError: no path is clear, or the motion breaks a limit of the arm.
    """
    rng = np.random.default_rng(problem.seed)
    refusal: PlanError | None = None
    for spacing in (options.spacing, 0.5 * options.spacing):
        search = StompSearch(problem, options, spacing, rng)
        path = search.clear_path()
        if path is None:
            break
        try:
            return in_time(motion_along, problem, search.smoothed(path))
        except PlanError as error:
            refusal = error
    raise refusal or PlanError(f"no path of {options.rounds} rounds is clear; try another seed or target")


def motion_along(problem: PlanningProblem, path: Floats) -> Motion:
    """The checked motion along waypoints ``(N, n)``: a B-spline, which stays in their convex hull, by minimum jerk."""
    way = np.concatenate([problem.start[None], path, problem.target[None]])
    share = np.linspace(0.0, 1.0, len(way))
    knots = clamped_knots(len(way))
    # Control points at the means of their knots make a straight way, evenly run through, of a straight way.
    means = np.lib.stride_tricks.sliding_window_view(knots[1:-1], SPLINE_DEGREE).mean(axis=1)
    curve = BSpline(knots, np.stack([np.interp(means, share, joint) for joint in way.T], axis=1), SPLINE_DEGREE)
    t = problem.times()
    u, rate = minimum_jerk_law(t / t[-1])
    return joint_motion(problem, curve(u), curve(u, nu=1) * (rate / t[-1])[:, None], u)


class StompSearch:
    """The search for one problem's path.

    Args:
        problem: where paths begin and end.
        options: of the planner.
        spacing: that paths are tested with, as in the options [m].
        rng: that noise is drawn from.

    Attributes:
        metric: R, ``(N, N)``.
        smoother: M, ``(N, N)``.
        straight: ``(N, n)`` waypoints of the path with the least second differences.
        path: ``(N, n)`` the best path of the present start.
        cost: ``(N,)`` of its waypoints.
    """

    def __init__(
        self, problem: PlanningProblem, options: StompOptions, spacing: float, rng: np.random.Generator
    ) -> None:
        self.problem, self.options, self.rng, n = problem, options, rng, options.waypoints
        self._clear, self._density = Workspace(problem, options.margin).clear, sweeps(problem.arm) / spacing
        differences = np.eye(n, k=-1) - 2.0 * np.eye(n) + np.eye(n, k=1)
        self.metric = differences.T @ differences
        inverse = np.linalg.inv(self.metric)
        self._root, self._deviation = np.linalg.cholesky(self.metric).T, np.sqrt(inverse.diagonal().max())
        self.smoother = inverse / (n * inverse.max(axis=0))
        share = np.arange(1, n + 1)[:, None] / (n + 1)
        self.straight = problem.start + share * (problem.target - problem.start)
        self.path = self.straight
        self.cost = self.costs(self.path)

    def noise(self, count: int) -> Floats:
        """``count`` samples for each joint ``(count, N, n)`` of N(0, R^-1), over its largest standard deviation."""
        n, joints = self.straight.shape
        # With R = L L', L'^-1 of white noise.
        drawn = solve_triangular(self._root, self.rng.normal(size=(n, count * joints))) / self._deviation
        return np.asarray(drawn.reshape(n, count, joints).transpose(1, 0, 2))

    def costs(self, path: Floats) -> Floats:
        """What geoms lack of the margin [m] and joints of their limits [rad, m], worst about each waypoint ``(N,)``."""
        way = np.concatenate([self.problem.start[None], path, self.problem.target[None]])
        edges = np.diff(way, axis=0)
        counts = np.maximum(np.ceil(np.abs(edges) @ self._density), 1).astype(int)
        first = np.cumsum(counts) - counts
        share = (np.arange(counts.sum()) - np.repeat(first, counts) + 1) / np.repeat(counts, counts)
        postures = np.repeat(way[:-1], counts, axis=0) + share[:, None] * np.repeat(edges, counts, axis=0)
        lack = np.empty(len(postures))
        for begin in range(0, len(postures), _POSTURES):
            check_time()
            part = slice(begin, begin + _POSTURES)
            beyond = np.maximum(self.problem.arm.limit_excess(postures[part]), 0.0).sum(axis=1)
            lack[part] = self._clear.lack(postures[part]) + beyond
        worst = np.maximum.reduceat(lack, first)
        return np.maximum(worst[:-1], worst[1:])

    def clear_path(self) -> Floats | None:
        """Waypoints ``(N, n)`` of a path that costs nothing, or None after all rounds."""
        options, spread, stalled = self.options, self.options.spread, 0
        for _ in range(options.rounds):
            if not self.cost.any():
                break
            better = self._round(spread)
            stalled = 0 if better else stalled + 1
            spread = spread * options.shrink if better else min(spread * options.grow, options.widest)
            if stalled == options.stalled:
                self.path, spread, stalled = self.straight, options.spread, 0
                self.cost = self.costs(self.path)
        return None if self.cost.any() else self.path

    def _round(self, spread: float) -> bool:
        """One round with noise of this spread; whether the path is better now."""
        arm = self.problem.arm
        low, high = arm.position_limits.T
        paths = np.clip(self.path + spread * arm.ranges * self.noise(self.options.rollouts), low, high)
        costs = np.array([self.costs(path) for path in paths])
        weights = noise_weights(costs, self.options.sensitivity)
        step = np.einsum("kt,ktj->tj", weights, paths - self.path)
        average = np.clip(self.path + self.smoother @ step, low, high)
        best = int(costs.sum(axis=1).argmin())
        found = min(((average, self.costs(average)), (paths[best], costs[best])), key=lambda one: float(one[1].sum()))
        better = bool(found[1].sum() < self.cost.sum())
        if better:
            self.path, self.cost = found
        return better

    def smoothed(self, path: Floats) -> Floats:
        """A clear path ``(N, n)`` after steps down the second term, joint by joint, none of which costs anything."""
        values, vectors = np.linalg.eigh(self.metric)
        # All the way first; then lambda in units of what halves the slowest bend, more after a step that stays clear.
        damping = np.full(path.shape[1], np.inf)
        for _ in range(self.options.steps):
            for joint in range(path.shape[1]):
                bends = vectors.T @ (path[:, joint] - self.straight[:, joint])
                if not bends.any():
                    continue
                trial = path.copy()
                trial[:, joint] = self.straight[:, joint] + vectors @ (
                    bends / (1.0 + damping[joint] * values / values[0])
                )
                clear = not self.costs(trial).any()
                path = trial if clear else path
                damping[joint] = 1.0 if np.isinf(damping[joint]) else damping[joint] * (2.0 if clear else 0.25)
        return path


def noise_weights(costs: Floats, sensitivity: float) -> Floats:
    """Weights ``(K, N)`` of K noises at each waypoint, from their costs ``(K, N)``; zero where all cost the same."""
    least, span = costs.min(axis=0), np.ptp(costs, axis=0)
    weights = np.exp(-sensitivity * (costs - least) / np.where(span > 0.0, span, 1.0))
    return np.where(span > 0.0, weights / weights.sum(axis=0), 0.0)
