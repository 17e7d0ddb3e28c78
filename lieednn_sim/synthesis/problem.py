"""The synthesis problem: conformal weight blocks that meet linear equations under an eigenvalue bound.

Each block alpha R of W_R is written through an unnormalised quaternion q as sign * |q|^2 R(q), which is quadratic in q.
In these coordinates the equations and the matrix are polynomials, and alpha and R need no separate charts.
The unknowns are the quaternions ``(N, N, 4)`` and log S ``(3N,)`` of the certificate, flattened into one vector.
A search starts from random signs and quaternions, and a log S that permits a solution.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.stability.certificate import log_scale_gradient, smooth_largest
from lieednn_sim.stability.norms import scale
from lieednn_sim.values import Floats

Indices = NDArray[np.intp]


def _conformal(q: Floats) -> Floats:
    """The matrices |q|^2 R(q), ``(3, 3, ...)``, of quaternions q = (w, x, y, z) ``(..., 4)``."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


# The symmetric tensor F ``(3, 3, 4, 4)`` with (|q|^2 R(q))_ab = sum_kl F_abkl q_k q_l, by polarisation.
_UNITS = np.eye(4)
_FORM = 0.25 * (_conformal(_UNITS[:, None] + _UNITS) - _conformal(_UNITS[:, None] - _UNITS))
_FORM_ROWS = np.ascontiguousarray(_FORM.reshape(36, 4).T)


class Point(NamedTuple):
    """The problem, or each of a stack, evaluated at one vector of unknowns; all may have leading axes."""

    unknowns: Floats  # (4 N^2 + 3N,)
    slope: Floats  # (N, N, 3, 3, 4) half the derivative of each block in its quaternion
    blocks: Floats  # (N, N, 3, 3) the blocks alpha R
    residual: Floats  # (N, 3, K) residual of the linear equations
    scaled: Floats  # (3N, 3N) S W_R S^-1
    values: Floats  # (3N,) ascending eigenvalues of its symmetric part
    vectors: Floats  # (3N, 3N) their eigenvectors, in columns

    def of(self, which: Indices) -> Point:
        """The points of a stack with these indices."""
        return self if len(which) == len(self.unknowns) else Point(*(array[which] for array in self))

    def moved(self, which: Indices, other: Point) -> Point:
        """The stack with the points of another stack at the indices ``which``."""
        if len(which) == len(self.unknowns):
            return other
        for mine, theirs in zip(self, other, strict=True):
            mine[which] = theirs
        return self


@cache
def pairs(size: int, first: int) -> tuple[Indices, Indices]:
    """All (a, b) with a >= first and a >= b, a below ``size``."""
    a, b = np.tril_indices(size)
    return a[a >= first], b[a >= first]


