"""A dynamic movement primitive in joint space, learned from one demonstration."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BPoly

from lieednn_sim.arm.targets import reference_configuration
from lieednn_sim.learning.demonstrations.models import DECAY
from lieednn_sim.learning.demonstrations.primitives import ALPHA, BETA, forcing, responses
from lieednn_sim.planning.joint_space import joint_motion
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.planning.time_laws import minimum_jerk_law


@dataclass(frozen=True)
class DmpOptions(PlannerOptions):
    """Options of the planner ``dmp``.

    Attributes:
        basis_functions: number of radial basis functions of the forcing term, from 2 to 1000.
        least_fraction: fraction of its range that a joint must move in the demonstration to be imitated in shape.
    """

    basis_functions: int = field(default=20, metadata={"range": (2, 1000)})
    least_fraction: float = 0.01


def dmp(problem: PlanningProblem, options: DmpOptions) -> Motion:
    """The motion of a primitive from start to target; it imitates minimum jerk from home to `reference_configuration`.

    A critically damped spring to the goal and a learned forcing term that fades (Ijspeert et al., Neural Computation
    25(2), 2013), with the smooth start of Pastor et al., ICRA 2009; in units of the duration,

        q'' = alpha (beta (g - q) - q' - beta (g - q_0) z) + f(z),  z decaying from 1 to 0.01.

    The forcing f is scaled by the joint's displacement over that in the demonstration, which keeps the demonstrated
    shape at every amplitude; an unscaled forcing of a long demonstration would throw a joint with a short displacement
    over its limits. A joint that moves less than ``least_fraction`` of its range in the demonstration gets no forcing:
    the spring alone takes it from start to target. All joints follow the same time law in the demonstration, so one
    row of weights, times a joint's displacement, serves them all.

    At the end of the duration 1 % of the phase is left, and about as much of the path. A quintic polynomial, zero at
    the start, removes the remaining errors of position, velocity and acceleration.

    Raises:
        PlanError: the motion breaks a limit of the arm; a primitive knows neither limits nor obstacles.
    """
    t = problem.times()
    sigma, _ = minimum_jerk_law(t / t[-1])
    phase = np.exp(-DECAY * t / t[-1])
    # Fractions of the path, by the spring with its smooth start and by each weight.
    spring = ALPHA * BETA * (1.0 - phase)[:, None]
    fractions = responses(np.hstack([spring, forcing(options.basis_functions, phase)]), problem.timestep / t[-1])
    # Relative size below which singular values are not inverted: responses to neighbouring functions are similar.
    least_response = 1e-6
    weights = np.linalg.pinv(fractions[:, 1:], rcond=least_response) @ (sigma - fractions[:, 0])
    shown = reference_configuration(problem.arm) - problem.arm.keyframe("home")
    imitates = np.abs(shown) > options.least_fraction * problem.arm.ranges
    law = np.where(imitates, (fractions @ np.append(1.0, weights))[:, None], fractions[:, :1])
    q = problem.start + law * (problem.target - problem.start)
    qd = np.gradient(q, problem.timestep, axis=0, edge_order=2)
    rest = np.zeros((3, len(shown)))
    left = np.stack([problem.target - q[-1], -qd[-1], -(qd[-1] - qd[-2]) / problem.timestep])
    correction = BPoly.from_derivatives([0.0, t[-1]], [rest, left])
    return joint_motion(problem, q + correction(t), qd + correction(t, nu=1), sigma)
