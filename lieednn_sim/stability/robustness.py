"""How far a push throws a network, for how long, how far it lags behind a moving target, and which time steps are safe.

A push moves only what W lets it reach: a coordinate that hears of none that moved stays on its course. So everything is
proved on the submatrix of the coordinates reached, and in a cascade a push on its last layer meets that layer alone.
There e' = -gamma e + mu W f, with f_i between 0 and e_i, has two kinds of proof, in the norm |e|_P = |T e|_2.

Contraction (`stability.contraction`), of any two motions: |e(t)|_P <= exp(-c t) |e(0)|_P. If the equilibrium moves at
the velocity x*', then e = x - x* obeys |e|_P' <= -c |e|_P + |x*'|_P, and the lag comes to |x*'|_P / c.

The certificate's own diagonal P = S^2, about the equilibrium, where contraction is not proved: with y = S e, g = S f,
M = S W S^-1, s = |M|_2 and V of `stability.certificate`, U = eps |y|^2 / 2 + V has

    U' + c U <= -eps (gamma - c/2) |y|^2 + eps mu s |y| |g| - k |g|^2,  k = gamma - c - mu max(lambda_max, 0),

which is not positive for eps = 4 k (gamma - c/2) / (mu s)^2. As eps |y|^2 <= 2 U <= (1 + eps) |y|^2,
|y(t)| <= sqrt(1 + 1/eps) exp(-c t / 2) |y(0)|. A moving equilibrium adds at most (1 + eps) |y| |S x*'| to U', and the
lag comes to 2 (1 + 1/eps) / c |S x*'|.

Time steps h. Under contraction, with w = (e, f), the inequality says 2 <e', e>_P <= -w^T N w with N positive definite,
and |e'|_P^2 = w^T K w. So 2 <e', e>_P <= -h_0 |e'|_P^2 with the largest h_0 for which N - h_0 K >= 0, and a step of
forward Euler brings two runs closer when h < h_0. A Runge-Kutta method with coefficients a_ij and weights b_i obeys
|e_new|^2 = |e|^2 + 2 h sum_i b_i <e_i', e_i> - h^2 sum_ij m_ij <e_i', e_j'>, m_ij = b_i a_ij + b_j a_ji - b_i b_j, so
it does when diag(b) h_0 + h m is positive definite (Dahlquist and Jeltsch, 1979): for the classical method of order 4
again when h < h_0. The weights of Runge-Kutta 4(5) are not all positive: of it nothing is proved but that its error is
small. (Lipschitz constants of the stages, as Kawano and Bullo take in arXiv 2603.11349, 2026, prove far smaller steps.)
Under U, whose second derivative is at most (1 + eps) P, a quadratic form in |y| and |g| says when U falls. The mean of
the four fields of Runge-Kutta 4 differs from the first by at most z/2 + z^2/6 + z^3/24 of it, z = h (gamma + mu s).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.stability.certificate import Certificate, known_or_found, verify
from lieednn_sim.stability.contraction import Contraction, find_contraction, norm_at, verify_contraction
from lieednn_sim.stability.norms import as_weight, scale
from lieednn_sim.validation import as_choice, as_floats, as_positive
from lieednn_sim.values import Floats, frozen

Indices = NDArray[np.intp]

INTEGRATORS_WITH_PROOF = ("Euler", "RK4")

# Rounding of norms of well-conditioned matrices, many times over.
_UP = 1.0 + 1e-9
# Rates to give bounds for, as shares lost of the highest: slower ones hold in rounder norms.
_CONTRACTION_SHARES = (1e-3, 0.25, 0.5, 0.75)
_LYAPUNOV_SHARES = (0.1, 0.5, 0.9)
# Weights of v against omega: the smaller, the less omega's drive of v costs in rate, and the more in size.
_TRANSLATION_WEIGHTS = (1.0, 0.25, 0.06, 0.015, 0.004, 1e-4)


@frozen
class Guarantee:
    """|T e(t)| <= overshoot exp(-rate t) |T e(0)|, and |T e| <= delay |T x*'| behind an equilibrium that moves.

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


