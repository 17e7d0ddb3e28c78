"""Conditions on norms of W: the paper's two norms, log norms, and log norms weighted neuron by neuron.

Between two solutions of x' = -gamma x + mu W phi(x) + mu b, e' = (-gamma I + mu W D) e, where D is diagonal and its
entries, mean slopes of phi, lie in [0, 1]. A log norm of W D that stays at or below v for all such D makes the distance
|e| shrink at the rate gamma - mu v, from everywhere; with v < gamma/mu there is one equilibrium and it attracts all.
A norm bounds the log norm, so it proves the same and never more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen

EPS = float(np.finfo(float).eps)


def smallest_one_norm(output: ArrayLike, required: ArrayLike) -> float:
    """Smallest 1-norm that a matrix W with W output = required can have: ||required||_1 / ||output||_1.

    The output is phi(xi*), of any shape; (gamma/mu) xi* - b, of the same shape, is required. The result is infinite if
    only the output vanishes, and 0 if both do.
    """
    outputs = as_floats("output", output, (), batched=True)
    given, target = np.abs(outputs).sum(), np.abs(as_floats("required", required, outputs.shape)).sum()
    if given == 0.0:
        return 0.0 if target == 0.0 else np.inf
    with np.errstate(over="ignore"):
        return float(target / given)


def as_weight(name: str, value: ArrayLike) -> Floats:
    """Return ``value`` as a square matrix ``(n, n)`` with n >= 1, or raise `InputError`."""
    matrix = as_floats(name, value, ("n", "n"))
    if matrix.size == 0:
        raise InputError(f"{name} must have shape (n, n) with n >= 1, got (0, 0)")
    return matrix


def scale(weight: Floats, log_scale: Floats) -> Floats:
    """S W S^-1 with S = diag(exp(log_scale)); both may have leading axes."""
    factor = np.exp(log_scale)
    return factor[..., :, None] * weight / factor[..., None, :]


def frobenius(matrix: Floats) -> float:
    """Frobenius norm, without overflow of large squares or underflow of small ones."""
    largest = float(np.abs(matrix).max(initial=0.0))
    return largest * float(np.linalg.norm(matrix / largest)) if largest > 0.0 else 0.0


@dataclass(frozen=True)
class LogNorms:
    """Norms and log norms of W, each the largest over all slopes in [0, 1] and rounded up.

    Attributes:
        one_norm: ||W||_1.
        infinity_norm: ||W||_inf.
        norm_sum: max_j sum_i (|w_ij| + |w_ji|), the paper's stability condition before it is split into two norms.
        log_norm_one: max_j max(0, w_jj + sum_{i != j} |w_ij|).
        log_norm_infinity: max_i (max(0, w_ii) + sum_{j != i} |w_ij|); a negative w_ii does not count, since its slope
            may be 0 while the others are 1.
    """

    one_norm: float
    infinity_norm: float
    norm_sum: float
    log_norm_one: float
    log_norm_infinity: float


def log_norms(weight: ArrayLike) -> LogNorms:
    """Evaluate norms and log norms of a weight matrix ``(n, n)``."""
    matrix = as_weight("weight", weight)
    magnitude = np.abs(matrix)
    columns, rows, diagonal = magnitude.sum(axis=0), magnitude.sum(axis=1), np.diag(matrix)
    up = (len(matrix) + 8.0) * EPS  # a sum of n terms rounds n - 1 times; the rest covers the comparison with gamma/mu
    signed = columns - np.abs(diagonal) + diagonal
    clipped = rows - np.abs(diagonal) + np.maximum(diagonal, 0.0)
    return LogNorms(
        one_norm=float(columns.max() * (1.0 + up)),
        infinity_norm=float(rows.max() * (1.0 + up)),
        norm_sum=float((columns + rows).max() * (1.0 + up)),
        log_norm_one=max(0.0, float((signed + up * columns).max())),
        log_norm_infinity=float((clipped + up * rows).max()),
    )


@frozen
class WeightedNorm:
    """The log norm of W in the best weighted 1-norm sum_i p_i |e_i|, for the worst slopes in [0, 1].

    Attributes:
        value: max(0, largest (p^T M)_j / p_j), rounded up; M is the Metzler majorant of W. It lies just above 0 or the
            spectral abscissa of M, the infimum over positive p (Collatz and Wielandt).
        left: ``(n,)`` the weights p, largest entry 1.
        right: ``(n,)`` positive v with M v <= value v up to rounding; diag(p / v) is then a diagonal Lyapunov matrix.
    """

    value: float
    left: Floats
    right: Floats


def weighted_norm(weight: ArrayLike) -> WeightedNorm:
    """Find the weighted 1-norm in which the log norm of W is smallest.

    The majorant M has |w_ij| off the diagonal and w_jj, with its sign, on it: slopes scale whole columns in W D, so the
    log norm of column j is d_j (w_jj + sum_i p_i |w_ij| / p_j), largest at d_j = 0 or 1. For every v above the
    spectral abscissa of M, v I - M is an M-matrix: p = (v I - M^T)^-1 1 is positive and p^T M < v p^T. Bisection finds
    the least v, and p is checked anew, so an inexact solve can only cost sharpness.

    Args:
        weight: W_R (or W), ``(n, n)``.
    """
    matrix = as_weight("weight", weight)
    n = len(matrix)
    # Scaled by a power of two, which is exact, to entries of about 1 for the linear systems.
    exponent = int(np.frexp(np.abs(matrix).max())[1])
    matrix = np.ldexp(matrix, -exponent)
    majorant = np.abs(matrix)
    np.fill_diagonal(majorant, np.diag(matrix))
    best = WeightedNorm(_weighted_log_norm(majorant, np.ones(n)), np.ones(n), np.ones(n))
    low = 0.0
    for _ in range(30):
        level = 0.5 * (low + best.value)
        if best.value - low <= 1e-9 * best.value:
            break
        trial = _positive_vectors(majorant, level)
        if trial is not None and trial.value < best.value:
            best = trial
        else:
            low = level
    value = float(np.ldexp(best.value, exponent))  # underflow in between is less than the smallest normal number
    return replace(best, value=value + float(np.finfo(float).tiny) if value > 0.0 else 0.0)


def _positive_vectors(majorant: Floats, level: float) -> WeightedNorm | None:
    shifted = level * np.eye(len(majorant)) - majorant
    try:
        left = np.linalg.solve(shifted.T, np.ones(len(majorant)))
        right = np.linalg.solve(shifted, np.ones(len(majorant)))
    except np.linalg.LinAlgError:
        return None
    for vector in (left, right):
        # A distance with weights further apart says nothing about the state.
        if not vector.min() > vector.max() / 1e12:
            return None
    left = left / left.max()
    return WeightedNorm(_weighted_log_norm(majorant, left), left, right / right.max())


def _weighted_log_norm(majorant: Floats, left: Floats) -> float:
    rounding = (len(majorant) + 8.0) * EPS * (left @ np.abs(majorant))
    return max(0.0, float(((left @ majorant + rounding) / left).max()))
