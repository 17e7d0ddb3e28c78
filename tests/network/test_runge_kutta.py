"""Steps by few products are Runge and Kutta's."""

import numpy as np
import pytest

from lieednn_sim.network import LieEDNN
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.network.runge_kutta import RungeKuttaStepper


@pytest.mark.parametrize("activation", ["tanh", "arctan"])
def test_a_step_is_that_of_runge_and_kutta(activation):
    rng = np.random.default_rng(2)
    network = LieEDNN(
        alpha=rng.normal(size=(3, 3)),
        rotation=np.broadcast_to(np.eye(3), (3, 3, 3, 3)),
        translation=rng.normal(size=(3, 3, 3)),
        bias=rng.normal(size=(3, 6)),
        gamma=1.7,
        mu=0.6,
        activation=activation,
    )
    stepping, x = RungeKuttaStepper(network), rng.normal(size=18)
    pull, other, drive = network.mu / network.gamma * network.bias.ravel(), x, stepping.drive(x)
    np.testing.assert_allclose(network.gamma * (pull + drive - x), network.flat_vector_field(x), atol=1e-14)
    for h in (0.3, 0.3, 0.7):
        x, drive = stepping.step(x, drive, pull, network.gamma * h)
        other = runge_kutta_step(lambda y, _: network.flat_vector_field(y), other, h)
        np.testing.assert_allclose(x, other, rtol=1e-13, atol=1e-13)
        np.testing.assert_array_equal(drive, stepping.drive(x))
