"""What is measured for the claims that are checked on random cases, and the verdicts that follow."""

from __future__ import annotations

from paper.checks.learning import TRANSLATIONS
from paper.measures import FAILS, FEW, HOLDS, MOST, PART, records_of
from paper.results import Results
from paper.runner import Record

# Relative errors below this are rounding, or of the finite differences that they are measured with.
_EXACT, _DIFFERENCES = 1e-9, 1e-6
# Directions whose cosine is above this are one to first order, as far as a random case can tell.
_SAME = 0.999


def check(results: Results, name: str) -> Record:
    """The record of a check."""
    return records_of(results, name)[0]


def automorphism(results: Results) -> tuple[str, str]:
    record = check(results, "automorphism")
    measured = (
        f"{record['count']} cases on eight groups: g X g^-1 leaves the algebra by at most {record['outside']:.0e}, the "
        f"inverse action brings X back to {record['back']:.0e}, brackets are kept to {record['bracket']:.0e}"
    )
    return measured, _exact(record["outside"], record["back"], record["bracket"])


def closed_group(results: Results) -> tuple[str, str]:
    record = check(results, "closed group")
    measured = (
        f"{record['count']} pairs: products off the printed ones by {record['product']:.0e}, inverses by "
        f"{record['inverse']:.0e}; limits of sequences lie {record['limit']:.0e} from the set"
    )
    return measured, _exact(record["product"], record["inverse"], record["limit"])


def definition(results: Results) -> tuple[str, str]:
    record = check(results, "closed group")
    measured = (
        "every adjoint matrix has this form, but R^T = R^-1 lets in reflections too, which are at least "
        f"{record['reflections_apart']:.1f} away from every adjoint matrix; det R = 1 has to be added"
    )
    return measured, PART if record["reflections_apart"] > FEW else HOLDS


def representation_se3(results: Results) -> tuple[str, str]:
    record = check(results, "representation")
    measured = f"P(g X g^-1) = L[Ad_g] P(X) to {record['se3']:.0e} for {record['count']} random poses and twists"
    return measured, _exact(record["se3"])


def representation(results: Results) -> tuple[str, str]:
    record = check(results, "representation")
    measured = (
        f"on eight groups: the matrix is fixed by its action in {record['unique']:.0%} of the cases and right to "
        f"{record['general']:.0e}; products go to products to {record['homomorphism']:.0e}, and its derivative is "
        f"L[Ad_g] ad to {record['slope']:.0e}"
    )
    exact = _exact(record["general"], record["homomorphism"]) == HOLDS and record["unique"] == 1.0
    return measured, HOLDS if exact and record["slope"] < _DIFFERENCES else FAILS


def quotient(results: Results) -> tuple[str, str]:
    record = check(results, "quotient")
    measured = (
        f"on eight groups: elements with equal adjoint matrices differ by one that commutes with all (to "
        f"{record['commuting']:.0e}); SU(2): Ad of g and -g agree to {record['two_to_one']:.0e}, and both are rotations"
    )
    exact = _exact(record["kernel"], record["commuting"], record["two_to_one"]) == HOLDS
    return measured, HOLDS if exact and record["onto_rotations"] else FAILS


def compact(results: Results) -> tuple[str, str]:
    record = check(results, "quotient")
    measured = (
        f"SO(3), SU(2), SU(3): adjoint matrices are orthogonal to {record['compact']:.0e}, so bounded; that of SE(3), "
        f"not compact, reaches norm {record['unbounded']:.0f} and is closed all the same"
    )
    return measured, _exact(record["compact"])


def rotation_lemma(results: Results) -> tuple[str, str]:
    record = check(results, "rotation lemma")
    measured = (
        f"{record['count']} random matrices, {record['reflected']:.0%} with det < 0: the formula reaches the largest "
        f"tr(Pi^T R), by the q-method, to {record['error']:.0e}; of 100 rotations around it none is nearer in "
        f"{record['count'] - record['beaten']} cases"
    )
    return measured, HOLDS if record["beaten"] == 0 and record["error"] < _EXACT else FAILS


def decoding(results: Results) -> tuple[str, str]:
    record = check(results, "decoding")
    measured = (
        f"{record['count']} random twists: R and p = J v agree with the matrix exponential to "
        f"{max(record['rotation'], record['position']):.0e}, R^T R = I and det R = 1 to "
        f"{max(record['rigid'], record['determinant']):.0e}; the Taylor form of J is off by O(theta^"
        f"{record['taylor_order']:.1f})"
    )
    exact = _exact(record["rotation"], record["position"], record["rigid"], record["determinant"]) == HOLDS
    return measured, HOLDS if exact and abs(record["taylor_order"] - 3.0) < 0.1 else FAILS


def telescopic(results: Results) -> tuple[str, str]:
    record = check(results, "decoding")
    measured = (
        "a joint with six degrees of freedom can take every decoded pose; one hinge and one slide "
        f"{record['on_hinge']:.0%} of {record['count']} random targets: the pose is tilted against the hinge by "
        f"{record['tilt_deg']:.0f} degrees (median)"
    )
    return measured, HOLDS if record["on_hinge"] >= MOST else PART


def weight_gradient(results: Results) -> tuple[str, str]:
    record = check(results, "weight gradient")
    measured = (
        f"{record['count']} entries against central differences of the equilibrium solved anew: off by at most "
        f"{record['largest_error']:.0e} of the largest entry"
    )
    return measured, HOLDS if record["largest_error"] < _DIFFERENCES else FAILS


