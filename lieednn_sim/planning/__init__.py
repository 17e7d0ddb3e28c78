"""Planning: from a joint target to a motion that is checked for limits, contact and clearance.

`plan` runs any planner by its name: certified networks, and those with which they are compared, with their options.
"""

from lieednn_sim.planning.baselines.optimisation import OptimisationOptions as OptimisationOptions
from lieednn_sim.planning.baselines.qshnn import QshnnOptions as QshnnOptions
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions as RrtConnectOptions
from lieednn_sim.planning.baselines.sampling import RrtStarOptions as RrtStarOptions
from lieednn_sim.planning.baselines.stomp import StompOptions as StompOptions
from lieednn_sim.planning.certified import CertifiedOptions as CertifiedOptions
from lieednn_sim.planning.guides import GuideOptions as GuideOptions
from lieednn_sim.planning.joint_space import joint_motion as joint_motion
from lieednn_sim.planning.learned import plan_learned as plan_learned
from lieednn_sim.planning.motion import Motion as Motion
from lieednn_sim.planning.network_planners import RetargetedOptions as RetargetedOptions
from lieednn_sim.planning.network_planners import TrainedOptions as TrainedOptions
from lieednn_sim.planning.network_planners import reference_network as reference_network
from lieednn_sim.planning.planners import OBSTACLE_PLANNER as OBSTACLE_PLANNER
from lieednn_sim.planning.planners import default_planner as default_planner
from lieednn_sim.planning.planners import plan as plan
from lieednn_sim.planning.planners import register_planner as register_planner
from lieednn_sim.planning.problem import Plan as Plan
from lieednn_sim.planning.problem import PlanningProblem as PlanningProblem
from lieednn_sim.planning.sequence import PlanSequence as PlanSequence
from lieednn_sim.planning.sequence import SequencePart as SequencePart
from lieednn_sim.planning.sequence import plan_sequence as plan_sequence
from lieednn_sim.planning.settling import SettlingOptions as SettlingOptions
from lieednn_sim.planning.settling import settled as settled
from lieednn_sim.planning.shaped import ShapedOptions as ShapedOptions
from lieednn_sim.planning.steps import Actuate as Actuate
from lieednn_sim.planning.steps import Move as Move
from lieednn_sim.planning.time_laws import retime as retime
from lieednn_sim.planning.tube import Tube as Tube
from lieednn_sim.planning.tube import find_tube as find_tube
from lieednn_sim.registry import PLANNERS as PLANNERS
from lieednn_sim.typecheck import typecheck_public

typecheck_public(globals())
