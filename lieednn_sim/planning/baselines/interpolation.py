"""Planners without network or search: interpolation timed by minimum jerk, and a primitive that imitates it."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BPoly

from lieednn_sim.arm.targets import reference_configuration
from lieednn_sim.learning.demonstrations.models import DECAY
from lieednn_sim.learning.demonstrations.primitives import ALPHA, BETA, forcing, responses
from lieednn_sim.lie import exp, left_jacobian_se3, log
from lieednn_sim.planning.joint_space import joint_motion
from lieednn_sim.planning.motion import Motion, check_motion
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.values import Floats


def minimum_jerk(problem: PlanningProblem, *, guiding: bool = False) -> Motion:
    """A straight line in joint space, q(t) = q_0 + sigma(t/T) (q_1 - q_0), sigma = 10 s^3 - 15 s^4 + 6 s^5.

    The time law is Flash and Hogan's, J. Neuroscience 5(7), 1985. For ``guiding``, and errors, see `joint_motion`.
    """
    _, sigma, rate = _schedule(problem)
    change = problem.target - problem.start
    q, qd = problem.start + sigma[:, None] * change, rate[:, None] * change
    return joint_motion(problem, q, qd, sigma, guiding=guiding)


def se3_geodesic(problem: PlanningProblem) -> Motion:
    """Every compound joint's pose on a geodesic of SE(3): T_i(t) = T_i(0) exp(sigma(t/T) log(T_i(0)^-1 T_i(1))).

    A joint with fewer than six degrees of freedom cannot follow such a geodesic, so it is decoded to the nearest joint
    position. Links that move along one screw turn as far as their joint does. For others the shorter rotation is taken;
    between angles more than pi apart it crosses the logarithm's cut, outside every joint's limits (`PlanError`).
    """
    arm, t, sigma, rate = problem.arm, *_schedule(problem)
    origin, goal = arm.joint_poses(problem.start), arm.joint_poses(problem.target)
    body_twist = log(origin.inv() * goal)
    # Twists of the joint poses in metres; the network's coordinates measure v in length scales.
    twists = log(origin * exp(sigma[:, None, None] * body_twist))
    # T' = T hat(sigma' z) and T = Exp(xi): the body twist is J_r(xi) xi', and J_r(xi) = J_l(-xi).
    twist_rates = np.linalg.solve(left_jacobian_se3(-twists), (rate[:, None, None] * body_twist)[..., None])[..., 0]
    units = arm.twist_units
    for i, joint in enumerate(arm.joints.joints):
        if joint.screw is not None:
            # Here the geodesic is the screw motion itself, of which the logarithm covers only half a turn.
            ends = [arm.joints.twists(q)[i] for q in (problem.start, problem.target)]
            twists[:, i] = ends[0] + sigma[:, None] * (ends[1] - ends[0])
            twist_rates[:, i] = rate[:, None] * (ends[1] - ends[0])
    xi = twists / units
    decoded = arm.decode(xi, twist_rates / units, problem.start)
    gaps = decoded.gap_translation, decoded.gap_rotation
    motion = Motion(t, sigma, xi, arm.encode(problem.target), decoded.q, decoded.qd, *gaps)
    check_motion(arm, motion)
    return motion


def dmp(problem: PlanningProblem) -> Motion:
    """The motion of a primitive from start to target; it imitates minimum jerk from home to `reference_configuration`.

    A critically damped spring to the goal and a learned forcing term that fades (Ijspeert et al., Neural Computation
    25(2), 2013), with the smooth start of Pastor et al., ICRA 2009; in units of the duration,

        q'' = alpha (beta (g - q) - q' - beta (g - q_0) z) + f(z),  z decaying from 1 to 0.01.

    The forcing f is scaled by the joint's displacement over that in the demonstration, which keeps the demonstrated
    shape at every amplitude; an unscaled forcing of a long demonstration would throw a joint with a short displacement
    over its limits. A joint that moves less than a hundredth of its range in the demonstration gets no forcing:
    the spring alone takes it from start to target. All joints follow the same time law in the demonstration, so one
    row of weights, times a joint's displacement, serves them all.

    At the end of the duration 1 % of the phase is left, and about as much of the path. A quintic polynomial, zero at
    the start, removes the remaining errors of position, velocity and acceleration. A primitive knows neither limits nor
    obstacles: `PlanError` if the motion breaks a limit.
    """
    t, sigma, _ = _schedule(problem)
    phase = np.exp(-DECAY * t / t[-1])
    # Fractions of the path, by the spring with its smooth start and by each weight.
    spring = ALPHA * BETA * (1.0 - phase)[:, None]
    fractions = responses(np.hstack([spring, forcing(20, phase)]), problem.timestep / t[-1])
    # Responses to neighbouring functions are similar, so small singular values are not inverted.
    weights = np.linalg.pinv(fractions[:, 1:], rcond=1e-6) @ (sigma - fractions[:, 0])
    shown = reference_configuration(problem.arm) - problem.arm.keyframe("home")
    imitates = np.abs(shown) > 0.01 * problem.arm.ranges
    law = np.where(imitates, (fractions @ np.append(1.0, weights))[:, None], fractions[:, :1])
    q = problem.start + law * (problem.target - problem.start)
    qd = np.gradient(q, problem.timestep, axis=0, edge_order=2)
    rest = np.zeros((3, len(shown)))
    left = np.stack([problem.target - q[-1], -qd[-1], -(qd[-1] - qd[-2]) / problem.timestep])
    correction = BPoly.from_derivatives([0.0, t[-1]], [rest, left])
    return joint_motion(problem, q + correction(t), qd + correction(t, nu=1), sigma)


def _schedule(problem: PlanningProblem) -> tuple[Floats, Floats, Floats]:
    """Times ``(K,)`` [s], path parameter sigma ``(K,)`` and its rate ``(K,)`` [1/s]."""
    t = problem.times()
    sigma, slope = minimum_jerk_law(t / t[-1])
    return t, sigma, slope / t[-1]
