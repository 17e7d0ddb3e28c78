"""Optimising a motion: from any first guess to the nearest local optimum of jerk, path length and clearance.

A motion is a quintic B-spline in time with control points C, from rest to rest. J is its squared jerk, and E a bound on
its squared length: the integral of |q'|^2 / s' over the fraction u of the duration, with s(u) the minimum-jerk law.
With joints in units of their ranges, and J and E in units of the straight minimum-jerk motion, this motion has J = E =
1, the least of all. Both are quadratic in C. With the end effector's squared jerk F, in units of a straight metre by
minimum jerk, and the least distance d from everything on the way, the measure is

    log(J + E) + beta log(F) - kappa (log(d) - d_0 / d),

where d counts up to 80 mm and to its value at start and target, which no motion exceeds. The measure is minimised by
sequential quadratic programming: at every step MuJoCo's contacts give the distances of all pairs and their gradients, a
quadratic program in C and d is solved within a trust region, with a Gauss-Newton model of F, and steps that lower the
measure are kept.

In a rough descent beta is 0, and 0.3 of kappa counts; so it is if the end effector is to stay in a region. Then d_0 is
0, too, the program also has the region's linearised bounds at a few instants, and the measure a penalty for leaving the
region. The final motion's samples are projected onto it.
"""

from __future__ import annotations

import math

import daqp
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline

from lieednn_sim.arm.contact_slopes import ContactSlopes
from lieednn_sim.budget import check_time
from lieednn_sim.planning.joint_space import SPLINE_DEGREE, clamped_knots, joint_motion
from lieednn_sim.planning.motion import Motion, travelled
from lieednn_sim.planning.path_constraints import check_path_constraint, excess_and_slopes, projected
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.values import Floats

_TOUCHING = 2.5e-3  # clearance [m] below which its term is continued by a steep line, so that contact is left first
_NEAR = 0.005  # d_0 [m]: at this clearance, gains in clearance count twice as much as far away
_EFFECTOR = 0.5  # beta, the weight of the end effector's jerk
_ALONE = 0.3  # the part of kappa that counts where F does not
_AMPLE = 0.08  # largest clearance that counts [m]; more would cost jerk
_SHORT = 0.05  # path length of the end effector [m] whose jerk is added to F, so that shorter ways count little
# Largest number of bounds on distances that are broken where a step begins: the solver activates all of them, which
# takes cubic time. If more are broken, as when whole links are inside obstacles, only the deepest count.
_DEEPEST = 600

# Instants ``(C,)`` of near pairs, their distances [m], and slopes ``(C, n)`` of these in units of the ranges.
_Near = tuple[NDArray[np.int_], Floats, Floats]
# F, and half its gradient and half its Gauss-Newton Hessian in the free points; None where F does not count.
_Effector = tuple[float, Floats, Floats] | None


