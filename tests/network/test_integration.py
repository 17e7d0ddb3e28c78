"""Quick ways to integrate: interpolants of all steps at once, and Runge and Kutta's steps by few products."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lieednn_sim.network import LieEDNN
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.network.stepping import RungeKuttaStepper


def drawn(rng: np.random.Generator, size: float, **rates) -> LieEDNN:
    return LieEDNN(
        alpha=size * rng.normal(size=(3, 3)),
        rotation=np.broadcast_to(np.eye(3), (3, 3, 3, 3)),
        translation=rng.normal(size=(3, 3, 3)),
        bias=rng.normal(size=(3, 6)),
        **rates,
    )


@pytest.mark.parametrize("method", ["RK45", "DOP853"])
def test_interpolants_are_those_of_scipy(method):
    network, rng = drawn(np.random.default_rng(3), 0.5), np.random.default_rng(4)
    start, t = rng.normal(size=(3, 6)), np.sort(rng.uniform(0.0, 9.0, 500))
    found = network.trajectory(start, 9.0, method=method, rtol=1e-6, atol=1e-8)(t)
    given = {"method": method, "rtol": 1e-6, "atol": 1e-8, "dense_output": True}
    expected = solve_ivp(lambda _, x: network.flat_vector_field(x), (0.0, 9.0), start.ravel(), **given).sol(t)
    np.testing.assert_allclose(found.reshape(500, 18), expected.T, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("activation", ["tanh", "arctan"])
def test_a_step_by_few_products_is_that_of_runge_and_kutta(activation):
    rng = np.random.default_rng(2)
    network = drawn(rng, 1.0, gamma=1.7, mu=0.6, activation=activation)
    stepping, x = RungeKuttaStepper(network), rng.normal(size=18)
    pull, other, drive = network.mu / network.gamma * network.bias.ravel(), x, stepping.drive(x)
    np.testing.assert_allclose(network.gamma * (pull + drive - x), network.flat_vector_field(x), atol=1e-14)
    for h in (0.3, 0.3, 0.7):
        x, drive = stepping.step(x, drive, pull, network.gamma * h)
        other = runge_kutta_step(lambda y: network.flat_vector_field(y), other, h)
        np.testing.assert_allclose(x, other, rtol=1e-13, atol=1e-13)
        np.testing.assert_array_equal(drive, stepping.drive(x))


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "BDF", "LSODA"])
@pytest.mark.parametrize("gamma", [1e18, 1e75])
def test_a_fast_network_is_a_slow_one_in_other_units_of_time(method, gamma):
    start = np.ones((3, 6))
    alone = drawn(np.random.default_rng(0), 0.0, gamma=gamma, mu=gamma)
    end = alone.bias
    found = alone.trajectory(start, 60.0 / gamma, until=end, distance=1e-6, method=method)
    # Without weights x = b + (x_0 - b) e^(-gamma t).
    assert gamma * found.t[-1] == pytest.approx(np.log(np.abs(start - end).max() / 1e-6), abs=0.1)
    assert np.abs(found.xi[-1] - end).max() == pytest.approx(1e-6, rel=1e-6)
    z = np.linspace(0.0, 0.99, 30) * gamma * found.t[-1]
    exact = end + (start - end) * np.exp(-z)[:, None, None]
    np.testing.assert_allclose(found(z / gamma), exact, atol=1e-6)
