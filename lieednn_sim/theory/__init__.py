"""The paper's mathematics beyond SE(3): networks on any matrix Lie group, and how smooth their trajectories are.

`GroupLieEDNN` is the paper's equation on a group of `GROUPS`; `complex_network` and `quaternion_network` are two of its
special cases; `EquivariantLieEDNN` has an activation that commutes with Ad. `train` works on any of the groups. No
planner needs this subpackage.
"""

from lieednn_sim.theory.groups import GROUPS, affine, group
from lieednn_sim.theory.matrix_group import MatrixLieGroup
from lieednn_sim.theory.networks import (
    EquivariantLieEDNN,
    GroupLieEDNN,
    complex_network,
    complex_state,
    complex_values,
    quaternion_network,
    quaternion_state,
    quaternion_values,
)
from lieednn_sim.theory.smoothness import SmoothnessBounds, curvature, smoothness_bounds
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "GROUPS",
    "EquivariantLieEDNN",
    "GroupLieEDNN",
    "MatrixLieGroup",
    "SmoothnessBounds",
    "affine",
    "complex_network",
    "complex_state",
    "complex_values",
    "curvature",
    "group",
    "quaternion_network",
    "quaternion_state",
    "quaternion_values",
    "smoothness_bounds",
]

typecheck_public(globals())
