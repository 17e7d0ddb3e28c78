"""From a joint target to a checked motion: certified networks, the safety filter, and rival planners."""

from lieednn_sim.planning.certified import Plan, plan
from lieednn_sim.planning.extras import missing_planners, require_planner
from lieednn_sim.planning.network_planners import reference_network
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.planning.registry import NETWORK_PLANNERS, OBSTACLE_PLANNER, PLANNERS, plan_network, plan_with

__all__ = [
    "NETWORK_PLANNERS",
    "OBSTACLE_PLANNER",
    "PLANNERS",
    "Plan",
    "PlanningProblem",
    "missing_planners",
    "plan",
    "plan_network",
    "plan_with",
    "reference_network",
    "require_planner",
]
