"""The claims of the paper, what was measured for each, and the verdicts that follow."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from paper import measures
from paper.checks.learning import TRANSLATIONS
from paper.measures import FAILS, FEW, HOLDS, MOST, PART
from paper.results import Missing, Results

# Relative errors below these are due to rounding, or to the finite differences of the measurement.
EXACT, DIFFERENCES = 1e-9, 1e-6
# Directions whose cosine is above this count as equal to first order.
SAME = 0.999
Scalars = dict[str, Any]


class Claim(NamedTuple):
    """One line of the table."""

    source: str  # where the paper says it
    text: str  # the claim, in our words
    measured: str  # what we found
    verdict: str  # one of the four of `measures`


def judge(results: Results) -> list[Claim]:
    """Every claim, those without results as not measured."""
    found = []
    for source, text, measure in CLAIMS:
        try:
            measured, verdict = checked(results, measure) if isinstance(measure, str) else measure(results)
        except Missing as missing:
            measured, verdict = f"no results of {missing}", measures.UNKNOWN
        found.append(Claim(source, text, measured, verdict))
    return found


def checked(results: Results, name: str) -> tuple[str, str]:
    """What was measured for an entry of `CHECKED`, and the verdict."""
    check, measured, verdict = CHECKED[name]
    values = results.require(check)[0].values
    lists = {key: ", ".join(f"{x:.2f}" for x in value) for key, value in values.items() if isinstance(value, list)}
    return measured.format(**values | lists), verdict(values)


def exact(*names: str, within: float = EXACT) -> Callable[[Scalars], str]:
    """Verdict on an equation, by the largest of its relative errors."""
    return lambda values: HOLDS if max(values[name] for name in names) < within else FAILS


def always(*names: str) -> Callable[[Scalars], str]:
    """Verdict on a property that must hold in all cases."""
    return lambda values: HOLDS if all(values[name] == values["count"] for name in names) else FAILS


def when(holds: Callable[[Scalars], bool], in_part: Callable[[Scalars], bool]) -> Callable[[Scalars], str]:
    """A verdict by two conditions."""
    return lambda values: HOLDS if holds(values) else PART if in_part(values) else FAILS


def same(values: Scalars) -> list[bool]:
    """Whether both directions are the Riemannian gradient's to first order, for each size of the translations."""
    return [min(pair) > SAME for pair in zip(values["loss"], values["random"], strict=True)]


