"""What all networks share: x_i' = -gamma x_i + mu sum_j W_ij phi(x_j) + mu b_i with blocks W_ij of size d x d."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim import stability, storage
from lieednn_sim.errors import FileError, InputError, NotCertifiedError
from lieednn_sim.network.dynamics import Equilibrium, Trajectory, find_equilibrium, integrate
from lieednn_sim.validation import as_floats, as_positive

Floats = NDArray[np.float64]


class BlockNetwork(ABC):
    """N neurons of d coordinates each, coupled by d x d blocks; subclasses are frozen dataclasses.

    The state has shape ``(..., N, d)``; the flat state is its C-order ravel.

    Attributes:
        bias: ``(N, d)``.
        gamma: decay rate, positive.
        mu: scale of the interaction, positive.
    """

    bias: Floats
    gamma: float
    mu: float

    # What `save` writes: the kind of file, and the attributes kept as arrays and as metadata.
    _kind: ClassVar[str]
    _arrays: ClassVar[tuple[str, ...]]
    _scalars: ClassVar[tuple[str, ...]]
    # What does not depend on the bias, so that a network with another bias can take it over.
    _bias_free: ClassVar[tuple[str, ...]] = ("blocks", "weight", "certificate")

    def __repr__(self) -> str:
        n, d = self.bias.shape
        proof = "certified" if self.certified else "not certified"
        return f"<{type(self).__name__}: {n} neurons of {d} coordinates, gamma {self.gamma:g}, mu {self.mu:g}, {proof}>"

    @property
    def n_neurons(self) -> int:
        """N."""
        return len(self.bias)

    @property
    @abstractmethod
    def blocks(self) -> Floats:
        """Weight blocks W_ij, ``(N, N, d, d)``; i receives, j sends."""

    @cached_property
    def weight(self) -> Floats:
        """Flat weight matrix W, ``(dN, dN)``."""
        return read_only(as_floats("weight", flatten_blocks(self.blocks), ("n", "n")))

    @property
    @abstractmethod
    def certificate(self) -> stability.Certificate | None:
        """The stored Lyapunov diagonal, checked against this network's weights; None when there is none."""

    @property
    def certified(self) -> bool:
        """Whether global stability is proved."""
        return self.certificate is not None and self.certificate.valid

    @abstractmethod
    def phi(self, x: Floats) -> Floats:
        """Activation of states ``(..., N, d)``."""

    @abstractmethod
    def _driven(self, state: Floats) -> Floats:
        """Jacobian of W phi, ``(..., N, d)`` to ``(..., dN, dN)``."""

    def vector_field(self, xi: ArrayLike) -> Floats:
        """Right-hand side in block form, ``(..., N, d)`` to the same shape."""
        state = as_floats("xi", xi, self.bias.shape, batched=True)
        drive = np.einsum("ijab,...jb->...ia", self.blocks, self.phi(state))
        return -self.gamma * state + self.mu * (drive + self.bias)

    def flat_vector_field(self, x: Floats) -> Floats:
        """Right-hand side in flat form, ``(dN,)`` to ``(dN,)``; unchecked, for integrators."""
        output = self.phi(x.reshape(self.bias.shape)).ravel()
        return -self.gamma * x + self.mu * (self.weight @ output + self.bias.ravel())

    def jacobian(self, xi: ArrayLike) -> Floats:
        """Jacobian of the flat vector field, ``(..., N, d)`` to ``(..., dN, dN)``."""
        state = as_floats("xi", xi, self.bias.shape, batched=True)
        return -self.gamma * np.eye(len(self.weight)) + self.mu * self._driven(state)

    def equilibrium(self, start: ArrayLike | None = None, *, tolerance: float = 1e-12) -> Equilibrium:
        """Find an equilibrium by damped Newton steps, with the flow as fallback; see `dynamics.find_equilibrium`.

        Args:
            start: ``(N, d)`` first guess, zero by default.
            tolerance: on the largest entry of the vector field, relative to gamma (1 + |xi|); a hundred times as much
                passes where rounding keeps Newton's method from doing better.

        Returns:
            The point found and whether it converged; a certified network has exactly one equilibrium.
        """
        shape = self.bias.shape
        return find_equilibrium(
            self.flat_vector_field,
            lambda x: self.jacobian(x.reshape(shape)),
            np.zeros(shape) if start is None else as_floats("start", start, shape),
            rate=self.gamma,
            tolerance=as_positive("tolerance", tolerance),
        )

    def trajectory(
        self,
        start: ArrayLike,
        duration: float,
        *,
        until: ArrayLike | None = None,
        distance: float = 1e-8,
        method: str = "RK45",
        rtol: float = 1e-8,
        atol: float = 1e-10,
    ) -> Trajectory:
        """Integrate the network from ``start``.

        Args:
            start: ``(N, d)`` state at time 0.
            duration: longest time to integrate, in the network's own time.
            until: ``(N, d)`` state to stop at, usually the equilibrium.
            distance: stop when the largest coordinate of xi - until is below this.
            method: a name of `dynamics.INTEGRATORS`.
            rtol: relative tolerance of the integrator.
            atol: absolute tolerance of the integrator.
        """
        shape = self.bias.shape
        return integrate(
            self.flat_vector_field,
            as_floats("start", start, shape),
            duration,
            until=None if until is None else as_floats("until", until, shape),
            distance=distance,
            method=method,
            rtol=rtol,
            atol=atol,
        )

    def norm_conditions(self, xi: ArrayLike) -> stability.NormConditions:
        """The paper's norm conditions, beside the smallest 1-norm possible with equilibrium ``xi``."""
        target = as_floats("xi", xi, self.bias.shape)
        required = self.gamma / self.mu * target - self.bias
        smallest = stability.smallest_one_norm(self.phi(target), required)
        return stability.norm_conditions(self.weight, smallest, gamma=self.gamma, mu=self.mu)

    def retarget(self, xi: ArrayLike) -> Self:
        """The same weights with the bias b = (gamma/mu) xi - W phi(xi), which makes ``xi`` the equilibrium.

        The certificate does not depend on the bias: a certified network stays certified.
        """
        target = as_floats("xi", xi, self.bias.shape)
        drive = (self.weight @ self.phi(target).ravel()).reshape(target.shape)
        # mypy cannot know that every subclass is a dataclass, here and below.
        network: Self = replace(self, bias=self.gamma / self.mu * target - drive)  # type: ignore[type-var]
        # Weights and proof are the same: hand over what has been computed of them.
        vars(network).update({name: vars(self)[name] for name in self._bias_free if name in vars(self)})
        return network

    def _carrying(self, found: stability.Certificate, every: int = 1) -> Self:
        """This network with a found certificate, of which every so-many-th entry is stored."""
        if not found.valid:
            raise NotCertifiedError(f"no certificate was found for the weights ({found}); scale alpha or mu down")
        diagonal = found.lyapunov_diagonal[::every]
        network: Self = replace(self, lyapunov_diagonal=diagonal)  # type: ignore[type-var]
        return network

    def save(self, path: str | os.PathLike[str], made_from: Mapping[str, str] | None = None) -> None:
        """Write the network to an ``.npz`` file, atomically; ``made_from`` as for `storage.save_arrays`."""
        arrays = {name: getattr(self, name) for name in self._arrays if getattr(self, name) is not None}
        storage.save_arrays(path, self._kind, arrays, self._meta(), made_from)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a network; a certificate in the file is verified again from the weights.

        Raises:
            FileError: the file cannot be read, is no network, or carries a certificate that does not hold.
        """
        arrays, meta = storage.load_arrays(path, cls._kind)
        required = [name for name in cls._arrays if name != "lyapunov_diagonal"]
        values: dict[str, Any] = dict(zip(required, storage.take(arrays, path, *required), strict=True))
        values["lyapunov_diagonal"] = arrays.get("lyapunov_diagonal")
        try:
            network = cls(**values, **cls._from_meta(meta))
            certificate = network.certificate
        except (KeyError, InputError) as error:
            raise FileError(f"{path} is not a valid network: {error}") from None
        if certificate is not None and not certificate.valid:
            raise FileError(f"{path} carries a certificate that does not hold for its weights ({certificate})")
        return network

    def _meta(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self._scalars}

    @classmethod
    def _from_meta(cls, meta: Mapping[str, Any]) -> dict[str, Any]:
        """Arguments of the constructor out of metadata; KeyError or InputError when they are not there."""
        return {name: meta[name] for name in cls._scalars}

    def _store(self, **checked: Any) -> None:
        """Set the fields of a frozen dataclass to checked values; arrays are copied and locked."""
        for name, value in checked.items():
            object.__setattr__(self, name, read_only(value.copy()) if isinstance(value, np.ndarray) else value)


def flatten_blocks(blocks: Floats) -> Floats:
    """Blocks ``(N, N, d, d)`` as one read-only matrix ``(Nd, Nd)``."""
    n, size = blocks.shape[0], blocks.shape[-1]
    return read_only(np.ascontiguousarray(blocks.transpose(0, 2, 1, 3).reshape(n * size, n * size)))


def read_only(array: Floats) -> Floats:
    """Lock an array against writing, and return it."""
    array.setflags(write=False)
    return array
