"""LieEDNN: Hopfield-like neural ODEs on g^N, whose weight blocks are adjoint matrices of a matrix Lie group.

`LieEDNN` is the paper's network on SE(3), `GroupLieEDNN` the same equation on any matrix Lie group, `complex_network`
and `quaternion_network` are two of its special cases, and `EquivariantLieEDNN` has an activation that commutes with Ad.
"""

from lieednn_sim.network.base import BlockNetwork
from lieednn_sim.network.componentwise import ACTIVATIONS, ComponentwiseNetwork
from lieednn_sim.network.division_algebras import (
    complex_network,
    complex_state,
    complex_values,
    quaternion_network,
    quaternion_state,
    quaternion_values,
)
from lieednn_sim.network.equivariant import EquivariantLieEDNN
from lieednn_sim.network.group import GroupLieEDNN
from lieednn_sim.network.se3 import LieEDNN

__all__ = [
    "ACTIVATIONS",
    "BlockNetwork",
    "ComponentwiseNetwork",
    "EquivariantLieEDNN",
    "GroupLieEDNN",
    "LieEDNN",
    "complex_network",
    "complex_state",
    "complex_values",
    "quaternion_network",
    "quaternion_state",
    "quaternion_values",
]
