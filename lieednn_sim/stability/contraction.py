"""Contraction: the distance between any two solutions falls at a proven rate in one norm.

With P = T^T T positive definite and full, and Q = S^2 positive and diagonal, the distance |e|_P = |T e|_2 of two
solutions falls at the rate gamma - mu v for v = |T^-T S + T W S^-1|_2^2 / 4, which `verify_contraction` evaluates, with
a bound on its rounding. `docs/mathematics/robustness.md` derives this, and what is the least v for Q alone, over all P.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, schur, solve_triangular
from scipy.optimize import minimize_scalar

from lieednn_sim.errors import InputError
from lieednn_sim.stability.certificate import find_certificate, minimise_by_centres
from lieednn_sim.stability.norms import EPS, as_weight, frobenius, scale
from lieednn_sim.validation import as_floats, as_positive, as_ratio
from lieednn_sim.values import Floats, frozen


@frozen
class Contraction:
    """A proof that any two motions of a network approach each other, checked by a spectral norm alone.

    It is the result for one pair (P, Q) and one W: distances in the norm of P fall at the rate `rate`.

    Attributes:
        factor: upper triangular T ``(n, n)`` of the norm |e|_P = |T e|_2, P = T^T T.
        multiplier: the diagonal of Q, ``(n,)``.
        value: the least v for which distances fall at the rate gamma - mu v.
        rounding: bound on the error of `value` in floating point; infinite where T is too ill-conditioned.
        bound: gamma/mu.
        gamma: decay rate of an isolated neuron, in 1 / (the network's time).
    """

    factor: Floats
    multiplier: Floats
    value: float
    rounding: float
    bound: float
    gamma: float

    @property
    def valid(self) -> bool:
        """Whether distances fall in spite of rounding errors."""
        return self.value + self.rounding < self.bound

    @property
    def rate(self) -> float:
        """Proven rate c = gamma - mu v, of |e(t)|_P <= exp(-c t) |e(0)|_P; 0 when not valid."""
        return self.gamma * (1.0 - (self.value + self.rounding) / self.bound) if self.valid else 0.0

    def __str__(self) -> str:
        verdict = f"contracting at a rate of at least {self.rate:.4g}" if self.valid else "not proved to contract"
        return f"{verdict}: {self.value:.6g} against gamma/mu {self.bound:.6g}"


def verify_contraction(
    factor: ArrayLike, multiplier: ArrayLike, weight: ArrayLike, *, gamma: float = 1.0, mu: float = 1.0
) -> Contraction:
    """Check a norm and a multiplier against a weight matrix; no solver, only a spectral norm.

    Args:
        factor: upper triangular T of the norm |T e|_2, with a positive diagonal, ``(n, n)``.
        multiplier: diagonal of Q, positive, ``(n,)``.
        weight: W_R (or W), ``(n, n)``.
        gamma, mu: decay rate and scale of the interaction, positive.

    Raises:
        InputError: shapes disagree, T is not upper triangular or its diagonal or Q not positive.
    """
    matrix = as_weight("weight", weight)
    n = len(matrix)
    upper, diagonal = as_floats("factor", factor, (n, n)), as_floats("multiplier", multiplier, (n,))
    if np.tril(upper, -1).any() or not (np.diag(upper) > 0.0).all():
        raise InputError("factor must be upper triangular with a positive diagonal")
    if not (diagonal > 0.0).all():
        raise InputError(f"multiplier must be positive, its smallest entry is {diagonal.min():g}")
    root = np.sqrt(diagonal)
    # Everything in the coordinates S e, where T becomes T S^-1 and W becomes S W S^-1.
    local = upper / root
    scaled = matrix * (root[:, None] / root)
    inverse = np.asarray(solve_triangular(local, np.eye(n)), np.float64)
    total = inverse.T + local @ scaled
    norm = float(np.linalg.norm(total, 2))
    size, inverse_size = float(np.linalg.norm(local)), float(np.linalg.norm(inverse))
    # Rounding in the entries, in a product of n terms, in the norm, and in the inverse, T^-1 dT T^-1, the largest.
    error = (10.0 + 2.0 * n) * EPS * (inverse_size * (1.0 + size * inverse_size) + 2.0 * size * frobenius(scaled))
    # A triangular factor with a larger condition number has no useful inverse in floating point.
    if size * inverse_size > 1e12 or not np.isfinite(norm + error):
        error = np.inf
    value, rounding = 0.25 * norm**2, float(0.25 * error * (2.0 * norm + error))
    return Contraction(upper, diagonal, value, rounding, as_ratio(as_positive("gamma", gamma), mu), float(gamma))


def find_contraction(
    weight: ArrayLike, *, gamma: float = 1.0, mu: float = 1.0, lyapunov_diagonal: ArrayLike | None = None
) -> Contraction:
    """Search for the norm in which distances fall fastest, and verify it; the result need not be `valid`.

    Q starts as the best diagonal Lyapunov matrix, and is moved once by the method of centres so that the initially
    worst angle counts as well as angle 0, which leaves v a few thousandths above the least possible; P is then the
    stabilising solution of a Riccati equation.

    Args:
        weight: W_R (or any square matrix), ``(n, n)``.
        gamma, mu: decay rate and scale of the interaction, positive.
        lyapunov_diagonal: initial Q ``(n,)``; by default, the best one is searched for.
    """
    matrix = as_weight("weight", weight)
    bound = as_ratio(as_positive("gamma", gamma), mu)
    if lyapunov_diagonal is None:
        lyapunov_diagonal = find_certificate(matrix, gamma=gamma, mu=mu).lyapunov_diagonal
    best = 0.5 * np.log(as_floats("lyapunov_diagonal", lyapunov_diagonal, (len(matrix),)))
    # Scaled to entries of about 1; T scales with the inverse root of W.
    magnitude = float(np.abs(scale(matrix, best)).max()) or 1.0
    unit = matrix / magnitude
    level, angle, symmetric = least_level(scale(unit, best))
    # If the worst angle costs more than a hundredth of gamma/mu, moving Q is worth while.
    if level - symmetric > 0.01 * bound / magnitude:
        # exp(i a) as a real rotation: its Hermitian part keeps its eigenvalues, each twice.
        turn = np.cos(angle) * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        moved = minimise_by_centres(np.kron(unit, block_diag(1.0, turn)), 3, best)
        reached, _, _ = least_level(scale(unit, moved))
        if reached < level:
            best, level = moved, reached
    result = verify_contraction(np.diag(np.exp(best)), np.exp(2.0 * best), matrix, gamma=gamma, mu=mu)
    # P is searched for at distances above the least v, relative to v or gamma/mu, in turn.
    for above in (1e-6, 1e-4, 1e-2, 1.0):
        factor = norm_at(unit, best, level + above * max(level, min(bound / magnitude, 1.0)))
        if factor is not None:
            trial = verify_contraction(factor / np.sqrt(magnitude), np.exp(2.0 * best), matrix, gamma=gamma, mu=mu)
            if trial.value + trial.rounding < result.value + result.rounding:
                return trial
    return result


def least_level(scaled: Floats) -> tuple[float, float, float]:
    """The least level v over all P for the matrix S W S^-1 ``(n, n)``, at least 0.

    Then the angle a in [0, pi/2) at which it is reached, and the value at a = 0 alone, at least 0.
    """

    def level(angle: Floats) -> Floats:
        turned = np.exp(1j * angle)[..., None, None] * scaled
        hermitian = 0.5 * (turned + turned.conj().swapaxes(-1, -2))
        return np.asarray(np.cos(angle) * np.linalg.eigvalsh(hermitian)[..., -1], np.float64)

    angles = np.linspace(0.0, 0.5 * np.pi, 32, endpoint=False)
    levels = level(angles)
    k = int(np.argmax(levels))
    around = angles[max(k - 1, 0)], angles[min(k + 1, len(angles) - 1)]
    near = minimize_scalar(lambda a: -float(level(np.asarray(a))), bounds=around, method="bounded")
    value, angle = max((float(levels[k]), float(angles[k])), (-float(near.fun), float(near.x)))
    return max(value, 0.0), angle, max(float(levels[0]), 0.0)


def norm_at(weight: Floats, log_scale: Floats, level: float) -> Floats | None:
    """T ``(n, n)`` of a well-conditioned P that proves the level v with Q = S^2; None if there is none.

    Equality in the inequality of `docs/mathematics/robustness.md` is a Riccati equation for X = S^-1 P S^-1: with
    M = S W S^-1, (I + X M) (I + X M)^T = 4 v X, of which this is the stabilising solution.
    """
    scaled, n = scale(weight, log_scale), len(weight)
    shifted = scaled - 2.0 * level * np.eye(n)
    try:
        # The stable invariant subspace of the Hamiltonian matrix is spanned by the columns of [I; X].
        _, vectors, stable = schur(np.block([[shifted, scaled @ scaled.T], [-np.eye(n), -shifted.T]]), sort="lhp")
        x = np.linalg.solve(vectors[:n, :n].T, vectors[n:, :n].T)
        factor = np.linalg.cholesky(0.5 * (x + x.T)).T * np.exp(log_scale)
    except np.linalg.LinAlgError:
        return None
    return np.asarray(factor, np.float64) if stable == n else None
