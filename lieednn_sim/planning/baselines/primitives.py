"""A dynamic movement primitive, learned from one demonstration; it needs the extra `dmp`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BPoly

from lieednn_sim.arm.targets import reference_posture
from lieednn_sim.budget import check_time
from lieednn_sim.planning.baselines.joint_space import joint_motion
from lieednn_sim.planning.extras import optional_module
from lieednn_sim.planning.laws import minimum_jerk_law
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.values import Floats


@dataclass(frozen=True)
class DmpOptions(PlannerOptions):
    """Options of the planner ``dmp``.

    Attributes:
        basis_functions: number of radial basis functions in each joint's forcing term, from 2 to 1000.
        least_share: share of its range that a joint must move in the demonstration to show a shape.
    """

    basis_functions: int = field(default=20, metadata={"range": (2, 1000)})
    least_share: float = 0.01


def dmp(problem: PlanningProblem, options: DmpOptions) -> Motion:
    """The motion of a primitive from start to target, which imitates minimum jerk from home to `reference_posture`.

    A critically damped spring to the goal and a learned forcing term that fades (Ijspeert et al., Neural Computation
    25(2), 2013), with the smooth start of Pastor et al., ICRA 2009:

        T^2 q'' = alpha (beta (g - q) - T q' - beta (g - q_0) z) + f(z),  z decaying from 1 to 0.01.

    The forcing f is scaled by the joint's displacement over that in the demonstration, which keeps the demonstrated
    shape at every amplitude; unscaled, the forcing of a long demonstration throws a joint with a short way over its
    limits. A joint that moves less than ``least_share`` of its range in the demonstration has no shape to keep: it gets
    no forcing, and the spring alone takes it from start to target.

    At the end of the duration 1 % of the phase is left, and about as much of the way. A quintic polynomial, zero at the
    start, removes the remaining errors of position, velocity and acceleration.

    Raises:
        LieEDNNError: movement_primitives is not installed.
        PlanError: the motion breaks a limit of the arm; a primitive knows neither limits nor obstacles.
    """
    primitive = optional_module("movement_primitives.dmp").DMP(
        problem.arm.n_joints,
        execution_time=float(problem.times()[-1]),
        dt=problem.timestep,
        n_weights_per_dim=options.basis_functions,
        smooth_scaling=True,
    )
    t = problem.times()
    sigma, _ = minimum_jerk_law(t / t[-1])
    home, extended = problem.arm.keyframe("home"), reference_posture(problem.arm)
    primitive.imitate(t, home + sigma[:, None] * (extended - home))
    primitive.forcing_term.weights_ *= _amplitudes(problem, extended - home, options.least_share)[:, None]
    primitive.configure(start_y=problem.start.copy(), goal_y=problem.target.copy())
    q, qd = np.empty((2, len(t), len(home)))
    q[0], qd[0] = problem.start, 0.0
    for k in range(1, len(t)):
        check_time()
        q[k], qd[k] = primitive.step(q[k - 1], qd[k - 1])
    acceleration = (qd[-1] - qd[-2]) / problem.timestep
    rest = np.zeros((3, len(home)))
    left = np.stack([problem.target - q[-1], -qd[-1], -acceleration])
    correction = BPoly.from_derivatives([0.0, t[-1]], [rest, left])
    return joint_motion(problem, q + correction(t), qd + correction(t, nu=1), sigma)


def _amplitudes(problem: PlanningProblem, shown: Floats, least: float) -> Floats:
    """Displacement of each joint ``(n,)`` over that in the demonstration; zero where it hardly moves there."""
    moves = np.abs(shown) > least * problem.arm.ranges
    return np.where(moves, problem.target - problem.start, 0.0) / np.where(moves, shown, 1.0)
