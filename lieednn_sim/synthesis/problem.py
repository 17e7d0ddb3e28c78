"""The synthesis problem: conformal weight blocks that meet linear equations under an eigenvalue bound.

Each block alpha R of W_R is written through an unnormalised quaternion q as sign * |q|^2 R(q), which is quadratic in q.
In these coordinates the equations and the matrix are polynomials, and alpha and R need no separate charts.
The unknowns are the quaternions ``(N, N, 4)`` and log S ``(3N,)`` of the certificate, flattened into one vector.
"""

from __future__ import annotations

import numpy as np

from lieednn_sim.stability import log_scale_gradient, scale, smooth_largest
from lieednn_sim.values import Floats, frozen


def _polarise() -> Floats:
    """Symmetric tensor F ``(3, 3, 4, 4)`` with (|q|^2 R(q))_ab = sum_kl F_abkl q_k q_l, q = (w, x, y, z)."""

    def conformal(q: Floats) -> Floats:
        w, x, y, z = q
        return np.array(
            [
                [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
            ]
        )

    e = np.eye(4)
    return np.stack(
        [
            np.stack([0.25 * (conformal(e[k] + e[m]) - conformal(e[k] - e[m])) for m in range(4)], axis=-1)
            for k in range(4)
        ],
        axis=-2,
    )


QUATERNION_FORM = _polarise()
_FORM_ROWS = np.ascontiguousarray(QUATERNION_FORM.reshape(36, 4).T)


@frozen
class Point:
    """The problem evaluated at one vector of unknowns.

    Attributes:
        unknowns: ``(4 N^2 + 3N,)``.
        slope: ``(N, N, 3, 3, 4)`` half the derivative of each block in its quaternion.
        blocks: ``(N, N, 3, 3)`` the blocks alpha R.
        residual: ``(N, 3, K)`` of the linear equations.
        scaled: ``(3N, 3N)`` S W_R S^-1.
        values: ``(3N,)`` ascending eigenvalues of its symmetric part.
        vectors: ``(3N, 3N)`` their eigenvectors, in columns.
    """

    unknowns: Floats
    slope: Floats
    blocks: Floats
    residual: Floats
    scaled: Floats
    values: Floats
    vectors: Floats


class Problem:
    """W_R inputs = outputs and lambda_max(sym(S W_R S^-1)) < 1, in units of gamma/mu.

    Args:
        inputs: ``(N, 3, K)`` columns that W_R acts on.
        outputs: ``(N, 3, K)`` what it must make of them.
        signs: ``(N, N)`` signs of the blocks' alpha, fixed.
    """

    def __init__(self, inputs: Floats, outputs: Floats, signs: Floats) -> None:
        self.inputs, self.outputs, self.signs = inputs, outputs, signs
        self.n_neurons = len(inputs)
        self.n_quaternion = 4 * self.n_neurons**2
        self.size = 3 * self.n_neurons

    def evaluate(self, unknowns: Floats) -> Point:
        """Evaluate blocks, equations and eigenvalues."""
        n = self.n_neurons
        q = unknowns[: self.n_quaternion].reshape(n, n, 4)
        slope = (q.reshape(-1, 4) @ _FORM_ROWS).reshape(n, n, 3, 3, 4) * self.signs[:, :, None, None, None]
        blocks = (slope @ q[:, :, None, :, None])[..., 0]
        weight = blocks.transpose(0, 2, 1, 3).reshape(self.size, self.size)
        scaled = scale(weight, unknowns[self.n_quaternion :])
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
        residual = (weight @ self.inputs.reshape(self.size, -1)).reshape(self.inputs.shape) - self.outputs
        return Point(unknowns, slope, blocks, residual, scaled, values, vectors)

    def equation_jacobian(self, point: Point) -> Floats:
        """Derivative ``(N, 3 K, 4 N)`` of each neuron's equations in its own row of quaternions."""
        n, k = self.n_neurons, self.inputs.shape[-1]
        return 2.0 * np.einsum("ijabk,jbm->iamjk", point.slope, self.inputs).reshape(n, 3 * k, 4 * n)

    def eigenspace_jacobian(self, point: Point, first: int) -> Floats:
        """Derivatives of v_a^T sym(S W_R S^-1) v_b for a >= first and every b, with the eigenvectors held.

        Returns:
            ``(m, 3N, 4 N^2 + 3N)`` with m = 3N - first.
        """
        n, size = self.n_neurons, self.size
        vectors, rows = point.vectors.T, point.vectors.T[first:]
        m = size - first
        factor = np.exp(point.unknowns[self.n_quaternion :])
        left = (vectors * factor).reshape(size, n, 3)
        right = (vectors / factor).reshape(size, n, 3)
        # images[i, a, (b, j, k)]: how the quaternion of block (i, j) moves that block's action on eigenvector b
        images = np.einsum("ijack,bjc->iabjk", 2.0 * point.slope, right, optimize=False)
        all_images = images.reshape(n, 3, -1)
        own_images = images[:, :, first:].reshape(n, 3, -1)
        forward = left[first:].transpose(1, 0, 2) @ all_images
        backward = left.transpose(1, 0, 2) @ own_images
        result = np.empty((m, size, self.n_quaternion + size))
        result[..., : self.n_quaternion] = 0.5 * (
            forward.reshape(n, m, size, 4 * n).transpose(1, 2, 0, 3)
            + backward.reshape(n, size, m, 4 * n).transpose(2, 1, 0, 3)
        ).reshape(m, size, -1)
        times, transposed = vectors @ point.scaled, vectors @ point.scaled.T
        # d(S W S^-1) = diag(ds) M - M diag(ds) for M = S W S^-1
        result[..., self.n_quaternion :] = 0.5 * (
            rows[:, None] * (transposed - times)[None] + vectors[None] * (transposed - times)[first:, None]
        )
        return result

    def smooth_largest_eigenvalue(self, unknowns: Floats, sharpness: float) -> tuple[float, Floats]:
        """Log-sum-exp bound on lambda_max and its gradient in the unknowns."""
        n = self.n_neurons
        point = self.evaluate(unknowns)
        value, in_scaled = smooth_largest(point.values, point.vectors, sharpness)
        factor = np.exp(unknowns[self.n_quaternion :])
        in_weight = (factor[:, None] * in_scaled / factor).reshape(n, 3, n, 3).transpose(0, 2, 1, 3)
        in_quaternion = 2.0 * np.einsum("ijab,ijabk->ijk", in_weight, point.slope)
        return value, np.concatenate([in_quaternion.ravel(), log_scale_gradient(in_scaled, point.scaled)])

    def flat_residual(self, unknowns: Floats) -> Floats:
        """Equations as one vector ``(3 N K,)``."""
        return self.evaluate(unknowns).residual.ravel()

    def flat_jacobian(self, unknowns: Floats) -> Floats:
        """Derivative of `flat_residual`, ``(3 N K, 4 N^2 + 3N)``."""
        return self.full_jacobian(self.equation_jacobian(self.evaluate(unknowns)))

    def full_jacobian(self, rows: Floats) -> Floats:
        """Place the per-neuron Jacobians of `equation_jacobian` in one matrix."""
        n, height, width = rows.shape
        full = np.zeros((n, height, n, width))
        full[np.arange(n), :, np.arange(n)] = rows
        jacobian = np.zeros((n * height, self.n_quaternion + self.size))
        jacobian[:, : self.n_quaternion] = full.reshape(n * height, -1)
        return jacobian
