"""The Lie group SE(3): exponential map, logarithm, adjoint matrices, and projections of matrices onto them.

Twists are ordered (omega, v), rotation before translation, as in SciPy's ``RigidTransform.from_exp_coords``. All
functions take arrays with any number of leading batch axes.
"""

# Here and in `arm`, SciPy's names are written in full after `import scipy`: its subpackages are then imported on first
# use, and importing `scipy.spatial` takes longer than importing MuJoCo.

from lieednn_sim.lie.projection import (
    project_to_adjoint,
    project_to_adjoint_exact,
    project_to_rotation,
    project_to_scaled_adjoint,
)
from lieednn_sim.lie.se3 import adjoint, exp, hat, left_jacobian_se3, left_jacobian_so3, log, spatial_twist, vee

# Unchecked, for the rest of the package.
from lieednn_sim.lie.se3 import continued as continued
from lieednn_sim.lie.se3 import rotations as rotations
from lieednn_sim.lie.se3 import same_signs as same_signs
from lieednn_sim.lie.se3 import transforms as transforms
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "adjoint",
    "exp",
    "hat",
    "left_jacobian_se3",
    "left_jacobian_so3",
    "log",
    "project_to_adjoint",
    "project_to_adjoint_exact",
    "project_to_rotation",
    "project_to_scaled_adjoint",
    "spatial_twist",
    "vee",
]

typecheck_public(globals())
