"""Arms: MJCF models of compound joints, with their forward map, encoding and retraction."""

from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE
from lieednn_sim.arm.importer import ImportReport, import_arm
from lieednn_sim.arm.inverse_kinematics import solve_ik
from lieednn_sim.arm.models import arm_names, models_directory, scene_path
from lieednn_sim.arm.projection import Retraction
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "PLANNED_CLEARANCE",
    "Arm",
    "ImportReport",
    "Retraction",
    "arm_names",
    "import_arm",
    "models_directory",
    "scene_path",
    "solve_ik",
]

typecheck_public(globals())
