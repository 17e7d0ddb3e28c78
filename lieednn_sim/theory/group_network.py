"""LieEDNN on any matrix Lie group (paper, Sec. 3.2 and App. D), complex and quaternion-valued networks among them.

The network z_i' = -gamma z_i + mu sum_j w_ij phi(z_j) + mu b_i, with phi on each real component and w_ij from the left,
is not a network on C^x or H^x, as the paper's Discussion has it (`docs/mathematics/groups.md`), but on affine(C^x) or
affine(H^x): with theta = (A, 0) and A the matrix of p -> w p, translations transform by v -> A v, the full product.
They are an invariant subspace when the other coordinates and their bias are 0.

The other coordinates see alpha_ij alone, the translations alpha_ij |theta_ij|: how |w_ij| is shared between the two is
free. We choose alpha_ij = |w_ij| / s and theta_ij = s w_ij / |w_ij| with s so large that the other coordinates decay at
rate gamma/2 at least. W is block diagonal (others, translations), so the network has a certificate exactly when the
complex or quaternion network has one. (With alpha_ij = 1 the others would grow from rounding for N > gamma/mu.)

Complex networks need no scale at all: alpha_ij = |w_ij| and theta_ij the rotation by arg w_ij gives the same on SE(2).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.errors import InputError
from lieednn_sim.network.base import as_rates, as_strengths, checked_fields
from lieednn_sim.network.componentwise import DEFAULT_ACTIVATION, ComponentwiseNetwork, as_activation
from lieednn_sim.theory import groups
from lieednn_sim.theory.matrix_group import MatrixLieGroup, as_numbers
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen, read_only, set_fields


@frozen
class GroupLieEDNN(ComponentwiseNetwork):
    """The paper's network on any matrix Lie group.

    It is X_i' = -gamma X_i + mu sum_j alpha_ij theta_ij phi(X_j) theta_ij^-1 + mu B_i in the Lie algebra (paper,
    eq. 3.9).

    The state ``(..., N, d)`` holds the coordinates of X_i in the basis of the group, and phi acts on each of them: the
    network depends on the basis. theta_ij matters only up to the kernel of Ad: SU(2) gives the networks of SO(3).

    Attributes:
        group: the group, with d coordinates and m x m matrices.
        alpha: ``(N, N)`` connection strengths.
        theta: ``(N, N, m, m)`` group elements; i receives, j sends.
        bias: ``(N, d)``.
        gamma, mu, activation: as of `LieEDNN`.
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
        alpha = as_strengths(self.alpha)
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
    # s, a power of two so that it rounds nothing: the blocks of the other coordinates are orthogonal times alpha, so
    # their matrix is bounded by ||alpha||_2.
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
