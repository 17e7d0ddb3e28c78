"""Quick ways to integrate: networks side by side, and Runge and Kutta's steps by few products."""

import numpy as np
import pytest

from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.network.stepping import RungeKuttaStepper, integrate_batch


def drawn(rng: np.random.Generator, size: float, **rates) -> LieEDNN:
    return LieEDNN(
        alpha=size * rng.normal(size=(3, 3)),
        rotation=np.broadcast_to(np.eye(3), (3, 3, 3, 3)),
        translation=rng.normal(size=(3, 3, 3)),
        bias=rng.normal(size=(3, 6)),
        **rates,
    )


@pytest.mark.parametrize("activation", ["tanh", "arctan"])
def test_steps_are_those_of_each_network_alone(activation):
    rng = np.random.default_rng(3)
    # From slow to restless: the number of steps differs, and some are refused.
    networks = [
        drawn(rng, size, gamma=gamma, mu=mu, activation=activation)
        for size, gamma, mu in ((0.0, 1.0, 1.0), (0.1, 1.0, 2.0), (0.5, 1.3, 1.0), (1.0, 0.7, 1.0), (0.1, 30.0, 9.0))
    ]
    start = rng.normal(size=(3, 6))
    found = integrate_batch(networks, start, 12.0, rtol=1e-4, atol=1e-6)
    alone = [network.trajectory(start, 12.0, rtol=1e-4, atol=1e-6).xi for network in networks]
    assert len({len(states) for states in found}) > 3
    for states, expected in zip(found, alone, strict=True):
        assert len(states) == len(expected)
        np.testing.assert_allclose(states, expected, rtol=1e-10, atol=1e-10)


def test_at_rest_steps_grow_as_they_do_alone():
    network = drawn(np.random.default_rng(4), 0.05)
    rest = network.equilibrium().xi
    (found,) = integrate_batch([network], rest, 50.0, rtol=1e-4, atol=1e-6)
    assert len(found) == len(network.trajectory(rest, 50.0, rtol=1e-4, atol=1e-6).xi)


def test_those_that_need_many_steps_are_integrated_alone(monkeypatch):
    rng = np.random.default_rng(5)
    quick, stiff, start = drawn(rng, 0.1), drawn(rng, 0.1, gamma=1e3), rng.normal(size=(3, 6))
    found = integrate_batch([quick, stiff], start, 3.0, rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(found[1], stiff.trajectory(start, 3.0, rtol=1e-4, atol=1e-6).xi)
    assert len(found[0]) < 50
    monkeypatch.setattr("lieednn_sim.network.dynamics._MAX_EVALUATIONS", 3000)
    with pytest.raises(LieEDNNError, match="too stiff"):
        integrate_batch([quick, stiff], start, 3.0, rtol=1e-4, atol=1e-6)


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


def test_networks_must_be_of_one_kind():
    rng = np.random.default_rng(6)
    with pytest.raises(InputError, match="one activation"):
        integrate_batch(
            [drawn(rng, 0.1), drawn(rng, 0.1, activation="arctan")], np.zeros((3, 6)), 1.0, rtol=1e-4, atol=1e-6
        )
