"""The Lie group SE(3): exponential map, logarithm, adjoint matrices, and projections of matrices onto them.

Twists are ordered (omega, v), rotation before translation, as in SciPy's ``RigidTransform.from_exp_coords``. All
functions take arrays with any number of leading batch axes.
"""

# Here and in `arm`, SciPy's names are written in full after `import scipy`: its subpackages are then imported on first
# use, and importing `scipy.spatial` takes longer than importing MuJoCo.

from lieednn_sim.lie.projection import project_to_adjoint as project_to_adjoint
from lieednn_sim.lie.projection import project_to_adjoint_exact as project_to_adjoint_exact
from lieednn_sim.lie.projection import project_to_rotation as project_to_rotation
from lieednn_sim.lie.projection import project_to_scaled_adjoint as project_to_scaled_adjoint
from lieednn_sim.lie.se3 import adjoint as adjoint
from lieednn_sim.lie.se3 import exp as exp
from lieednn_sim.lie.se3 import hat as hat
from lieednn_sim.lie.se3 import left_jacobian_se3 as left_jacobian_se3
from lieednn_sim.lie.se3 import left_jacobian_so3 as left_jacobian_so3
from lieednn_sim.lie.se3 import log as log
from lieednn_sim.lie.se3 import spatial_twist as spatial_twist
from lieednn_sim.lie.se3 import vee as vee
from lieednn_sim.typecheck import typecheck_public

typecheck_public(globals())
