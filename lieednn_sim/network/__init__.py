"""LieEDNN on se(3)^N: Hopfield-like neural ODEs whose weight blocks are scaled adjoint matrices of SE(3).

`theory` has the same equation on other matrix Lie groups.
"""

from lieednn_sim.network.base import BlockNetwork
from lieednn_sim.network.componentwise import ACTIVATIONS, DEFAULT_ACTIVATION, Activation, ComponentwiseNetwork
from lieednn_sim.network.se3 import LieEDNN
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "ACTIVATIONS",
    "DEFAULT_ACTIVATION",
    "Activation",
    "BlockNetwork",
    "ComponentwiseNetwork",
    "LieEDNN",
]

typecheck_public(globals())
