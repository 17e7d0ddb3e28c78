"""The hierarchy of stability conditions: which of them hold for a network, and the rate that each one proves.

They range from sums of weights over the best diagonal Lyapunov matrix to local stability; which implies which is in
`docs/mathematics/certificates.md`. A later condition does not always prove a higher rate than an earlier one, each in
its own distance, so the verdict names both the first that holds and the fastest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.stability.certificate import Certificate, known_or_found, verify
from lieednn_sim.stability.contraction import Contraction, find_contraction
from lieednn_sim.stability.norms import as_weight, frobenius, log_norms, weighted_norm
from lieednn_sim.validation import as_choice, as_positive, as_ratio
from lieednn_sim.values import Floats, frozen

#: Names of the stability conditions in hierarchical order; a verdict's level is one of these, or "none".
CONDITIONS = (
    *("1-norm", "infinity norm", "norm sum", "log norm 1", "log norm infinity", "weighted log norm", "log norm 2"),
    *("contraction", "diagonal Lyapunov", "local"),
)

# Couplings stronger than this, relative to the decay, make a network stiff: explicit integrators need very many steps.
STIFF = 100.0


@dataclass(frozen=True)
class Condition:
    """One stability condition, evaluated for one network.

    Attributes:
        name: one of `CONDITIONS`.
        holds: whether value < bound.
        value: left side of the condition, rounded up.
        bound: right side.
        rate: proven exponential rate, in 1 / (the network's time); 0 when the condition fails.
        scope: "global" when it proves one equilibrium that attracts every start, whatever the bias; "local" when it
            proves that one equilibrium attracts its neighbourhood.
    """

    name: str
    holds: bool
    value: float
    bound: float
    rate: float
    scope: str


@frozen
class Verdict:
    """The verdict on a network: all stability conditions, evaluated, and the proofs behind them.

    Attributes:
        conditions: in the order of `CONDITIONS`; "local" only by `locally`.
        certificate: the diagonal Lyapunov matrix behind its condition, valid or not.
        contraction: the norm behind its condition, valid or not.
        stiffness: strongest coupling of two neurons in units of gamma/mu: |alpha_ij| if W_R is known, else |W_ij|.
    """

    conditions: tuple[Condition, ...]
    certificate: Certificate
    contraction: Contraction
    stiffness: float

    @property
    def warning(self) -> str | None:
        """A warning about couplings more than `STIFF` times as strong as the decay, or None."""
        if self.stiffness <= STIFF:
            return None
        return (
            f"stiff: the strongest coupling is {self.stiffness:.3g} gamma/mu, above {STIFF:g}; proved stable or not, "
            "integration takes many small steps; make alpha smaller, or integrate with method='Radau'"
        )

    def locally(self, jacobian: ArrayLike) -> Verdict:
        """This verdict with the condition on the Jacobian ``(n, n)`` of the vector field at an equilibrium."""
        matrix = as_weight("jacobian", jacobian)
        # Backward error of the eigenvalues; the forward error of ill-conditioned ones is not bounded by it.
        rounding = len(matrix) * np.finfo(float).eps * frobenius(matrix)
        abscissa = float(np.linalg.eigvals(matrix).real.max() + rounding)
        local = Condition("local", abscissa < 0.0, abscissa, 0.0, max(0.0, -abscissa), "local")
        return replace(self, conditions=(*self.conditions, local))

    @property
    def globally_stable(self) -> bool:
        """Whether any condition proves global stability."""
        return any(condition.holds for condition in self.conditions if condition.scope == "global")

    @property
    def level(self) -> str:
        """Name of the first condition that holds, the simplest proof; "none" if none does."""
        return next((condition.name for condition in self.conditions if condition.holds), "none")

    @property
    def strongest(self) -> Condition | None:
        """The global condition that proves the highest rate; the local one if no other holds, None if none does."""
        held = [condition for condition in self.conditions if condition.holds]
        return max(held, key=lambda condition: (condition.scope == "global", condition.rate), default=None)

    def __getitem__(self, name: str) -> Condition:
        """The condition with this name; `InputError` if there is none."""
        known = {condition.name: condition for condition in self.conditions}
        return known[as_choice("condition", name, known)]

    def __str__(self) -> str:
        if self.globally_stable:
            summary = f"globally stable by the {self.level}, at a rate of at least {self[self.level].rate:.3g}"
            fastest = self.strongest
            if fastest is not None and fastest.rate > self[self.level].rate:
                summary += f"; the {fastest.name} proves {fastest.rate:.3g}"
        else:
            summary = "locally stable only" if self.level == "local" else "no proof of stability"
        lines = [
            f"  {condition.name:<17} {condition.value:>11.5g} < {condition.bound:<9.5g} "
            + (f"{condition.scope:<6} rate {condition.rate:.3g}" if condition.holds else "fails")
            for condition in self.conditions
        ]
        if self.warning is not None:
            lines.append(f"  warning: {self.warning}")
        return "\n".join([summary, *lines])


def assess(
    weight: ArrayLike,
    *,
    gamma: float = 1.0,
    mu: float = 1.0,
    rotational_weight: ArrayLike | None = None,
    lyapunov_diagonal: ArrayLike | None = None,
) -> Verdict:
    """Evaluate every stability condition for a network x' = -gamma x + mu W phi(x) + mu b.

    The activation phi may be any function whose slopes are in (0, 1].

    The weighted and the Lyapunov conditions hold for W exactly when they hold for W_R (`stability.certificate`), at the
    same rate up to any small epsilon. The log norm 2 on W_R proves the same for W through diag(I, eps I). Only
    unweighted norms depend on the other blocks, by which omega drives v, and need the whole W.

    If more than half of the coordinates have no inputs, these are left out of the weighted log norm and of contraction,
    for the same reason: a large weight on them makes what they send arbitrarily small.

    Args:
        weight: W, ``(n, n)``; n = 6N with interleaved twists (omega, v) when `rotational_weight` is given.
        gamma, mu: decay rate and scale of the interaction, positive.
        rotational_weight: W_R, ``(3N, 3N)``, on which the last global conditions are then evaluated.
        lyapunov_diagonal: a known diagonal P, of the size of `rotational_weight` or else of `weight`, to save a search.

    Raises:
        InputError: shapes disagree, or `rotational_weight` does not belong to `weight`.
    """
    matrix = as_weight("weight", weight)
    decay, scale = as_positive("gamma", gamma), as_positive("mu", mu)
    bound = as_ratio(decay, scale)
    core = matrix if rotational_weight is None else _rotational_part(matrix, rotational_weight)
    certificate = known_or_found(lyapunov_diagonal, core, gamma=decay, mu=scale)
    driven = core.any(axis=1)
    kept = driven if 0 < 2 * driven.sum() < len(core) else np.ones(len(core), dtype=bool)
    inner = core[np.ix_(kept, kept)]
    contraction = find_contraction(inner, gamma=decay, mu=scale, lyapunov_diagonal=certificate.lyapunov_diagonal[kept])
    euclidean = verify(np.ones(len(core)), core, gamma=decay, mu=scale)
    norms = log_norms(matrix)

    def condition(name: str, value: float) -> Condition:
        factor = 2.0 if name == "norm sum" else 1.0
        holds = value < factor * bound
        # Each value is a bound v on the interaction, and proves the rate gamma - mu max(v, 0).
        rate = decay - scale * max(value, 0.0) / factor if holds else 0.0
        return Condition(name, holds, value, factor * bound, rate, "global")

    sums = norms.one_norm, norms.infinity_norm, norms.norm_sum, norms.log_norm_one, norms.log_norm_infinity
    two_norm, diagonal = (proof.lambda_max + proof.rounding for proof in (euclidean, certificate))
    values = *sums, weighted_norm(inner).value, two_norm, contraction.value + contraction.rounding, diagonal
    conditions = list(map(condition, CONDITIONS, values))
    size = 1 if core is matrix else 3
    blocks = core.reshape(len(core) // size, size, -1, size)
    # The spectral norm of a block alpha R is |alpha|.
    stiffness = float(np.linalg.norm(blocks, 2, axis=(1, 3)).max()) / bound
    return Verdict(tuple(conditions), certificate, contraction, stiffness)


def _rotational_part(weight: Floats, rotational_weight: ArrayLike) -> Floats:
    """Check that W_R belongs to W; a proof about another matrix would be worthless."""
    given = as_weight("rotational_weight", rotational_weight)
    n = len(given)
    if n % 3 or len(weight) != 2 * n:
        raise InputError(f"rotational_weight must be (3N, 3N) for a weight (6N, 6N), got {given.shape}, {weight.shape}")
    blocks = weight.reshape(n // 3, 2, 3, n // 3, 2, 3)
    if blocks[:, 0, :, :, 1].any():
        raise InputError("weight must have no entry by which v drives omega, since rotational_weight is given")
    for part in (0, 1):
        difference = np.abs(blocks[:, part, :, :, part].reshape(n, n) - given).max()
        # Both blocks are the same rotation; other orders of multiplication may round differently.
        if difference > 1e-12 * np.abs(given).max():
            raise InputError(f"rotational_weight must be the rotational blocks of weight, differs by {difference:.2g}")
    return given
