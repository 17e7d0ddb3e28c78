"""The diagonal-Lyapunov certificate: a proof of global stability that is one vector of positive numbers.

For x' = -gamma x + mu W phi(x) + mu b with every slope of phi in (0, 1]: if a positive diagonal P = S^2 has
lambda_max(sym(S W S^-1)) < gamma/mu, then for every bias b there is exactly one equilibrium and it attracts every start
(Forti and Tesi, IEEE Trans. Circuits Syst. I 42(7), 1995). `docs/mathematics/certificates.md` proves the rate, and why
W of blocks alpha_ij Ad(theta_ij) has such a P exactly when W_R = [alpha_ij R_ij] has one. Hence everything here works
on W_R, of shape (3N, 3N).

The best P is found by the method of centres, which needs only NumPy and has no local minima.
A level lambda is feasible when some positive diagonal P makes F(P) = 2 lambda P - P W - W^T P positive definite. F is
linear in P, so the set of such P is convex, with the barrier -log det F. Its analytic centre, the minimum of the
barrier within bounds on P, is found by Newton's method, and leaves room to lower lambda; so centre and level follow
each other down to the least lambda (Boyd and El Ghaoui, Linear Algebra and its Applications 188, 1993). Each lowering
first follows the tangent of the path of centres, which saves most of the Newton steps.

In relative changes of P the barrier's derivatives need three products of matrices. With M = S W S^-1, A = lambda I - M
and G = (A + A^T)^-1 the gradient is -2 (A G)_ii, the Hessian 2 (G o (A G A^T) + (A G) o (A G)^T), where o multiplies
entry by entry, and the gradient's derivative in lambda is -2 (G - 2 A G G)_ii.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.stability.norms import EPS, as_weight, scale, weighted_norm
from lieednn_sim.validation import LARGEST, as_count, as_floats, as_positive, as_ratio
from lieednn_sim.values import Floats, frozen

# Entries of P further apart prove nothing useful (V would depend on one coordinate only). With `LARGEST`, which bounds
# W, gamma, mu and their inverses, S W S^-1 stays far from overflow, and gamma/mu far from underflow.
_LARGEST_SPREAD = 1e60
_TINY = float(np.finfo(float).tiny)
_LOG_SCALE_BOUND = 8.0  # exp(+-_LOG_SCALE_BOUND) bounds S, so that S W S^-1 stays accurate
_LEAST, _MOST = np.exp(-2.0 * _LOG_SCALE_BOUND), np.exp(2.0 * _LOG_SCALE_BOUND)


@frozen
class Certificate:
    """A proof of global stability: a diagonal Lyapunov matrix P, checked by eigenvalues against one W_R.

    It is valid if lambda_max(sym(S W_R S^-1)) < gamma/mu with S = P^(1/2) (Forti and Tesi, 1995).

    Attributes:
        lyapunov_diagonal: the diagonal of P, ``(3N,)``, geometric mean 1.
        lambda_max: largest eigenvalue of sym(S W_R S^-1), S = P^(1/2).
        rounding: bound on the error of `lambda_max` in floating point.
        bound: gamma/mu.
        gamma: decay rate of an isolated neuron, in 1 / (the network's time).
    """

    lyapunov_diagonal: Floats
    lambda_max: float
    rounding: float
    bound: float
    gamma: float

    @property
    def valid(self) -> bool:
        """Whether the inequality holds in spite of rounding errors."""
        return self.lambda_max + self.rounding < self.bound

    @property
    def margin(self) -> float:
        """Distance to the bound, relative to it; positive when certified."""
        return 1.0 - (self.lambda_max + self.rounding) / self.bound

    @property
    def rate(self) -> float:
        """Proven exponential rate gamma - mu max(lambda_max, 0), at most gamma; 0 when not certified."""
        return self.gamma * min(self.margin, 1.0) if self.valid else 0.0

    def __str__(self) -> str:
        verdict = "globally stable for every bias" if self.valid else "not certified"
        near = f", below by {self.bound - self.lambda_max:.2g}" if self.valid and self.margin < 1e-5 else ""
        return f"{verdict}: lambda_max {self.lambda_max:.6g} against gamma/mu {self.bound:.6g}{near}"


def verify(lyapunov_diagonal: ArrayLike, weight: ArrayLike, *, gamma: float = 1.0, mu: float = 1.0) -> Certificate:
    """Check a diagonal Lyapunov matrix against a weight matrix; no solver, only eigenvalues.

    Args:
        lyapunov_diagonal: diagonal of P, positive, ``(n,)``.
        weight: W_R (or W), ``(n, n)``.
        gamma, mu: decay rate and scale of the interaction, positive.

    Raises:
        InputError: shapes disagree, an entry of the diagonal is not positive, or the numbers are so large, small or far
            apart (entries of P by more than 1e60) that overflow or underflow could invalidate a proof.
    """
    diagonal = as_floats("lyapunov_diagonal", lyapunov_diagonal, ("n",))
    if diagonal.size == 0:
        raise InputError("lyapunov_diagonal must have shape (n,) with n >= 1, got (0,)")
    matrix = as_floats("weight", weight, (diagonal.size, diagonal.size))
    least, most = diagonal.min(), diagonal.max()
    if not least > 0.0:
        raise InputError(f"lyapunov_diagonal must be positive, its smallest entry is {least:g}")
    decay = as_positive("gamma", gamma)
    spread = most / least if least >= 1.0 / LARGEST else np.inf
    if spread > _LARGEST_SPREAD:
        wanted = f"from {1.0 / LARGEST:g}, none more than {_LARGEST_SPREAD:g} times another"
        raise InputError(f"lyapunov_diagonal must have entries {wanted}, got {least:g} to {most:g}")
    root = np.sqrt(diagonal)
    # The quotient first: within the bounds on P it neither overflows nor underflows, nor do its products with W.
    scaled = matrix * (root[:, None] / root)
    # Scaled by a power of two, which is exact, so that the eigensolver and the norm see entries of about 1.
    exponent = int(np.frexp(np.abs(scaled).max())[1])
    unit = np.ldexp(scaled, -exponent)
    # Forming an entry rounds at most five times; the symmetric eigensolver and the reduction, by reflections, are
    # backward stable, with an error below n eps ||A||_2. Both are doubled, in the Frobenius norm. Underflow changes
    # each entry, and the eigenvalue, by less than the smallest normal number.
    relative = (10.0 + 4.0 * diagonal.size) * EPS * np.linalg.norm(unit)
    rounding = float(np.ldexp(relative, exponent)) + (diagonal.size + 1.0) * _TINY
    normal, largest = diagonal * np.exp(-np.log(diagonal).mean()), float(np.ldexp(_largest(unit), exponent))
    return Certificate(normal, largest, rounding, as_ratio(decay, mu), decay)


def _largest(matrix: Floats) -> float:
    """Largest eigenvalue of the symmetric part of ``(n, n)``; fast if few rows are not zero."""
    heard = matrix.any(axis=1)
    few = int(heard.sum())
    if few == 0 or 2 * few >= len(matrix):
        return float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[-1])
    # With rows (A, B) and B^T = Q R, an orthogonal transformation of the other coordinates leaves (A, R^T), and zeros.
    triangle = np.asarray(np.linalg.qr(matrix[heard][:, ~heard].T, "r"))
    rows = np.concatenate([matrix[np.ix_(heard, heard)], triangle.T], axis=1)
    square = np.zeros((rows.shape[1], rows.shape[1]))
    square[:few] = 0.5 * rows
    # The other coordinates add eigenvalues of zero, which do not exceed it, since it has a block of zeros, too.
    return float(np.linalg.eigvalsh(square + square.T)[-1])


def find_certificate(weight: ArrayLike, *, gamma: float = 1.0, mu: float = 1.0, group_size: int = 1) -> Certificate:
    """Search for the diagonal P that minimises lambda_max(sym(S W S^-1)), and verify it; the result may be invalid.

    It follows the path of analytic centres (`minimise_by_centres`) down from the P that weighted norms suggest.
    In P the problem is quasi-convex, so a failure is strong evidence, though no proof, that there is no diagonal P with
    entries within exp(+-16). The result is checked by `verify`.

    Args:
        weight: W_R (or any square matrix), ``(n, n)``.
        gamma, mu: decay rate and scale of the interaction, positive.
        group_size: entries of P are equal within consecutive groups of this size. With 3, P has the form diag(p_i I_3)
            that a network needs whose symmetry is a common rotation of all omega_i.

    Raises:
        InputError: the matrix is not square, or n is not a multiple of `group_size`.
    """
    matrix = as_weight("weight", weight)
    n, size = len(matrix), as_count("group_size", group_size)
    if n % size:
        raise InputError(f"group_size must divide the {n} rows of weight, got {size}")
    # The majorant's left Perron vector over the right one is a diagonal that proves whatever a weighted norm proves.
    weights = weighted_norm(matrix)
    perron = 0.5 * np.log(weights.left / weights.right).reshape(-1, size).mean(axis=1)
    candidates = [np.zeros(n // size), perron, minimise_by_centres(matrix, size, perron)]
    certificates = (verify(np.exp(2.0 * np.repeat(c, size)), matrix, gamma=gamma, mu=mu) for c in candidates)
    return min(certificates, key=lambda certificate: certificate.lambda_max + certificate.rounding)


def known_or_found(lyapunov_diagonal: ArrayLike | None, weight: ArrayLike, *, gamma: float, mu: float) -> Certificate:
    """The certificate of a known diagonal if it is valid, otherwise the best one found."""
    if lyapunov_diagonal is not None:
        certificate = verify(lyapunov_diagonal, weight, gamma=gamma, mu=mu)
        if certificate.valid:
            return certificate
    return find_certificate(weight, gamma=gamma, mu=mu)


def smooth_largest(values: Floats, vectors: Floats, sharpness: float) -> tuple[float, Floats]:
    """Log-sum-exp of ascending eigenvalues, a bound on the largest, and its gradient in the symmetric matrix."""
    exponentials = np.exp(sharpness * (values - values[-1]))
    total = exponentials.sum()
    return float(values[-1] + np.log(total) / sharpness), (vectors * (exponentials / total)) @ vectors.T


def log_scale_gradient(in_scaled: Floats, scaled: Floats) -> Floats:
    """Gradient in log S from the gradient in M = S W S^-1, for dM = diag(ds) M - M diag(ds)."""
    product = in_scaled * scaled
    return product.sum(axis=1) - product.sum(axis=0)


def minimise_by_centres(weight: Floats, group_size: int, start: Floats) -> Floats:
    """Log S ``(n / group_size,)`` that makes the largest eigenvalue of sym(S W S^-1) smallest, with |log S| <= 8.

    Nothing about it is guaranteed: pass it to `stability.verify`. Entries of S are equal within consecutive groups of
    ``group_size``. The initial log S, ``start``, is centred at zero and clipped to the bounds.
    """
    inside = 0.99 * _LOG_SCALE_BOUND
    start = np.clip(start - start.mean(), -inside, inside)
    magnitude = float(np.linalg.norm(scale(weight, np.repeat(start, group_size)), 2))
    if magnitude == 0.0 or len(start) == 1:
        return start
    search = _CentreSearch(weight / magnitude, group_size)
    entries = np.exp(2.0 * start)
    # Gaps above the eigenvalue are in units of |S W S^-1|_2; in the end it is within about n gaps of the least.
    level = search.largest(entries) + 0.03
    try:
        for _ in range(100):
            entries, hessian, slope = search.centre(entries, level)
            gap = level - search.largest(entries)
            if not gap > 1e-8:
                break
            tangent = np.asarray(np.linalg.solve(hessian, slope), np.float64)
            entries, level = search.lower(entries, tangent, level, gap)
    except np.linalg.LinAlgError:
        pass  # the level is so near the least one that F is singular up to rounding
    return 0.5 * np.log(search.best)


class _CentreSearch:
    """The steps of the search, and the best diagonal so far."""

    def __init__(self, weight: Floats, group_size: int) -> None:
        self._weight, self._size = weight, group_size
        self._least = np.inf
        self.best = np.ones(len(weight) // group_size)

    def largest(self, entries: Floats) -> float:
        """Largest eigenvalue of sym(S W S^-1) for the entries ``(g,)`` of P."""
        scaled = self._scaled(entries)
        value = float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[-1])
        if value < self._least:
            self._least, self.best = value, entries
        return value

    def centre(self, entries: Floats, level: float) -> tuple[Floats, Floats, Floats]:
        """The analytic centre of a level feasible for ``entries``, the Hessian there and the gradient's rate in it."""
        for _ in range(30):
            a = level * np.eye(len(self._weight)) - self._scaled(entries)
            g = np.linalg.inv(a + a.T)
            ag = a @ g
            low, high = entries / (entries - _LEAST), entries / (_MOST - entries)
            gradient = self._summed(-2.0 * np.diag(ag)) - low + high
            second = 2.0 * (g * (ag @ a.T) + ag * ag.T)
            hessian = self._summed(self._summed(second).T) + np.diag(low**2 + high**2)
            direction = -np.linalg.solve(hessian, gradient)
            decrement = float(np.sqrt(max(-gradient @ direction, 0.0)))
            if not decrement > 0.3:  # the barrier can then fall by no more than about half the square
                break
            # The damped step of a self-concordant function never leaves its domain.
            entries = entries * (1.0 + direction / (1.0 + decrement))
        return entries, hessian, self._summed(-2.0 * np.diag(g - 2.0 * ag @ g))

    def lower(self, entries: Floats, tangent: Floats, level: float, gap: float) -> tuple[Floats, float]:
        """Entries and level further down the path of centres: most of the longest feasible step along the tangent."""
        step = 64.0 * gap
        while step > 0.5 * gap and not self._has(entries * (1.0 + step * tangent), level - step):
            step *= 0.6
        moved, lower = entries * (1.0 + 0.8 * step * tangent), level - 0.8 * step
        if step > 0.5 * gap and self._has(moved, lower):
            return moved, lower
        return entries, level - 0.9 * gap  # without a step the level falls by less than the gap

    def _has(self, entries: Floats, level: float) -> bool:
        within = bool(entries.min() > _LEAST and entries.max() < _MOST)
        return within and self.largest(entries) < level

    def _scaled(self, entries: Floats) -> Floats:
        return scale(self._weight, np.repeat(0.5 * np.log(entries), self._size))

    def _summed(self, values: Floats) -> Floats:
        """Sums over each group of the first axis."""
        return values.reshape(-1, self._size, *values.shape[1:]).sum(axis=1)
