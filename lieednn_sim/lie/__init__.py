"""SE(3): exponential map, adjoint representation and projections onto it.

Twists of SE(3) are ordered (omega, v), the order of `RigidTransform.from_exp_coords`. Leading batch axes everywhere.

Here and in `arm`, SciPy's names are written in full after `import scipy`: its subpackages are then imported on first
use, and importing `scipy.spatial` takes longer than importing MuJoCo.
"""

from lieednn_sim.lie.projection import (
    project_to_adjoint,
    project_to_adjoint_exact,
    project_to_rotation,
    project_to_scaled_adjoint,
)
from lieednn_sim.lie.se3 import (
    adjoint,
    continued,
    exp,
    hat,
    left_jacobian_se3,
    left_jacobian_so3,
    log,
    poses,
    rotations,
    skew,
    spatial_twist,
    vee,
)
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "adjoint",
    "continued",
    "exp",
    "hat",
    "left_jacobian_se3",
    "left_jacobian_so3",
    "log",
    "poses",
    "project_to_adjoint",
    "project_to_adjoint_exact",
    "project_to_rotation",
    "project_to_scaled_adjoint",
    "rotations",
    "skew",
    "spatial_twist",
    "vee",
]

typecheck_public(globals())
