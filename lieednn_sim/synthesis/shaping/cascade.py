"""The cascade in closed form: clock, soft switches and filter, and the derivatives in its parameters.

With gamma = mu = 1 the hidden neurons are h_n(t) = a_n + c_n g(t), where g falls from 1 to 0, and the visible ones

    x_i(t) = x_d,i + (x_0,i - x_d,i) e^-t + sum_n alpha_in Ad(theta_in) Q[phi(a_n + c_n g) - phi(a_n)](t)

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
from lieednn_sim.synthesis.problem import QUATERNION_FORM
from lieednn_sim.values import Floats, frozen

# State of the clock at time 0: below this the activation is nearly linear, above it the clock starts slowly.
CLOCK_START = 0.5
# g is sampled down to this value, a ten thousandth of its start.
_LEAST_CLOCK = 1e-4
# Most that g falls, and that time passes, within one piece of time.
_MAX_CLOCK_STEP, _MAX_TIME_STEP = 1.0 / 60.0, 0.5
# For rho = 1, hidden and visible neurons decay at one rate, and x - x_d ends as e^-t (A + B t), which overshoots beyond
# t = -A/B. B is penalised with this weight: the last row of states has an error of `TAIL` B.
TAIL = 0.05
# Nodes of the Gauss rule on each piece: switches have slopes up to 60, so that one spans a piece.
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
def clockwork(rate: float, refinement: int = 1, activation: Activation = ACTIVATIONS[DEFAULT_ACTIVATION]) -> Clockwork:
    """The time functions of a clock with rate rho in (0, 1], on a grid refined ``refinement`` times."""
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
    edges = np.interp(np.linspace(0.0, total, refinement * int(np.ceil(total)) + 1), measure, looks)
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
        q: ``(N, M, 4)`` quaternions; alpha R is |q|^2 R(q).
        tau: ``(N, M, 3)`` translations of theta.
    """

    a: Floats
    c: Floats
    q: Floats
    tau: Floats

    @property
    def flat(self) -> Floats:
        """``(12 M + 7 N M,)``: a, c, then for each visible neuron the entries of (q, tau), each over all switches."""
        own = np.concatenate([self.q, self.tau], axis=2).transpose(0, 2, 1)
        return np.concatenate([self.a.ravel(), self.c.ravel(), own.ravel()])

    @classmethod
    def of(cls, flat: Floats, n: int) -> Parameters:
        """The inverse of `flat` for N visible neurons."""
        m = len(flat) // (12 + 7 * n)
        a, c = flat[: 12 * m].reshape(2, m, 6)
        own = flat[12 * m :].reshape(n, 7, m).transpose(0, 2, 1)
        return cls(a, c, own[..., :4], own[..., 4:])

    def blocks(self) -> tuple[Floats, Floats]:
        """The blocks alpha Ad(theta) ``(N, M, 6, 6)``, and derivatives of alpha R in q ``(N, M, 4, 3, 3)``."""
        slope = 2.0 * np.einsum("abkl,nml->nmkab", QUATERNION_FORM, self.q)
        turned = 0.5 * np.einsum("nmkab,nmk->nmab", slope, self.q)
        blocks = np.zeros((*self.q.shape[:2], 6, 6))
        blocks[..., :3, :3] = blocks[..., 3:, 3:] = turned
        blocks[..., 3:, :3] = np.cross(self.tau[..., None], turned, axis=-2)
        return blocks, slope