@frozen
class Robustness:
    """Bounds for a push on some coordinates, or for a target that moves in them; each the best of several proofs.

    Sizes are Euclidean, in the units of the state (rad for omega, m for v); times are the network's own.

    Attributes:
        pushed: flat coordinates that a push may move, ascending.
        reached: those that are moved by it sooner or later, ``(m,)``, ascending.
        guarantees: each holds; every method takes the one that says most.
        others: the same of the coordinates that are not reached, pushed themselves; None where all are reached. Only
            time steps ask for it: those of a whole run suit them, too.
    """

    pushed: Indices
    reached: Indices
    guarantees: tuple[Guarantee, ...]
    others: Robustness | None = None

    @property
    def contracting(self) -> Robustness | None:
        """What contraction proves: between any two motions, on the way and not only at the equilibrium. None if not."""
        chosen = tuple(guarantee for guarantee in self.guarantees if guarantee.contracting)
        return replace(self, guarantees=chosen) if chosen else None

    def throw(self, pushed: ArrayLike | None = None, watched: ArrayLike | None = None) -> float:
        """Largest size, at any time, of what a push of size 1 does: sup |e_watched(t)| / |e_pushed(0)|.

        Args:
            pushed: flat coordinates that the push moves, among `pushed`; all of them by default.
            watched: flat coordinates that are looked at, all that may be pushed by default.
        """
        return min(guarantee.overshoot * gain for guarantee, gain in self._gains(pushed, watched))

    def duration(self, share: float, pushed: ArrayLike | None = None, watched: ArrayLike | None = None) -> float:
        """Time after which |e_watched| stays below ``share`` times the size of the push; arguments as of `throw`."""
        part = as_positive("share", share)
        gains = self._gains(pushed, watched)
        return min(max(0.0, float(np.log(g.overshoot * gain / part)) / g.rate) if gain else 0.0 for g, gain in gains)

    def lag(self, moved: ArrayLike | None = None, watched: ArrayLike | None = None) -> float:
        """Largest |e_watched| behind an equilibrium that moves at speed 1 in ``moved``, from a start without lag.

        Through the bias b(t) = (gamma/mu) x*(t) - W phi(x*(t)). In general a distance behind it falls to this one as
        after a push. Arguments as of `throw`; in the state's units per unit of speed, that is in the network's time.
        """
        return min(guarantee.delay * gain for guarantee, gain in self._gains(moved, watched))

    def largest_step(self, method: str) -> float:
        """Time step up to which a fixed-step run by ``method``, a name of `INTEGRATORS_WITH_PROOF`, keeps the proof.

        Each step then brings two runs closer (contraction), or one closer to the equilibrium, in the guarantee's norm
        or function U, first of the coordinates that no push reaches and, as these come to rest, of the others; so the
        run ends where the network does. In the network's time. Methods whose weights are not all positive, as the
        adaptive RK45, have no proof here.
        """
        euler = as_choice("method", method, INTEGRATORS_WITH_PROOF) == "Euler"
        largest = max(guarantee.euler_step if euler else guarantee.rk4_step for guarantee in self.guarantees)
        return largest if self.others is None else min(largest, self.others.largest_step(method))

    def __str__(self) -> str:
        scope = "between any two motions" if self.contracting else "about the equilibrium"
        best = self.contracting or self
        return (
            f"a push of size 1 throws the state at most {best.throw():.3g} away, a tenth of it is left after "
            f"{best.duration(0.1):.3g} ({scope})\n"
            f"a target that moves at speed 1 is followed within {self.lag():.3g}\n"
            f"time steps up to {self.largest_step('Euler'):.3g} (Euler), {self.largest_step('RK4'):.3g} (RK4) keep the "
            "proof; RK45 has none"
        )

    def _gains(self, pushed: ArrayLike | None, watched: ArrayLike | None) -> list[tuple[Guarantee, float]]:
        """Largest |T e| of a unit push times the largest |e_watched| of a unit |T e|, for each guarantee."""
        moved = self.pushed if pushed is None else np.atleast_1d(np.asarray(pushed, np.intp))
        if not len(moved) or not np.isin(moved, self.pushed).all():
            raise InputError(f"pushed must name some of the coordinates {self.pushed.tolist()}, got {moved.tolist()}")
        seen = self.pushed if watched is None else np.atleast_1d(np.asarray(watched, np.intp))
        columns, rows = np.isin(self.reached, moved), np.isin(self.reached, seen)
        # What the push never reaches never moves.
        return [(g, _norm(g.factor[:, columns]) * _norm(g.inverse[rows]) * _UP) for g in self.guarantees]


