"""Planners without a network: interpolation from start to target, timed by minimum jerk."""

from __future__ import annotations

import numpy as np

from lieednn_sim.lie import exp, left_jacobian_se3, log
from lieednn_sim.planning.joint_space import joint_motion
from lieednn_sim.planning.motion import Motion, check_motion
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.values import Floats


def minimum_jerk(problem: PlanningProblem) -> Motion:
    """A straight line in joint space, q(t) = q_0 + sigma(t/T) (q_1 - q_0), sigma = 10 s^3 - 15 s^4 + 6 s^5.

    The time law is Flash and Hogan's, J. Neuroscience 5(7), 1985. The poses are those of the joints, so there is no
    mechanism gap.

    Raises:
        PlanError: the motion breaks a limit of the arm.
    """
    _, sigma, rate = _schedule(problem)
    change = problem.target - problem.start
    return joint_motion(problem, problem.start + sigma[:, None] * change, rate[:, None] * change, sigma)


def se3_geodesic(problem: PlanningProblem) -> Motion:
    """Every compound joint's pose on a geodesic of SE(3): T_i(t) = T_i(0) exp(sigma(t/T) log(T_i(0)^-1 T_i(1))).

    A joint with fewer than six degrees of freedom cannot follow such a geodesic, so it is decoded to the nearest joint
    position. Links that move along one screw turn as far as their joint does. For others the shorter rotation is taken;
    between angles more than pi apart it crosses the logarithm's cut, outside every joint's limits.

    Raises:
        PlanError: the motion breaks a limit of the arm.
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


def _schedule(problem: PlanningProblem) -> tuple[Floats, Floats, Floats]:
    """Times ``(K,)`` [s], path parameter sigma ``(K,)`` and its rate ``(K,)`` [1/s]."""
    t = problem.times()
    sigma, slope = minimum_jerk_law(t / t[-1])
    return t, sigma, slope / t[-1]