class Cascade:
    """A cascade from a start to a target.

    Args:
        clock: clockwork of the cascade.
        start: ``(N, 6)`` visible state at time 0.
        target: ``(N, 6)`` visible equilibrium.
    """

    def __init__(self, clock: Clockwork, start: Floats, target: Floats) -> None:
        self.clock, self.start, self.target = clock, start, target
        fading = np.append(np.exp(-clock.t), 0.0)
        self.free = target + fading[:, None, None] * (start - target)

    def switched(self, a: Floats, c: Floats) -> tuple[Floats, Floats, Floats]:
        """Q[phi(a + c g) - phi(a)] and its derivatives in a and c, each ``(K + 1, M, 6)``; last row: see `TAIL`."""
        shape, g, activation = a.shape, self.clock.fine[:, None], self.clock.activation
        a, c = a.ravel(), c.ravel()
        inputs = a + c * g
        value, rest = activation.phi(inputs), activation.phi(a)
        slope, rest_slope = activation.slope_at(inputs, value), activation.slope_at(a, rest)
        stacked = np.concatenate([value - rest, slope - rest_slope, slope * g], axis=1)
        filtered = np.empty((len(self.clock.t) + 1, 3 * len(a)))
        np.matmul(self.clock.filter, stacked, out=filtered[:-1])
        weight = TAIL if self.clock.rate == 1.0 else 0.0
        filtered[-1] = weight * np.concatenate(
            [c * rest_slope, c * activation.bend_at(a, rest) * rest_slope, rest_slope]
        )
        filtered = filtered.reshape(-1, 3, *shape)
        return filtered[:, 0], filtered[:, 1], filtered[:, 2]

    def states(self, parameters: Parameters) -> Floats:
        """Visible states ``(K + 1, N, 6)`` at the clock's instants; the last row is the target plus `TAIL` B."""
        blocks, _ = parameters.blocks()
        outputs, _, _ = self.switched(parameters.a, parameters.c)
        return self.free + _applied(blocks, outputs)

    def linearised(self, parameters: Parameters) -> tuple[Floats, Floats, Floats]:
        """`states` and their derivatives in the shared parameters, and in each visible neuron's own.

        Returns:
            The states, ``(N, K + 1, 6, 12 M)`` in a and c, and ``(N, K + 1, 6, 7 M)`` in the neuron's own q and tau.
        """
        n, m = parameters.q.shape[:2]
        blocks, slope = parameters.blocks()
        outputs, in_a, in_c = self.switched(parameters.a, parameters.c)
        k = len(outputs)
        shared = np.empty((n, k, 6, 2, m, 6))
        arranged = blocks.transpose(0, 2, 1, 3)[:, None]
        np.multiply(arranged, in_a[None, :, None], out=shared[..., 0, :, :])
        np.multiply(arranged, in_c[None, :, None], out=shared[..., 1, :, :])
        own = np.zeros((n, k, 6, 7, m))
        # (M, N 4 3, 3) times (M, 3, K): derivatives of both rotated halves in each quaternion.
        rows = slope.transpose(1, 0, 2, 3, 4).reshape(m, -1, 3)
        half = outputs.transpose(1, 2, 0)
        turned, shifted = (
            (rows @ half[:, part]).reshape(m, n, 4, 3, k).transpose(1, 4, 3, 2, 0)
            for part in (slice(0, 3), slice(3, 6))
        )
        own[:, :, :3, :4] = turned
        own[:, :, 3:, :4] = shifted + np.cross(parameters.tau.transpose(0, 2, 1)[:, None, :, None], turned, axis=2)
        drive = np.einsum("nmab,kmb->nkam", blocks[..., :3, :3], outputs[..., :3])
        x, y, z = (drive[:, :, i] for i in range(3))
        # The derivative of tau x d in tau is -hat(d).
        own[:, :, 3, 5], own[:, :, 3, 6] = z, -y
        own[:, :, 4, 4], own[:, :, 4, 6] = -z, x
        own[:, :, 5, 4], own[:, :, 5, 5] = y, -x
        return (
            self.free + _applied(blocks, outputs),
            shared.reshape(n, k, 6, 12 * m),
            own.reshape(n, k, 6, 7 * m),
        )


def _applied(blocks: Floats, outputs: Floats) -> Floats:
    n, m = blocks.shape[:2]
    flat = blocks.transpose(0, 2, 1, 3).reshape(6 * n, 6 * m)
    return (outputs.reshape(-1, 6 * m) @ flat.T).reshape(-1, n, 6)