def robustness(
    weight: ArrayLike,
    *,
    gamma: float,
    mu: float,
    pushed: ArrayLike | None = None,
    rotational_weight: ArrayLike | None = None,
    lyapunov_diagonal: ArrayLike | None = None,
) -> Robustness:
    """What is proved of pushes, moving targets and time steps, for x' = -gamma x + mu W phi(x) + mu b.

    Args:
        weight: W, ``(n, n)``; n = 6N with interleaved twists (omega, v) when `rotational_weight` is given.
        gamma: decay rate, positive.
        mu: scale of the interaction, positive.
        pushed: flat coordinates that pushes and targets may move, all by default.
        rotational_weight: W_R, ``(3N, 3N)``, on which proofs are searched for.
        lyapunov_diagonal: a known diagonal P of the size of `rotational_weight` or else of `weight`.

    Raises:
        InputError: shapes disagree, or a coordinate is not there.
        NotCertifiedError: what the push reaches is not certified.
    """
    matrix = as_weight("weight", weight)
    n = len(matrix)
    moved = np.unique(np.arange(n) if pushed is None else np.asarray(pushed, np.intp))
    if not len(moved) or moved[0] < 0 or moved[-1] >= n:
        raise InputError(f"pushed must name coordinates from 0 to {n - 1}, got {moved.tolist()}")
    reached = np.isin(np.arange(n), moved)
    while (wider := reached | matrix[:, reached].any(axis=1)).sum() > reached.sum():
        reached = wider
    # Coordinates of W_R that stand for those reached, and S of W from S of W_R, once for each weight of v.
    twists = rotational_weight is not None
    core = matrix if rotational_weight is None else as_floats("rotational_weight", rotational_weight, (n // 2, n // 2))
    kept = reached.reshape(-1, 2, 3).any(axis=1).ravel() if twists else reached
    part = core[np.ix_(kept, kept)]
    known = None
    if lyapunov_diagonal is not None:
        known = as_floats("lyapunov_diagonal", lyapunov_diagonal, (len(core),))[kept]
    certificate = known_or_found(known, part, gamma=gamma, mu=mu)
    if not certificate.valid:
        raise NotCertifiedError(f"nothing is proved of pushes without a certificate ({certificate})")
    contraction = find_contraction(part, gamma=gamma, mu=mu, lyapunov_diagonal=certificate.lyapunov_diagonal)
    inner = matrix[np.ix_(reached, reached)]
    guarantees: list[Guarantee] = []
    for weight_of_v in _TRANSLATION_WEIGHTS if twists else (1.0,):

        def whole(diagonal: Floats, factor: float = weight_of_v) -> Floats:
            log_scale = np.zeros(len(core))
            log_scale[kept] = 0.5 * np.log(diagonal)
            if twists:
                each = log_scale.reshape(-1, 3)
                log_scale = np.stack([each, each + np.log(factor)], axis=1).ravel()
            return np.asarray(log_scale[reached], np.float64)

        # Rounder norms prove less of the rate and more of the size; where nothing is coupled, all of both.
        for power in (1.0, 0.0):
            guarantees += _by_contraction(inner, whole(contraction.multiplier**power), contraction, gamma, mu)
            guarantees += _by_lyapunov(inner, whole(certificate.lyapunov_diagonal**power), gamma, mu)
    if not guarantees:
        raise NotCertifiedError("the certificate is too near its bound for proofs about pushes")
    others = None
    if not reached.all():
        # They hear nothing of those reached. No twist needs to be whole among them, so the proof is on W itself.
        others = robustness(matrix[np.ix_(~reached, ~reached)], gamma=gamma, mu=mu)
    return Robustness(moved, np.flatnonzero(reached), tuple(guarantees), others)


def _by_contraction(weight: Floats, log_scale: Floats, best: Contraction, gamma: float, mu: float) -> list[Guarantee]:
    """Guarantees of contraction with Q = S^2, at rates below the best one."""
    found = []
    for share in _CONTRACTION_SHARES if best.valid else ():
        factor = norm_at(weight, log_scale, best.value + share * (best.bound - best.value))
        if factor is None:
            continue
        proof = verify_contraction(factor, np.exp(2.0 * log_scale), weight, gamma=gamma, mu=mu)
        if not proof.valid:
            continue
        inverse = np.asarray(np.linalg.inv(factor), np.float64)
        step = _contraction_step(scale(weight, log_scale), factor / np.exp(log_scale), gamma, mu)
        found.append(Guarantee(True, factor, inverse, 1.0, proof.rate, 1.0 / proof.rate, step, step))
    return found


def _contraction_step(scaled: Floats, factor: Floats, gamma: float, mu: float) -> float:
    """h_0 from M = S W S^-1 and T S^-1, in the coordinates S e and S f."""
    n = len(scaled)
    metric, one = factor.T @ factor, np.eye(n)
    cross = -mu * (metric @ scaled + one)
    decay = np.block([[2.0 * gamma * metric, cross], [cross.T, 2.0 * mu * one]])
    field = factor @ np.hstack([gamma * one, -mu * scaled])
    try:
        return (1.0 - 1e-6) / float(eigh(field.T @ field, decay, eigvals_only=True)[-1])
    except np.linalg.LinAlgError:
        return 0.0


def _by_lyapunov(weight: Floats, log_scale: Floats, gamma: float, mu: float) -> list[Guarantee]:
    """Guarantees of U = eps |y|^2 / 2 + V, for several rates."""
    certificate: Certificate = verify(np.exp(2.0 * log_scale), weight, gamma=gamma, mu=mu)
    found = []
    drive = max(mu * _norm(scale(weight, log_scale)) * _UP, 1e-6 * gamma)
    for share in _LYAPUNOV_SHARES if certificate.valid else ():
        c = share * certificate.rate
        # Below the largest, so that the quadratic form of the steps is definite.
        eps = min(4.0 * (certificate.rate - c) * (gamma - 0.5 * c) / drive**2, 1e6)
        euler, rk4 = (_lyapunov_step(certificate.rate, eps, gamma, drive, stages) for stages in (1, 4))
        root = np.asarray(np.exp(log_scale), np.float64)
        growth = 1.0 + 1.0 / eps
        found.append(
            Guarantee(
                False, np.diag(root), np.diag(1.0 / root), float(np.sqrt(growth)), 0.5 * c, 2.0 * growth / c, euler, rk4
            )
        )
    return found


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


def _norm(matrix: Floats) -> float:
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0
