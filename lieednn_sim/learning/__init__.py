"""Learning the weights of a LieEDNN so that its equilibrium is a given target.

`train` runs the paper's Algorithm 1, as printed, repaired, or with projections that keep the equilibrium. It can also
take steps on the manifold of the weights, and learn a certificate along with them. Learning from recorded motions is in
`lieednn_sim.learning.demonstrations`.
"""

from lieednn_sim.learning.algorithms import train as train
from lieednn_sim.learning.options import RiemannianOptions as RiemannianOptions
from lieednn_sim.learning.options import TrainingOptions as TrainingOptions
from lieednn_sim.learning.sensitivity import Sensitivity as Sensitivity
from lieednn_sim.learning.sensitivity import sensitivity as sensitivity
from lieednn_sim.learning.training import History as History
from lieednn_sim.learning.training import StopReason as StopReason
from lieednn_sim.learning.training import TrainingResult as TrainingResult
from lieednn_sim.registry import ALGORITHMS as ALGORITHMS
from lieednn_sim.typecheck import typecheck_public

typecheck_public(globals())
