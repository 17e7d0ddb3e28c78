"""Arms and their scenes: models, kinematics, inverse kinematics, contacts, and the importer for MJCF and URDF files.

An arm is a chain of links, each moved by a compound joint. `Arm.encode` maps joint coordinates to the twists that are
the network's state; `Arm.decode` finds the joint coordinates whose poses are nearest to given twists.
"""

from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE
from lieednn_sim.arm.importer.report import ImportReport
from lieednn_sim.arm.inverse_kinematics import ik_candidates, solve_ik
from lieednn_sim.arm.models import arm_names, models_directory, scene_path
from lieednn_sim.arm.oscillation import Mode, with_load
from lieednn_sim.arm.projection import Retraction
from lieednn_sim.arm.regions import TaskSpaceRegion
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "PLANNED_CLEARANCE",
    "Arm",
    "ImportReport",
    "Mode",
    "Retraction",
    "TaskSpaceRegion",
    "arm_names",
    "ik_candidates",
    "models_directory",
    "scene_path",
    "solve_ik",
    "with_load",
]

typecheck_public(globals())
