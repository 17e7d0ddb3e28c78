"""Planners by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from lieednn_sim.budget import time_limit
from lieednn_sim.errors import InputError
from lieednn_sim.network import ComponentwiseNetwork
from lieednn_sim.planning import filtered
from lieednn_sim.planning import network_planners as lieednn
from lieednn_sim.planning.baselines import interpolation, optimisation, primitives, sampling
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.problem import PlanningProblem, in_time
from lieednn_sim.validation import as_choice

# Those that run a network, and return it beside the motion.
NETWORK_PLANNERS: dict[str, Callable[[PlanningProblem], tuple[ComponentwiseNetwork, Motion]]] = {
    "linear-law": lieednn.linear_law,
    "lieednn-certified": lieednn.certified,
    "lieednn-retargeted": lieednn.retargeted,
    "lieednn-trained": lieednn.trained,
    "lieednn-unprojected": lieednn.unprojected,
    "lieednn-filtered": filtered.filtered,
    "lieednn-guided": filtered.guided,
}


# The LieEDNN planner that gets furthest among obstacles, whether its library is installed or not.
OBSTACLE_PLANNER = "lieednn-guided"


def _motion_of(name: str, problem: PlanningProblem) -> Motion:
    return NETWORK_PLANNERS[name](problem)[1]


# Each returns a motion that `motion.check_motion` passes, sampled at the model's time step, or raises.
PLANNERS: dict[str, Callable[[PlanningProblem], Motion]] = {
    "minimum-jerk": partial(in_time, interpolation.minimum_jerk),
    "screw": partial(in_time, interpolation.screw),
    "dmp": partial(in_time, primitives.dmp),
    "rrt-connect": sampling.rrt_connect,
    "rrt-star": sampling.rrt_star,
    "trajectory-optimisation": partial(in_time, optimisation.trajectory_optimisation),
    **{name: partial(_motion_of, name) for name in NETWORK_PLANNERS},
}


def plan_with(name: str, problem: PlanningProblem) -> Motion:
    """Plan with the planner of a name.

    Returns:
        A motion from rest at the start to rest at the target in the problem's duration, or in up to `LONGEST` times
        that where the arm's limits need it, within the arm's limits and free of contact, sampled at
        the time step of the arm's model.

    Raises:
        InputError: an unknown name; the message lists the known ones.
        NotCertifiedError: no network could be certified.
        PlanError: the motion breaks a limit of the arm, or does not arrive.
        OutOfTimeError: the problem's time budget is spent.
        LieEDNNError: a library that the planner needs is not installed; see `missing_planners`.
    """
    return plan_network(name, problem)[1]


def plan_network(name: str, problem: PlanningProblem) -> tuple[ComponentwiseNetwork | None, Motion]:
    """As `plan_with`, with the network that made the motion, or None for a planner that has none."""
    as_choice("planner", name, PLANNERS)
    if not isinstance(problem, PlanningProblem):
        raise InputError(f"problem must be a PlanningProblem, got {type(problem).__name__}")
    with time_limit(problem.time_budget):
        return NETWORK_PLANNERS[name](problem) if name in NETWORK_PLANNERS else (None, PLANNERS[name](problem))
