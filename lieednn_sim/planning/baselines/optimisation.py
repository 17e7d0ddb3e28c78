"""Trajectory optimisation: the smoothest spline in time that keeps the limits and a distance from everything.

In the style of CHOMP (Zucker et al., Int. J. Robotics Research 32(9-10), 2013) and TrajOpt (Schulman et al., ibid.
33(9), 2014): smoothness plus hinge losses on signed distances, minimised from several first guesses. Here smoothness
is the integral of the squared jerk, so in free space the result is the minimum-jerk motion. The trajectory is a quintic
B-spline. Since every term is a square, SciPy's Gauss-Newton method in a trust region with bounds minimises them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import least_squares

from lieednn_sim.budget import check_time
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.joint_space import SPLINE_DEGREE, ClearanceTest, ProblemClearance, clamped_knots, joint_motion
from lieednn_sim.planning.motion import Motion, joint_scale
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.values import Floats

# Distance below which a pair's hinge loss grows [m]; the loss is soft, so this is well above what must be kept. And the
# fraction of the velocity and acceleration limits above which theirs grow.
_INFLUENCE, _RATE_FRACTION = 0.04, 0.95
_FIXED = 3  # control points at each end, by its position and zero velocity and acceleration


@dataclass(frozen=True)
class OptimisationOptions(PlannerOptions):
    """Options of the planner ``trajectory-optimisation``.

    Attributes:
        margin: clearance by which first guesses are judged, as far as start and target keep it [m].
        intervals: number of intervals of the spline, from 2 to 1000.
        instants: number of instants at which distances and rates are weighed, up to 10 000.
        weights: weights of the hinge losses against smoothness, one for each descent from a guess.
        evaluations: largest number of evaluations of the cost in a descent.
        guesses: number of first guesses to descend from.
        drawn: number of bent guesses drawn; the clearest are used.
    """

    margin: float = 0.01
    intervals: int = field(default=12, metadata={"range": (2, 1000)})
    instants: int = field(default=100, metadata={"range": (1, 10_000)})
    weights: tuple[float, ...] = (300.0, 3000.0)
    evaluations: int = 20
    guesses: int = 6
    drawn: int = 150


def trajectory_optimisation(problem: PlanningProblem, options: OptimisationOptions) -> Motion:
    """The first of a few locally optimal trajectories that the arm can follow.

    The first guess is minimum jerk, straight in joint space; the others are bent towards random configurations.
    `PlanError` if none keeps the limits and the clearance says why the first one does not.
    """
    descent = _Descent(problem, options)
    refusal = ""
    for x in descent.guesses():
        for weight in options.weights:
            x = descent.minimise(x, weight)
            try:
                return descent.motion(x)
            except PlanError as error:
                refusal = refusal or str(error)
    raise PlanError(f"no local optimum of {options.guesses} first guesses can be followed: {refusal}")


class _Descent:
    """The cost of a problem; the variables are the free control points ``(F, n)`` over the joints' scale, flat."""

    def __init__(self, problem: PlanningProblem, options: OptimisationOptions) -> None:
        self.problem, self.arm, self.options = problem, problem.arm, options
        intervals, count = options.intervals, options.instants
        self.clear, self.scale = ProblemClearance(problem, options.margin), joint_scale(problem.arm)
        self.near = ClearanceTest(problem.arm, _INFLUENCE)
        # The minimum-jerk motion of free space is such a quintic.
        control = intervals + SPLINE_DEGREE
        basis = BSpline(clamped_knots(control), np.eye(control), SPLINE_DEGREE)
        t = problem.times()
        # Denser where the motion is fast, or it would skip thin obstacles.
        fraction = 0.5 * (t / t[-1] + minimum_jerk_law(t / t[-1])[0])
        instants = np.interp((np.arange(count) + 0.5) / count, fraction, t / t[-1])
        # Basis functions and their time derivatives, at the samples and at the instants.
        self.sampled = [basis(t / t[-1], nu=nu) / t[-1] ** nu for nu in (0, 1)]
        self.weighed = [basis(instants, nu=nu) / t[-1] ** nu for nu in (0, 1, 2)]
        # The three-point Gauss rule is exact for the squared jerk, whose degree is 4.
        nodes, weights = np.polynomial.legendre.leggauss(3)
        u = (np.arange(intervals)[:, None] + 0.5 * (nodes + 1.0)).ravel() / intervals
        jerk = basis(u, nu=3) * np.sqrt(np.tile(weights, intervals) / (2 * intervals))[:, None]
        squared = jerk.T @ jerk
        self.inner = slice(_FIXED, -_FIXED)
        start, target = problem.start / self.scale, problem.target / self.scale
        self.ends = np.zeros((control, self.arm.n_joints))
        self.ends[:_FIXED], self.ends[-_FIXED:] = start, target
        free = squared[self.inner, self.inner]
        # The smoothest trajectory with these ends is the quintic polynomial, which is among the splines.
        self.smoothest = -np.linalg.solve(free, squared[self.inner] @ self.ends)
        # A unit displacement has a squared jerk of 720. The unit is its length, at least a tenth of the joint space's.
        spread = self.arm.ranges / self.scale
        unit = max(float(np.linalg.norm(target - start)), 0.1 * float(np.linalg.norm(spread)))
        self.root = np.linalg.cholesky(free).T / (math.sqrt(720.0) * unit)
        # Control points keep this far inside the limits, where start and target do.
        inset = 1e-9 * spread
        low, high = self.arm.position_limits.T / self.scale
        self.low = np.tile(np.minimum(low + inset, np.minimum(start, target)), len(free))
        self.high = np.tile(np.maximum(high - inset, np.maximum(start, target)), len(free))

    def guesses(self) -> Iterator[Floats]:
        """First guesses, flat: the smoothest trajectory, then bent ones, clearest first."""
        yield self.smoothest.ravel()
        rng = np.random.default_rng(self.problem.seed)
        low, high = self.arm.position_limits.T / self.scale
        u = (np.arange(len(self.smoothest)) + 1.0) / (len(self.smoothest) + 1)
        drawn, blocked = [], []
        for _ in range(self.options.drawn):
            # Bent towards a random configuration, at a random instant.
            shape = u ** (2.0 * rng.uniform(0.4, 1.6)) * (1.0 - u) ** (2.0 * rng.uniform(0.4, 1.6))
            peak = int(shape.argmax())
            shift = rng.uniform(low, high) - self.smoothest[peak]
            control = np.clip(self.smoothest + (shape / shape[peak])[:, None] * rng.uniform() * shift, low, high)
            drawn.append(control.ravel())
            check_time()
            positions = self.scale * (self.weighed[0] @ self._control(control))
            blocked.append(sum(not self.clear(q) for q in positions))
        for index in np.argsort(blocked, kind="stable")[: self.options.guesses - 1]:
            yield drawn[index]

    def _control(self, x: Floats) -> Floats:
        """All control points over the joints' scale ``(F + 6, n)``, from the free ones, flat."""
        control = self.ends.copy()
        control[self.inner] = x.reshape(-1, self.arm.n_joints)
        return control

    def minimise(self, x: Floats, weight: float) -> Floats:
        """The local optimum ``(F n,)`` near ``x``."""
        # The solver needs a start strictly inside the bounds.
        edge = 1e-6 * (self.high - self.low)
        solution = least_squares(
            lambda y: self.terms(y, weight)[0],
            np.clip(x, self.low + edge, self.high - edge),
            jac=lambda y: self.terms(y, weight)[1],
            bounds=(self.low, self.high),
            xtol=1e-4,
            ftol=1e-4,
            gtol=1e-6,
            max_nfev=self.options.evaluations,
        )
        return np.asarray(solution.x)

    def terms(self, x: Floats, weight: float) -> tuple[Floats, Floats]:
        """Residuals, whose squares are summed, and their Jacobian ``(terms, F n)``."""
        n, control = self.arm.n_joints, self._control(x)
        smooth = (self.root @ (control[self.inner] - self.smoothest)).ravel()
        values, rows = [smooth], [np.kron(self.root, np.eye(n))]
        factor = math.sqrt(weight / self.options.instants)
        position, velocity, acceleration = (self.scale * (table @ control) for table in self.weighed)
        hinges = (
            self._closeness(position),
            _excess(velocity, _RATE_FRACTION * self.arm.velocity_limits),
            _excess(acceleration, _RATE_FRACTION * self.arm.acceleration_limits),
        )
        for table, (hinge, slope) in zip(self.weighed, hinges, strict=True):
            values.append(factor * hinge)
            of_control = np.einsum("kf,kn->kfn", table[:, self.inner], slope * self.scale)
            rows.append(factor * of_control.reshape(len(table), -1))
        return np.concatenate(values), np.concatenate(rows)

    def motion(self, x: Floats) -> Motion:
        """The checked motion of control points ``(F n,)``."""
        control = self._control(x)
        q, qd = (self.scale * (table @ control) for table in self.sampled)
        t = self.problem.times()
        return joint_motion(self.problem, q, qd, minimum_jerk_law(t / t[-1])[0])

    def _closeness(self, q: Floats) -> tuple[Floats, Floats]:
        """Root of the summed squares of (1 - d / influence)_+ over the pairs ``(K,)``, and its slope ``(K, n)``."""
        value, slope = np.zeros(len(q)), np.zeros(q.shape)
        for k, position in enumerate(q):
            check_time()
            if self.near(position):
                continue
            result = self.clear.collisions.distances(position, _INFLUENCE)
            hinge = 1.0 - result.distance / _INFLUENCE
            value[k] = math.sqrt(hinge @ hinge)
            slope[k] = -(hinge @ result.jacobian) / (_INFLUENCE * max(value[k], 1e-12))
        return value, slope


def _excess(rate: Floats, limit: Floats) -> tuple[Floats, Floats]:
    """Root of the summed squares of (|rate| / limit - 1)_+ over the joints ``(K,)``, and its slope ``(K, n)``."""
    hinge = np.maximum(np.abs(rate) / limit - 1.0, 0.0)
    value = np.linalg.norm(hinge, axis=1)
    return value, hinge * np.sign(rate) / (limit * np.maximum(value, 1e-12)[:, None])
