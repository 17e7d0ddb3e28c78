"""SE(3) beyond what `scipy.spatial.transform` offers: adjoint, Jacobians and projections.

Twists are ordered (omega, v), the order of `RigidTransform.from_exp_coords`. Every function takes leading batch axes.
"""

from lieednn_sim.lie.projection import project_to_adjoint, project_to_rotation
from lieednn_sim.lie.se3 import adjoint, exp, hat, left_jacobian_se3, left_jacobian_so3, log, vee

__all__ = [
    "adjoint",
    "exp",
    "hat",
    "left_jacobian_se3",
    "left_jacobian_so3",
    "log",
    "project_to_adjoint",
    "project_to_rotation",
    "vee",
]
