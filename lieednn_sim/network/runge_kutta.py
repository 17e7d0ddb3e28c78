"""Runge-Kutta steps of a network in real time, with few products of small arrays.

With u(x) = (mu / gamma) W phi(x) and the pull v = (mu / gamma) b, a network is x' = gamma (v + u(x) - x). So every
stage of a step h is a sum of x, v and the u of the stages before it, whose factors are polynomials of z = gamma h. A
stage takes one product for the state and one for its u. The result is that of `dynamics.runge_kutta_step` up to
rounding.
"""

from __future__ import annotations

import numpy as np

from lieednn_sim.network.componentwise import ComponentwiseNetwork
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.values import Floats

# Stages of the classical Runge-Kutta method, and the powers of z = -gamma h that its states hold.
_STAGES = 4
_POWERS = np.arange(1.0 + _STAGES)


def _factors() -> Floats:
    """Factors of x, v and u_1 to u_4 in the states of stages 2 to 4 and of the end, at powers of z; ``(24, 5)``."""
    parts = 2 + _STAGES
    x, v, *drives = np.eye(parts)[..., None] * np.eye(1, len(_POWERS))
    states = []

    def field(state: Floats, _: float) -> Floats:
        states.append(state)
        # gamma h is one power of z more.
        return np.roll(v + drives[len(states) - 1] - state, 1, axis=-1)

    end = runge_kutta_step(field, x, 1.0)
    return np.array([*states[1:], end]).reshape(_STAGES * parts, -1)


_FACTORS = _factors()


class RungeKuttaStepper:
    """Runge-Kutta steps of a network's flat state with any pull v.

    Args:
        network: gives weights, activation and decay rate; its bias is not used.
    """

    def __init__(self, network: ComponentwiseNetwork) -> None:
        self._network = network
        self._weight, self._phi = network.mu / network.gamma * network.driven_weight, network.phi
        # The u of neurons without inputs stays zero.
        self._parts = np.zeros((2 + _STAGES, network.bias.size))
        self._later = [self._parts[k, : len(self._weight)] for k in range(3, 2 + _STAGES)]

    def __reduce__(self) -> tuple[type[RungeKuttaStepper], tuple[ComponentwiseNetwork]]:
        # In a copy entry by entry the views would be arrays of their own.
        return RungeKuttaStepper, (self._network,)

    def drive(self, x: Floats) -> Floats:
        """The input u(x) ``(dN,)`` of a flat state ``(dN,)``."""
        drive = np.zeros(len(x))
        np.dot(self._weight, self._phi(x), out=drive[: len(self._weight)])
        return drive

    def step(self, x: Floats, drive: Floats, pull: Floats, z: float) -> tuple[Floats, Floats]:
        """The state after a step of gamma h = z, and its u, from a state, its u and the pull, all ``(dN,)``."""
        parts = self._parts
        parts[0], parts[1], parts[2] = x, pull, drive
        factors = _FACTORS.dot((1.0, z, z**2, z**3, z**4)).reshape(_STAGES, -1)
        for factor, later in zip(factors, self._later, strict=False):
            self._weight.dot(self._phi(factor.dot(parts)), out=later)
        end = factors[-1].dot(parts)
        return end, self.drive(end)