class GuideOptimisation:
    """The optimisation for one problem; guesses and results are free control points ``(F, n)`` in units of the ranges.

    Args:
        problem: start and target.
        sweep: ``(n,)`` largest distance that a unit of each joint moves a link frame (`joint_space.sweeps`).
        ends: least distance of start and target from everything [m]; more clearance than that does not count.
        weight: kappa, the weight of clearance.
        intervals: number of intervals of the spline.
        instants: number of instants at which distances are measured.
        own: whether the arm's distances from itself count; without them a step takes a fraction of the time.

    Attributes:
        straight: ``(F, n)`` the minimum-jerk motion.
    """

    def __init__(
        self,
        problem: PlanningProblem,
        sweep: Floats,
        ends: float,
        *,
        weight: float,
        intervals: int,
        instants: int,
        own: bool = False,
    ) -> None:
        arm = problem.arm
        self._problem, self._scale, self._weight = problem, arm.ranges, weight
        self._near = _NEAR if problem.path_constraint is None else 0.0
        # A reserve of a tenth, since distances between the instants may be less.
        self._enough = max(min(1.1 * ends, _AMPLE), _TOUCHING)
        # A step may bring a pair nearer by 3 cm.
        self._slopes = ContactSlopes(arm, self._enough + 0.03, own=own)
        count = intervals + SPLINE_DEGREE
        self._basis = BSpline(clamped_knots(count), np.eye(count), SPLINE_DEGREE)
        u = np.linspace(0.0, 1.0, 1001)
        # Spaced mostly evenly along the path, and a little in time.
        spacing = 0.3 * u + 0.7 * minimum_jerk_law(u)[0]
        self._rows = self._basis(np.interp((np.arange(instants) + 0.5) / instants, spacing, u))
        # Three control points at each end are fixed by its position and zero velocity and acceleration.
        self._free = slice(3, -3)
        # As many instants as free control points, so that these can keep all bounds there.
        self._kept_rows = self._basis(np.arange(1.0, count - 5.0) / (count - 5.0))
        start, target = problem.start / arm.ranges, problem.target / arm.ranges
        self._ends = np.zeros((count, arm.n_joints))
        self._ends[:3], self._ends[-3:] = start, target
        # The three-point Gauss rule is exact for the squared jerk, whose degree is 4.
        nodes, weights = np.polynomial.legendre.leggauss(3)
        u = (np.arange(intervals)[:, None] + 0.5 * (nodes + 1.0)).ravel() / intervals
        rate, jerk = (self._basis(u, nu=nu) for nu in (1, 3))
        share = np.tile(weights, intervals)[:, None] / (2 * intervals)
        # F is computed, within 2 %, from the spline through the effector's positions at these times. Finite differences
        # of the positions would be a third of it: a descent exploits that they ignore what is between them.
        even = np.linspace(0.0, 1.0, 3 * intervals + 1)
        self._even_rows = self._basis(even)
        self._thirds = make_interp_spline(even, np.eye(len(even)), SPLINE_DEGREE)(u, nu=3) * np.sqrt(share / 720.0)
        # The bound on the length is divided by the speed, which is zero at rest.
        speed = np.maximum(minimum_jerk_law(u)[1], 0.02)[:, None]
        # A unit displacement has a squared jerk of 720. The unit is the straight way, at least 0.1 of the joint space.
        unit = max(float(np.linalg.norm(target - start)), 0.1 * math.sqrt(arm.n_joints))
        self._quadratic = (jerk.T @ (jerk * share) / 720.0 + rate.T @ (rate * share / speed)) / unit**2
        self._hessian = self._quadratic[self._free, self._free]
        # The Hessian for all joints, one after another, and one more variable, the clearance.
        self._program = np.pad(np.kron(np.eye(arm.n_joints), self._hessian), (0, 1))
        self.straight = -np.linalg.solve(self._hessian, self._quadratic[self._free] @ self._ends)
        low, high = (arm.position_limits / arm.ranges[:, None]).T
        # Bounds are a little inside the limits, if start and target are.
        self._low = np.minimum(low + 0.005, np.minimum(start, target))
        self._high = np.maximum(high - 0.005, np.maximum(start, target))
        # A joint whose axis goes through the origin of the last frame moves no frame; only its limits bound its steps.
        self._sweep = np.maximum(sweep * arm.ranges, 1e-9)

    def near(self, corners: Floats) -> Floats:
        """The slightly smoothed spline near a polyline ``(M, n)`` that is followed by the minimum-jerk law."""
        points = corners / self._scale
        length = travelled(points)
        u = np.linspace(0.0, 1.0, 200)[1:-1]
        fraction = minimum_jerk_law(u)[0]
        target = np.stack([np.interp(fraction, length / length[-1], joint) for joint in points.T], axis=1)
        basis = self._basis(u)
        left, free = target - basis @ self._ends, basis[:, self._free]
        smooth = 1e-4 * len(u) / self._hessian.diagonal().mean() * self._hessian
        return np.asarray(np.linalg.solve(free.T @ free + smooth, free.T @ left))

    def near_constraint(self, free: Floats) -> Floats:
        """The spline through projections of a motion's positions onto the region to keep; ``free`` without a region."""
        if (region := self._problem.path_constraint) is None:
            return free
        q = projected(self._problem.arm, self._scale * (self._kept_rows @ self._control(free)), region)
        left = q / self._scale - self._kept_rows @ self._ends
        return np.asarray(np.linalg.solve(self._kept_rows[:, self._free], left))

    def cost(self, free: Floats) -> float:
        """J + E."""
        control = self._control(free)
        return float(np.sum(control * (self._quadratic @ control)))

    def measure(self, free: Floats, clearance: float, effector: _Effector) -> float:
        """The measure of a motion with this clearance [m] and F."""
        far = min(max(clearance, _TOUCHING), self._enough)
        away = math.log(far) - self._near / far
        away -= (1.0 + self._near / _TOUCHING) * max(1.0 - clearance / _TOUCHING, 0.0) / 0.6
        smooth = math.log(self.cost(free)) + (_EFFECTOR * math.log(effector[0]) if effector else 0.0)
        return smooth - self._weight_beside(effector) * away + 30.0 * self._beyond(free)

    def _weight_beside(self, effector: _Effector) -> float:
        """Kappa, or a part of it beside J and E alone, without F."""
        return self._weight if effector else _ALONE * self._weight

    def descend(self, free: Floats, steps: int, *, rough: bool = False) -> tuple[float, Floats, bool]:
        """The measure, the control points, and whether these are usable, after up to so many steps from a guess."""
        kept = self._problem.path_constraint is not None
        # A rough descent uses a third of the instants, and no F. Large steps would leave a region that is kept.
        every, enough, wider = (1, 1e-3, 1.5) if kept else (3, 0.02, 2.0) if rough else (1, 2e-3, 2.0)
        jerk_of = self._effector_jerk if not (rough or kept) else lambda _: None
        distances, jerk = self._distances(free, every), jerk_of(free)
        # The trust region is the largest distance that a joint may move a link [m].
        clearance, trust = distances[1].min(initial=self._enough), 0.1
        measure = self.measure(free, clearance, jerk)
        for _ in range(steps):
            check_time()
            new, gain = self._step(free, distances, jerk, clearance, trust)
            if gain < enough and clearance >= _TOUCHING and not kept:
                break
            ahead, smooth = self._distances(new, every), jerk_of(new)
            near = ahead[1].min(initial=self._enough)
            lower = self.measure(new, near, smooth)
            if lower < measure:
                gain = measure - lower
                free, distances, jerk, clearance, measure = new, ahead, smooth, near, lower
                if gain < enough:
                    break
                trust *= wider
            else:
                # A step inside the trust region would be found again, unless the region becomes smaller than the step.
                trust = 0.4 * min(trust, float((np.abs(new - free) * self._sweep).max()))
                if trust < 5e-3:
                    break
        # If the motion leaves the region by less than 0.01 on average [m, rad], its projection is near it.
        return measure, free, clearance >= _TOUCHING and self._beyond(free) < 0.01

    def motion(self, problem: PlanningProblem, free: Floats) -> Motion:
        """The roughly checked motion, in the problem's duration.

        Raises:
            PlanError: it breaks a limit, or touches something at some samples.
        """
        t, control = problem.times(), self._control(free)
        u = t / t[-1]
        q, qd = (self._scale * (self._basis(u, nu=nu) @ control) for nu in (0, 1))
        progress = minimum_jerk_law(u)[0]
        if problem.path_constraint is not None:
            q = projected(problem.arm, q, problem.path_constraint)
            # The projection may move the ends by the accuracy of inverse kinematics; they are put back.
            q += np.outer(1.0 - progress, problem.start - q[0]) + np.outer(progress, problem.target - q[-1])
            qd = CubicSpline(t, q, bc_type="clamped")(t, 1) * t[-1]
        motion = joint_motion(problem, q, qd / t[-1], progress, guiding=True)
        check_path_constraint(problem.arm, problem.path_constraint, motion)
        return motion

    def _beyond(self, free: Floats) -> float:
        """Mean over the instants of the excess over the region that is kept [m, rad]."""
        return 0.0 if self._problem.path_constraint is None else float(np.abs(self._kept(free)[0]).sum(axis=1).mean())

    def _kept(self, free: Floats) -> tuple[Floats, Floats]:
        """Excess ``(I, 6)`` over the region that is kept, and slopes ``(I, 6, n)`` in units of the ranges."""
        assert self._problem.path_constraint is not None
        q = self._scale * (self._kept_rows @ self._control(free))
        excess, slopes = excess_and_slopes(self._problem.arm, q, self._problem.path_constraint)
        return excess, slopes * self._scale

    def _control(self, free: Floats) -> Floats:
        """All control points ``(F + 6, n)``."""
        control = self._ends.copy()
        control[self._free] = free
        return control

    def _effector_jerk(self, free: Floats) -> tuple[float, Floats, Floats]:
        """F, half its gradient and half its Gauss-Newton Hessian in the free points, one joint after another."""
        q, h = self._scale * (self._even_rows @ self._control(free)), 1e-5
        # The tip's positions at the instants, and with each joint moved by a little of its range.
        tip = self._problem.arm.tip(q[:, None] + h * np.pad(np.diag(self._scale), ((1, 0), (0, 0))))
        slope = (tip[:, 1:] - tip[:, :1])[..., None] / h * self._even_rows[:, None, None, self._free]
        jerk = (self._thirds @ tip[:, 0]).ravel()
        slope = (self._thirds @ slope.swapaxes(1, 2).reshape(len(q), -1)).reshape(jerk.size, free.size)
        return _SHORT**2 + float(jerk @ jerk), jerk @ slope, slope.T @ slope

    def _distances(self, free: Floats, every: int = 1) -> _Near:
        instant, distance, slope = self._slopes.along(self._scale * (self._rows[::every] @ self._control(free)))
        return every * instant, distance, slope * self._scale

    def _step(self, free: Floats, near: _Near, jerk: _Effector, clearance: float, trust: float) -> tuple[Floats, float]:
        """The control points after the quadratic program's step in the trust region, and the gain that it expects."""
        n, count = free.shape[1], len(free)
        radius = trust / self._sweep
        instant, distance, slope = near
        # The last variable y is the relative change of the clearance: -log(1 + y) is about y^2 / 2 - y.
        known = min(max(clearance, _TOUCHING), self._enough)
        most = min(1.0, self._enough / known - 1.0)
        reached = distance - known * (1.0 + most) < np.abs(slope) @ radius
        if len(distance) > _DEEPEST:
            reached &= (distance >= known) | (distance < np.partition(distance, _DEEPEST)[_DEEPEST])
        instant, distance, slope = instant[reached], distance[reached], slope[reached]
        x = free.T.ravel()
        cost, near_by = self.cost(free), self._near / known
        value, hessian = self._weight_beside(jerk) * cost / 2.0, self._program.copy()
        hessian[-1, -1] = (1.0 + 2.0 * near_by) * value
        pull = (self._quadratic[self._free] @ self._control(free)).T.ravel()
        if jerk is not None:
            share = _EFFECTOR * cost / jerk[0]
            hessian[:-1, :-1] += share * jerk[2]
            pull += share * jerk[1]
        rows = np.empty((len(instant), n * count + 1))
        each = slope[:, :, None] * self._rows[instant][:, None, self._free]
        rows[:, :-1] = each.reshape(len(instant), n * count)
        rows[:, -1] = -known
        reach = np.repeat(radius, count)
        low = np.minimum(np.maximum(np.repeat(self._low, count) - x, -reach), 0.0)
        high = np.maximum(np.minimum(np.repeat(self._high, count) - x, reach), 0.0)
        upper = np.concatenate([high, [most], np.full(len(instant), 1e30)])
        lower = np.concatenate([low, [-0.5 if known > _TOUCHING else 0.0], known - distance])
        if self._problem.path_constraint is not None:
            excess, slope = self._kept(free)
            instant, bound = np.nonzero(slope.any(axis=2))
            each = slope[instant, bound][:, :, None] * self._kept_rows[instant][:, None, self._free]
            kept = np.zeros((len(instant), n * count + 1))
            kept[:, :-1] = each.reshape(len(instant), n * count)
            rows = np.concatenate([rows, kept])
            upper, lower = (np.concatenate([side, -excess[instant, bound]]) for side in (upper, lower))
        sense = np.zeros(len(upper), dtype=np.int32)
        # DAQP marks soft constraints by 8.
        sense[n * count + 1 :] = 8
        linear = np.append(pull, -(1.0 + near_by) * value)
        change, least, *_ = daqp.solve(hessian, linear, rows, upper, lower, sense, rho_soft=1e-6)
        return free + np.asarray(change)[:-1].reshape(n, count).T, -2.0 * least / cost
