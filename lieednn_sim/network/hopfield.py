"""The Hopfield network, whose weights have no structure, for comparison with LieEDNN."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np

from lieednn_sim.network.checks import as_rates
from lieednn_sim.network.componentwise import DEFAULT_ACTIVATION, ComponentwiseNetwork, as_activation
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen, read_only, set_fields


@frozen
class HopfieldNetwork(ComponentwiseNetwork):
    """A network with any weight matrix, of N neurons with d coordinates (Hopfield, PNAS 81, 1984).

    It is x' = -gamma x + mu (W phi(x) + b).

    Attributes:
        matrix: ``(dN, dN)`` W.
        bias: ``(N, d)``.
        gamma: decay rate, positive.
        mu: scale of the interaction, positive.
        activation: a name of `network.ACTIVATIONS`.
        lyapunov_diagonal: ``(dN,)`` diagonal P that certifies W, or None. Checked by `certificate`.

    Raises:
        InputError: wrong shapes or entries that are not finite.
    """

    matrix: Floats
    bias: Floats
    gamma: float = 1.0
    mu: float = 1.0
    activation: str = DEFAULT_ACTIVATION
    lyapunov_diagonal: Floats | None = None

    _kind: ClassVar[str] = "hopfield-network"

    def __post_init__(self) -> None:
        bias = as_floats("bias", self.bias, ("N", "d"))
        diagonal = self.lyapunov_diagonal
        set_fields(
            self,
            matrix=as_floats("matrix", self.matrix, (bias.size, bias.size)),
            bias=bias,
            **as_rates(self.gamma, self.mu),
            activation=as_activation(self.activation),
            lyapunov_diagonal=None if diagonal is None else as_floats("lyapunov_diagonal", diagonal, (bias.size,)),
        )

    @cached_property
    def blocks(self) -> Floats:
        """W as blocks ``(N, N, d, d)``."""
        n, d = self.bias.shape
        return read_only(np.ascontiguousarray(self.matrix.reshape(n, d, n, d).transpose(0, 2, 1, 3)))
