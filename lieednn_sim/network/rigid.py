"""What networks with theta in SE(3) share: their blocks, and the part of the weights that decides stability."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

from lieednn_sim.lie import adjoint
from lieednn_sim.network.base import BlockNetwork, flatten_blocks, read_only
from lieednn_sim.values import Floats


class RigidNetwork(BlockNetwork):
    """A network on se(3)^N with blocks alpha_ij Ad(theta_ij).

    Attributes:
        alpha: ``(N, N)`` connection strengths.
        rotation: ``(N, N, 3, 3)`` rotations of theta_ij; i receives, j sends.
        translation: ``(N, N, 3)`` translations of theta_ij.
    """

    alpha: Floats
    rotation: Floats
    translation: Floats

    _bias_free: ClassVar[tuple[str, ...]] = (*BlockNetwork._bias_free, "rotational_weight")

    @cached_property
    def blocks(self) -> Floats:
        """Weight blocks alpha_ij Ad(theta_ij), ``(N, N, 6, 6)``."""
        return read_only(self.alpha[:, :, None, None] * adjoint(self.rotation, self.translation))

    @cached_property
    def rotational_weight(self) -> Floats:
        """W_R = [alpha_ij R_ij], ``(3N, 3N)``: the part that decides stability."""
        return flatten_blocks(self.blocks[..., :3, :3])
