"""Guarantees of how deviations decay, for one norm each; `robustness` takes the sharpest of many.

There are two kinds of proof, in the norm |e|_P = |T e|_2, both derived in `docs/mathematics/robustness.md`. One is
contraction of any two motions (`stability.contraction`), with steps h < h_0 of forward Euler and of Runge-Kutta 4. The
other, for where contraction is not proved, is about the equilibrium: it uses the certificate's own diagonal P = S^2 and
the function U = eps |S e|^2 / 2 + V.

The second derivative of U is at most (1 + eps) P. A quadratic form in |y| = |S e| and |g| = |S f|, where f is the
change of phi that e causes, tells whether U falls in a step h. The mean of the four fields of Runge-Kutta 4 differs
from the first by at most the fraction z/2 + z^2/6 + z^3/24 of it, with z = h (gamma + mu |S W S^-1|_2).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from lieednn_sim.stability.certificate import verify
from lieednn_sim.stability.contraction import Contraction, norm_at, verify_contraction
from lieednn_sim.stability.norms import scale
from lieednn_sim.values import Floats, frozen

UP = 1.0 + 1e-9  # many times the rounding of norms of well-conditioned matrices


@frozen
class Guarantee:
    """A bound on how a deviation e decays, and on the lag behind an equilibrium that moves.

    The bounds are |T e(t)| <= overshoot exp(-rate t) |T e(0)| and |T e| <= delay |T x*'|.

    Attributes:
        contracting: whether e may be the distance of any two motions; otherwise it is the distance to the equilibrium.
        factor: T ``(m, m)`` of the norm, on the coordinates reached.
        inverse: T^-1.
        overshoot: at least 1.
        rate: in 1 / (the network's time).
        delay: in the network's time.
        euler_step: largest time step of the forward Euler method that keeps the proof, in the network's time.
        rk4_step: the same for the classical Runge-Kutta method of order 4.
    """

    contracting: bool
    factor: Floats
    inverse: Floats
    overshoot: float
    rate: float
    delay: float
    euler_step: float
    rk4_step: float


def by_contraction(weight: Floats, log_scale: Floats, best: Contraction, gamma: float, mu: float) -> list[Guarantee]:
    """Guarantees of contraction with Q = S^2, at rates below the best one."""
    results = []
    # A fraction of the highest rate is given up, since slower rates allow rounder norms.
    for fraction in (1e-3, 0.25, 0.5, 0.75) if best.valid else ():
        factor = norm_at(weight, log_scale, best.value + fraction * (best.bound - best.value))
        if factor is None:
            continue
        proof = verify_contraction(factor, np.exp(2.0 * log_scale), weight, gamma=gamma, mu=mu)
        if not proof.valid:
            continue
        inverse = np.asarray(np.linalg.inv(factor), np.float64)
        step = _contraction_step(scale(weight, log_scale), factor / np.exp(log_scale), gamma, mu)
        results.append(Guarantee(True, factor, inverse, 1.0, proof.rate, 1.0 / proof.rate, step, step))
    return results


def _contraction_step(scaled: Floats, factor: Floats, gamma: float, mu: float) -> float:
    """The largest h_0 with 2 <e', e>_P <= -h_0 |e'|_P^2, from M = S W S^-1 and T S^-1, in coordinates S e and S f."""
    n = len(scaled)
    metric, identity = factor.T @ factor, np.eye(n)
    cross = -mu * (metric @ scaled + identity)
    decay = np.block([[2.0 * gamma * metric, cross], [cross.T, 2.0 * mu * identity]])
    field = factor @ np.hstack([gamma * identity, -mu * scaled])
    try:
        return (1.0 - 1e-6) / float(eigh(field.T @ field, decay, eigvals_only=True)[-1])
    except np.linalg.LinAlgError:
        return 0.0


def by_lyapunov(weight: Floats, log_scale: Floats, gamma: float, mu: float) -> list[Guarantee]:
    """Guarantees of U = eps |y|^2 / 2 + V, for several rates."""
    certificate = verify(np.exp(2.0 * log_scale), weight, gamma=gamma, mu=mu)
    results = []
    drive = max(mu * spectral_norm(scale(weight, log_scale)) * UP, 1e-6 * gamma)
    for fraction in (0.1, 0.5, 0.9) if certificate.valid else ():  # fractions of the highest rate that are kept
        c = fraction * certificate.rate
        # Below the largest eps, so that the quadratic form of the steps is definite.
        eps = min(4.0 * (certificate.rate - c) * (gamma - 0.5 * c) / drive**2, 1e6)
        euler, rk4 = (_lyapunov_step(certificate.rate, eps, gamma, drive, stages) for stages in (1, 4))
        root, growth = np.asarray(np.exp(log_scale), np.float64), 1.0 + 1.0 / eps
        norm = np.diag(root), np.diag(1.0 / root)
        results.append(Guarantee(False, *norm, float(np.sqrt(growth)), 0.5 * c, 2.0 * growth / c, euler, rk4))
    return results


def _lyapunov_step(margin: float, eps: float, gamma: float, drive: float, stages: int) -> float:
    """Largest step found at which U falls, by its quadratic form in (|y|, |g|); a smaller step is then safe, too."""

    def falls(h: float) -> bool:
        z = h * (gamma + drive)
        more = z / 2.0 + z**2 / 6.0 + z**3 / 24.0 if stages > 1 else 0.0
        # |S x'| <= gamma |y| + drive |g|, and the gradient of U is at most eps |y| + |g|.
        curved = 0.5 * h * (1.0 + eps) * (1.0 + more) ** 2
        yy = eps * gamma * (1.0 - more) - curved * gamma**2
        gg = margin - more * drive - curved * drive**2
        yg = -0.5 * eps * drive * (1.0 + more) - 0.5 * more * gamma - curved * gamma * drive
        return yy > 0.0 and gg > 0.0 and yy * gg > yg**2 * (1.0 + 1e-9)

    low, high = 0.0, 2.0 / gamma
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if falls(middle) else (low, middle)
    return low


def spectral_norm(matrix: Floats) -> float:
    """The largest singular value; zero for an empty matrix."""
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0
