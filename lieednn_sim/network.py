"""LieEDNN: a Hopfield-like neural ODE on se(3)^N with adjoint weight blocks."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim import stability, storage
from lieednn_sim.dynamics import Equilibrium, Trajectory, find_equilibrium, integrate
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.lie import adjoint
from lieednn_sim.validation import as_choice, as_floats, as_positive

Floats = NDArray[np.float64]

# Odd, bounded activations with slopes in (0, 1]: what the certificate of `stability` assumes. (phi, phi').
ACTIVATIONS: dict[str, tuple[Callable[[Floats], Floats], Callable[[Floats], Floats]]] = {
    "tanh": (np.tanh, lambda x: 1.0 / np.cosh(np.clip(x, -350.0, 350.0)) ** 2),
    "arctan": (lambda x: 2.0 / np.pi * np.arctan(0.5 * np.pi * x), lambda x: 1.0 / (1.0 + (0.5 * np.pi * x) ** 2)),
}

_ORTHONORMAL_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class LieEDNN:
    """x_i' = -gamma x_i + mu sum_j alpha_ij Ad(theta_ij) phi(x_j) + mu b_i, with x_i in se(3) (paper, eq. 3.9).

    The state has shape ``(..., N, 6)``, twists ordered (omega, v); the flat state is its C-order ravel.

    Attributes:
        alpha: ``(N, N)`` connection strengths.
        rotation: ``(N, N, 3, 3)`` rotations of theta_ij; i receives, j sends.
        translation: ``(N, N, 3)`` translations of theta_ij.
        bias: ``(N, 6)``.
        gamma: decay rate, positive.
        mu: scale of the interaction, positive.
        activation: a name of `ACTIVATIONS`.
        lyapunov_diagonal: ``(3N,)`` diagonal P that certifies W_R, or None. Checked by `certificate`.

    Raises:
        InputError: wrong shapes, entries that are not finite, or rotations that are none.
    """

    alpha: Floats
    rotation: Floats
    translation: Floats
    bias: Floats
    gamma: float = 1.0
    mu: float = 1.0
    activation: str = "tanh"
    lyapunov_diagonal: Floats | None = None

    def __post_init__(self) -> None:
        alpha = as_floats("alpha", self.alpha, ("N", "N"))
        n = len(alpha)
        if n == 0:
            raise InputError("alpha must have shape (N, N) with N >= 1, got (0, 0)")
        checked: dict[str, Floats | float | str | None] = {
            "alpha": alpha,
            "rotation": as_floats("rotation", self.rotation, (n, n, 3, 3)),
            "translation": as_floats("translation", self.translation, (n, n, 3)),
            "bias": as_floats("bias", self.bias, (n, 6)),
            "gamma": as_positive("gamma", self.gamma),
            "mu": as_positive("mu", self.mu),
            "activation": as_choice("activation", self.activation, ACTIVATIONS),
        }
        if self.lyapunov_diagonal is not None:
            checked["lyapunov_diagonal"] = as_floats("lyapunov_diagonal", self.lyapunov_diagonal, (3 * n,))
        for name, value in checked.items():
            if isinstance(value, np.ndarray):
                value = _read_only(value.copy())
            object.__setattr__(self, name, value)
        gram = self.rotation @ np.swapaxes(self.rotation, -1, -2) - np.eye(3)
        if np.abs(gram).max() > _ORTHONORMAL_TOLERANCE or (np.linalg.det(self.rotation) < 0).any():
            raise InputError(
                f"rotation must hold rotation matrices; R R^T differs from I by up to {np.abs(gram).max():.2g} or a "
                "determinant is negative; project with lieednn_sim.lie.project_to_rotation"
            )

    @property
    def n_neurons(self) -> int:
        """N."""
        return len(self.alpha)

    @cached_property
    def blocks(self) -> Floats:
        """Weight blocks alpha_ij Ad(theta_ij), ``(N, N, 6, 6)``."""
        return _read_only(self.alpha[:, :, None, None] * adjoint(self.rotation, self.translation))

    @cached_property
    def weight(self) -> Floats:
        """Flat weight matrix W, ``(6N, 6N)``."""
        return _flatten_blocks(self.blocks)

    @cached_property
    def rotational_weight(self) -> Floats:
        """W_R = [alpha_ij R_ij], ``(3N, 3N)``: the part that decides stability."""
        return _flatten_blocks(self.blocks[..., :3, :3])

    @cached_property
    def certificate(self) -> stability.Certificate | None:
        """The stored Lyapunov diagonal, checked against this network's weights; None when there is none."""
        if self.lyapunov_diagonal is None:
            return None
        return stability.verify(self.lyapunov_diagonal, self.rotational_weight, gamma=self.gamma, mu=self.mu)

    @property
    def certified(self) -> bool:
        """Whether global stability is proved."""
        return self.certificate is not None and self.certificate.valid

    def phi(self, x: Floats) -> Floats:
        """Activation, entry by entry."""
        return ACTIVATIONS[self.activation][0](x)

    def vector_field(self, xi: ArrayLike) -> Floats:
        """Right-hand side in block form, ``(..., N, 6)`` to the same shape."""
        state = as_floats("xi", xi, (self.n_neurons, 6), batched=True)
        drive = np.einsum("ijab,...jb->...ia", self.blocks, self.phi(state))
        return -self.gamma * state + self.mu * (drive + self.bias)

    def flat_vector_field(self, x: Floats) -> Floats:
        """Right-hand side in flat form, ``(6N,)`` to ``(6N,)``; unchecked, for integrators."""
        return -self.gamma * x + self.mu * (self.weight @ self.phi(x) + self.bias.ravel())

    def jacobian(self, xi: ArrayLike) -> Floats:
        """Jacobian of the flat vector field, ``(..., N, 6)`` to ``(..., 6N, 6N)``."""
        state = as_floats("xi", xi, (self.n_neurons, 6), batched=True)
        slope = ACTIVATIONS[self.activation][1](state).reshape(*state.shape[:-2], 1, -1)
        return -self.gamma * np.eye(len(self.weight)) + self.mu * self.weight * slope

    def equilibrium(self, start: ArrayLike | None = None, *, tolerance: float = 1e-12) -> Equilibrium:
        """Find an equilibrium by damped Newton steps, with the flow as fallback; see `dynamics.find_equilibrium`.

        Args:
            start: ``(N, 6)`` first guess, zero by default.
            tolerance: on the largest entry of the vector field, relative to gamma (1 + |xi|); a hundred times as much
                passes where rounding keeps Newton's method from doing better.

        Returns:
            The point found and whether it converged; a certified network has exactly one equilibrium.
        """
        shape = (self.n_neurons, 6)
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
            start: ``(N, 6)`` state at time 0.
            duration: longest time to integrate, in the network's own time.
            until: ``(N, 6)`` state to stop at, usually the equilibrium.
            distance: stop when the largest coordinate of xi - until is below this.
            method: a name of `dynamics.INTEGRATORS`.
            rtol: relative tolerance of the integrator.
            atol: absolute tolerance of the integrator.
        """
        shape = (self.n_neurons, 6)
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
        target = as_floats("xi", xi, (self.n_neurons, 6))
        required = self.gamma / self.mu * target - self.bias
        smallest = stability.smallest_one_norm(self.phi(target), required)
        return stability.norm_conditions(self.weight, smallest, gamma=self.gamma, mu=self.mu)

    def retarget(self, xi: ArrayLike) -> LieEDNN:
        """The same weights with the bias b = (gamma/mu) xi - W phi(xi), which makes ``xi`` the equilibrium.

        The certificate does not depend on the bias: a certified network stays certified.
        """
        target = as_floats("xi", xi, (self.n_neurons, 6))
        drive = (self.weight @ self.phi(target).ravel()).reshape(target.shape)
        network = replace(self, bias=self.gamma / self.mu * target - drive)
        # Weights and proof are the same: hand over what has been computed of them.
        shared = ("blocks", "weight", "rotational_weight", "certificate")
        vars(network).update({name: vars(self)[name] for name in shared if name in vars(self)})
        return network

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the network to an ``.npz`` file, atomically."""
        names = ["alpha", "rotation", "translation", "bias"]
        if self.lyapunov_diagonal is not None:
            names.append("lyapunov_diagonal")
        meta = {"gamma": self.gamma, "mu": self.mu, "activation": self.activation}
        storage.save_arrays(path, "network", {name: getattr(self, name) for name in names}, meta)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> LieEDNN:
        """Read a network; a certificate in the file is verified again from the weights.

        Raises:
            FileError: the file cannot be read, is no network, or carries a certificate that does not hold.
        """
        arrays, meta = storage.load_arrays(path, "network")
        names = ("alpha", "rotation", "translation", "bias")
        values = dict(zip(names, storage.take(arrays, path, *names), strict=True))
        try:
            network = cls(
                **values,
                gamma=meta["gamma"],
                mu=meta["mu"],
                activation=meta["activation"],
                lyapunov_diagonal=arrays.get("lyapunov_diagonal"),
            )
            certificate = network.certificate
        except (KeyError, InputError) as error:
            raise FileError(f"{path} is not a valid network: {error}") from None
        if certificate is not None and not certificate.valid:
            raise FileError(f"{path} carries a certificate that does not hold for its weights ({certificate})")
        return network


def _flatten_blocks(blocks: Floats) -> Floats:
    n, size = blocks.shape[0], blocks.shape[-1]
    return _read_only(np.ascontiguousarray(blocks.transpose(0, 2, 1, 3).reshape(n * size, n * size)))


def _read_only(array: Floats) -> Floats:
    array.setflags(write=False)
    return array
