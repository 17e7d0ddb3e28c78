"""Dynamic time warping, by hand and against the definition."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations.alignment import warp


def test_distances_by_hand():
    # 0 1 2 against 0 2: 0-0, 1-0 or 1-2, 2-2.
    one, other = np.array([[0.0], [1.0], [2.0]]), np.array([[0.0], [2.0]])
    for first, second in ((one, other), (other, one)):
        found = warp(first, second)
        assert (found.total, found.frechet, len(found.pairs)) == (1.0, 1.0, 3)
    # Back and forth: to match the detour to 3 somebody must wait at 1.
    found = warp([[0.0], [3.0], [0.2], [1.0]], [[0.0], [1.0]])
    assert found.total == pytest.approx(2.0 + 0.8)
    assert found.frechet == 2.0
    assert found.pairs.tolist() == [[0, 0], [1, 1], [2, 1], [3, 1]]
    # A point against a path: every one of its samples is matched to it.
    assert warp([[0.0, 0.0]], [[3.0, 4.0], [0.0, 1.0]]).total == 6.0
    assert warp([[3.0, 4.0], [0.0, 1.0]], [[0.0, 0.0]]).frechet == 5.0
    with pytest.raises(InputError, match="samples of the same size"):
        warp(np.zeros((2, 3)), np.zeros((2, 2)))


@settings(max_examples=30)
@given(st.integers(1, 6), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_distances_are_what_they_are_defined_to_be(n, m, seed):
    rng = np.random.default_rng(seed)
    one, other = rng.normal(size=(n, 2)), rng.normal(size=(m, 2))

    @functools.cache
    def best(i, j, join):
        if i < 0 or j < 0:
            return 0.0 if (i, j) == (-1, -1) else np.inf
        before = min(best(i - 1, j, join), best(i, j - 1, join), best(i - 1, j - 1, join))
        return join(float(np.linalg.norm(one[i] - other[j])), before)

    found = warp(one, other)
    assert found.total == pytest.approx(best(n - 1, m - 1, float.__add__))
    assert found.frechet == pytest.approx(best(n - 1, m - 1, max))
    first, second = found.pairs.T
    assert np.linalg.norm(one[first] - other[second], axis=1).sum() == pytest.approx(found.total)
    steps = np.diff(found.pairs, axis=0).tolist()
    assert found.pairs[0].tolist() == [0, 0]
    assert found.pairs[-1].tolist() == [n - 1, m - 1]
    assert all(step in ([0, 1], [1, 0], [1, 1]) for step in steps)
