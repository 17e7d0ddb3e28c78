"""The cascade of clock, soft switches and filter in closed form, and the certified network with its parameters.

With gamma = mu = 1 the hidden neurons are h_n = a_n + c_n g, where g falls from 1 to 0, and the visible ones are their
outputs phi(h_n) through the filter Q = 1 / (1 + d/dt) from rest (`docs/mathematics/shaped.md`). For rho < 1 a clock
drives the hidden neurons with (1 - rho) phi(p), so that they follow it exactly. As g does not depend on the parameters,
Q is one matrix, and no differential equation is solved when they change.

For rho = 1, pairs of opposite switches, phi(a + c g) and phi(-a - c g), bend a motion if their starts are shifted, and
cancel otherwise (`docs/mathematics/families.md`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.integrate import solve_ivp

from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION, Activation, LieEDNN
from lieednn_sim.values import Floats, frozen

# State of the clock at time 0: below this the activation is nearly linear, above it the clock starts slowly.
CLOCK_START = 0.5
# For rho = 1, hidden and visible neurons decay at one rate, and x - x_d ends as e^-t (A + B t), which overshoots beyond
# t = -A/B. B is penalised with this weight: the last row of the states has an error of `TAIL` B.
TAIL = 0.05
# Largest fall of g, and longest time, within one piece of time: ripples between switches are short.
_MAX_CLOCK_STEP, _MAX_TIME_STEP = 1.0 / 120.0, 0.25
PAIRS = 24  # number of pairs of each visible neuron of a family
LARGEST_CODE = 0.05  # largest entry of a code: its cubic term is then a thousandth of the bump


@frozen
class Clockwork:
    """The time functions of a cascade, sampled; see `clockwork`."""

    rate: float  # rho
    activation: Activation  # phi
    t: Floats  # (K,) instants
    g: Floats  # (K,) g at these instants
    fine: Floats  # (F,) g at the nodes of the filter's quadrature
    filter: Floats  # (K, F) Q


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
    end = looks[np.argmax(levels < 1e-4)]  # g is sampled down to a ten thousandth of its start
    # Pieces that are even in the measure that bounds them.
    measure = np.append(0.0, np.cumsum(np.hypot(np.diff(levels) / _MAX_CLOCK_STEP, np.diff(looks) / _MAX_TIME_STEP)))
    total = np.interp(end, looks, measure)
    edges = np.interp(np.linspace(0.0, total, int(np.ceil(total)) + 1), measure, looks)
    node, weight = np.polynomial.legendre.leggauss(3)  # on each piece
    width = np.diff(edges)
    fine = edges[:-1, None] + 0.5 * width[:, None] * (node + 1.0)
    masses = 0.5 * width[:, None] * weight
    lag = edges[:, None, None] - fine[None]
    matrix = np.where(lag > 0.0, np.exp(-np.maximum(lag, 0.0)) * masses, 0.0).reshape(len(edges), -1)
    return Clockwork(rate, activation, edges, falling(edges), falling(fine.ravel()), matrix)


@frozen
class Parameters:
    """Parameters of a cascade with N visible neurons and M switches."""

    a: Floats  # (M, 6) equilibria of the hidden neurons
    c: Floats  # (M, 6) slopes of the switches
    alpha: Floats  # (N, M) strengths with which the visible neurons read the switches
    rotation: Floats  # (N, M, 3, 3) rotations R of what they read; theta = (R, 0) does not translate


class Cascade:
    """A cascade from a start to a target, visible states ``(N, 6)``."""

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


_MOST_ADDED = 0.02  # what a layer's input from the next one may add to lambda_max at most, in S-scaled weights
_UNIT = np.eye(3)[0]


def assemble(parameters: Parameters, rate: float, target: Floats, activation: str = DEFAULT_ACTIVATION) -> LieEDNN:
    """The network of a cascade to ``target`` ``(N, 6)``, with its Lyapunov diagonal in closed form.

    Ordered (visible, hidden, clock), W_R is block triangular with a diagonal of 0, 0 and 1 - rho. With P = S^2 and
    S = diag(1, s_h, s_c), a layer's input is divided by the ratio of two scales, so that lambda_max of sym(S W_R S^-1)
    can come arbitrarily close to 1 - rho. Each scale is the least with which it comes within `_MOST_ADDED` of it. With
    a rate rho of 1 there is no clock.
    """
    n, m = parameters.alpha.shape
    clock = 2 if rate < 1.0 else 0
    size = n + m + clock
    alpha, rotation = np.zeros((size, size)), np.tile(np.eye(3), (size, size, 1, 1))
    hidden = slice(n, n + m)
    alpha[:n, hidden], rotation[:n, hidden] = parameters.alpha, parameters.rotation
    hidden_start = np.zeros((m + clock, 6))
    hidden_start[:m] = parameters.a + parameters.c
    for part in range(clock):
        # One clock neuron drives the rotational halves of c, the other the translational ones.
        sender, half = n + m + part, slice(3 * part, 3 * part + 3)
        alpha[sender, sender] = 1.0 - rate
        hidden_start[m + part, half.start] = CLOCK_START
        driven = (1.0 - rate) / CLOCK_START * parameters.c[:, half]
        alpha[hidden, sender] = np.linalg.norm(driven, axis=1)
        rotation[hidden, sender] = turns_to(driven)
    bias = np.zeros((size, 6))
    bias[hidden] = parameters.a
    scales = [1.0]
    for receiver, sender_slice in ((slice(0, n), hidden), (hidden, slice(n + m, size)))[: 1 + bool(clock)]:
        weight = (alpha[receiver, sender_slice, None, None] * rotation[receiver, sender_slice]).transpose(0, 2, 1, 3)
        heard = float(np.linalg.norm(weight.reshape(3 * weight.shape[0], -1), 2))
        scales.append(scales[-1] * max(1.0, heard / (2.0 * min(_MOST_ADDED, 0.25 * rate))))
    network = LieEDNN(
        alpha=alpha,
        rotation=rotation,
        translation=np.zeros((size, size, 3)),
        bias=bias,
        activation=activation,
        lyapunov_diagonal=np.repeat(np.repeat(scales, [n, m, clock][: len(scales)]), 3) ** 2,
        hidden_start=hidden_start,
        n_clock=clock,
    )
    return network.retarget(target)


def turns_to(vectors: Floats) -> Floats:
    """Rotations ``(..., 3, 3)`` of e_x to the directions of ``vectors`` ``(..., 3)``, as products of two reflections.

    The rotation to a vector of length zero is the identity.
    """
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    direction = np.where(size > 0.0, vectors / np.maximum(size, 1e-300), _UNIT)
    # A mirror that swaps e_x and the direction (or that of e_z if they agree), after one that leaves e_x alone.
    normal = direction - _UNIT
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.where(length > 1e-12, normal / np.maximum(length, 1e-300), np.eye(3)[2])
    mirror = np.eye(3) - 2.0 * normal[..., :, None] * normal[..., None, :]
    return np.asarray(mirror @ np.diag([1.0, 1.0, -1.0]))


def switches(count: int) -> tuple[Floats, Floats]:
    """Equilibria a and slopes c ``(M,)`` of the first switches of ``count`` pairs, at equal steps of the clock."""
    # The range goes beyond both ends of the clock, so that its first and last part have as many bumps as its middle.
    low, high = -0.1, 1.05
    # Steep bumps ripple; wide ones are hardly independent, so that they need large codes and a large D.
    slope = np.full(count, 0.6 * count / (high - low))
    return -slope * (1.0 - low - (high - low) * (np.arange(count) + 0.5) / count), slope


def pairs_of(n: int, count: int, strength: float) -> Parameters:
    """``count`` pairs for each of N visible neurons, read with the strength D, as a cascade."""
    a, c = (np.tile(np.outer([1.0, -1.0], part).ravel(), n)[:, None] * np.ones(6) for part in switches(count))
    alpha = np.kron(np.eye(n), np.full(2 * count, strength))
    return Parameters(a, c, alpha, np.tile(np.eye(3), (n, len(a), 1, 1)))


def bumps(clock: Clockwork) -> Floats:
    """Displacements ``(K + 1, M)`` of a visible neuron by `PAIRS` pairs of unit D delta; the last row is `TAIL` B."""
    a, c = switches(PAIRS)
    slope = clock.activation.slope
    g = clock.fine[:, None]
    return np.concatenate([clock.filter @ (2.0 * g * slope(a + c * g)), 2.0 * TAIL * slope(a)[None]])


def encoder(clock: Clockwork) -> Floats:
    """Codes D delta ``(M,)`` of a displacement at the clock's instants ``(K,)``, as one matrix ``(M, K)``."""
    left, size, right = np.linalg.svd(bumps(clock), full_matrices=False)
    ridge = 1e-3  # weight of the squared codes, relative to the largest singular value of the bumps
    return np.asarray(right.T * (size / (size**2 + (ridge * size[0]) ** 2)) @ left.T[:, :-1])


