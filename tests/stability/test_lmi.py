"""Linear matrix inequalities against the descent: two ways to the best diagonal."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.stability import find_certificate, verify

seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=8)
@given(seeds, st.sampled_from([1, 3]), st.booleans())
def test_descent_finds_what_the_matrix_inequalities_find(seed, group_size, rotations):
    rng = np.random.default_rng(seed)
    if rotations:
        blocks = rng.normal(size=(3, 3, 1, 1)) * Rotation.random(9, rng=rng).as_matrix().reshape(3, 3, 3, 3)
        weight = blocks.transpose(0, 2, 1, 3).reshape(9, 9)
    else:
        scaling = np.repeat(10.0 ** rng.uniform(-1.0, 1.0, 3), 3)
        weight = scaling[:, None] * rng.normal(size=(9, 9)) / scaling
    descent = find_certificate(weight, group_size=group_size)
    lmi = find_certificate(weight, group_size=group_size, method="lmi")
    size = np.linalg.norm(np.sqrt(lmi.lyapunov_diagonal)[:, None] * weight / np.sqrt(lmi.lyapunov_diagonal), 2)
    assert descent.lambda_max <= lmi.lambda_max + 1e-5 * size
    assert descent.lambda_max == pytest.approx(lmi.lambda_max, abs=1e-3 * size)
    assert np.ptp(lmi.lyapunov_diagonal.reshape(-1, group_size), axis=1).max() == 0.0
    # What is reported is what the eigenvalues say of the diagonal reported.
    again = verify(lmi.lyapunov_diagonal, weight)
    assert again.lambda_max == pytest.approx(lmi.lambda_max, abs=1e-12 * size)


def test_no_weight_at_all_and_a_nilpotent_one():
    assert find_certificate(np.zeros((2, 2)), method="lmi").valid
    assert find_certificate([[0.0, 30.0], [0.0, 0.0]], method="lmi").valid


def test_without_cvxpy_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    with pytest.raises(LieEDNNError, match=r"method 'lmi' needs cvxpy: pip install 'lieednn_sim\[lmi\]'"):
        find_certificate(np.eye(2), method="lmi")
    assert find_certificate(0.5 * np.eye(2)).valid
