"""Rival planners behind one interface: from a problem to a checked motion."""

from lieednn_sim.planners.extras import missing_planners
from lieednn_sim.planners.lieednn import reference_network
from lieednn_sim.planners.problem import PlanningProblem
from lieednn_sim.planners.registry import NETWORK_PLANNERS, PLANNERS, obstacle_planner, plan_network, plan_with

__all__ = [
    "NETWORK_PLANNERS",
    "PLANNERS",
    "PlanningProblem",
    "missing_planners",
    "obstacle_planner",
    "plan_network",
    "plan_with",
    "reference_network",
]
