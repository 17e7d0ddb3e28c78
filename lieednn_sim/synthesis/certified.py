"""Certified synthesis: a LieEDNN with a given equilibrium and a proof of global stability."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.network import DEFAULT_ACTIVATION
from lieednn_sim.synthesis.attempts import Options, attempt_all
from lieednn_sim.synthesis.result import Synthesis
from lieednn_sim.validation import Seed, as_floats, as_generator, as_positive
from lieednn_sim.values import Floats


def synthesize(
    xi: ArrayLike,
    *,
    bias: str | ArrayLike = "uniform",
    bias_magnitude: float = 0.125,
    gamma: float = 1.0,
    mu: float = 1.0,
    activation: str = DEFAULT_ACTIVATION,
    seed: Seed = 0,
    max_translation: float = 20.0,
    max_attempts: int = 16,
) -> Synthesis:
    """Make a network whose only equilibrium is ``xi``, with a proof that it is globally attractive.

    xi is an equilibrium exactly when W phi(xi) = (gamma/mu) xi - b. The 3N rotational equations are solved for
    (alpha, R) under the eigenvalue bound of `stability`, the 3N translational ones then almost always for t alone.

    Args:
        xi: ``(N, 6)`` target, twists (omega, v).
        bias: a name of `BIAS_RULES` or an array ``(N, 6)``.
        bias_magnitude: strength of the uniform rule; least strength of the sign-matched one, in units of gamma/mu.
        gamma: decay rate.
        mu: scale of the interaction.
        activation: a name of `network.ACTIVATIONS`.
        seed: seed of the random starts; the same seed gives the same network.
        max_translation: largest |t_ij| allowed.
        max_attempts: number of starts to try.

    Returns:
        The outcome. If it failed, `network` is None and `message` says whether no such network exists or none was
        found.

    Raises:
        InputError: a value has the wrong shape or range.
    """
    target = as_floats("xi", xi, ("N", 6))
    _require_neurons(target)
    offset = bias if isinstance(bias, str) else as_floats("bias", bias, target.shape)[None]
    magnitudes = [as_positive("bias_magnitude", bias_magnitude)]
    options = Options(gamma, mu, activation, max_translation, max_attempts)
    return attempt_all(target[None], offset, magnitudes, [as_generator("seed", seed)], options)[0]


def synthesize_many(
    xi: ArrayLike,
    *,
    bias: str | ArrayLike = "uniform",
    bias_magnitude: ArrayLike = 0.125,
    gamma: float = 1.0,
    mu: float = 1.0,
    activation: str = DEFAULT_ACTIVATION,
    seed: Seed = 0,
    max_translation: float = 20.0,
    max_attempts: int = 16,
) -> list[Synthesis]:
    """Make a network for each of many targets, as `synthesize` makes one, in a fraction of the time.

    The fast searches run for all targets at once, in stacked arrays; the targets left are then searched one by one. The
    k-th network is, to the last bit, the one that ``synthesize`` makes with the k-th generator spawned from ``seed``,
    whatever the other targets are.

    Args:
        xi: ``(B, N, 6)`` targets; equal ones give several networks with one equilibrium.
        bias: a name of `BIAS_RULES` or an array ``(B, N, 6)``.
        bias_magnitude: as in `synthesize`, one number or one for each target ``(B,)``.
        gamma: decay rate.
        mu: scale of the interaction.
        activation: a name of `network.ACTIVATIONS`.
        seed: seed from which a generator for each target's starts is spawned.
        max_translation: largest |t_ij| allowed.
        max_attempts: number of starts to try for each target.

    Returns:
        B outcomes, in the order of the targets; a failure does not affect the others.

    Raises:
        InputError: a value has the wrong shape or range.
    """
    targets = as_floats("xi", xi, ("B", "N", 6))
    _require_neurons(targets)
    count = len(targets)
    offset = bias if isinstance(bias, str) else as_floats("bias", bias, targets.shape)
    given = as_floats("bias_magnitude", bias_magnitude, (), batched=True)
    given = np.broadcast_to(as_floats("bias_magnitude", given, (count,) if given.ndim else ()), (count,))
    magnitudes = [as_positive("bias_magnitude", float(item)) for item in given]
    options = Options(gamma, mu, activation, max_translation, max_attempts)
    return attempt_all(targets, offset, magnitudes, as_generator("seed", seed).spawn(count), options)


def _require_neurons(target: Floats) -> None:
    if target.shape[-2] == 0:
        raise InputError(f"xi must have shape (..., N, 6) with N >= 1, got {target.shape}")
