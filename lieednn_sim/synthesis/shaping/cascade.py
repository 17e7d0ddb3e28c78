"""The cascade in closed form: clock, soft switches and filter.

With gamma = mu = 1 the hidden neurons are h_n(t) = a_n + c_n g(t), where g falls from 1 to 0, and the visible ones

    x_i(t) = x_d,i + (x_0,i - x_d,i) e^-t + sum_n alpha_in Ad(R_in, 0) Q[phi(a_n + c_n g) - phi(a_n)](t)

with any activation phi and Q = 1 / (1 + d/dt) from rest. For rho = 1, g = e^-t is the hidden neurons' own decay. For
rho < 1, a clock p' = -p + (1 - rho) phi(p) drives them with (1 - rho) phi(p), so that they follow it exactly: g is p
over its start, and finally falls at the rate 1 - (1 - rho) phi'(0), which is rho for phi'(0) = 1. In neither case does
g depend on the parameters, so Q is one matrix, and no differential equation is solved when they change.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.integrate import solve_ivp

from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION, Activation
from lieednn_sim.values import Floats, frozen

# State of the clock at time 0: below this the activation is nearly linear, above it the clock starts slowly.
CLOCK_START = 0.5
# For rho = 1, hidden and visible neurons decay at one rate, and x - x_d ends as e^-t (A + B t), which overshoots beyond
# t = -A/B. B is penalised with this weight: the last row of states has an error of `TAIL` B.
TAIL = 0.05
# g is sampled down to this value, a ten thousandth of its start.
_LEAST_CLOCK = 1e-4
# Most that g falls, and that time passes, within one piece of time: ripples between switches are short.
_MAX_CLOCK_STEP, _MAX_TIME_STEP = 1.0 / 120.0, 0.25
# Nodes of the Gauss rule on each piece.
_NODES = 3


@frozen
class Clockwork:
    """The time functions of a cascade, sampled; see `clockwork`.

    Attributes:
        rate: rho.
        activation: phi.
        t: ``(K,)`` instants.
        g: ``(K,)`` g at these instants.
        fine: ``(F,)`` g at the nodes of the filter's quadrature.
        filter: ``(K, F)`` Q.
    """

    rate: float
    activation: Activation
    t: Floats
    g: Floats
    fine: Floats
    filter: Floats


@lru_cache(maxsize=8)
def clockwork(rate: float, activation: Activation = ACTIVATIONS[DEFAULT_ACTIVATION]) -> Clockwork:
    """The time functions of a clock with rate rho in (0, 1]."""
    span = 30.0 / rate

    def flow(_: float, p: Floats) -> Floats:
        return -p + (1.0 - rate) * activation.phi(p)

    run = solve_ivp(flow, (0.0, span), [CLOCK_START], method="DOP853", rtol=1e-11, atol=1e-14, dense_output=True)

    def falling(t: Floats) -> Floats:
        return np.exp(-t) if rate == 1.0 else np.asarray(run.sol(t)[0]) / CLOCK_START

    looks = np.linspace(0.0, span, 20_001)
    levels = falling(looks)
    end = looks[np.argmax(levels < _LEAST_CLOCK)]
    # Pieces that are even in the measure that bounds them.
    measure = np.append(0.0, np.cumsum(np.hypot(np.diff(levels) / _MAX_CLOCK_STEP, np.diff(looks) / _MAX_TIME_STEP)))
    total = np.interp(end, looks, measure)
    edges = np.interp(np.linspace(0.0, total, int(np.ceil(total)) + 1), measure, looks)
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    width = np.diff(edges)
    fine = edges[:-1, None] + 0.5 * width[:, None] * (node + 1.0)
    masses = 0.5 * width[:, None] * weight
    lag = edges[:, None, None] - fine[None]
    matrix = np.where(lag > 0.0, np.exp(-np.maximum(lag, 0.0)) * masses, 0.0).reshape(len(edges), -1)
    return Clockwork(rate, activation, edges, falling(edges), falling(fine.ravel()), matrix)


@frozen
class Parameters:
    """Parameters of a cascade with N visible neurons and M switches.

    Attributes:
        a: ``(M, 6)`` equilibria of the hidden neurons.
        c: ``(M, 6)`` slopes of the switches.
        alpha: ``(N, M)`` strengths with which the visible neurons read the switches.
        rotation: ``(N, M, 3, 3)`` rotations R of what they read; theta = (R, 0) does not translate.
    """

    a: Floats
    c: Floats
    alpha: Floats
    rotation: Floats


class Cascade:
    """A cascade from a start to a target.

    Args:
        clock: clockwork of the cascade.
        start: ``(N, 6)`` visible state at time 0.
        target: ``(N, 6)`` visible equilibrium.
    """

    def __init__(self, clock: Clockwork, start: Floats, target: Floats) -> None:
        self.clock = clock
        fading = np.append(np.exp(-clock.t), 0.0)
        self.free = target + fading[:, None, None] * (start - target)

    def switched(self, a: Floats, c: Floats) -> Floats:
        """Q[phi(a + c g) - phi(a)] ``(K + 1, ...)`` for a and c ``(...)``; for the last row see `TAIL`."""
        clock, shape = self.clock, a.shape
        a, c = a.ravel(), c.ravel()
        rest = clock.activation.phi(a)
        outputs = clock.filter @ (clock.activation.phi(a + c * clock.fine[:, None]) - rest)
        tail = (TAIL if clock.rate == 1.0 else 0.0) * c * clock.activation.slope_at(a, rest)
        return np.concatenate([outputs, tail[None]]).reshape(-1, *shape)

    def states(self, parameters: Parameters) -> Floats:
        """Visible states ``(K + 1, N, 6)`` at the clock's instants; the last row is the target plus `TAIL` B."""
        halves = self.switched(parameters.a, parameters.c).reshape(len(self.free), -1, 2, 3)
        read = np.einsum("nm,nmab,kmhb->knha", parameters.alpha, parameters.rotation, halves, optimize=True)
        return self.free + read.reshape(self.free.shape)
