"""The outcome of a certified synthesis."""

from __future__ import annotations

from lieednn_sim.errors import NotCertifiedError
from lieednn_sim.network import LieEDNN
from lieednn_sim.stability import Certificate
from lieednn_sim.values import frozen


@frozen
class Synthesis:
    """Result of `synthesize`, or one of the results of `synthesize_many`.

    Attributes:
        impossible: whether it is proved that no weights can be certified with this target and bias.
        message: the outcome, with the reason for a failure.
        network: the certified network, or None. An uncertified network is never returned.
        residual: largest entry of the vector field at the target.
        largest_translation: largest |t_ij| of the weights.
        attempts: number of starts tried.
        iterations: number of iterations of all searches.
        cpu_time: CPU time since the beginning of the call [s].
    """

    impossible: bool
    message: str
    network: LieEDNN | None
    residual: float
    largest_translation: float
    attempts: int
    iterations: int
    cpu_time: float

    @property
    def success(self) -> bool:
        """Whether there is a certified network with the target as its equilibrium."""
        return self.network is not None

    @property
    def certificate(self) -> Certificate | None:
        """The verified certificate of the network."""
        return self.network.certificate if self.network is not None else None

    def unwrap(self) -> LieEDNN:
        """The network, or `NotCertifiedError` with the reason."""
        if self.network is None:
            raise NotCertifiedError(self.message)
        return self.network
