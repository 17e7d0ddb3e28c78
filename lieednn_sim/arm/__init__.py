"""Arms and their scenes: models, kinematics, inverse kinematics, contacts, and the importer for MJCF and URDF files.

An arm is a chain of links, each moved by a compound joint. `Arm.encode` maps joint coordinates to the twists that are
the network's state; `Arm.decode` finds the joint coordinates whose poses are nearest to given twists.
"""

from lieednn_sim.arm.arm import Arm as Arm
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE as PLANNED_CLEARANCE
from lieednn_sim.arm.importer.report import ImportReport as ImportReport
from lieednn_sim.arm.inverse_kinematics import ik_candidates as ik_candidates
from lieednn_sim.arm.inverse_kinematics import solve_ik as solve_ik
from lieednn_sim.arm.models import arm_names as arm_names
from lieednn_sim.arm.models import models_directory as models_directory
from lieednn_sim.arm.models import scene_path as scene_path
from lieednn_sim.arm.oscillation import Mode as Mode
from lieednn_sim.arm.oscillation import with_load as with_load
from lieednn_sim.arm.projection import Retraction as Retraction
from lieednn_sim.arm.regions import TaskSpaceRegion as TaskSpaceRegion
from lieednn_sim.typecheck import typecheck_public

typecheck_public(globals())