def riemannian(results: Results) -> tuple[str, str]:
    record = check(results, "riemannian")
    sizes = ", ".join(f"{size:g}" for size in TRANSLATIONS)
    rises = [f"{rate:.0%}" for rate in record["rising"]]
    measured = (
        f"cosine of the first-order change and the Riemannian gradient, translations of size {sizes}: "
        f"{_list(record['loss'])} for the gradient of E, {_list(record['random'])} for a random gradient (medians of "
        f"{record['count']}; smallest {record['smallest']:.2f}; the loss rises to first order in {', '.join(rises)}); "
        f"with the nearest point in place of the block-wise one at least {record['nearest']:.6f}"
    )
    same = [min(pair) > _SAME for pair in zip(record["loss"], record["random"], strict=True)]
    return measured, HOLDS if all(same) else PART if any(same) else FAILS


def columns_alone(results: Results) -> tuple[str, str]:
    record = check(results, "single norms")
    measured = (
        f"{record['columns']} of {record['count']} random W with ||W||_1 = 0.99 and a row-plus-column sum of 2 or "
        "more have a diagonal Lyapunov proof: one equilibrium, and stable from every start, which is more than claimed"
    )
    return measured, HOLDS if record["columns"] == record["violating"] == record["count"] else FAILS


def sums_alone(results: Results) -> tuple[str, str]:
    record = check(results, "single norms")
    measured = (
        f"{record['sums']} of {record['count']} random W with row-plus-column sums up to 1.98 and ||W||_1 > 1 are "
        "proved stable by P = I, from every start and with one equilibrium, which is more than claimed"
    )
    return measured, HOLDS if record["sums"] == record["beyond"] == record["count"] else FAILS


def one_norm_for_both(results: Results) -> tuple[str, str]:
    record = check(results, "single norms")
    measured = (
        f"{record['violating']} of {record['count']} random W with ||W||_1 = 0.99 and one large row break the "
        f"second inequality; what it is there for, stability, holds for {record['columns']} of them all the same"
    )
    if record["violating"] == 0:
        return measured, HOLDS
    return measured, PART if record["columns"] == record["count"] else FAILS


def equivariance(results: Results) -> tuple[str, str]:
    record = check(results, "equivariance")
    measured = (
        f"{record['count']} networks: trajectories seen from a common frame agree to {record['largest']:.0e} with the "
        f"equivariant activation, to {record['tanh']:.1g} with tanh by coordinates (relative); with a frame of its own "
        f"for every neuron theta -> h theta h^-1 is off by at least {record['own']:.1g}, and one common h is needed"
    )
    return measured, HOLDS if record["largest"] < _DIFFERENCES else FAILS


def norm_theorem(results: Results) -> tuple[str, str]:
    record = check(results, "norm conditions")
    measured = f"{record['certified']} of {record['count']} random W inside both norms have a diagonal Lyapunov proof"
    return measured, HOLDS if record["certified"] == record["count"] else FAILS


def algebras(results: Results) -> tuple[str, str]:
    record = check(results, "algebras")
    measured = (
        f"Ad of C^x is the identity (to {record['complex_identity']:.0e}) and differs from the product in "
        f"{record['complex_apart']:.0%} of random pairs, that of H^x in {record['quaternion_apart']:.0%}; on their "
        f"affine groups, in the translations, the equations agree to {record['affine_error']:.0e}"
    )
    literal = max(record["complex_apart"], record["quaternion_apart"]) < FEW
    return measured, HOLDS if literal else PART if record["affine_error"] < 1e-9 else FAILS


def projection(results: Results) -> tuple[str, str]:
    record = check(results, "projection")
    measured = (
        f"the nearest point is nearer than the block-wise one for {record['farther']:.0%} of random blocks, by "
        f"{record['median_excess']:.1%} (median) to {record['largest_excess']:.0%}; for {record['negative']:.0%} "
        "det((A + D)/2) < 0, where no rotation is near"
    )
    return measured, HOLDS if record["farther"] < FEW else PART if record["median_excess"] < 0.1 else FAILS


def activation(results: Results) -> tuple[str, str]:
    record = check(results, "activation")
    measured = (
        f"tanh by coordinates is off by {record['tanh']:.1f}, as the paper says; the form in ||omega|| is equivariant "
        f"to {record['printed']:.0e}, but sends the pure translation 1 to {record['printed_pure_translation']:.0f} "
        f"(corrected: {record['corrected_pure_translation']:.0f}); the form in sqrt(tr X^2) is not real for "
        f"{record['negative_trace']:.0%} of random twists"
    )
    sound = record["printed"] < 1e-9
    return measured, FAILS if not sound else HOLDS if record["negative_trace"] < FEW else PART


def gradient(results: Results) -> tuple[str, str]:
    record = check(results, "strength gradient")
    measured = (
        f"w/alpha for Ad is exact right after a projection (to {record['on_manifold']:.0e}); in between it is off by "
        f"{record['median_error']:.0%} (median) to {record['largest_error']:.0%}"
    )
    return measured, HOLDS if record["largest_error"] < 1e-6 else PART if record["on_manifold"] < 1e-6 else FAILS


def _exact(*errors: float) -> str:
    """Verdict on an equation, by the largest of its relative errors."""
    return HOLDS if max(errors) < _EXACT else FAILS


def _list(values: list[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)
