"""Starts of searches for certified weights: random signs and quaternions, and a log S that permits a solution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lieednn_sim.synthesis.problem import Problem
from lieednn_sim.values import Floats

# Candidate differences of log P between helpful and harmful coordinates.
_SPREADS = np.arange(0.0, 3.0, 0.1)


def random_starts(
    state: Floats, required: Floats, columns: Sequence[slice], generators: Sequence[np.random.Generator]
) -> tuple[Problem, Floats]:
    """A stack of B random problems (signs of the blocks) and a random start for each, drawn by its own generator.

    Args:
        state: phi(xi) of the targets, ``(B, N, 6)``.
        required: what W phi(xi) must be, ``(B, N, 6)``.
        columns: parts of the twists that W_R must meet by itself.
        generators: B generators.

    Returns:
        The problems and the unknowns ``(B, 4 N^2 + 3N)``.
    """
    count, n = state.shape[:2]
    signs, quaternion, size = np.empty((count, n, n)), np.empty((count, n, n, 4)), np.empty((count, n, n, 1))
    for k, rng in enumerate(generators):
        rng.random(out=signs[k])
        rng.standard_normal(out=quaternion[k])
        rng.standard_normal(out=size[k])
    inputs = np.stack([state[..., part] for part in columns], axis=-1)
    outputs = np.stack([required[..., part] for part in columns], axis=-1)
    problem = Problem(inputs, outputs, np.where(signs < 0.5, 1.0, -1.0))
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion *= np.sqrt(0.3 / np.sqrt(n) * np.abs(size))
    return problem, np.concatenate([quaternion.reshape(count, -1), _log_scale(inputs, outputs)], axis=-1)


def _log_scale(inputs: Floats, outputs: Floats) -> Floats:
    """The log S of least spread with sum_i s_i^2 u_i (c_i - u_i) < 0, without which no weights can be certified."""
    work = (inputs * (outputs - 0.9 * inputs)).sum(axis=-1).reshape(len(inputs), -1)
    helpful = np.where(work < 0.0, 1.0, -1.0)
    # All spreads at once, (B, T, 3N), in a quarter of the time of one after another.
    power = np.exp(_SPREADS[:, None] * helpful[:, None])
    enough = (power * work[:, None]).sum(axis=-1) <= -0.1 * (power * np.abs(work)[:, None]).sum(axis=-1)
    # Where none is enough, the last one.
    enough[:, -1] = True
    return 0.5 * _SPREADS[enough.argmax(axis=-1)][:, None] * helpful


def contracted(problem: Problem, start: Floats) -> Floats:
    """Random weights shrunk until lambda_max is at most 0.5, for a bias that is solved for afterwards."""
    unknowns = start.copy()
    unknowns[:, problem.n_quaternion :] = 0.0
    largest = problem.evaluate(unknowns).values[:, -1:]
    unknowns[:, : problem.n_quaternion] *= np.sqrt(0.5 / np.maximum(largest, 0.5))
    return unknowns
