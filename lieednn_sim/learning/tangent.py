"""Tangent vectors of the weight manifold R^(N x N) x SE(3)^(N x N), and derivatives along them.

A step has the coordinates (d_alpha, omega, d_t) at block (i, j), shape ``(N, N, 7)``. It is taken by the retraction of
the product R x SO(3) x R^3, not by the exponential of SE(3):

    alpha + d_alpha,  Exp(hat(omega)) R,  t + d_t.

The metric is Euclidean in these coordinates, so a Riemannian gradient is the list of plain derivatives in them.

Row i of W y, y = phi(x), depends on the blocks (i, j) only: equations on W y are N systems with 6 rows, 7N unknowns.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from lieednn_sim.learning.equilibria import SensitivityMatrix
from lieednn_sim.learning.manifold import SE3Weights, WeightPoint, block_view
from lieednn_sim.lie import hat, vee
from lieednn_sim.network.base import flatten_blocks
from lieednn_sim.stability.certificate import log_scale_gradient, smooth_largest
from lieednn_sim.stability.norms import scale
from lieednn_sim.values import Floats

_SE3 = SE3Weights()


def retract(point: WeightPoint, step: Floats) -> WeightPoint:
    """The point a step ``(N, N, 7)`` away; on the manifold, up to rounding, for a step of any length."""
    turn = Rotation.from_rotvec(step[..., 1:4]).as_matrix()
    theta = {
        "rotation": turn @ point.elements["rotation"],
        "translation": point.elements["translation"] + step[..., 4:],
    }
    return _SE3.point(point.alpha + step[..., 0], theta)


def differential(point: WeightPoint, output: Floats) -> Floats:
    """Derivative of row block i of W y in the coordinates of the blocks (i, j), ``(N, 6, 7N)``.

    With (u, v) = Ad(theta_ij) y_j, block (i, j) alone gives alpha_ij (u, v), whose derivative is

        (u, v) d_alpha - alpha_ij [[hat(u), 0], [hat(v) + hat(u) hat(t), hat(u)]] (omega, d_t):

    turning R while t stays is to move theta from the left by the twist (omega, t x omega), shifting t by (0, d_t).

    Args:
        point: weights.
        output: ``(6N,)`` y.
    """
    n = len(point.alpha)
    images = np.einsum("ijab,jb->ija", point.adjoints, output.reshape(n, 6))
    u, v, t = hat(np.stack([images[..., :3], images[..., 3:], point.elements["translation"]]))
    alpha = point.alpha[:, :, None, None]
    blocks = np.zeros((n, n, 6, 7))
    blocks[..., 0] = images
    blocks[..., :3, 1:4] = blocks[..., 3:, 4:] = -alpha * u
    blocks[..., 3:, 1:4] = -alpha * (v + u @ t)
    return blocks.transpose(0, 2, 1, 3).reshape(n, 6, 7 * n)


def loss_gradient(rows: Floats, nearby: SensitivityMatrix, delta: Floats, ratio: float) -> Floats:
    """Riemannian gradient (mu/gamma) B^T S^-T delta of E^2/2, ``(N, N, 7)``.

    Args:
        rows: ``(N, 6, 7N)`` B, from `differential`.
        nearby: S, not singular.
        delta: ``(6N,)`` xi* - xi_d.
        ratio: mu/gamma.
    """
    n = len(rows)
    multiplier = nearby.solve_transposed(ratio * delta).reshape(n, 1, 6)
    return (multiplier @ rows).reshape(n, n, 7)


def rotational_weight(point: WeightPoint) -> Floats:
    """W_R = [alpha_ij R_ij], ``(3N, 3N)``."""
    return flatten_blocks(point.alpha[:, :, None, None] * point.elements["rotation"])


def smoothed_eigenvalue(
    point: WeightPoint, log_scale: Floats, ratio: float, sharpness: float
) -> tuple[float, Floats, Floats]:
    """Log-sum-exp bound on the largest eigenvalue of sym(M), M = (mu/gamma) S W_R S^-1, and its gradients.

    With G the gradient in W_R, that in block (i, j) is <G, d_alpha R + hat(omega) alpha R> = d_alpha <G, R>
    + omega . 2 vee(alpha G R^T); it does not depend on translations.

    Args:
        point: weights.
        log_scale: ``(3N,)`` log S.
        ratio: mu/gamma.
        sharpness: sharpness of the log-sum-exp.

    Returns:
        The bound, the Riemannian gradient ``(N, N, 7)``, and the gradient in log S ``(3N,)``.
    """
    scaled = ratio * scale(rotational_weight(point), log_scale)
    value, in_scaled = smooth_largest(*np.linalg.eigh(0.5 * (scaled + scaled.T)), sharpness)
    # <H, S dW S^-1> = <S H S^-1, dW>: the scaling is symmetric.
    in_weight, rotation = block_view(ratio * scale(in_scaled, log_scale), 3), point.elements["rotation"]
    gradient = np.zeros((*point.alpha.shape, 7))
    gradient[..., 0] = np.einsum("ijab,ijab->ij", in_weight, rotation)
    gradient[..., 1:4] = 2.0 * point.alpha[..., None] * vee(in_weight @ rotation.swapaxes(-1, -2))
    return value, gradient, log_scale_gradient(in_scaled, scaled)


class RowEquations:
    """The N linear systems B_i p_i = r_i on a step's rows p_i, each with fewer equations than unknowns.

    Solved by (B_i B_i^T + damping I) z_i = r_i and p_i = B_i^T z_i (Levenberg): the shortest solution when the damping
    is small against the squared singular values of B_i, and still a short one where these vanish.

    Args:
        rows: ``(N, 6, 7N)`` B, from `differential`.
        damping: positive.
    """

    def __init__(self, rows: Floats, damping: float) -> None:
        self._rows = rows
        self._gram = rows @ rows.swapaxes(1, 2) + damping * np.eye(rows.shape[1])

    def shortest(self, right: Floats) -> Floats:
        """The step ``(N, N, 7)`` for right-hand sides ``(6N,)``."""
        n = len(self._rows)
        multiplier = np.linalg.solve(self._gram, right.reshape(n, -1, 1))
        return (self._rows.swapaxes(1, 2) @ multiplier).reshape(n, n, 7)

    def neutral(self, step: Floats) -> Floats:
        """The part of a step that changes no left-hand side: its orthogonal projection onto the null space."""
        n = len(self._rows)
        return step - self.shortest(self._rows @ step.reshape(n, -1, 1))
