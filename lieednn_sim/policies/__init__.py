"""Policies, which run an arm online: from measured joints and the present target to the next reference.

`make_policy` makes one by name; `lieednn_sim.follow` runs it behind a simulated arm, `control_loop` behind a real one.
"""

from lieednn_sim.policies.base import Policy as Policy
from lieednn_sim.policies.bounds import FilterOptions as FilterOptions
from lieednn_sim.policies.chunk_messages import ChunkStep as ChunkStep
from lieednn_sim.policies.chunk_messages import from_joint_trajectory as from_joint_trajectory
from lieednn_sim.policies.chunk_messages import to_joint_trajectory as to_joint_trajectory
from lieednn_sim.policies.chunks import ChunkOptions as ChunkOptions
from lieednn_sim.policies.chunks import ChunkPolicy as ChunkPolicy
from lieednn_sim.policies.chunks import ChunkVerdict as ChunkVerdict
from lieednn_sim.policies.fabric import Fabric as Fabric
from lieednn_sim.policies.fabric import FabricOptions as FabricOptions
from lieednn_sim.policies.feedback import Feedback as Feedback
from lieednn_sim.policies.feedback import JointPolicy as JointPolicy
from lieednn_sim.policies.loop import LoopReport as LoopReport
from lieednn_sim.policies.loop import control_loop as control_loop
from lieednn_sim.policies.loop_faults import LoopOptions as LoopOptions
from lieednn_sim.policies.making import PolicyTask as PolicyTask
from lieednn_sim.policies.making import make_policy as make_policy
from lieednn_sim.policies.making import register_policy as register_policy
from lieednn_sim.policies.network_policy import CertifiedPolicyOptions as CertifiedPolicyOptions
from lieednn_sim.policies.network_policy import NetworkPolicy as NetworkPolicy
from lieednn_sim.policies.path_integral import PathIntegral as PathIntegral
from lieednn_sim.policies.path_integral import PathIntegralOptions as PathIntegralOptions
from lieednn_sim.policies.planned import MotionTracker as MotionTracker
from lieednn_sim.policies.planned import MovementPrimitive as MovementPrimitive
from lieednn_sim.policies.planned import PrimitiveOptions as PrimitiveOptions
from lieednn_sim.policies.replanning import ReplanningOptions as ReplanningOptions
from lieednn_sim.policies.replanning import ReplanningPolicy as ReplanningPolicy
from lieednn_sim.policies.safety_filter import FilteredPolicy as FilteredPolicy
from lieednn_sim.policies.safety_filter import FilterStep as FilterStep
from lieednn_sim.policies.safety_filter import SafetyFilter as SafetyFilter
from lieednn_sim.registry import POLICIES as POLICIES
from lieednn_sim.typecheck import typecheck_public

typecheck_public(globals())
