"""Invariant boxes: bounds lower <= xi <= upper that no trajectory leaves, proved face by face.

Nagumo's theorem: a box is never left when on each face the vector field does not point outward. For
xi' = -gamma xi + mu W phi(xi) + mu b with phi increasing, the worst point of the face xi_i = upper_i puts every other
xi_j at its upper end where w_ij > 0 and at its lower end where w_ij < 0, so the face is closed exactly when

    w_ii phi(upper_i) + sum_{j != i} (w_ij^+ phi(upper_j) + w_ij^- phi(lower_j)) + b_i <= (gamma/mu) upper_i,

with w^+ = max(w, 0) and w^- = min(w, 0); the lower faces are the mirror image.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.stability.norms import as_weight
from lieednn_sim.validation import LARGEST, as_floats, as_ratio
from lieednn_sim.values import Floats

Activation = Callable[[Floats], Floats]

_EPS = float(np.finfo(float).eps)
# Relative size by which the search lets the field point inward on a face, so that rounding cannot undo it.
_INWARD = 1e-9
_MAX_ITERATIONS = 200_000


def is_invariant(
    weight: ArrayLike,
    bias: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    phi: Activation,
    *,
    gamma: float,
    mu: float,
) -> bool:
    """Whether no trajectory leaves the box lower <= xi <= upper, with rounding errors on the unsafe side.

    Args:
        weight: W, ``(n, n)``.
        bias: b, ``(n,)``.
        lower: ``(n,)`` lower ends.
        upper: ``(n,)`` upper ends, none below its lower end.
        phi: activation, entry by entry; increasing, with slopes of at most 1.
        gamma: decay rate, positive.
        mu: scale of the interaction, positive.

    Returns:
        True only when proved. A box that meets the condition with equality fails, because of rounding.

    Raises:
        InputError: wrong shapes, or an upper end below its lower end.
    """
    matrix = as_weight("weight", weight)
    n = len(matrix)
    shift = as_floats("bias", bias, (n,))
    low, high = as_floats("lower", lower, (n,)), as_floats("upper", upper, (n,))
    if (high < low).any():
        worst = int(np.argmax(low - high))
        raise InputError(f"upper must not lie below lower, got [{low[worst]:g}, {high[worst]:g}] at entry {worst}")
    ratio = as_ratio(gamma, mu)
    outward_low, outward_high = _outward(matrix, shift, low, high, phi, ratio)
    # Sums of n products with a phi good to a few units in the last place.
    terms = np.abs(matrix) @ np.maximum(np.abs(phi(low)), np.abs(phi(high))) + np.abs(shift)
    rounding = (n + 16.0) * _EPS * (terms + ratio * np.maximum(np.abs(low), np.abs(high)))
    return bool((outward_low + rounding <= 0.0).all() and (outward_high + rounding <= 0.0).all())


def invariant_box(
    weight: ArrayLike, bias: ArrayLike, start: ArrayLike, phi: Activation, *, gamma: float, mu: float
) -> tuple[Floats, Floats]:
    """The least invariant box around one or more start points, which bounds the whole motion from each of them.

    Invariant boxes around the starts intersect in another, so there is a least one. The box grows from the starts: each
    face moves out by its outward field over the largest slope that this can have in the face's own position,
    gamma/mu + max(-w_ii, 0), hence never beyond the least box. It ends slightly outside, where `is_invariant` holds.

    Args:
        weight: W, ``(n, n)``.
        bias: b, ``(n,)``.
        start: start points, ``(n,)`` or ``(K, n)``.
        phi: activation, entry by entry; increasing, bounded, with slopes of at most 1.
        gamma: decay rate, positive.
        mu: scale of the interaction, positive.

    Returns:
        Lower and upper ends, ``(n,)`` each, within about 1e-9 of the least.

    Raises:
        InputError: wrong shapes.
        NoSolutionError: the box did not stop growing. With a bounded phi it does, though slowly where a smaller
            invariant box has only just ceased to exist.
    """
    matrix = as_weight("weight", weight)
    n = len(matrix)
    shift = as_floats("bias", bias, (n,))
    points = as_floats("start", start, (), batched=True)
    points = as_floats("start", points, (n,) if points.ndim < 2 else ("K", n)).reshape(-1, n)
    if not len(points):
        raise InputError("start must hold at least one point, got shape (0, n)")
    ratio = as_ratio(gamma, mu)
    low, high = points.min(axis=0), points.max(axis=0)
    steepest = ratio + np.maximum(-np.diag(matrix), 0.0)
    radius = np.maximum(np.abs(low), np.abs(high))
    inward = _INWARD * (np.abs(matrix).sum(axis=1) + np.abs(shift) + ratio * radius)
    for _ in range(_MAX_ITERATIONS):
        outward_low, outward_high = _outward(matrix, shift, low, high, phi, ratio)
        # Grow until the field points inward by half of `inward` at least; each step aims for all of it.
        if (outward_low <= -0.5 * inward).all() and (outward_high <= -0.5 * inward).all():
            break
        # Only an unbounded phi lets a box grow so far.
        if max(np.abs(low).max(), np.abs(high).max()) > LARGEST:
            break
        low = low - np.maximum(outward_low + inward, 0.0) / steepest
        high = high + np.maximum(outward_high + inward, 0.0) / steepest
    bounded = max(np.abs(low).max(), np.abs(high).max()) <= LARGEST
    if not (bounded and is_invariant(matrix, shift, low, high, phi, gamma=gamma, mu=mu)):
        raise NoSolutionError(
            f"no invariant box found: it still grows after {_MAX_ITERATIONS} steps or beyond {LARGEST:g}; "
            "is phi bounded?"
        )
    return low, high


def _outward(
    weight: Floats, bias: Floats, low: Floats, high: Floats, phi: Activation, ratio: float
) -> tuple[Floats, Floats]:
    """Largest outward component of the field over mu on each lower and each upper face, ``(n,)`` each."""
    diagonal = np.diag(weight)
    others = weight - np.diag(diagonal)
    positive, negative = np.maximum(others, 0.0), np.minimum(others, 0.0)
    at_low, at_high = phi(low), phi(high)
    on_high = diagonal * at_high + positive @ at_high + negative @ at_low + bias - ratio * high
    on_low = diagonal * at_low + positive @ at_low + negative @ at_high + bias - ratio * low
    return -on_low, on_high
