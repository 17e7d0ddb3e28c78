"""Proofs of global stability: the diagonal-Lyapunov certificate and the paper's norm conditions.

For x' = -gamma x + mu W phi(x) + mu b with every slope of phi in (0, 1]: if a positive diagonal P makes
P (W - (gamma/mu) I) negative definite in its symmetric part, then for every bias b there is exactly one equilibrium and
it attracts every start (Forti and Tesi, IEEE Trans. Circuits Syst. I 42(7), 1995). With S = P^(1/2) the condition reads
lambda_max(sym(S W S^-1)) < gamma/mu.

The adjoint of SE(3) lets rotation drive translation and never the reverse, so with all omega sorted before all v
W = [[W_R, 0], [W_C, W_R]] with W_R = [alpha_ij R_ij]. W has such a P exactly when W_R has one: take
diag(P_R, eps P_R) with eps small. Hence everything here works on W_R, of shape (3N, 3N).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize

from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats, as_positive

Floats = NDArray[np.float64]

# exp(+-_LOG_SCALE_BOUND) bounds S, so that S W S^-1 keeps its digits.
_LOG_SCALE_BOUND = 8.0


@dataclass(frozen=True)
class Certificate:
    """Verdict on one diagonal P for one W_R, decided by eigenvalues alone.

    Attributes:
        lyapunov_diagonal: the diagonal of P, ``(3N,)``, geometric mean 1.
        lambda_max: largest eigenvalue of sym(S W_R S^-1), S = P^(1/2).
        rounding: bound on the error of `lambda_max` in floating point.
        bound: gamma/mu.
    """

    lyapunov_diagonal: Floats
    lambda_max: float
    rounding: float
    bound: float

    @property
    def valid(self) -> bool:
        """Whether the inequality holds with the rounding error on the unsafe side."""
        return self.lambda_max + self.rounding < self.bound

    @property
    def margin(self) -> float:
        """Distance to the bound, relative to it; positive when certified."""
        return 1.0 - (self.lambda_max + self.rounding) / self.bound

    def __str__(self) -> str:
        verdict = "globally stable for every bias" if self.valid else "not certified"
        return f"{verdict}: lambda_max {self.lambda_max:.6g} against gamma/mu {self.bound:.6g}"


def verify(lyapunov_diagonal: ArrayLike, weight: ArrayLike, *, gamma: float = 1.0, mu: float = 1.0) -> Certificate:
    """Check a diagonal Lyapunov matrix against a weight matrix; no solver, only eigenvalues.

    Args:
        lyapunov_diagonal: diagonal of P, positive, ``(n,)``.
        weight: W_R (or W), ``(n, n)``.

    Raises:
        InputError: shapes disagree, or an entry of the diagonal is not positive.
    """
    diagonal = as_floats("lyapunov_diagonal", lyapunov_diagonal, ("n",))
    if diagonal.size == 0:
        raise InputError("lyapunov_diagonal must have shape (n,) with n >= 1, got (0,)")
    matrix = as_floats("weight", weight, (diagonal.size, diagonal.size))
    if not (diagonal > 0).all():
        raise InputError(f"lyapunov_diagonal must be positive, its smallest entry is {diagonal.min():g}")
    log_scale = 0.5 * np.log(diagonal)
    log_scale -= log_scale.mean()
    scaled = scale(matrix, log_scale)
    symmetric = 0.5 * (scaled + scaled.T)
    # Forming an entry rounds at most five times; the symmetric eigensolver is backward stable, with an error
    # below n eps ||A||_2. Both are taken twice over, in the Frobenius norm.
    rounding = (10.0 + 2.0 * diagonal.size) * np.finfo(float).eps * float(np.linalg.norm(scaled))
    return Certificate(
        lyapunov_diagonal=np.exp(2.0 * log_scale),
        lambda_max=float(np.linalg.eigvalsh(symmetric)[-1]),
        rounding=rounding,
        bound=as_positive("gamma", gamma) / as_positive("mu", mu),
    )


def find_certificate(weight: ArrayLike, *, gamma: float = 1.0, mu: float = 1.0) -> Certificate:
    """Search the diagonal P that makes lambda_max(sym(S W S^-1)) smallest, and verify it.

    A smoothed largest eigenvalue is minimised over log S (L-BFGS-B, analytic gradient), sharpened in four steps. In P
    the problem is quasi-convex, so a failure is strong evidence, though no proof, that no diagonal P exists.

    Args:
        weight: W_R (or any square matrix), ``(n, n)``.

    Returns:
        The best certificate found; look at its `valid`.
    """
    matrix = as_floats("weight", weight, ("n", "n"))
    if matrix.size == 0:
        raise InputError("weight must have shape (n, n) with n >= 1, got (0, 0)")
    bound = as_positive("gamma", gamma) / as_positive("mu", mu)
    log_scale = np.zeros(len(matrix))
    best = verify(np.ones(len(matrix)), matrix, gamma=gamma, mu=mu)
    magnitude = max(float(np.linalg.norm(matrix, 2)), np.finfo(float).tiny)
    for sharpness in (4.0, 16.0, 64.0, 256.0):
        found = minimize(
            _smooth_largest_eigenvalue,
            log_scale,
            args=(matrix / magnitude, sharpness),
            jac=True,
            method="L-BFGS-B",
            bounds=[(-_LOG_SCALE_BOUND, _LOG_SCALE_BOUND)] * len(matrix),
        )
        log_scale = found.x
        candidate = verify(np.exp(2.0 * log_scale), matrix, gamma=gamma, mu=mu)
        if candidate.lambda_max < best.lambda_max:
            best = candidate
        if best.lambda_max < 0.9 * bound:
            break
    return best


def scale(weight: Floats, log_scale: Floats) -> Floats:
    """S W S^-1 with S = diag(exp(log_scale))."""
    factor = np.exp(log_scale)
    return factor[:, None] * weight / factor


def smooth_largest(values: Floats, vectors: Floats, sharpness: float) -> tuple[float, Floats]:
    """Log-sum-exp of ascending eigenvalues, a bound on the largest, and its gradient in the symmetric matrix."""
    exponentials = np.exp(sharpness * (values - values[-1]))
    total = exponentials.sum()
    return float(values[-1] + np.log(total) / sharpness), (vectors * (exponentials / total)) @ vectors.T


def log_scale_gradient(in_scaled: Floats, scaled: Floats) -> Floats:
    """Gradient in log S from the gradient in M = S W S^-1, for dM = diag(ds) M - M diag(ds)."""
    product = in_scaled * scaled
    return product.sum(axis=1) - product.sum(axis=0)


def _smooth_largest_eigenvalue(log_scale: Floats, weight: Floats, sharpness: float) -> tuple[float, Floats]:
    """Log-sum-exp of the eigenvalues of sym(S W S^-1), and its gradient in log S."""
    scaled = scale(weight, log_scale)
    value, in_scaled = smooth_largest(*np.linalg.eigh(0.5 * (scaled + scaled.T)), sharpness)
    return value, log_scale_gradient(in_scaled, scaled)


@dataclass(frozen=True)
class NormConditions:
    """The paper's sufficient conditions (its theorem on equilibrium and asymptotic stability, App. G and I).

    Attributes:
        one_norm: largest column sum of absolute weights of W.
        infinity_norm: largest row sum.
        bound: gamma/mu.
        smallest_one_norm: no network with this equilibrium and bias has a smaller 1-norm.
    """

    one_norm: float
    infinity_norm: float
    bound: float
    smallest_one_norm: float

    @property
    def unique(self) -> bool:
        """||W||_1 < gamma/mu: the equilibrium exists and is unique."""
        return self.one_norm < self.bound

    @property
    def stable(self) -> bool:
        """||W||_1 + ||W||_inf < 2 gamma/mu: the equilibrium is asymptotically stable."""
        return self.one_norm + self.infinity_norm < 2.0 * self.bound

    @property
    def possible(self) -> bool:
        """Whether any network at all with this equilibrium and bias could meet the 1-norm condition."""
        return self.smallest_one_norm < self.bound


def norm_conditions(weight: ArrayLike, smallest: float, *, gamma: float = 1.0, mu: float = 1.0) -> NormConditions:
    """Evaluate the paper's norm conditions on the whole W ``(6N, 6N)``; `smallest` is of `smallest_one_norm`."""
    matrix = as_floats("weight", weight, ("n", "n"))
    return NormConditions(
        one_norm=float(np.linalg.norm(matrix, 1)),
        infinity_norm=float(np.linalg.norm(matrix, np.inf)),
        bound=as_positive("gamma", gamma) / as_positive("mu", mu),
        smallest_one_norm=smallest,
    )


def smallest_one_norm(output: ArrayLike, required: ArrayLike) -> float:
    """Smallest 1-norm of any W with W output = required, which is ||required||_1 / ||output||_1.

    Args:
        output: phi(xi*), any shape.
        required: (gamma/mu) xi* - b, the same shape.

    Returns:
        The ratio; infinite when the output vanishes and the requirement does not, 0 when both vanish.
    """
    given = np.abs(as_floats("output", output, np.shape(output))).sum()
    wanted = np.abs(as_floats("required", required, np.shape(output))).sum()
    if given == 0.0:
        return 0.0 if wanted == 0.0 else np.inf
    return float(wanted / given)
