"""Arms: MJCF models of compound joints, with their forward map, encoding and retraction."""

from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.models import arm_names, models_directory, scene_path
from lieednn_sim.arm.reach import reach
from lieednn_sim.arm.retraction import Retraction

__all__ = ["Arm", "Retraction", "arm_names", "models_directory", "reach", "scene_path"]