class Problem:
    """W_R inputs = outputs and lambda_max(sym(S W_R S^-1)) < 1, in units of gamma/mu.

    Inputs and outputs have K columns each, ``(N, 3, K)``; the signs ``(N, N)`` of the blocks' alpha are fixed.

    Arguments, unknowns and results may have leading axes, for a stack of independent problems of one size. Products,
    solves and decompositions are those of each problem by itself, so its results in every stack are equal to the bit.
    """

    def __init__(self, inputs: Floats, outputs: Floats, signs: Floats) -> None:
        self.inputs, self.outputs, self.signs = inputs, outputs, signs
        self.n_neurons, _, self.n_columns = inputs.shape[-3:]
        self.n_quaternion = 4 * self.n_neurons**2
        self.size = 3 * self.n_neurons

    def of(self, which: Indices | int) -> Problem:
        """The problems of a stack with these indices; for a single index, one without a leading axis."""
        if not isinstance(which, int) and len(which) == len(self.signs):
            return self
        return Problem(self.inputs[which], self.outputs[which], self.signs[which])

    def blocks(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """The blocks alpha R and half their derivatives in the quaternions, `Point.blocks` and `Point.slope`."""
        n, lead = self.n_neurons, unknowns.shape[:-1]
        q = unknowns[..., : self.n_quaternion].reshape(*lead, n * n, 4)
        slope = (q @ _FORM_ROWS) * self.signs.reshape(*lead, n * n, 1)
        blocks = slope.reshape(*lead, n * n, 9, 4) @ q[..., None]
        return blocks.reshape(*lead, n, n, 3, 3), slope.reshape(*lead, n, n, 3, 3, 4)

    def evaluate(self, unknowns: Floats) -> Point:
        """Evaluate blocks, equations and eigenvalues."""
        lead = unknowns.shape[:-1]
        blocks, slope = self.blocks(unknowns)
        weight = blocks.swapaxes(-3, -2).reshape(*lead, self.size, self.size)
        scaled = scale(weight, unknowns[..., self.n_quaternion :])
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.swapaxes(-1, -2)))
        image = weight @ self.inputs.reshape(*lead, self.size, self.n_columns)
        residual = image.reshape(self.inputs.shape) - self.outputs
        return Point(unknowns, slope, blocks, residual, scaled, values, vectors)

    def equation_jacobian(self, point: Point) -> Floats:
        """Derivative ``(N, 3 K, 4 N)`` of each neuron's equations in its own row of quaternions."""
        n, k, lead = self.n_neurons, self.n_columns, point.unknowns.shape[:-1]
        # (i, j, a, k, m) as products over b of slopes (a k, b) and inputs (b, m) of j
        slope = point.slope.swapaxes(-1, -2).reshape(*lead, n, n, 12, 3)
        moved = (slope @ self.inputs[..., None, :, :, :]).reshape(*lead, n, n, 3, 4, k)
        order = tuple(len(lead) + axis for axis in (0, 2, 4, 1, 3))
        return 2.0 * moved.transpose(*range(len(lead)), *order).reshape(*lead, n, 3 * k, 4 * n)

    def eigenspace_jacobian(self, point: Point, first: int) -> Floats:
        """Derivatives ``(P, 4 N^2 + 3N)`` of v_a^T sym(S W_R S^-1) v_b for all `pairs`, with the eigenvectors held."""
        n, size, lead = self.n_neurons, self.size, point.unknowns.shape[:-1]
        a, b = pairs(size, first)
        vectors = point.vectors.swapaxes(-1, -2)
        factor = np.exp(point.unknowns[..., None, self.n_quaternion :])
        # Each neuron's part of all vectors, (i, a, 3).
        left = (vectors * factor).reshape(*lead, size, n, 3).swapaxes(-3, -2)
        right = (vectors / factor).reshape(*lead, size, n, 3).swapaxes(-3, -2)

        def ordered(array: Floats, *order: int) -> Floats:
            return array.transpose(*range(len(lead)), *(len(lead) + axis for axis in order))

        # images[i, a, (b, j, k)]: how the quaternion of block (i, j) moves that block's action on eigenvector b
        slope = ordered(point.slope, 1, 3, 0, 2, 4).reshape(*lead, n, 3, 12 * n)
        images = np.ascontiguousarray(ordered((right @ slope).reshape(*lead, n, size, n, 3, 4), 2, 3, 1, 0, 4))
        forward = left[..., first:, :] @ images.reshape(*lead, n, 3, -1)
        backward = left @ images[..., first:, :, :].reshape(*lead, n, 3, -1)
        by_row = forward.reshape(*lead, n, -1, 4 * n)[..., (a - first) * size + b, :]
        by_row += backward.reshape(*lead, n, -1, 4 * n)[..., b * (size - first) + a - first, :]
        # d(S W S^-1) = diag(ds) M - M diag(ds) for M = S W S^-1
        change = 0.5 * (vectors @ point.scaled.swapaxes(-1, -2) - vectors @ point.scaled)
        in_log_scale = vectors[..., a, :] * change[..., b, :] + vectors[..., b, :] * change[..., a, :]
        in_quaternion = by_row.swapaxes(-3, -2).reshape(*lead, len(a), self.n_quaternion)
        return np.concatenate([in_quaternion, in_log_scale], axis=-1)

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
        rows = self.equation_jacobian(self.evaluate(unknowns))
        n, height, width = rows.shape
        full = np.zeros((n, height, n, width))
        full[np.arange(n), :, np.arange(n)] = rows
        jacobian = np.zeros((n * height, self.n_quaternion + self.size))
        jacobian[:, : self.n_quaternion] = full.reshape(n * height, -1)
        return jacobian


_SPREADS = np.arange(0.0, 3.0, 0.1)  # candidate differences of log P between helpful and harmful coordinates


def random_starts(
    state: Floats, required: Floats, columns: Sequence[slice], generators: Sequence[np.random.Generator]
) -> tuple[Problem, Floats]:
    """A stack of B random problems (signs of the blocks) and a random start ``(B, 4 N^2 + 3N)``, each by its generator.

    ``state`` is phi(xi) and ``required`` what W phi(xi) must be, both ``(B, N, 6)``; ``columns`` are the parts of the
    twists that W_R must meet by itself.
    """
    count, n = state.shape[:2]
    signs, quaternion, size = np.empty((count, n, n)), np.empty((count, n, n, 4)), np.empty((count, n, n, 1))
    for k, rng in enumerate(generators):
        rng.random(out=signs[k])
        rng.standard_normal(out=quaternion[k])
        rng.standard_normal(out=size[k])
    inputs = np.stack([state[..., part] for part in columns], axis=-1)
    outputs = np.stack([required[..., part] for part in columns], axis=-1)
    problem = Problem(inputs, outputs, np.where(signs < 0.5, 1.0, -1.0))
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion *= np.sqrt(0.3 / np.sqrt(n) * np.abs(size))
    return problem, np.concatenate([quaternion.reshape(count, -1), _log_scale(inputs, outputs)], axis=-1)


def _log_scale(inputs: Floats, outputs: Floats) -> Floats:
    """The log S of least spread with sum_i s_i^2 u_i (c_i - u_i) < 0, without which no weights can be certified."""
    work = (inputs * (outputs - 0.9 * inputs)).sum(axis=-1).reshape(len(inputs), -1)
    helpful = np.where(work < 0.0, 1.0, -1.0)
    # All spreads at once, (B, T, 3N), which takes a quarter of the time of a loop.
    power = np.exp(_SPREADS[:, None] * helpful[:, None])
    enough = (power * work[:, None]).sum(axis=-1) <= -0.1 * (power * np.abs(work)[:, None]).sum(axis=-1)
    enough[:, -1] = True  # if none is enough, the last one is taken
    return 0.5 * _SPREADS[enough.argmax(axis=-1)][:, None] * helpful


def contracted(problem: Problem, start: Floats) -> Floats:
    """Random weights shrunk until lambda_max is at most 0.5, for a bias that is solved for afterwards."""
    unknowns = start.copy()
    unknowns[:, problem.n_quaternion :] = 0.0
    largest = problem.evaluate(unknowns).values[:, -1:]
    unknowns[:, : problem.n_quaternion] *= np.sqrt(0.5 / np.maximum(largest, 0.5))
    return unknowns
