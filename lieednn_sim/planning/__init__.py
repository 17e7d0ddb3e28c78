"""Planning: from a joint target to a motion that is checked for limits, contact and clearance.

`plan` runs any planner by its name: certified networks, and the planners with which they are compared. Each planner has
a class of options here.
"""

from lieednn_sim.planning.baselines.optimisation import OptimisationOptions
from lieednn_sim.planning.baselines.qshnn import QshnnOptions
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions, RrtStarOptions
from lieednn_sim.planning.baselines.stomp import StompOptions
from lieednn_sim.planning.certified import CertifiedOptions
from lieednn_sim.planning.guides import GuideOptions
from lieednn_sim.planning.joint_space import joint_motion
from lieednn_sim.planning.learned import plan_learned
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.network_planners import RetargetedOptions, TrainedOptions, reference_network
from lieednn_sim.planning.planners import OBSTACLE_PLANNER, default_planner, plan, register_planner
from lieednn_sim.planning.problem import Plan, PlanningProblem
from lieednn_sim.planning.sequence import PlanSequence, SequencePart, plan_sequence
from lieednn_sim.planning.shaped import ShapedOptions
from lieednn_sim.planning.steps import Actuate, Move
from lieednn_sim.planning.time_laws import retime
from lieednn_sim.planning.tube import Tube, find_tube
from lieednn_sim.registry import PLANNERS
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "OBSTACLE_PLANNER",
    "PLANNERS",
    "Actuate",
    "CertifiedOptions",
    "GuideOptions",
    "Motion",
    "Move",
    "OptimisationOptions",
    "Plan",
    "PlanSequence",
    "PlanningProblem",
    "QshnnOptions",
    "RetargetedOptions",
    "RrtConnectOptions",
    "RrtStarOptions",
    "SequencePart",
    "ShapedOptions",
    "StompOptions",
    "TrainedOptions",
    "Tube",
    "default_planner",
    "find_tube",
    "joint_motion",
    "plan",
    "plan_learned",
    "plan_sequence",
    "reference_network",
    "register_planner",
    "retime",
]

typecheck_public(globals())
