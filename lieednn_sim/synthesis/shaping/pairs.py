"""Pairs of opposite switches: hidden neurons whose starts bend a network's motion, and that are silent otherwise.

A switch phi(a + c g) and its opposite phi(-a - c g), both read out by D I, cancel at every instant and at rest. With
both starts shifted by delta, coordinate by coordinate, they add 2 D delta g phi'(a + c g) + O(delta^3) to a visible
neuron's input: a bump where g = -a/c. Pairs at equal steps of the clock are basis functions, for rho = 1, where g =
e^-t is a shift's own decay; their codes delta are hidden starts. See `docs/mathematics/families.md`.
"""

from __future__ import annotations

import numpy as np

from lieednn_sim.network import LieEDNN
from lieednn_sim.synthesis.shaping.cascade import TAIL, Clockwork, Parameters, assemble
from lieednn_sim.values import Floats

# Number of pairs of each visible neuron of a family.
PAIRS = 24
# Largest entry of a code, at which the cubic term is a thousandth of the bump.
LARGEST_CODE = 0.05


def switches(count: int) -> tuple[Floats, Floats]:
    """Equilibria a and slopes c ``(M,)`` of the first switches of ``count`` pairs, at equal steps of the clock."""
    # A little beyond both ends of the clock, so that its first and last part have as many bumps as its middle.
    low, high = -0.1, 1.05
    # Steep bumps ripple, and wide ones, hardly independent, need large codes and so a large D.
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
    # Weight of the squared codes, relative to the largest singular value of the bumps.
    ridge = 1e-3
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
    """A network whose motion depends on its visible start, and its target, with the pairs and gains that this takes.

    Args:
        parameters: parameters of the cascade.
        clock: its clockwork, with rho = 1.
        network: the network of the cascade.
        start: ``(N, 6)`` visible start of its motion, which stays as it is.
        response: ``(K, 6N, E)`` derivatives of the visible states at the clock's instants in the visible start, E = 6N,
            or in that and in the target, E = 12N.
        inputs: ``(n, E)`` deviations of the start (and of the target) for which codes must be small, so that bumps are
            linear in them.
        others: other codes D delta ``(..., N, M, 6)`` that must be small.
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
    # The start is seen from the target, with which its reference moves: K (start - target) + (K + K_target) target.
    return result.with_start(result.hidden_start, gain, start, gain + rest[0] if rest else None)


def shifts(network: LieEDNN, codes: Floats) -> Floats:
    """Shifts of the hidden starts ``(H, 6, ...)`` of a network with pairs by codes D delta ``(N, M, 6, ...)``."""
    n, count = codes.shape[:2]
    shift = np.zeros((network.n_hidden, 6, *codes.shape[3:]))
    # Both of a pair are shifted by the same; they are the last hidden neurons, and D is the strength of each.
    shift[-2 * n * count :].reshape(n, 2, count, *codes.shape[2:])[:] = codes[:, None] / network.alpha[n - 1, -1]
    return shift


def codes_of(network: LieEDNN, shift: Floats) -> Floats:
    """The inverse of `shifts` for `PAIRS` pairs."""
    n = network.n_visible
    pairs = shift[-2 * n * PAIRS :].reshape(n, 2, PAIRS, *shift.shape[1:])
    return np.asarray(pairs[:, 0] * network.alpha[n - 1, -1])
