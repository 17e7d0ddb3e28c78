"""What is measured for the claims that are checked on random cases, and the verdicts that follow."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from paper.checks.learning import TRANSLATIONS
from paper.measures import FAILS, FEW, HOLDS, MOST, PART, records_of
from paper.results import Results

# Relative errors below these are rounding, or of the finite differences that they are measured with.
EXACT, DIFFERENCES = 1e-9, 1e-6
# Directions whose cosine is above this are one to first order, as far as a random case can tell.
SAME = 0.999
Scalars = dict[str, Any]


def checked(results: Results, name: str) -> tuple[str, str]:
    """What was measured for an entry of `CHECKED`, and the verdict."""
    check, measured, verdict = CHECKED[name]
    values = records_of(results, check)[0].values
    lists = {key: ", ".join(f"{x:.2f}" for x in value) for key, value in values.items() if isinstance(value, list)}
    return measured.format(**values | lists), verdict(values)


def exact(*names: str, within: float = EXACT) -> Callable[[Scalars], str]:
    """Verdict on an equation, by the largest of its relative errors."""
    return lambda values: HOLDS if max(values[name] for name in names) < within else FAILS


def always(*names: str) -> Callable[[Scalars], str]:
    """Verdict on what has to be so in all cases."""
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
