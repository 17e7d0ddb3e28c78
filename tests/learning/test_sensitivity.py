"""Gradients against finite differences of a re-solved equilibrium, and against the paper's entry-by-entry formula."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.learning import sensitivity
from lieednn_sim.learning.sensitivity import gauss_newton_direction
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.dynamics import find_equilibrium

seeds = st.integers(0, 2**32 - 1)


def random_network(seed: int, n: int = 2) -> tuple[LieEDNN, np.ndarray]:
    rng = np.random.default_rng(seed)
    network = LieEDNN(
        rng.uniform(-0.2, 0.2, (n, n)),
        Rotation.random(n * n, rng=rng).as_matrix().reshape(n, n, 3, 3),
        rng.normal(size=(n, n, 3)),
        rng.uniform(-0.5, 0.5, (n, 6)),
        gamma=rng.uniform(0.5, 2.0),
        mu=rng.uniform(0.5, 1.0),
        activation=str(rng.choice(["tanh", "arctan"])),
    )
    return network, rng.uniform(-0.8, 0.8, (n, 6))


def equilibrium_for(network: LieEDNN, weight: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Equilibrium for weights that need not be on the manifold."""
    bias, shape = network.bias.ravel(), network.bias.shape

    def field(x: np.ndarray) -> np.ndarray:
        return -network.gamma * x + network.mu * (weight @ network.phi(x) + bias)

    def jacobian(x: np.ndarray) -> np.ndarray:
        step = 1e-6
        slope = (network.phi(x + step) - network.phi(x - step)) / (2.0 * step)
        return -network.gamma * np.eye(x.size) + network.mu * weight * slope

    found = find_equilibrium(field, jacobian, start.reshape(shape), rate=network.gamma)
    assert found.success
    return found.xi.ravel()


def loss_at(x: np.ndarray, target: np.ndarray) -> float:
    return 0.5 * np.sum((x[: target.size] - target.ravel()) ** 2)


@settings(max_examples=8)
@given(seeds, st.integers(0, 1))
def test_gradient_in_the_weights_is_that_of_the_solved_equilibrium(seed, hidden):
    """Of the visible neurons alone, which come first."""
    network, target = random_network(seed)
    network, target = replace(network, hidden_start=np.ones((hidden, 6))), target[: 2 - hidden]
    found = sensitivity(network, target)
    assert found.loss == pytest.approx(loss_at(found.equilibrium.ravel(), target), rel=1e-12)

    def value(flat: np.ndarray) -> float:
        weight = flat.reshape(network.weight.shape)
        return loss_at(equilibrium_for(network, weight, found.equilibrium), target)

    numeric = approx_fprime(network.weight.ravel(), value, 1e-6).reshape(network.weight.shape)
    np.testing.assert_allclose(found.weight, numeric, atol=2e-5)


@settings(max_examples=15)
@given(seeds)
def test_gradient_in_the_strengths_is_that_of_the_solved_equilibrium(seed):
    network, target = random_network(seed)
    found = sensitivity(network, target)

    def value(flat: np.ndarray) -> float:
        other = replace(network, alpha=flat.reshape(network.alpha.shape))
        return loss_at(other.equilibrium(found.equilibrium).xi.ravel(), target)

    numeric = approx_fprime(network.alpha.ravel(), value, 1e-6).reshape(network.alpha.shape)
    np.testing.assert_allclose(found.alpha, numeric, atol=2e-4 * max(1.0, np.abs(numeric).max()))


@settings(max_examples=15)
@given(seeds)
def test_gauss_newton_direction_moves_the_equilibrium_by_the_error_and_no_smaller_change_does(seed):
    network, target = random_network(seed)
    found = sensitivity(network, target)
    delta = (found.equilibrium - target).ravel()
    output = network.phi(found.equilibrium).ravel()
    direction = gauss_newton_direction(found.matrix, output, delta, network.mu / network.gamma)
    step = 1e-6
    moved = equilibrium_for(network, network.weight - step * direction, found.equilibrium)
    np.testing.assert_allclose((moved - found.equilibrium.ravel()) / step, -delta, atol=1e-4)
    # Every other change with the same effect on W phi is longer: its rows are not along phi.
    np.testing.assert_allclose(direction, np.outer(direction @ output, output) / (output @ output), atol=1e-12)


def test_bad_input_is_named():
    network, target = random_network(0)
    with pytest.raises(InputError, match=r"target must have shape \(2, 6\)"):
        sensitivity(network, target[:1])
    assert np.abs(sensitivity(network, network.equilibrium().xi).weight).max() < 1e-12
