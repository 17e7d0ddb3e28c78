"""Norms and log norms against brute force over the slopes, and the paper's norms against what any network can reach."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.errors import InputError
from lieednn_sim.stability import log_norms, smallest_one_norm, verify, weighted_norm

seeds = st.integers(0, 2**32 - 1)


def one_log_norm(a):
    """Textbook mu_1 of a stack of matrices: largest a_jj + sum_{i != j} |a_ij|."""
    diagonal = np.diagonal(a, axis1=-2, axis2=-1)
    return (np.abs(a).sum(axis=-2) - np.abs(diagonal) + diagonal).max(axis=-1)


@settings(max_examples=20)
@given(seeds)
def test_smallest_one_norm_is_attained_and_never_beaten(seed):
    rng = np.random.default_rng(seed)
    output, required = rng.normal(size=(2, 12))
    smallest = smallest_one_norm(output.reshape(2, 6), required.reshape(2, 6))
    attained = np.outer(required, np.sign(output)) / np.abs(output).sum()
    np.testing.assert_allclose(attained @ output, required, atol=1e-13)
    assert np.linalg.norm(attained, 1) == pytest.approx(smallest, rel=1e-13)
    others = rng.normal(size=(50, 12, 12)) * 10.0 ** rng.uniform(-3, 0, (50, 1, 1))
    others -= (others @ output)[..., None] * output / (output @ output)
    norms = np.abs(attained + others).sum(axis=-2).max(axis=-1)
    assert norms.min() >= smallest * (1.0 - 1e-13)


def test_smallest_one_norm_of_nothing():
    assert smallest_one_norm(np.zeros(3), np.zeros(3)) == 0.0
    assert smallest_one_norm(np.zeros(3), [0.0, 1.0, 0.0]) == np.inf
    assert smallest_one_norm(np.ones(3), np.zeros(3)) == 0.0


@settings(max_examples=20)
@given(seeds)
def test_log_norms_are_the_largest_over_all_slopes(seed):
    """Each is a maximum over a box of a convex function, so the corners (all slopes 0 or 1) decide it."""
    rng = np.random.default_rng(seed)
    weight = rng.normal(size=(5, 5)) - 2.0 * np.diag(rng.uniform(size=5))
    slopes = np.array(np.meshgrid(*[[0.0, 1.0]] * 5)).reshape(5, -1).T
    found = log_norms(weight)
    assert found.log_norm_one == pytest.approx(one_log_norm(weight * slopes[:, None, :]).max(), rel=1e-12)
    rows = one_log_norm(np.swapaxes(weight * slopes[:, None, :], -1, -2))
    assert found.log_norm_infinity == pytest.approx(rows.max(), rel=1e-12)


@settings(max_examples=20)
@given(seeds)
def test_weighted_norm_is_the_spectral_abscissa_of_the_majorant_and_its_weights_prove_it(seed):
    rng = np.random.default_rng(seed)
    scaling = 10.0 ** rng.uniform(-2, 2, 6)
    weight = scaling[:, None] * rng.normal(size=(6, 6)) / scaling
    weight -= np.diag(rng.uniform(0.0, 3.0, 6))
    majorant = np.where(np.eye(6, dtype=bool), weight, np.abs(weight))
    found = weighted_norm(weight)
    exact = max(0.0, np.linalg.eigvals(majorant).real.max())
    assert exact * (1.0 - 1e-9) <= found.value <= exact * (1.0 + 1e-6) + 1e-8 * np.abs(weight).sum()
    # The weights themselves, without any eigenvalue: mu_1 of P W D P^-1 for random slopes stays below.
    slopes = np.concatenate([rng.uniform(size=(100, 6)), rng.integers(0, 2, size=(100, 6))])
    transformed = found.left[:, None] * weight / found.left * slopes[:, None, :]
    assert one_log_norm(transformed).max() <= found.value * (1.0 + 1e-12)
    # Left over right is a diagonal Lyapunov matrix that proves the same.
    assert verify(found.left / found.right, weight).lambda_max <= found.value * (1.0 + 1e-6)


def test_weighted_norm_of_reducible_and_damped_weights():
    assert weighted_norm(np.zeros((3, 3))).value == 0.0
    # A chain: the majorant is nilpotent, and unweighted norms are 300.
    assert weighted_norm(np.diag([300.0, 300.0], 1)).value < 0.01
    # Slopes can switch a column off, so damping never proves more than gamma.
    assert weighted_norm([[-3.0, 1.0], [1.0, -3.0]]).value == 0.0
    assert log_norms([[-3.0, 1.0], [1.0, -3.0]]).log_norm_one == 0.0
    assert log_norms([[-3.0, 1.0], [1.0, -3.0]]).log_norm_infinity == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        pytest.param(lambda: smallest_one_norm(np.ones(2), np.ones(3)), r"required.*3", id="unequal lengths"),
        (lambda: log_norms(np.ones((2, 3))), r"weight must have shape \(n, n\), got \(2, 3\)"),
        pytest.param(lambda: weighted_norm(np.zeros((0, 0))), "n >= 1", id="empty"),
    ],
)
def test_wrong_input_is_named(call, words):
    with pytest.raises(InputError, match=words):
        call()
