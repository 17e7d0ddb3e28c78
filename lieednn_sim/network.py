"""LieEDNN: a Hopfield-like neural ODE on se(3)^N with adjoint weight blocks."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import OdeSolution, solve_ivp

from lieednn_sim import stability, storage
from lieednn_sim.errors import FileError, InputError, LieEDNNError
from lieednn_sim.lie import adjoint
from lieednn_sim.validation import as_choice, as_floats, as_positive

Floats = NDArray[np.float64]

# Odd, bounded activations with slopes in (0, 1]: what the certificate of `stability` assumes. (phi, phi').
ACTIVATIONS: dict[str, tuple[Callable[[Floats], Floats], Callable[[Floats], Floats]]] = {
    "tanh": (np.tanh, lambda x: 1.0 / np.cosh(np.clip(x, -350.0, 350.0)) ** 2),
    "arctan": (lambda x: 2.0 / np.pi * np.arctan(0.5 * np.pi * x), lambda x: 1.0 / (1.0 + (0.5 * np.pi * x) ** 2)),
}

_ORTHONORMAL_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Equilibrium:
    """Result of the search for an equilibrium.

    Attributes:
        success: whether `residual` is below the tolerance.
        message: how the search ended.
        xi: ``(N, 6)`` the point found.
        residual: largest entry of the vector field there.
        spectral_abscissa: largest real part of the Jacobian's eigenvalues; negative when locally stable.
        n_newton: Newton steps taken.
    """

    success: bool
    message: str
    xi: Floats
    residual: float
    spectral_abscissa: float
    n_newton: int


@dataclass(frozen=True)
class Trajectory:
    """Solution xi(t) of the network's equation with dense output.

    Attributes:
        t: ``(K,)`` times of the integrator's steps, in the network's own time.
        xi: ``(K, N, 6)`` states there.
    """

    t: Floats
    xi: Floats
    _dense: OdeSolution = field(repr=False)

    def __call__(self, t: ArrayLike) -> Floats:
        """States ``(..., N, 6)`` at times ``(...)`` inside the integrated range."""
        times = as_floats("t", t, np.shape(t))
        if times.size and (times.min() < self.t[0] or times.max() > self.t[-1]):
            raise InputError(f"t must lie in [{self.t[0]:g}, {self.t[-1]:g}], got {times.min():g} to {times.max():g}")
        flat = self._dense(times.ravel())
        return flat.T.reshape(*times.shape, *self.xi.shape[1:])


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
        return -self.gamma * x + self.mu * (self.weight @ self.phi(x) + self._flat_bias)

    def jacobian(self, xi: ArrayLike) -> Floats:
        """Jacobian of the flat vector field, ``(..., N, 6)`` to ``(..., 6N, 6N)``."""
        state = as_floats("xi", xi, (self.n_neurons, 6), batched=True)
        slope = ACTIVATIONS[self.activation][1](state).reshape(*state.shape[:-2], 1, -1)
        return -self.gamma * np.eye(len(self.weight)) + self.mu * self.weight * slope

    def equilibrium(self, start: ArrayLike | None = None, *, tolerance: float = 1e-12) -> Equilibrium:
        """Find an equilibrium by damped Newton steps; where they stall, follow the flow and try again.

        Args:
            start: ``(N, 6)`` first guess, zero by default.
            tolerance: on the largest entry of the vector field, relative to gamma (1 + |xi|).

        Returns:
            The point found and whether it converged; a certified network has exactly one equilibrium.
        """
        shape = (self.n_neurons, 6)
        x = np.zeros(6 * self.n_neurons) if start is None else as_floats("start", start, shape).ravel().copy()
        steps, how = 0, "Newton converged"
        for attempt in range(3):
            x, n, converged = self._newton(x, tolerance)
            steps += n
            if converged:
                break
            if attempt < 2:
                how = "Newton converged after following the flow"
                flow = solve_ivp(lambda _, y: self.flat_vector_field(y), (0.0, 50.0 * 4**attempt / self.gamma), x)
                x = flow.y[:, -1]
        else:
            how = "no equilibrium found: Newton stalled, also after following the flow; the network may not be stable"
        return Equilibrium(
            success=converged,
            message=how,
            xi=x.reshape(shape),
            residual=float(np.abs(self.flat_vector_field(x)).max()),
            spectral_abscissa=float(np.linalg.eigvals(self.jacobian(x.reshape(shape))).real.max()),
            n_newton=steps,
        )

    def _newton(self, x: Floats, tolerance: float) -> tuple[Floats, int, bool]:
        value = self.flat_vector_field(x)
        for step in range(100):
            limit = tolerance * self.gamma * (1.0 + np.abs(x).max())
            if np.abs(value).max() <= limit:
                return x, step, True
            try:
                direction = np.linalg.solve(self.jacobian(x.reshape(-1, 6)), value)
            except np.linalg.LinAlgError:
                return x, step, False
            fraction = 1.0
            while fraction > 1e-4:
                trial = x - fraction * direction
                trial_value = self.flat_vector_field(trial)
                if np.linalg.norm(trial_value) < (1.0 - 0.5 * fraction) * np.linalg.norm(value) + 1e-300:
                    break
                fraction *= 0.5
            else:
                # At the rounding floor no step can shrink the residual any more.
                return x, step, bool(np.abs(value).max() <= 100.0 * limit)
            x, value = trial, trial_value
        return x, 100, False

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
            method: an explicit or implicit method of `scipy.integrate.solve_ivp`.
            rtol: relative tolerance of the integrator.
            atol: absolute tolerance of the integrator.
        """
        state = as_floats("start", start, (self.n_neurons, 6))
        as_choice("method", method, ("RK45", "DOP853", "Radau", "BDF", "LSODA"))
        events = None
        longest = as_positive("duration", duration)
        if until is not None:
            goal = as_floats("until", until, state.shape).ravel()
            if np.abs(state.ravel() - goal).max() <= distance:
                # An event needs a crossing; there is none when the start is inside, and nothing to integrate.
                longest = min(longest, 1e-9 / self.gamma)

            def events(_: float, x: Floats) -> float:
                return float(np.abs(x - goal).max()) - distance

            events.terminal = True  # type: ignore[attr-defined]  # SciPy's protocol for stopping at an event
        solution = solve_ivp(
            lambda _, x: self.flat_vector_field(x),
            (0.0, longest),
            state.ravel(),
            method=method,
            events=events,
            rtol=rtol,
            atol=atol,
            dense_output=True,
        )
        if not solution.success:
            raise LieEDNNError(f"integration of the network failed: {solution.message}")
        return Trajectory(t=solution.t, xi=solution.y.T.reshape(-1, self.n_neurons, 6), _dense=solution.sol)

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

    @cached_property
    def _flat_bias(self) -> Floats:
        return self.bias.ravel()


def _flatten_blocks(blocks: Floats) -> Floats:
    n, size = blocks.shape[0], blocks.shape[-1]
    return _read_only(np.ascontiguousarray(blocks.transpose(0, 2, 1, 3).reshape(n * size, n * size)))


def _read_only(array: Floats) -> Floats:
    array.setflags(write=False)
    return array
