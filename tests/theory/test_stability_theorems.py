"""The paper's theorems on stability and smoothness, each in a test of its name (Sec. 3.2, App. G, H and I)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from lieednn_sim.stability import assess, smallest_one_norm
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


def assert_one_attractor(weight, bias, rng, gamma, mu, rate):
    """The states from far apart end in one and the same point, and that is an equilibrium."""
    starts = rng.normal(size=(6, len(weight))) * 10.0 ** rng.uniform(-1, 1, (6, 1))
    _, x = solve(weight, bias, starts, gamma, mu, 25.0 / rate)
    np.testing.assert_allclose(x[-1], np.broadcast_to(x[-1, 0], x[-1].shape), atol=1e-7)
    field = -gamma * x[-1, 0] + mu * (weight @ np.tanh(x[-1, 0]) + bias)
    assert np.abs(field).max() < 1e-6 * (gamma + mu)


@settings(max_examples=10)
@given(seeds, rates_of_change)
def test_theorem_equilibrium_condition_and_asymptotic_stability(seed, rates):
    """Sec. 3.2 and App. G: columns below gamma/mu and row-plus-column sums below 2 gamma/mu.

    Then an equilibrium exists, there is only one, and it is asymptotically stable, in fact from every start.
    """
    rng, (gamma, mu) = np.random.default_rng(seed), rates
    weight = rng.normal(size=(6, 6)) * 10.0 ** rng.uniform(-1, 0, (6, 1))
    columns = np.abs(weight).sum(axis=0)
    both = columns + np.abs(weight).sum(axis=1)
    weight *= 0.95 * gamma / mu / max(columns.max(), 0.5 * both.max())
    verdict = assess(weight, gamma=gamma, mu=mu)
    assert verdict["1-norm"].holds
    assert verdict["norm sum"].holds
    assert_one_attractor(weight, rng.normal(size=6) * gamma / mu, rng, gamma, mu, verdict.best_rate)


@settings(max_examples=10)
@given(seeds, st.booleans())
def test_theorem_equilibrium_condition_and_asymptotic_stability_each_norm_alone_suffices(seed, transpose):
    """Stronger than the paper: ||W||_1 < gamma/mu alone is enough, and so is ||W||_inf, with a rate in its own norm.

    d|e|_1/dt <= -(gamma - mu ||W||_1) |e|_1 by the triangle inequality, and the same for the largest coordinate. The
    weights here are far outside of the paper's second inequality.
    """
    rng = np.random.default_rng(seed)
    weight = 0.1 * rng.uniform(-1, 1, (8, 8))
    weight[0] = rng.choice([-1.0, 1.0], 8) * rng.uniform(0.7, 1.0, 8)
    weight *= 0.9 / np.linalg.norm(weight, 1)
    weight = weight.T if transpose else weight
    verdict = assess(weight, gamma=1.0, mu=1.0)
    name = "infinity norm" if transpose else "1-norm"
    assert [condition.holds for condition in verdict.conditions[:3]] == [not transpose, transpose, False]
    bias = rng.normal(size=8)
    assert_one_attractor(weight, bias, rng, 1.0, 1.0, verdict[name].rate)
    t, x = solve(weight, bias, 3.0 * rng.normal(size=(2, 8)), 1.0, 1.0, 10.0)
    distance = np.linalg.norm(x[:, 0] - x[:, 1], np.inf if transpose else 1, axis=1)
    assert (np.diff(np.log(distance)) <= -verdict[name].rate * np.diff(t) + 1e-6).all()


@settings(max_examples=20)
@given(seeds)
def test_theorem_equilibrium_condition_and_asymptotic_stability_with_unequal_lipschitz_constants(seed):
    """The index of L_i: a column sum weighted by the receiver's L_i is no contraction in the plain 1-norm.

    It is one in the norm sum_i L_i |x_i|, so the printed condition sum_i L_i |w_ij| < gamma/mu is right although the
    step that the paper takes in the 1-norm, which needs L_j, is not.
    """
    rng = np.random.default_rng(seed)
    lipschitz = 10.0 ** rng.uniform(-2, 1, 5)
    weight = rng.normal(size=(5, 5))
    weight /= 1.01 * (lipschitz[:, None] * np.abs(weight)).sum(axis=0).max()
    x, y = rng.normal(size=(2, 500, 5)) * 10.0 ** rng.uniform(-2, 1, (2, 500, 1))
    image = (np.tanh(lipschitz * x) - np.tanh(lipschitz * y)) @ weight.T
    assert (np.abs(image) @ lipschitz < np.abs(x - y) @ lipschitz).all()
    # One sender with a steep activation already stretches the 1-norm, under the printed condition.
    stretched = np.array([[0.0, 5.0], [0.0, 0.0]]) @ np.tanh(np.array([0.1, 3.0]) * np.array([0.0, 1e-3]))
    assert 0.1 * 5.0 < 1.0
    assert np.abs(stretched).sum() > 1e-3


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


@settings(max_examples=10)
@given(seeds, rates_of_change)
def test_theorem_sufficient_condition_of_norm_constraints(seed, rates):
    """App. I: ||W||_1 + ||W||_inf < 2 gamma/mu implies the sums, and V = |e|^2/2 falls by at least what it states.

    V' <= -(gamma - mu/2 max_j sum_i (|w_ij| + |w_ji|)) |e|^2. T(xi) = (mu/gamma)(W phi(xi) + b) contracts in the
    1-norm when ||W||_1 < gamma/mu, by a factor below 1, as Banach's theorem needs (the paper prints "below infinity").
    """
    rng, (gamma, mu) = np.random.default_rng(seed), rates
    weight = rng.normal(size=(6, 6))
    weight *= 0.99 * gamma / mu / max(np.linalg.norm(weight, 1), np.linalg.norm(weight, np.inf))
    verdict = assess(weight, gamma=gamma, mu=mu)
    assert verdict["1-norm"].holds
    assert verdict["norm sum"].holds
    both = (np.abs(weight) + np.abs(weight).T).sum(axis=0).max()
    assert both <= verdict["1-norm"].value + verdict["infinity norm"].value
    assert verdict["norm sum"].rate == pytest.approx(gamma - 0.5 * mu * both)
    # An equilibrium made to order, and the derivative of V at random points near and far from it.
    x_star = rng.normal(size=6)
    bias = gamma / mu * x_star - weight @ np.tanh(x_star)
    e = rng.normal(size=(500, 6)) * 10.0 ** rng.uniform(-6, 2, (500, 1))
    x = x_star + e
    field = -gamma * x + mu * (np.tanh(x) @ weight.T + bias)
    assert ((e * field).sum(axis=1) <= -verdict["norm sum"].rate * (e * e).sum(axis=1) * (1.0 - 1e-8)).all()
    contracted = mu / gamma * np.abs((np.tanh(x) - np.tanh(x_star)) @ weight.T).sum(axis=1)
    factor = mu / gamma * verdict["1-norm"].value
    assert factor < 1.0
    assert (contracted <= factor * np.abs(e).sum(axis=1) * (1.0 + 1e-8)).all()
    assert_one_attractor(weight, bias, rng, gamma, mu, verdict.best_rate)


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
    assert curvature(velocity, acceleration).max() <= np.abs(acceleration).max() <= bounds.curvature
    assert (bounds.closing is not None) == small
    if small:
        assert bounds.acceleration < bounds.closing
        assert bounds.closing == pytest.approx(2.0 * gamma * (gamma * radius + gamma + mu * np.abs(bias).max()))
    # That this is the second derivative: central differences of the velocity along a fine solution.
    h = 1e-4 / gamma
    around = np.stack([x[10] + s * h * velocity[10] + 0.5 * h * h * acceleration[10] for s in (-1.0, 1.0)])
    shifted = -gamma * around + mu * (np.tanh(around) @ weight.T + bias)
    np.testing.assert_allclose((shifted[1] - shifted[0]) / (2.0 * h), acceleration[10], atol=1e-5 * bounds.acceleration)


def test_theorem_smoothness_and_curvature_bound_closing_line_fails_without_its_norm_condition():
    """The closing bound is printed for every network; a trained one (||W||_inf > gamma/mu) may break it."""
    weight, bias = np.array([[-8.0]]), np.array([0.0])
    x = np.array([0.3])
    velocity = -x + weight @ np.tanh(x)
    acceleration = -velocity + weight @ ((1.0 - np.tanh(x) ** 2) * velocity)
    radius = float(np.abs(x).max())  # -x + w tanh(x) pulls towards 0, so |xi| never grows
    assert np.abs(acceleration).max() > 2.0 * (radius + 1.0 + 0.0)
    assert np.abs(acceleration).max() <= smoothness_bounds(weight, bias, radius, gamma=1.0, mu=1.0).acceleration
    assert smoothness_bounds(weight, bias, radius, gamma=1.0, mu=1.0).closing is None
