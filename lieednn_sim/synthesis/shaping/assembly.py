"""From a cascade's parameters to a certified network."""

from __future__ import annotations

import numpy as np

from lieednn_sim.network import DEFAULT_ACTIVATION, LieEDNN
from lieednn_sim.synthesis.shaping.cascade import CLOCK_START, Parameters
from lieednn_sim.values import Floats

# Most that a layer's input from the next one may add to lambda_max, in S-scaled weights.
_MOST_ADDED = 0.02
_UNIT = np.eye(3)[0]


def assemble(parameters: Parameters, rate: float, target: Floats, activation: str = DEFAULT_ACTIVATION) -> LieEDNN:
    """The network of a cascade to ``target`` ``(N, 6)``, with its Lyapunov diagonal in closed form.

    Ordered (visible, hidden, clock), W_R is block triangular with a diagonal of 0, 0 and 1 - rho. With P = S^2 and
    S = diag(1, s_h, s_c), a layer's input is divided by the ratio of two scales, so that lambda_max of
    sym(S W_R S^-1) comes arbitrarily close to 1 - rho: each scale is the least that comes within `_MOST_ADDED` of it.

    Args:
        parameters: parameters of N visible neurons and M switches.
        rate: rho of the clock; with 1 there is no clock.
        target: visible equilibrium.
        activation: a name of `ACTIVATIONS`.
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
    # The mirror that swaps e_x and the direction (that of e_z where they agree), after one that leaves e_x alone.
    normal = direction - _UNIT
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.where(length > 1e-12, normal / np.maximum(length, 1e-300), np.eye(3)[2])
    mirror = np.eye(3) - 2.0 * normal[..., :, None] * normal[..., None, :]
    return np.asarray(mirror @ np.diag([1.0, 1.0, -1.0]))
