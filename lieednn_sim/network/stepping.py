"""Steps of a network in real time: by the Runge-Kutta method, or exact where its hidden neurons have no inputs.

With u(x) = (mu / gamma) W phi(x) and the pull v = (mu / gamma) b, a network is x' = gamma (v + u(x) - x). So every
stage of a step h is a sum of x, v and the u of the stages before it, whose factors are polynomials of z = gamma h.
`RungeKuttaStepper` takes one product for a stage's state and one for its u, with the result of
`dynamics.runge_kutta_step` up to rounding.

For `UndrivenState`, with gamma time z and the hidden rest state a, the hidden neurons are h = a + (h_0 - a) e^-z, and
the visible ones obey x' = u(h) - x with u(h) = (mu / gamma) (W phi(h) + b), so that

    x(z) = x_d + (x_0 - x_d) e^-z + integral_0^z e^-(z - s) (u(h(s)) - x_d) ds,    x_d = u(a).

The integrand vanishes at rest, so x_d is kept exactly; Simpson's rule integrates it. Along a motion of an arm all its
errors together are below 1e-6.
"""

from __future__ import annotations

import math

import numpy as np

from lieednn_sim.errors import InputError
from lieednn_sim.network.componentwise import ComponentwiseNetwork
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.network.se3 import LieEDNN
from lieednn_sim.values import Floats

# Stages of the classical Runge-Kutta method, and the powers of z = -gamma h that its states hold.
_STAGES = 4
_POWERS = np.arange(1.0 + _STAGES)
_NODES, _WEIGHTS = np.array([0.0, 0.5, 1.0]), np.array([1.0, 4.0, 1.0]) / 6.0  # of Simpson's rule, in a step


def _factors() -> Floats:
    """Factors of x, v and u_1 to u_4 in the states of stages 2 to 4 and of the end, at powers of z; ``(24, 5)``."""
    parts = 2 + _STAGES
    x, v, *drives = np.eye(parts)[..., None] * np.eye(1, len(_POWERS))
    states = []

    def field(state: Floats) -> Floats:
        states.append(state)
        return np.roll(v + drives[len(states) - 1] - state, 1, axis=-1)  # gamma h is one power of z more

    end = runge_kutta_step(field, x, 1.0)
    return np.array([*states[1:], end]).reshape(_STAGES * parts, -1)


_FACTORS = _factors()


class RungeKuttaStepper:
    """Runge-Kutta steps of a network's flat state with any pull v instead of its bias."""

    def __init__(self, network: ComponentwiseNetwork) -> None:
        self._network = network
        self._weight, self._phi = network.mu / network.gamma * network.driven_weight, network.phi
        self._parts = np.zeros((2 + _STAGES, network.bias.size))  # the u of neurons without inputs stays zero
        self._later = [self._parts[k, : len(self._weight)] for k in range(3, 2 + _STAGES)]

    def __reduce__(self) -> tuple[type[RungeKuttaStepper], tuple[ComponentwiseNetwork]]:
        return RungeKuttaStepper, (self._network,)  # copied entry by entry, the views would become arrays of their own

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


class UndrivenState:
    """The state of a network whose hidden neurons have no inputs, from visible neurons ``(N, 6)`` and its hidden start.

    ``x`` is the state of the visible neurons, ``target`` their equilibrium x_d, and ``flow``, after `advance`, their
    field per unit of z, all ``(6N,)``. `InputError` if hidden neurons have inputs, or visible ones from each other.
    """

    def __init__(self, network: LieEDNN, visible: Floats) -> None:
        size = 6 * network.n_visible
        ratio = network.mu / network.gamma
        driven = ratio * network.driven_weight
        if len(driven) > size or driven[:, :size].any():
            raise InputError("only visible neurons may have inputs, and only from hidden ones")
        # For each visible coordinate, the hidden ones that drive it, padded with weights of zero.
        weight, self._phi = driven[:, size:], network.phi
        count = int(np.count_nonzero(weight, axis=1).max())
        self._drivers = np.argsort(weight == 0.0, axis=1, kind="stable")[:, :count]
        self._weight = np.take_along_axis(weight, self._drivers, axis=1)
        self._rest = (ratio * network.bias[network.n_visible :]).ravel()[self._drivers]
        self._resting = np.vecdot(self._phi(self._rest), self._weight)
        self._begin(network.hidden_start, ratio * network.bias[: network.n_visible].ravel() + self._resting, visible)

    def begun(self, hidden_start: Floats, target: Floats, visible: Floats) -> UndrivenState:
        """A state of the network with another hidden start ``(M, 6)``, target and visible state ``(N, 6)``."""
        state = object.__new__(UndrivenState)
        vars(state).update(vars(self))
        state._begin(hidden_start, target.ravel(), visible)
        return state

    def _begin(self, hidden_start: Floats, target: Floats, visible: Floats) -> None:
        self._off, self.target, self.x = hidden_start.ravel()[self._drivers] - self._rest, target, visible.ravel()
        self._left = 1.0
        self._last = np.empty((0, self.x.size))  # the input at the end of the last step

    def _inputs(self, left: Floats) -> Floats:
        """U(h) - x_d ``(m, 6N)`` where e^-z is ``(m,)``."""
        hidden = left[:, None, None] * self._off
        hidden += self._rest
        return np.asarray(np.vecdot(self._phi(hidden), self._weight) - self._resting)

    def advance(self, z: float) -> None:
        """Advance by a time z of 1/gamma."""
        # In a step e^-z falls by at most 0.0125; the switches are less steep than the inverse of that.
        count = max(1, math.ceil(self._left * -math.expm1(-z) / 0.0125))
        step = z / count
        for _ in range(count):
            falls = np.exp(-step * _NODES)
            inputs = np.concatenate([self._last, self._inputs(self._left * falls[len(self._last) :])])
            off = falls[2] * (self.x - self.target) + (step * _WEIGHTS * falls[::-1]).dot(inputs)
            self.x, self._last = self.target + off, inputs[2:]
            self._left *= falls[2]
        self.flow = inputs[2] - off
