"""Networks beyond the printed one on SE(3): on any matrix Lie group, and with an equivariant activation.

Complex and quaternion-valued networks are networks on the groups affine(C^x) and affine(H^x) (paper, Sec. 3.2 and
App. D), whose translations transform by v -> A v with theta = (A, 0) and A the matrix of p -> w p. The translations are
an invariant subspace when the other coordinates and their bias are 0. The weight w_ij acts on the other coordinates by
alpha_ij alone, and on the translations by alpha_ij |theta_ij|: we choose alpha_ij = |w_ij| / s and theta_ij =
s w_ij / |w_ij| with s so large that the others decay at least at rate gamma/2. (With alpha_ij = 1 they would grow from
rounding for N > gamma/mu.) So the network has a certificate exactly when the complex or quaternion network has one.

An activation may commute with the adjoint action (paper, App. N): Phi(X) = tanh(||omega||)/||omega|| X scales the whole
twist X = (omega, v), and is X at omega = 0. `docs/mathematics/groups.md` proves stability with it, by a P that is
constant on each neuron, and says where the paper is read differently here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.errors import InputError
from lieednn_sim.lie import adjoint
from lieednn_sim.network.base import as_rates, checked_fields
from lieednn_sim.network.componentwise import DEFAULT_ACTIVATION, ComponentwiseNetwork, as_activation
from lieednn_sim.network.se3 import RigidNetwork, as_poses, require_rotations
from lieednn_sim.stability.norms import as_weight
from lieednn_sim.theory import groups
from lieednn_sim.theory.matrix_group import MatrixLieGroup, as_numbers
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen, read_only, set_fields

# The derivative of tanh(r)/r over r, in powers of r^2. Below the angle [rad] the series is used: there the closed form
# cancels, and both are good to 3e-14.
_SERIES_ANGLE = 0.1
_SERIES_SLOPE = 2.0 * polynomial.polyder([1.0, -1 / 3, 2 / 15, -17 / 315, 62 / 2835, -1382 / 155925, 21844 / 6081075])


@frozen
class GroupLieEDNN(ComponentwiseNetwork):
    """The paper's network on any matrix Lie group.

    It is X_i' = -gamma X_i + mu sum_j alpha_ij theta_ij phi(X_j) theta_ij^-1 + mu B_i in the Lie algebra (eq. 3.9).

    The state ``(..., N, d)`` holds the coordinates of X_i in the basis of the group, and phi acts on each of them: the
    network depends on the basis. theta_ij matters only up to the kernel of Ad: SU(2) gives the networks of SO(3).

    Attributes:
        group: the group, with d coordinates and m x m matrices.
        alpha: ``(N, N)`` connection strengths.
        theta: ``(N, N, m, m)`` group elements; i receives, j sends.
        bias: ``(N, d)``.
        gamma, mu, activation: as in `LieEDNN`.
        lyapunov_diagonal: ``(dN,)`` diagonal of P that certifies the whole W, or None. Checked by `certificate`.

    Raises:
        InputError: wrong shapes, entries that are not finite, or theta outside the group.
    """

    group: MatrixLieGroup
    alpha: Floats
    theta: NDArray[Any]
    bias: Floats
    gamma: float = 1.0
    mu: float = 1.0
    activation: str = DEFAULT_ACTIVATION
    lyapunov_diagonal: Floats | None = None

    _kind: ClassVar[str] = "group-network"

    def __post_init__(self) -> None:
        alpha = as_weight("alpha", self.alpha)
        n, d = len(alpha), self.group.dimension
        theta = as_numbers("theta", self.theta, (n, n, self.group.size, self.group.size))
        if outside := np.count_nonzero(~self.group.contains(theta)):
            wrong = f"theta must hold elements of {self.group.name}, {outside} of {n * n} are none"
            raise InputError(f"{wrong}; `project_to_adjoint` of the group finds the nearest")
        theta = np.array(theta, dtype=self.group.basis.dtype)
        shared, activation = checked_fields(self, (n, d)), as_activation(self.activation)
        set_fields(self, alpha=alpha, theta=theta, **shared, activation=activation)

    @cached_property
    def blocks(self) -> Floats:
        """Weight blocks alpha_ij L[Ad(theta_ij)], ``(N, N, d, d)``."""
        return read_only(self.alpha[:, :, None, None] * self.group.adjoint(self.theta))

    def _meta(self) -> dict[str, Any]:
        return {"group": groups.catalogue_name(self.group), **super()._meta()}

    @classmethod
    def _from_meta(cls, meta: Mapping[str, Any]) -> dict[str, Any]:
        return {"group": groups.group(str(meta["group"])), **super()._from_meta(meta)}


def complex_network(
    weights: ArrayLike, bias: ArrayLike, *, gamma: float = 1.0, mu: float = 1.0, activation: str = DEFAULT_ACTIVATION
) -> GroupLieEDNN:
    """A complex-valued network as a network on affine(C^x), states ``(..., N, 4)``; see `complex_state`.

    Args:
        weights: w_ij, complex ``(N, N)``.
        bias: b_i, complex ``(N,)``.
        gamma, mu, activation: as in `GroupLieEDNN`; the activation acts on the real and the imaginary part.
    """
    parts = _components("weights", weights), _components("bias", bias)
    return _network(groups.group("C^x"), *parts, gamma, mu, activation)


def quaternion_network(
    weights: ArrayLike, bias: ArrayLike, *, gamma: float = 1.0, mu: float = 1.0, activation: str = DEFAULT_ACTIVATION
) -> GroupLieEDNN:
    """A quaternion-valued network as a network on affine(H^x), states ``(..., N, 8)``; see `quaternion_state`.

    Args:
        weights: w_ij as (w, x, y, z), ``(N, N, 4)``; they multiply from the left.
        bias: b_i, ``(N, 4)``.
        gamma, mu, activation: as in `GroupLieEDNN`; the activation acts on each of the four components.
    """
    return _network(groups.group("H^x"), weights, bias, gamma, mu, activation)


def complex_state(z: ArrayLike) -> Floats:
    """State ``(..., N, 4)`` of a `complex_network` that represents complex numbers z ``(..., N)``."""
    return _embed(_components("z", z))


def complex_values(xi: ArrayLike) -> NDArray[np.complex128]:
    """Inverse of `complex_state`, ``(..., N, 4)`` to ``(..., N)``."""
    state = as_floats("xi", xi, (4,), batched=True)
    return state[..., 2] + 1j * state[..., 3]


def quaternion_state(q: ArrayLike) -> Floats:
    """State ``(..., N, 8)`` of a `quaternion_network` that represents quaternions (w, x, y, z) ``(..., N, 4)``."""
    return _embed(as_floats("q", q, (4,), batched=True))


def quaternion_values(xi: ArrayLike) -> Floats:
    """Inverse of `quaternion_state`, ``(..., N, 8)`` to ``(..., N, 4)``."""
    return as_floats("xi", xi, (8,), batched=True)[..., 4:]


def _network(
    algebra: MatrixLieGroup, weights: ArrayLike, bias: ArrayLike, gamma: float, mu: float, activation: str
) -> GroupLieEDNN:
    size = algebra.size
    given = as_floats("weights", weights, ("N", "N", size))
    n = len(given)
    if n == 0:
        raise InputError("weights must have N >= 1 rows and columns, got none")
    rates = as_rates(gamma, mu)
    modulus = np.linalg.norm(given, axis=-1)
    # s is a power of two, which causes no rounding. The blocks of the other coordinates are orthogonal times alpha, so
    # the norm of their matrix is at most ||alpha||_2.
    needed = 2.0 * rates["mu"] / rates["gamma"] * float(np.linalg.norm(modulus, 2))
    scale = 2.0 ** np.ceil(np.log2(max(needed, 1.0)))
    theta = np.broadcast_to(np.eye(size + 1), (n, n, size + 1, size + 1)).copy()
    linked = modulus > 0.0
    # The Lie algebra of C^x is C itself, with basis 1, i, and that of H^x is H: `hat` is the matrix of the product.
    theta[linked, :size, :size] = scale * algebra.hat(given[linked] / modulus[linked][:, None])
    parts = modulus / scale, theta, _embed(as_floats("bias", bias, (n, size)))
    return GroupLieEDNN(groups.affine(algebra), *parts, rates["gamma"], rates["mu"], activation)


def _embed(components: Floats) -> Floats:
    return np.concatenate([np.zeros_like(components), components], axis=-1)


def _components(name: str, value: ArrayLike) -> Floats:
    """Real and imaginary part along a new last axis."""
    array = as_numbers(name, value, (), batched=True)
    return np.stack([array.real, array.imag], axis=-1)


@frozen
class EquivariantLieEDNN(RigidNetwork):
    """A network on se(3)^N whose activation Phi commutes with the adjoint, so that it commutes with changes of frame.

    It is x_i' = -gamma x_i + mu sum_j alpha_ij Ad(theta_ij) Phi(x_j) + mu b_i, with Phi of the paper's appendix N.

    Attributes:
        alpha, rotation, translation, bias, gamma, mu: as in `LieEDNN`.
        lyapunov_diagonal: ``(N,)`` p with P = diag(p_i I_3) certifying W_R, or None. Checked by `certificate`.

    Raises:
        InputError: wrong shapes, entries that are not finite, or matrices that are not rotations.
    """

    alpha: Floats
    rotation: Floats
    translation: Floats
    bias: Floats
    gamma: float = 1.0
    mu: float = 1.0
    lyapunov_diagonal: Floats | None = None

    _kind: ClassVar[str] = "equivariant-network"
    _rows_alike: ClassVar[int] = 3

    def __post_init__(self) -> None:
        alpha = as_weight("alpha", self.alpha)
        poses = as_poses(self.rotation, self.translation, alpha)
        set_fields(self, alpha=alpha, **poses, **checked_fields(self, (len(alpha), 6), len(alpha)))

    def phi(self, x: Floats) -> Floats:
        """Activation Phi of twists ``(..., 6)``: the whole twist, scaled by tanh(||omega||)/||omega||; unchecked."""
        return _gain(_length(x[..., :3]))[..., None] * x

    def phi_jacobian(self, x: Floats) -> Floats:
        """Jacobian of `phi` on each twist, ``(..., 6)`` to ``(..., 6, 6)``: g I + X [grad g, 0]; unchecked."""
        omega = x[..., :3]
        r = _length(omega)
        gain, gradient = _gain(r), _slope(r)[..., None] * omega
        result: Floats = gain[..., None, None] * np.eye(6)
        result[..., :3] += x[..., :, None] * gradient[..., None, :]
        return result

    def transform(self, rotation: ArrayLike, translation: ArrayLike) -> EquivariantLieEDNN:
        """The same network seen from other frames: theta_ij -> h_i theta_ij h_j^-1 and b_i -> Ad(h_i) b_i.

        The trajectory from Ad(h_i) xi_i(0) of the returned network is Ad(h_i) xi_i(t), and its certificate is the same.

        Args:
            rotation: rotation of h, ``(3, 3)`` for one frame of all neurons (the paper's case), or ``(N, 3, 3)``.
            translation: translation of h, ``(3,)`` or ``(N, 3)``.
        """
        n = self.n_neurons
        turns = as_floats("rotation", rotation, (), batched=True)
        turns = as_floats("rotation", turns, (n, 3, 3) if turns.ndim == 3 else (3, 3))
        moves = as_floats("translation", translation, (), batched=True)
        moves = as_floats("translation", moves, (n, 3) if moves.ndim == 2 else (3,))
        require_rotations(turns)
        q, s = np.broadcast_to(turns, (n, 3, 3)), np.broadcast_to(moves, (n, 3))
        turned = q[:, None] @ self.rotation @ np.swapaxes(q, -1, -2)
        moved = np.einsum("iab,ijb->ija", q, self.translation) + s[:, None] - np.einsum("ijab,jb->ija", turned, s)
        bias = np.einsum("iab,ib->ia", adjoint(q, s), self.bias)
        return replace(self, rotation=turned, translation=moved, bias=bias)

    def _driven(self, state: Floats) -> Floats:
        driven = self.blocks[: self.n_driven]
        product = np.einsum("ijab,...jbc->...iajc", driven, self.phi_jacobian(state))
        return product.reshape(*state.shape[:-2], 6 * self.n_driven, self.bias.size)


def _length(omega: Floats) -> Floats:
    """The norm r = ||omega||, ``(..., 3)`` to ``(...)``; hypot neither overflows nor underflows."""
    return np.asarray(np.hypot(np.hypot(omega[..., 0], omega[..., 1]), omega[..., 2]))


def _gain(r: Floats) -> Floats:
    """Factor g = tanh(r)/r, 1 at r = 0."""
    safe = np.maximum(r, np.finfo(float).tiny)
    return np.asarray(np.tanh(safe) / safe)


def _slope(r: Floats) -> Floats:
    """Factor s = g'(r)/r: the gradient of g in omega is s omega."""
    small = r < _SERIES_ANGLE
    x = np.where(small, 1.0, r)
    closed = (1.0 / np.cosh(np.minimum(x, 350.0)) ** 2 - np.tanh(x) / x) / x / x
    return np.where(small, polynomial.polyval(np.where(small, r, 0.0) ** 2, _SERIES_SLOPE), closed)
