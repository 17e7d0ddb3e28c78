"""Learning the weights of a LieEDNN: the paper's Algorithm 1, as printed and repaired, and what works better."""

from lieednn_sim.learning.history import History
from lieednn_sim.learning.options import ALGORITHMS, RiemannianOptions, TrainingOptions
from lieednn_sim.learning.projected import train
from lieednn_sim.learning.result import StopReason, TrainingResult
from lieednn_sim.learning.riemannian import train_riemannian
from lieednn_sim.learning.sensitivity import Sensitivity, sensitivity
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
    "train_riemannian",
]

typecheck_public(globals())
