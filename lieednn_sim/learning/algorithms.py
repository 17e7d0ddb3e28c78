"""Learning a network for a target by one of the algorithms."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.budget import one_blas_thread
from lieednn_sim.errors import InputError
from lieednn_sim.learning.manifold import GroupWeights, QuaternionWeights, SE3Weights, WeightManifold
from lieednn_sim.learning.options import RiemannianOptions, TrainingOptions
from lieednn_sim.learning.projected import ProjectedTraining
from lieednn_sim.learning.riemannian import RiemannianTraining
from lieednn_sim.learning.training import TrainingProblem, TrainingResult
from lieednn_sim.network import DEFAULT_ACTIVATION
from lieednn_sim.network.componentwise import as_activation
from lieednn_sim.theory.matrix_group import MatrixLieGroup
from lieednn_sim.validation import Seed, as_floats, as_positive, as_seed


def train(
    target: ArrayLike,
    options: TrainingOptions | RiemannianOptions | None = None,
    *,
    bias: ArrayLike = 0.125,
    gamma: float = 1.0,
    mu: float = 1.0,
    activation: str = DEFAULT_ACTIVATION,
    group: MatrixLieGroup | QuaternionWeights | None = None,
    initial_weight: ArrayLike | None = None,
    seed: Seed = 0,
) -> TrainingResult:
    """Learn weights whose equilibrium is the target.

    `TrainingOptions` ask for the paper's Algorithm 1 and its variants, which project the weights onto the manifold
    every few epochs; `RiemannianOptions` for steps on the manifold itself, which may learn a certificate as well.
    Who `reporting` names is told of the epochs done, and of their largest number.

    A single neuron reaches few targets, since one block rotates omega and v together and keeps the angle between them.

    Args:
        target: ``(N, 6)`` xi_d, or ``(N, d)`` with a group of dimension d.
        options: the repaired Algorithm 1 by default.
        bias: ``(N, d)``, or one number for all.
        gamma, mu: decay rate and scale of the interaction.
        activation: a name of `network.ACTIVATIONS`.
        group: another group than SE(3), or `manifold.QuaternionWeights` for quaternions, d = 4; projected only.
        initial_weight: ``(Nd, Nd)`` weights of the first start; by default, and for every other start, random ones of
            1-norm 1, as in the paper.
        seed: seed of the initial weights; the same seed gives the same network.

    Returns:
        The outcome; where `success` is false, `reason` says why. Certified training succeeds only with a network that
        carries a valid certificate.
    """
    manifold: WeightManifold = SE3Weights()
    if group is not None:
        manifold = group if isinstance(group, QuaternionWeights) else GroupWeights(group)
    goal = as_floats("target", target, ("N", manifold.dimension))
    size = goal.size
    if size == 0:
        raise InputError(f"target must have shape (N, {manifold.dimension}) with N >= 1, got {goal.shape}")
    offset = as_floats("bias", bias, (), batched=True)
    offset = as_floats("bias", offset if offset.ndim else np.full(goal.shape, offset), goal.shape)
    if not offset.any():
        raise InputError("bias must not be zero: zero would be an equilibrium for all weights")
    rates = as_positive("gamma", gamma), as_positive("mu", mu), as_activation(activation)
    problem = TrainingProblem(goal, offset, *rates, manifold, as_seed("seed", seed))
    first = None if initial_weight is None else as_floats("initial_weight", initial_weight, (size, size))
    chosen = TrainingOptions() if options is None else options
    with one_blas_thread():
        if isinstance(chosen, TrainingOptions):
            return ProjectedTraining(problem, chosen).run(first)
        if group is not None:
            raise InputError("learning on the manifold itself is for SE(3); use TrainingOptions for another group")
        return RiemannianTraining(problem, chosen).run(first)
