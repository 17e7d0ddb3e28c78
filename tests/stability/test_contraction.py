"""Contraction in a quadratic norm: levels by hand, all slopes, and an independent solver."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.errors import InputError
from lieednn_sim.stability import find_certificate, find_contraction, verify_contraction

seeds = st.integers(0, 2**32 - 1)
rates = st.sampled_from([(1.0, 1.0), (2.0, 0.5), (0.3, 4.0)])


def contracting(rng, n, gamma, mu):
    """A badly scaled weight with a skew part, somewhere below the level at which its contraction ends."""
    scaling = 10.0 ** rng.uniform(-1.0, 1.0, n)
    raw = rng.normal(size=(n, n))
    weight = scaling[:, None] * (raw - rng.uniform(0.0, 1.0) * raw.T) / scaling
    return weight * rng.uniform(0.3, 0.98) * gamma / mu / find_contraction(weight).value


@pytest.mark.parametrize(
    ("weight", "level"),
    [
        # The parabola beta^2 <= 4 v (v - alpha) through the numerical range.
        ([[0.0, 1.6], [-1.6, 0.0]], 0.8),
        ([[0.5, 3.0], [-3.0, 0.5]], 0.25 + np.sqrt(0.0625 + 2.25)),
        ([[-2.0, 1.0], [-1.0, -2.0]], -1.0 + np.sqrt(1.25)),
        ([[0.2, 0.5], [0.5, 0.2]], 0.7),
        ([[-3.0, 0.0], [0.0, -1.0]], 0.0),
        ([[0.0, 300.0], [0.0, 0.0]], 0.0),
    ],
)
def test_levels_by_hand(weight, level):
    found = find_contraction(weight)
    assert found.value == pytest.approx(level, abs=1e-5)
    assert found.rate == pytest.approx(1.0 - level if level < 1.0 else 0.0, abs=1e-5)


@settings(max_examples=6)
@given(seeds, rates)
def test_distances_fall_at_the_rate_for_all_slopes(seed, both):
    rng, (gamma, mu) = np.random.default_rng(seed), both
    weight = contracting(rng, 5, gamma, mu)
    found = find_contraction(weight, gamma=gamma, mu=mu)
    assert found.valid
    # Contraction is more than global stability, so never at a higher rate than that.
    assert found.rate <= find_certificate(weight, gamma=gamma, mu=mu).rate + 1e-6 * gamma
    t = found.factor
    slopes = ((np.arange(32)[:, None] >> np.arange(5)) & 1).astype(float)
    fields = t @ (mu * weight * slopes[:, None, :] - gamma * np.eye(5)) @ np.linalg.inv(t)
    logarithmic = np.linalg.eigvalsh(0.5 * (fields + fields.swapaxes(1, 2)))[:, -1]
    assert logarithmic.max() <= -found.rate * (1.0 - 1e-9)


@settings(max_examples=4)
@given(seeds)
def test_no_other_norm_and_multiplier_prove_much_more(seed):
    """The whole linear matrix inequality, P full and Q diagonal, by an interior-point solver."""
    cp = pytest.importorskip("cvxpy")
    weight = contracting(np.random.default_rng(seed), 4, 1.0, 1.0)
    found = find_contraction(weight)
    # In the coordinates of the answer, so that the solver sees numbers of about 1.
    root = np.sqrt(found.multiplier)
    scaled = root[:, None] * weight / root

    def margin(level):
        p, q, room = cp.Variable((4, 4), PSD=True), cp.Variable(4), cp.Variable()
        corner = p @ scaled + cp.diag(q)
        whole = cp.bmat([[2.0 * level * p, corner], [corner.T, 2.0 * cp.diag(q)]])
        problem = cp.Problem(
            cp.Maximize(room), [0.5 * (whole + whole.T) >> room * np.eye(8), cp.trace(p) <= 4.0, q <= 10.0]
        )
        problem.solve(solver=cp.CLARABEL)
        return room.value

    assert margin(1.001 * found.value + 1e-4) > 0.0
    assert margin(0.97 * found.value - 1e-3) < 1e-7


def test_only_what_is_proved_is_valid():
    weight = np.array([[0.0, 1.6], [-1.6, 0.0]])
    found = find_contraction(weight)
    assert verify_contraction(found.factor, found.multiplier, weight).value == found.value
    assert "contracting at a rate of at least 0.2" in str(found)
    # The same norm, but not beside the same multiplier.
    assert not verify_contraction(2.0 * found.factor, found.multiplier, weight).valid
    # On the boundary rounding decides against it; a norm of no digits proves nothing.
    assert not verify_contraction(np.eye(2), np.ones(2), np.eye(2)).valid
    assert not verify_contraction(np.diag([1.0, 1e13]), np.ones(2), np.zeros((2, 2))).valid
    assert "not proved" in str(find_contraction(2.0 * weight))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: verify_contraction(np.ones((2, 2)), np.ones(2), np.eye(2)), "factor must be upper triangular"),
        (lambda: verify_contraction(-np.eye(2), np.ones(2), np.eye(2)), "positive diagonal"),
        (lambda: verify_contraction(np.eye(2), [1.0, 0.0], np.eye(2)), "multiplier must be positive, .* is 0"),
        (lambda: find_contraction(np.ones((2, 3))), r"weight must have shape \(n, n\)"),
    ],
)
def test_wrong_input_is_named(call, words):
    with pytest.raises(InputError, match=words):
        call()
