"""Steps of a network whose hidden neurons have no inputs, exact up to a quadrature, for real time.

With gamma time z and the hidden rest state a, the hidden neurons are h = a + (h_0 - a) e^-z, and the visible ones obey
x' = u(h) - x with u(h) = (mu / gamma) (W phi(h) + b), so that

    x(z) = x_d + (x_0 - x_d) e^-z + integral_0^z e^-(z - s) (u(h(s)) - x_d) ds,    x_d = u(a).

The integrand vanishes at rest, so x_d is kept exactly; Gauss's rule with three nodes integrates it.
"""

from __future__ import annotations

import math

import numpy as np

from lieednn_sim.errors import InputError
from lieednn_sim.network.se3 import LieEDNN
from lieednn_sim.values import Floats

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
# Positions in a step, the last one its end, and weights of the first three.
_PLACES, _SHARES = np.append(0.5 * (1.0 + _NODES), 1.0), 0.5 * _WEIGHTS


class UndrivenState:
    """The state of a network whose hidden neurons have no inputs, from given visible neurons and its hidden start.

    Args:
        network: hidden neurons without inputs, and visible ones without inputs from each other.
        visible: ``(N, 6)`` the visible neurons' state.

    Attributes:
        x: ``(6N,)`` visible state.
        target: ``(6N,)`` visible equilibrium x_d.
        flow: ``(6N,)`` visible part of the field, per unit of z.

    Raises:
        InputError: the network has other inputs.
    """

    def __init__(self, network: LieEDNN, visible: Floats) -> None:
        size = 6 * network.n_visible
        driven = network.mu / network.gamma * network.driven_weight
        if len(driven) > size or driven[:, :size].any():
            raise InputError("only visible neurons may have inputs, and only from hidden ones")
        self._weight, self._phi = driven[:, size:], network.phi
        ratio = network.mu / network.gamma
        self._rest = ratio * network.bias[network.n_visible :].ravel()
        self._off = network.hidden_start.ravel() - self._rest
        self._resting = self._weight @ self._phi(self._rest)
        self.target = ratio * network.bias[: network.n_visible].ravel() + self._resting
        self._left = 1.0
        self.x = visible.ravel()
        self.flow = self._input(np.ones(1))[0] + self.target - self.x

    def _input(self, left: Floats) -> Floats:
        """U(h) - x_d ``(m, 6N)`` where e^-z is ``(m,)``."""
        return np.asarray(self._phi(self._rest + left[:, None] * self._off) @ self._weight.T - self._resting)

    def advance(self, z: float) -> None:
        """Advance by a time z of 1/gamma."""
        # Switches are less steep than the inverse of the largest fall of e^-z in a step.
        count = max(1, math.ceil(self._left * -math.expm1(-z) / 0.02))
        step = z / count
        for _ in range(count):
            inputs = self._input(self._left * np.exp(-step * _PLACES))
            weights = step * _SHARES * np.exp(step * (_PLACES[:3] - 1.0))
            self.x = self.target + math.exp(-step) * (self.x - self.target) + weights @ inputs[:3]
            self._left *= math.exp(-step)
        self.flow = inputs[3] + self.target - self.x
