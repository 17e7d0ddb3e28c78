"""`LieEDNN`: Hopfield-like neural ODEs on se(3)^N whose weight blocks are scaled adjoint matrices of SE(3).

A network is an immutable value. It knows its vector field, its equilibria and trajectories, and its certificate, and
it can be saved to a file. `theory` has the same equation on other matrix Lie groups.
"""

from lieednn_sim.network.base import BlockNetwork
from lieednn_sim.network.componentwise import ACTIVATIONS, DEFAULT_ACTIVATION, Activation, ComponentwiseNetwork
from lieednn_sim.network.se3 import LieEDNN
from lieednn_sim.typecheck import typecheck_public

__all__ = ["ACTIVATIONS", "DEFAULT_ACTIVATION", "Activation", "BlockNetwork", "ComponentwiseNetwork", "LieEDNN"]

typecheck_public(globals())
