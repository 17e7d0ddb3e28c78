"""Claims of the paper, what was measured, and the verdicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from paper import measures
from paper.check_measures import checked
from paper.results import Results


@dataclass(frozen=True)
class Claim:
    """One line of the table.

    Attributes:
        source: where the paper says it.
        text: the claim, in our words.
        measured: what we found.
        verdict: one of the four of `measures`.
    """

    source: str
    text: str
    measured: str
    verdict: str


def judge(results: Results) -> list[Claim]:
    """Every claim, those without results as not measured."""
    found = []
    for source, text, measure in CLAIMS:
        try:
            measured, verdict = checked(results, measure) if isinstance(measure, str) else measure(results)
        except measures.Missing as missing:
            measured, verdict = f"no results of {missing}", measures.UNKNOWN
        found.append(Claim(source, text, measured, verdict))
    return found


# Where the paper says it, in our words, and a function of `measures` or an entry of `check_measures.CHECKED`.
CLAIMS: tuple[tuple[str, str, str | Callable[[Results], tuple[str, str]]], ...] = (
    (
        "Sec. 4, Fig. (a)",
        "Training with projection converges, with oscillations, for periods P in 8 to 16",
        measures.oscillating,
    ),
    ("Sec. 4, Fig. (a)", "Smaller P take too long", measures.small_periods),
    ("Sec. 4, Fig. (a)", "Larger P fail", measures.large_periods),
    ("Sec. 4, Fig. (a)", "Within 8 to 16, larger P converge faster", measures.larger_is_faster),
    ("Sec. 4, Fig. (b)", "Accuracy reaches 1", measures.accuracy),
    ("Sec. 4, Fig. (c), (d)", "Projection preserves the block structure, without it is lost", measures.structure),
    ("Sec. 4, Fig. (d)", "Without projection the target is still reached", measures.ablation),
    ("Sec. 4, second figure", "The dynamics of the trained network converge to the target", measures.converging),
    ("Sec. 5", "The norm conditions are enforced in the experiments", measures.norms),
    ("Sec. 4 and 5", "The trained networks are stable, from every start", measures.stable),
    ("App. G, I", "The norm conditions imply a unique, stable equilibrium", "norm conditions"),
    ("App. G", "The column condition alone implies a unique equilibrium", "columns alone"),
    ("App. G, I", "The row-plus-column condition alone implies asymptotic stability", "sums alone"),
    ("App. G", "||W||_1 < gamma/mu is enough for both inequalities", "one norm for both"),
    ("App. H", "The curvature is bounded, and by 2 gamma (gamma R + gamma + mu b_max)", measures.curvature),
    ("Sec. 3.3", "The strengths alpha are to be learned with W (Algorithm 1 leaves it out)", measures.alpha),
    ("Sec. 3.3", "dE/dW is mu phi(xi_j) delta^T S^-1 e_i / (gamma E)", "weight gradient"),
    ("Sec. 3.3", "dE/dalpha is the sum of (dE/dw) w/alpha", "strength gradient"),
    ("Sec. 3.3, App. M", "Descent on E itself, not on its square, reaches the tolerance", measures.norm_loss),
    ("App. M", "Algorithm 1 as printed reaches the tolerance", measures.literal),
    ("App. M", "A training takes three to five minutes at most", measures.minutes),
    ("Sec. 3.3, App. A", "The SVD formula is the nearest rotation", "rotation lemma"),
    ("Sec. 3.3, App. F", "The block-wise projection is the metric projection", "projection"),
    (
        "Sec. 3.3, 4",
        "Periodic projection is a first-order approximation of the Riemannian gradient",
        "riemannian",
    ),
    ("Sec. 3.1", "The adjoint action is an automorphism of the Lie algebra", "automorphism"),
    ("Sec. 3.1", "L[Ad_SE(3)] is the set of matrices with R^T = R^-1", "definition"),
    ("Sec. 3.1, App. B", "L[Ad_SE(3)] is a closed group, so a Lie group", "closed group"),
    ("Sec. 3.1, App. C", "L[Ad_g] represents the adjoint action on se(3)", "representation of SE(3)"),
    ("App. D", "Every matrix Lie group has one such representation, a smooth homomorphism", "representation"),
    ("App. E", "L[Ad_G] is G modulo the kernel, which is the centre", "quotient"),
    ("App. E", "A compact group has a closed adjoint image; it need not be compact", "compact"),
    ("App. L", "The retraction in closed form gives rigid motions", "decoding"),
    ("App. L", "R and p are the orientation and displacement of a telescopic joint", "telescopic"),
    ("Sec. 5", "Complex and quaternion networks are its networks on C^x and H^x", "algebras"),
    ("App. N", "The printed activation is equivariant", "activation"),
    ("App. N", "With an equivariant activation the dynamics are equivariant", "equivariance"),
)
