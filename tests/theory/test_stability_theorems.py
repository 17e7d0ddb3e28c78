"""The paper's theorems on stability and smoothness, each in a test of its name (Sec. 3.2, App. G, H and I)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from lieednn_sim.stability import smallest_one_norm
from lieednn_sim.theory import curvature, smoothness_bounds

seeds = st.integers(0, 2**32 - 1)
# Pairs (gamma, mu).
rates_of_change = st.sampled_from([(1.0, 1.0), (2.0, 0.5), (0.3, 4.0)])


def solve(weight, bias, starts, gamma, mu, duration):
    """Trajectories from starts ``(K, n)``: times ``(T,)``, states ``(T, K, n)``."""
    shape = starts.shape

    def flow(_, x):
        x = x.reshape(shape)
        return (-gamma * x + mu * (np.tanh(x) @ weight.T + bias)).ravel()

    t = np.linspace(0.0, duration, 100)
    solution = solve_ivp(flow, (0.0, duration), starts.ravel(), t_eval=t, method="DOP853", rtol=1e-10, atol=1e-12)
    return t, solution.y.T.reshape(len(t), *shape)


def test_theorem_equilibrium_condition_and_asymptotic_stability_excludes_the_papers_own_targets():
    """No W with an equilibrium at xi_d ~ U(-0.8, 0.8), b = 1/8, gamma = mu = 1 meets the norms, for nearly every xi_d.

    Such a W obeys W u = r with u = tanh(xi_d), r = xi_d - b, so ||W||_p >= |r|_p / |u|_p, and the row-plus-column
    condition forces u^T r < u^T u. Of 24-dimensional targets 96.5 % exclude ||W||_1 < 1, 99.6 % exclude ||W||_inf < 1,
    99.9 % at least one of them, and 96.3 % the row-plus-column condition.
    """
    rng = np.random.default_rng(1)
    targets = rng.uniform(-0.8, 0.8, (20_000, 24))
    output, required = np.tanh(targets), targets - 0.125
    one = np.array([smallest_one_norm(u, r) for u, r in zip(output[:2000], required[:2000], strict=True)]) >= 1.0
    infinity = np.abs(required).max(axis=1) >= np.abs(output).max(axis=1)
    sums = (output * required).sum(axis=1) >= (output * output).sum(axis=1)
    every_one = np.abs(required).sum(axis=1) >= np.abs(output).sum(axis=1)
    np.testing.assert_array_equal(one, every_one[:2000])
    assert every_one.mean() == pytest.approx(0.965, abs=0.005)
    assert infinity.mean() == pytest.approx(0.996, abs=0.002)
    assert (every_one | infinity).mean() == pytest.approx(0.9986, abs=0.001)
    assert sums.mean() == pytest.approx(0.963, abs=0.005)


@settings(max_examples=15)
@given(seeds, rates_of_change, st.booleans())
def test_theorem_smoothness_and_curvature_bound(seed, rates, small):
    """App. H: bounds on xi'', and on the curvature of each component, along trajectories inside |xi|_inf <= R.

    The exact second derivative is J_F(xi) F(xi). R is one that no trajectory exceeds, so the bounds hold for all time.
    The closing bound, 2 gamma (gamma R + gamma + mu b_max) with b_max = max |b_i|, needs ||W||_inf < gamma/mu.
    """
    rng, (gamma, mu) = np.random.default_rng(seed), rates
    weight = rng.normal(size=(6, 6))
    weight *= (0.95 if small else 3.0) * gamma / mu / np.linalg.norm(weight, np.inf)
    bias = rng.normal(size=6) * 0.3 * gamma / mu
    start = rng.normal(size=(1, 6)) * 2.0
    radius = max(np.abs(start).max(), mu / gamma * (np.linalg.norm(weight, np.inf) + np.abs(bias).max()))
    bounds = smoothness_bounds(weight, bias, radius, gamma=gamma, mu=mu)
    x = solve(weight, bias, start, gamma, mu, 8.0 / gamma)[1][:, 0]
    assert np.abs(x).max() <= radius * (1.0 + 1e-8)
    velocity = -gamma * x + mu * (np.tanh(x) @ weight.T + bias)
    slopes = 1.0 - np.tanh(x) ** 2
    acceleration = -gamma * velocity + mu * (slopes * velocity) @ weight.T
    assert np.abs(velocity).max() <= bounds.velocity
    assert np.abs(acceleration).max() <= bounds.acceleration
    assert curvature(velocity, acceleration).max() <= np.abs(acceleration).max() <= bounds.acceleration
    assert (bounds.closing is not None) == small
    if small:
        assert bounds.acceleration < bounds.closing
        assert bounds.closing == pytest.approx(2.0 * gamma * (gamma * radius + gamma + mu * np.abs(bias).max()))
    # That this is the second derivative: central differences of the velocity along a fine solution.
    h = 1e-4 / gamma
    around = np.stack([x[10] + s * h * velocity[10] + 0.5 * h * h * acceleration[10] for s in (-1.0, 1.0)])
    shifted = -gamma * around + mu * (np.tanh(around) @ weight.T + bias)
    np.testing.assert_allclose((shifted[1] - shifted[0]) / (2.0 * h), acceleration[10], atol=1e-5 * bounds.acceleration)
