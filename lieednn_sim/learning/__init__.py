"""Learning the weights of a LieEDNN so that its equilibrium is a given target.

`train` is the paper's Algorithm 1, as printed, repaired, or with projections that keep the equilibrium; or it moves on
the manifold of the weights, and can learn a certificate with them. Learning from recorded motions is in
`lieednn_sim.learning.demonstrations`.
"""

from lieednn_sim.learning.algorithms import train
from lieednn_sim.learning.options import RiemannianOptions, TrainingOptions
from lieednn_sim.learning.sensitivity import Sensitivity, sensitivity
from lieednn_sim.learning.training import History, StopReason, TrainingResult
from lieednn_sim.registry import ALGORITHMS
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "ALGORITHMS",
    "History",
    "RiemannianOptions",
    "Sensitivity",
    "StopReason",
    "TrainingOptions",
    "TrainingResult",
    "sensitivity",
    "train",
]

typecheck_public(globals())
