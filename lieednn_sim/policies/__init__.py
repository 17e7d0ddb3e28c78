"""Policies, which run an arm online: from measured joints and the present target to the next reference.

`make_policy` makes one by name; `lieednn_sim.follow` runs it behind a simulated arm, `control_loop` behind a real one.
"""

from lieednn_sim.policies.base import Policy
from lieednn_sim.policies.bounds import FilterOptions
from lieednn_sim.policies.chunk_messages import ChunkStep, from_joint_trajectory, to_joint_trajectory
from lieednn_sim.policies.chunks import ChunkOptions, ChunkPolicy, ChunkVerdict
from lieednn_sim.policies.fabric import Fabric, FabricOptions
from lieednn_sim.policies.feedback import Feedback, JointPolicy
from lieednn_sim.policies.loop import LoopReport, control_loop
from lieednn_sim.policies.loop_faults import LoopOptions
from lieednn_sim.policies.making import PolicyTask, make_policy, register_policy
from lieednn_sim.policies.network_policy import CertifiedPolicyOptions, NetworkPolicy
from lieednn_sim.policies.path_integral import PathIntegral, PathIntegralOptions
from lieednn_sim.policies.planned import MotionTracker, MovementPrimitive, PrimitiveOptions
from lieednn_sim.policies.replanning import ReplanningOptions, ReplanningPolicy
from lieednn_sim.policies.safety_filter import FilteredPolicy, FilterStep, SafetyFilter
from lieednn_sim.registry import POLICIES
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "POLICIES",
    "CertifiedPolicyOptions",
    "ChunkOptions",
    "ChunkPolicy",
    "ChunkStep",
    "ChunkVerdict",
    "Fabric",
    "FabricOptions",
    "Feedback",
    "FilterOptions",
    "FilterStep",
    "FilteredPolicy",
    "JointPolicy",
    "LoopOptions",
    "LoopReport",
    "MotionTracker",
    "MovementPrimitive",
    "NetworkPolicy",
    "PathIntegral",
    "PathIntegralOptions",
    "Policy",
    "PolicyTask",
    "PrimitiveOptions",
    "ReplanningOptions",
    "ReplanningPolicy",
    "SafetyFilter",
    "control_loop",
    "from_joint_trajectory",
    "make_policy",
    "register_policy",
    "to_joint_trajectory",
]

typecheck_public(globals())