def with_pairs(
    parameters: Parameters,
    clock: Clockwork,
    network: LieEDNN,
    start: Floats,
    response: Floats,
    inputs: Floats,
    others: Floats | None = None,
) -> LieEDNN:
    """A network whose motion depends on its visible start, and on its target if asked, by added pairs and gains.

    Args:
        parameters, clock, network: of the cascade, with rho = 1.
        start: ``(N, 6)`` visible start of its motion, which stays as it is.
        response: ``(K, 6N, E)`` derivatives of the visible states at the clock's instants in the visible start, E = 6N,
            or in that and in the target, E = 12N.
        inputs: ``(n, E)`` deviations of start (and target) for which codes must be small, so that bumps are linear.
        others: further codes D delta ``(..., N, M, 6)`` that must be small.
    """
    n = len(parameters.alpha)
    left = np.exp(-clock.t)[:, None, None] * np.eye(6 * n)
    target = response - np.concatenate([left, np.eye(6 * n) - left], axis=2)[:, :, : response.shape[2]]
    # For each visible neuron and pair, D delta for a unit of each coordinate of the start and of the target.
    codes = (encoder(clock) @ target.reshape(len(target), -1)).reshape(PAIRS, n, 6, -1).swapaxes(0, 1)
    largest = float(np.abs(codes @ inputs.T).max())
    strength = max(largest, 0.0 if others is None else float(np.abs(others).max())) / LARGEST_CODE
    if strength <= 0.0:
        return network
    pairs = pairs_of(n, PAIRS, strength)
    joined = Parameters(
        np.concatenate([parameters.a, pairs.a]),
        np.concatenate([parameters.c, pairs.c]),
        np.concatenate([parameters.alpha, pairs.alpha], axis=1),
        np.concatenate([parameters.rotation, pairs.rotation], axis=1),
    )
    result = assemble(joined, clock.rate, network.equilibrium().xi[:n], network.activation)
    gain, *rest = np.split(shifts(result, codes).reshape(result.n_hidden * 6, -1), response.shape[2] // (6 * n), axis=1)
    # The start's reference moves with the target: K start + L target = K (start - target) + (K + L) target.
    return result.with_start(result.hidden_start, gain, start, gain + rest[0] if rest else None)


def shifts(network: LieEDNN, codes: Floats) -> Floats:
    """Shifts of the hidden starts ``(H, 6, ...)`` of a network with pairs by codes D delta ``(N, M, 6, ...)``."""
    n, count = codes.shape[:2]
    shift = np.zeros((network.n_hidden, 6, *codes.shape[3:]))
    # Both neurons of a pair have the same shift; pairs are the last hidden neurons, and D is the strength of each.
    shift[-2 * n * count :].reshape(n, 2, count, *codes.shape[2:])[:] = codes[:, None] / network.alpha[n - 1, -1]
    return shift


def codes_of(network: LieEDNN, shift: Floats) -> Floats:
    """The inverse of `shifts` for `PAIRS` pairs."""
    n = network.n_visible
    pairs = shift[-2 * n * PAIRS :].reshape(n, 2, PAIRS, *shift.shape[1:])
    return np.asarray(pairs[:, 0] * network.alpha[n - 1, -1])
