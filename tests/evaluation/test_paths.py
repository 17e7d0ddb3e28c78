"""Distances of paths, by hand and against the definition."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.paths import dtw_distance, frechet_distance, path_errors


def test_distances_by_hand():
    # 0 1 2 against 0 2: 0-0, 1-0 or 1-2, 2-2.
    one, other = np.array([[0.0], [1.0], [2.0]]), np.array([[0.0], [2.0]])
    assert dtw_distance(one, other) == dtw_distance(other, one) == 1.0
    assert frechet_distance(one, other) == frechet_distance(other, one) == 1.0
    # Back and forth: to match the detour to 3 somebody must wait at 0 or 1.
    there, back = np.array([[0.0], [3.0], [0.0], [1.0]]), np.array([[0.0], [1.0]])
    assert dtw_distance(there, back) == 2.0 + 1.0
    assert frechet_distance(there, back) == 2.0
    # A point against a path: every one of its samples is matched to it.
    assert dtw_distance([[0.0, 0.0]], [[3.0, 4.0], [0.0, 1.0]]) == 6.0
    assert frechet_distance([[3.0, 4.0], [0.0, 1.0]], [[0.0, 0.0]]) == 5.0


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

    assert dtw_distance(one, other) == pytest.approx(best(n - 1, m - 1, float.__add__))
    assert frechet_distance(one, other) == pytest.approx(best(n - 1, m - 1, max))


def test_errors_of_parallel_lines_do_not_depend_on_pace():
    shown = np.zeros((5, 6))
    shown[:, 3] = [1.0, 0.9, 0.5, 0.1, 0.0]
    found = np.zeros((3, 6))
    found[:, 3] = [1.0, 0.2, 0.0]
    found[:, 5] = 0.003
    errors = path_errors(found, shown)
    for value in (errors.rms_mm, errors.frechet_mm, errors.goal_mm, errors.dtwd_mm / 1000.0):
        assert value == pytest.approx(3.0)
    assert errors.rms_deg == errors.goal_deg == 0.0


def test_errors_of_turns_by_the_chart():
    # Half a turn about z takes v = (pi/2, 0, 0) to the position (0, 1, 0); without the turn it is where it was.
    one, other = np.zeros((2, 2, 6))
    one[:, 2], other[:, 2] = [np.pi, 0.0], [np.pi / 2.0, 0.0]
    one[0, 3] = np.pi / 2.0
    other[0, 4] = 1.0
    errors = path_errors(one, other)
    assert errors.goal_mm == errors.goal_deg == 0.0
    # From 90 degrees to none, linearly.
    assert errors.rms_deg == pytest.approx(90.0 / np.sqrt(3.0), rel=1e-3)
    assert path_errors(one, one).frechet_mm == 0.0
    with pytest.raises(InputError, match="samples of the same size"):
        dtw_distance(np.zeros((2, 3)), np.zeros((2, 2)))
