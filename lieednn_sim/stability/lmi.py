"""The best diagonal Lyapunov matrix by linear matrix inequalities; needs the extra `lmi` (cvxpy with Clarabel)."""

from __future__ import annotations

import warnings

import numpy as np

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.values import Floats

# Bisection stops at this fraction of ||W||_2; the interior-point answers are not sharper.
_RELATIVE_TOLERANCE = 1e-6
# Entries of P relative to the largest: beyond this the check by eigenvalues loses its digits.
_SMALLEST_ENTRY = 1e-8


def minimise_largest_eigenvalue(weight: Floats, group_size: int = 1) -> Floats:
    """Diagonal P ``(n,)`` with the least lambda such that P W + W^T P <= 2 lambda P, a generalised eigenvalue problem.

    See Boyd, El Ghaoui, Feron and Balakrishnan, Linear Matrix Inequalities in System and Control Theory, 1994. For a
    fixed lambda the inequality is linear in P; its largest margin t with P W + W^T P - 2 lambda P <= -t I and P <= I is
    positive exactly when a smaller lambda is feasible. Bisection on lambda takes the largest eigenvalue of each
    solution as the new upper end.

    Args:
        weight: ``(n, n)``, n a multiple of `group_size`.
        group_size: entries of P are equal within consecutive groups of this size.

    Returns:
        A positive diagonal. Nothing about it is guaranteed: pass it to `stability.verify`.

    Raises:
        LieEDNNError: cvxpy is not installed.
    """
    try:
        import cvxpy as cp
    except ImportError:
        raise LieEDNNError("method 'lmi' needs cvxpy: pip install 'lieednn_sim[lmi]'") from None
    n = len(weight)
    magnitude = max(float(np.linalg.norm(weight, 2)), np.finfo(float).tiny)
    matrix = weight / magnitude
    entries = cp.Variable(n // group_size)
    diagonal = cp.diag(np.kron(np.eye(n // group_size), np.ones((group_size, 1))) @ entries)
    margin, level = cp.Variable(), cp.Parameter()
    product = diagonal @ matrix
    problem = cp.Problem(
        cp.Maximize(margin),
        [
            product + product.T - 2.0 * level * diagonal << -margin * np.eye(n),
            entries >= _SMALLEST_ENTRY,
            entries <= 1.0,
        ],
    )
    best = np.ones(n)
    high = _largest_eigenvalue(best, matrix)
    # The scaling changes neither the spectrum nor the diagonal, and both lie below the largest eigenvalue.
    low = max(float(np.linalg.eigvals(matrix).real.max()), float(np.diag(matrix).max()))
    while high - low > _RELATIVE_TOLERANCE:
        level.value = 0.5 * (low + high)
        with warnings.catch_warnings():
            # An inaccurate solution does no harm: only its own eigenvalues count.
            warnings.simplefilter("ignore")
            try:
                problem.solve(solver=cp.CLARABEL)
            except cp.error.SolverError:
                break
        reached = np.inf
        if entries.value is not None:
            found: Floats = np.repeat(np.maximum(entries.value, _SMALLEST_ENTRY), group_size)
            reached = _largest_eigenvalue(found, matrix)
            if reached < high:
                best, high = found, reached
        if reached >= level.value:
            low = level.value
    return best


def _largest_eigenvalue(diagonal: Floats, weight: Floats) -> float:
    root = np.sqrt(diagonal)
    scaled = root[:, None] * weight / root
    return float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[-1])
