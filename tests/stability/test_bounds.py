"""Invariant boxes against trajectories, against the theorem's symmetric special case, and against smaller boxes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.stability import invariant_box, is_invariant

seeds = st.integers(0, 2**32 - 1)
rates_of_change = st.sampled_from([(1.0, 1.0), (2.0, 0.5), (0.3, 4.0)])


def arctan(x):
    return 2.0 / np.pi * np.arctan(0.5 * np.pi * x)


def random_network(rng, n, gamma, mu):
    """Weights of all sizes, stable or not, negative and large positive self-weights among them."""
    return gamma / mu * rng.normal(size=(n, n)) * rng.uniform(0.1, 2.0), gamma / mu * rng.normal(size=n)


def follow(weight, bias, start, phi, gamma, mu):
    """End points and steps of trajectories from starts ``(K, n)``, flattened into ``(steps, K, n)``."""
    shape = start.shape

    def flow(_, x):
        x = x.reshape(shape)
        return (-gamma * x + mu * (phi(x) @ weight.T + bias)).ravel()

    solution = solve_ivp(flow, (0.0, 10.0 / gamma), start.ravel(), method="DOP853", rtol=1e-10, atol=1e-12)
    return solution.y.T.reshape(-1, *shape)


@settings(max_examples=25)
@given(seeds, rates_of_change, st.sampled_from([np.tanh, arctan]))
def test_no_trajectory_leaves_the_box_from_any_point_in_it(seed, rates, phi):
    rng, (gamma, mu) = np.random.default_rng(seed), rates
    weight, bias = random_network(rng, 4, gamma, mu)
    low, high = invariant_box(weight, bias, rng.normal(size=(2, 4)), phi, gamma=gamma, mu=mu)
    assert is_invariant(weight, bias, low, high, phi, gamma=gamma, mu=mu)
    inside = rng.uniform(low, high, (6, 4))
    corners = np.where(rng.integers(0, 2, (6, 4)), low, high)
    path = follow(weight, bias, np.concatenate([inside, corners]), phi, gamma, mu)
    assert (path >= low - 1e-7).all()
    assert (path <= high + 1e-7).all()


@settings(max_examples=25)
@given(seeds, rates_of_change)
def test_box_is_the_least_around_its_starts(seed, rates):
    """A smaller box with one face moved in would be invariant with all others kept, if that face could move at all."""
    rng, (gamma, mu) = np.random.default_rng(seed), rates
    weight, bias = random_network(rng, 5, gamma, mu)
    start = rng.normal(size=(3, 5))
    low, high = invariant_box(weight, bias, start, np.tanh, gamma=gamma, mu=mu)
    assert (low <= start.min(axis=0)).all()
    assert (high >= start.max(axis=0)).all()
    moved = 0
    for i in range(5):
        for ends, sign, limit in ((low, -1.0, start.min(axis=0)), (high, 1.0, start.max(axis=0))):
            room = sign * (ends[i] - limit[i])
            if room > 1e-4:
                smaller = ends.copy()
                smaller[i] -= sign * rng.uniform(1e-5, room)
                box = (smaller, high) if ends is low else (low, smaller)
                assert not is_invariant(weight, bias, *box, np.tanh, gamma=gamma, mu=mu)
                moved += 1
    assert moved > 0


@settings(max_examples=40)
@given(seeds, rates_of_change)
def test_symmetric_condition_is_a_special_case(seed, rates):
    """mu (sum_j |w_ij| phi(r_j) + |b_i|) <= gamma r_i closes |xi_i| <= r_i; with a negative w_ii even less will do."""
    rng, (gamma, mu) = np.random.default_rng(seed), rates
    weight, bias = random_network(rng, 5, gamma, mu)
    r = rng.uniform(0.2, 3.0, 5)
    needed = mu * (np.abs(weight) @ np.tanh(r) + np.abs(bias)) / gamma
    # The weights as they are, times what makes the tightest face just closed.
    weight, bias = weight * (r / needed).min() * (1.0 - 1e-9), bias * (r / needed).min() * (1.0 - 1e-9)
    assert is_invariant(weight, bias, -r, r, np.tanh, gamma=gamma, mu=mu)
    tight = int(np.argmin(r / needed))
    # With every sign against it, that face gives way at the same size plus a little.
    weight[tight], bias[tight] = np.abs(weight[tight]), abs(bias[tight])
    weight[tight] *= 1.0 + 1e-6
    bias[tight] *= 1.0 + 1e-6
    assert not is_invariant(weight, bias, -r, r, np.tanh, gamma=gamma, mu=mu)


@settings(max_examples=40)
@given(seeds)
def test_faces_agree_with_the_vector_field_on_all_corners(seed):
    """phi is increasing, so the worst point of a face is a corner of it; all corners of a 3-box are few."""
    rng = np.random.default_rng(seed)
    weight, bias = random_network(rng, 3, 1.0, 1.0)
    low, high = np.sort(rng.normal(size=(2, 3)) * 2.0, axis=0)
    picks = np.array(np.meshgrid(*[[0, 1]] * 3)).reshape(3, -1).T
    corners = np.where(picks, high, low)
    field = -corners + np.tanh(corners) @ weight.T + bias
    outward = np.where(picks, field, -field)
    assert is_invariant(weight, bias, low, high, np.tanh, gamma=1.0, mu=1.0) == (outward.max() <= 0.0)


def test_equality_on_a_face_is_not_taken_for_a_proof():
    # xi' = -xi + 1: the face xi = 1 holds the equilibrium, and rounding could put the field on either side.
    assert not is_invariant([[0.0]], [1.0], [0.0], [1.0], np.tanh, gamma=1.0, mu=1.0)
    assert not is_invariant([[0.0]], [-1.0], [-1.0], [0.0], np.tanh, gamma=1.0, mu=1.0)
    assert is_invariant([[0.0]], [1.0], [0.0], [1.0 + 1e-14], np.tanh, gamma=1.0, mu=1.0)
    low, high = invariant_box([[0.0]], [1.0], [0.0], np.tanh, gamma=1.0, mu=1.0)
    assert low <= 0.0
    assert 1.0 < high < 1.0 + 1e-8
    assert is_invariant([[0.0]], [0.0], [0.0], [0.0], np.tanh, gamma=1.0, mu=1.0)


@settings(max_examples=30)
@given(st.floats(1.5, 6.0), st.floats(0.05, 0.5))
def test_one_neuron_stops_at_the_first_equilibrium_above_it(weight, start):
    """x' = -x + w tanh(x) with w > 1 leaves 0 for +x*, and the box must not reach beyond; w < 0 stays put."""
    low, high = invariant_box([[weight]], [0.0], [start], np.tanh, gamma=1.0, mu=1.0)
    x = high[0]
    for _ in range(200):
        x = weight * np.tanh(x)
    assert high[0] == pytest.approx(x, abs=1e-7)
    assert low[0] == pytest.approx(start, abs=1e-7)
    still = invariant_box([[-weight]], [0.0], [start], np.tanh, gamma=1.0, mu=1.0)
    assert still[1][0] == pytest.approx(start, abs=1e-7)
    assert still[0][0] == pytest.approx(0.0, abs=1e-7)


def test_unbounded_activation_with_a_growing_box_is_an_error():
    with pytest.raises(LieEDNNError, match="is phi bounded"):
        invariant_box([[2.0]], [0.0], [1.0], lambda x: x, gamma=1.0, mu=1.0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda b, s: is_invariant(b, s, [0.0, 2.0], [1.0, 1.0], np.tanh, gamma=1.0, mu=1.0), r"\[2, 1\] at entry 1"),
        (lambda b, s: is_invariant(b, [1.0], s, s, np.tanh, gamma=1.0, mu=1.0), r"bias must have shape \(2\)"),
        (lambda b, s: invariant_box(b, s, [1.0], np.tanh, gamma=1.0, mu=1.0), r"start must have shape \(2\)"),
        (lambda b, s: invariant_box(b, s, np.zeros((0, 2)), np.tanh, gamma=1.0, mu=1.0), "at least one point"),
        (lambda b, s: invariant_box(b, s, s, np.tanh, gamma=1.0, mu=-1.0), "mu must be positive"),
    ],
)
def test_wrong_input_is_named(call, words):
    with pytest.raises(InputError, match=words):
        call(np.eye(2), np.zeros(2))
