"""From a joint target to a checked motion: certified networks, the safety filter, and rival planners."""

from lieednn_sim.planning.certified import CertifiedOptions
from lieednn_sim.planning.extras import missing_planners, require_planner
from lieednn_sim.planning.network_planners import reference_network
from lieednn_sim.planning.problem import Plan, PlanningProblem
from lieednn_sim.planning.registry import OBSTACLE_PLANNER, PLANNERS, Planner, plan

__all__ = [
    "OBSTACLE_PLANNER",
    "PLANNERS",
    "CertifiedOptions",
    "Plan",
    "Planner",
    "PlanningProblem",
    "missing_planners",
    "plan",
    "reference_network",
    "require_planner",
]
