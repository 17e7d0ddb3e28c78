"""LieEDNN with an activation that commutes with the adjoint action (paper, App. N).

Phi(X) = tanh(||omega||)/||omega|| X scales the whole twist X = (omega, v). Ad_h turns omega by a rotation, so the
factor is invariant and Phi(Ad_h X) = Ad_h Phi(X). It is continuous at omega = 0, with value X.

Frames: if each neuron is written in a frame of its own, X_i -> Ad(h_i) X_i, then theta_ij -> h_i theta_ij h_j^-1 and
b_i -> Ad(h_i) b_i describe the same network. The paper's theta_ij -> h theta_ij h^-1 is the case of one common h.

Stability. Phi is unbounded and not globally Lipschitz in (omega, v), so the theorem of `stability` does not apply to W.
It follows by the cascade from a P = diag(p_i I_3) with P (W_R - (gamma/mu) I) negative definite in its symmetric part;
`docs/mathematics/groups.md` has the proof. P is constant on each neuron, so the proof is as invariant as the network.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike

from lieednn_sim.lie import adjoint
from lieednn_sim.network.base import as_strengths, checked_fields
from lieednn_sim.network.se3 import RigidNetwork, as_poses, require_rotations
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen, set_fields

# The derivative of tanh(r)/r over r, in powers of r^2. Below the angle [rad] the series is used: there the closed form
# cancels, and both are good to 3e-14.
_SERIES_ANGLE = 0.1
_SERIES_SLOPE = 2.0 * polynomial.polyder([1.0, -1 / 3, 2 / 15, -17 / 315, 62 / 2835, -1382 / 155925, 21844 / 6081075])


@frozen
class EquivariantLieEDNN(RigidNetwork):
    """A network on se(3)^N whose activation Phi commutes with the adjoint, so that it commutes with changes of frame.

    It is x_i' = -gamma x_i + mu sum_j alpha_ij Ad(theta_ij) Phi(x_j) + mu b_i, with Phi of the paper's appendix N.

    Attributes:
        alpha, rotation, translation: ``(N, N)``, ``(N, N, 3, 3)`` and ``(N, N, 3)``, as of `LieEDNN`.
        bias: ``(N, 6)``, twists ordered (omega, v).
        gamma, mu: decay rate and scale of the interaction, positive.
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
        alpha = as_strengths(self.alpha)
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
            rotation: rotation of h, ``(3, 3)`` for one frame common to all neurons (the paper's case), or
                ``(N, 3, 3)``.
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
