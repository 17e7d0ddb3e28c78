"""The search for a certificate against linear matrix inequalities, solved by an interior-point method."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim.stability import find_certificate

seeds = st.integers(0, 2**32 - 1)


def largest_margin(weight, level, group_size):
    """The largest t with P W + W^T P - 2 level P <= -t I for a diagonal P of mean 1: positive if level is feasible."""
    import cvxpy as cp  # by the worker that needs it, not by all that collect the tests

    n = len(weight)
    entries, margin = cp.Variable(n // group_size, nonneg=True), cp.Variable()
    diagonal = cp.diag(np.kron(np.eye(n // group_size), np.ones((group_size, 1))) @ entries)
    product = diagonal @ weight
    inequality = product + product.T - 2.0 * level * diagonal << -margin * np.eye(n)
    cp.Problem(cp.Maximize(margin), [inequality, cp.sum(entries) == n // group_size]).solve(solver=cp.CLARABEL)
    return margin.value


@settings(max_examples=5)
@given(seeds, st.sampled_from([1, 3]), st.booleans())
def test_no_other_diagonal_proves_more(seed, group_size, rotations):
    rng = np.random.default_rng(seed)
    if rotations:
        blocks = rng.normal(size=(3, 3, 1, 1)) * Rotation.random(9, rng=rng).as_matrix().reshape(3, 3, 3, 3)
        weight = blocks.transpose(0, 2, 1, 3).reshape(9, 9)
    else:
        scaling = np.repeat(10.0 ** rng.uniform(-1.0, 1.0, 3), 3)
        weight = scaling[:, None] * rng.normal(size=(9, 9)) / scaling
    found = find_certificate(weight, group_size=group_size)
    assert np.ptp(found.lyapunov_diagonal.reshape(-1, group_size), axis=1).max() == 0.0
    # In the coordinates of the answer, so that the solver sees numbers of about 1.
    root = np.sqrt(found.lyapunov_diagonal)
    scaled = root[:, None] * weight / root
    size = np.linalg.norm(scaled, 2)
    assert largest_margin(scaled / size, found.lambda_max / size - 1e-5, group_size) < 1e-8
    assert largest_margin(scaled / size, found.lambda_max / size + 1e-5, group_size) > 1e-8