# By name: the check of `checks.CHECKS`, what it measured, and the verdict on it.
CHECKED: dict[str, tuple[str, str, Callable[[Scalars], str]]] = {
    "automorphism": (
        "automorphism",
        "{count} cases on eight groups: g X g^-1 leaves the algebra by at most {outside:.0e}, the inverse action "
        "brings X back to {back:.0e}, brackets are kept to {bracket:.0e}",
        exact("outside", "back", "bracket"),
    ),
    "closed group": (
        "closed group",
        "{count} pairs: products off the printed ones by {product:.0e}, inverses by {inverse:.0e}; limits of sequences "
        "lie {limit:.0e} from the set",
        exact("product", "inverse", "limit"),
    ),
    "definition": (
        "closed group",
        "every adjoint matrix has this form, but R^T = R^-1 lets in reflections too, which are at least "
        "{reflections_apart:.1f} away from every adjoint matrix; det R = 1 has to be added",
        lambda values: PART if values["reflections_apart"] > FEW else HOLDS,
    ),
    "representation of SE(3)": (
        "representation",
        "P(g X g^-1) = L[Ad_g] P(X) to {se3:.0e} for {count} random poses and twists",
        exact("se3"),
    ),
    "representation": (
        "representation",
        "on eight groups: the matrix is fixed by its action in {unique:.0%} of the cases and right to {general:.0e}; "
        "products go to products to {homomorphism:.0e}, and its derivative is L[Ad_g] ad to {slope:.0e}",
        when(
            lambda values: (
                max(values["general"], values["homomorphism"]) < EXACT
                and values["unique"] == 1.0
                and values["slope"] < DIFFERENCES
            ),
            lambda values: False,
        ),
    ),
    "quotient": (
        "quotient",
        "on eight groups: elements with equal adjoint matrices differ by one that commutes with all (to "
        "{commuting:.0e}); SU(2): Ad of g and -g agree to {two_to_one:.0e}, and both are rotations",
        lambda values: exact("kernel", "commuting", "two_to_one")(values) if values["onto_rotations"] else FAILS,
    ),
    "compact": (
        "quotient",
        "SO(3), SU(2), SU(3): adjoint matrices are orthogonal to {compact:.0e}, so bounded; that of SE(3), not "
        "compact, reaches norm {unbounded:.0f} and is closed all the same",
        exact("compact"),
    ),
    "rotation lemma": (
        "rotation lemma",
        "{count} random matrices, {reflected:.0%} with det < 0: the formula reaches the largest tr(Pi^T R), by the "
        "q-method, to {error:.0e}; of 100 rotations around it none is nearer in {unbeaten} cases",
        lambda values: exact("error")(values) if values["unbeaten"] == values["count"] else FAILS,
    ),
    "decoding": (
        "decoding",
        "{count} random twists: R and p = J v agree with the matrix exponential to {pose:.0e}, R^T R = I and det R = 1 "
        "to {rigid:.0e}; the Taylor form of J is off by O(theta^{taylor_order:.1f})",
        lambda values: exact("pose", "rigid")(values) if abs(values["taylor_order"] - 3.0) < 0.1 else FAILS,
    ),
    "telescopic": (
        "decoding",
        "a joint with six degrees of freedom can take every decoded pose; one hinge and one slide {on_hinge:.0%} of "
        "{count} random targets: the pose is tilted against the hinge by {tilt_deg:.0f} degrees (median)",
        lambda values: HOLDS if values["on_hinge"] >= MOST else PART,
    ),
    "weight gradient": (
        "weight gradient",
        "{count} entries against central differences of the equilibrium solved anew: off by at most "
        "{largest_error:.0e} of the largest entry",
        exact("largest_error", within=DIFFERENCES),
    ),
    "strength gradient": (
        "strength gradient",
        "w/alpha for Ad is exact right after a projection (to {on_manifold:.0e}); in between it is off by "
        "{median_error:.0%} (median) to {largest_error:.0%}",
        when(
            lambda values: values["largest_error"] < DIFFERENCES,
            lambda values: values["on_manifold"] < DIFFERENCES,
        ),
    ),
    "riemannian": (
        "riemannian",
        "cosine of the first-order change and the Riemannian gradient, translations of size "
        f"{', '.join(f'{size:g}' for size in TRANSLATIONS)}: "
        "{loss} for the gradient of E, {random} for a random gradient (medians of {count}; smallest {smallest:.2f}; "
        "the loss rises to first order in fractions of {rising}); with the nearest point in place of the block-wise "
        "one at least {nearest:.6f}",
        when(lambda values: all(same(values)), lambda values: any(same(values))),
    ),
    "columns alone": (
        "single norms",
        "{columns} of {count} random W with ||W||_1 = 0.99 and a row-plus-column sum of 2 or more have a diagonal "
        "Lyapunov proof: one equilibrium, and stable from every start, which is more than claimed",
        always("columns", "violating"),
    ),
    "sums alone": (
        "single norms",
        "{sums} of {count} random W with row-plus-column sums up to 1.98 and ||W||_1 > 1 are proved stable by P = I, "
        "from every start and with one equilibrium, which is more than claimed",
        always("sums", "beyond"),
    ),
    "one norm for both": (
        "single norms",
        "{violating} of {count} random W with ||W||_1 = 0.99 and one large row break the second inequality; what it is "
        "there for, stability, holds for {columns} of them all the same",
        when(lambda values: values["violating"] == 0, lambda values: values["columns"] == values["count"]),
    ),
    "norm conditions": (
        "norm conditions",
        "{certified} of {count} random W inside both norms have a diagonal Lyapunov proof",
        always("certified"),
    ),
    "equivariance": (
        "equivariance",
        "{count} networks: trajectories seen from a common frame agree to {largest:.0e} with the equivariant "
        "activation, to {tanh:.1g} with tanh by coordinates (relative); with a frame of its own for every neuron theta "
        "-> h theta h^-1 is off by at least {own:.1g}, and one common h is needed",
        exact("largest", within=DIFFERENCES),
    ),
    "algebras": (
        "algebras",
        "Ad of C^x is the identity (to {complex_identity:.0e}) and differs from the product in {complex_apart:.0%} of "
        "random pairs, that of H^x in {quaternion_apart:.0%}; on their affine groups, in the translations, the "
        "equations agree to {affine_error:.0e}",
        when(
            lambda values: max(values["complex_apart"], values["quaternion_apart"]) < FEW,
            lambda values: values["affine_error"] < EXACT,
        ),
    ),
    "projection": (
        "projection",
        "the nearest point is nearer than the block-wise one for {farther:.0%} of random blocks, by "
        "{median_excess:.1%} (median) to {largest_excess:.0%}; for {negative:.0%} det((A + D)/2) < 0, where no "
        "rotation is near",
        when(lambda values: values["farther"] < FEW, lambda values: values["median_excess"] < 0.1),
    ),
    "activation": (
        "activation",
        "tanh by coordinates is off by {tanh:.1f}, as the paper says; the form in ||omega|| is equivariant to "
        "{printed:.0e}, but sends the pure translation 1 to {printed_pure_translation:.0f} (corrected: "
        "{corrected_pure_translation:.0f}); the form in sqrt(tr X^2) is not real for {negative_trace:.0%} of random "
        "twists",
        when(
            lambda values: values["printed"] < EXACT and values["negative_trace"] < FEW,
            lambda values: values["printed"] < EXACT,
        ),
    ),
}

# Where the paper says it, in our words, and a function of `measures` or an entry of `CHECKED`.
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
