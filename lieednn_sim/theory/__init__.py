"""The paper's mathematics beyond SE(3): networks on any matrix Lie group, and how smooth their trajectories are.

`GroupLieEDNN` is the paper's equation on a group of `GROUPS`; `complex_network` and `quaternion_network` are two of its
special cases; `EquivariantLieEDNN` has an activation that commutes with Ad. `train` works on any of the groups. No
planner needs this subpackage.
"""

from lieednn_sim.theory.groups import GROUPS as GROUPS
from lieednn_sim.theory.groups import affine as affine
from lieednn_sim.theory.groups import group as group
from lieednn_sim.theory.matrix_group import MatrixLieGroup as MatrixLieGroup
from lieednn_sim.theory.networks import EquivariantLieEDNN as EquivariantLieEDNN
from lieednn_sim.theory.networks import GroupLieEDNN as GroupLieEDNN
from lieednn_sim.theory.networks import complex_network as complex_network
from lieednn_sim.theory.networks import complex_state as complex_state
from lieednn_sim.theory.networks import complex_values as complex_values
from lieednn_sim.theory.networks import quaternion_network as quaternion_network
from lieednn_sim.theory.networks import quaternion_state as quaternion_state
from lieednn_sim.theory.networks import quaternion_values as quaternion_values
from lieednn_sim.theory.smoothness import SmoothnessBounds as SmoothnessBounds
from lieednn_sim.theory.smoothness import curvature as curvature
from lieednn_sim.theory.smoothness import smoothness_bounds as smoothness_bounds
from lieednn_sim.typecheck import typecheck_public

typecheck_public(globals())
