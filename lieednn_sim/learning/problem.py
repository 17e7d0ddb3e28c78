"""The learning problem: a target, and the parts of the network that are not learned."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.learning.equilibria import EquilibriumSolver
from lieednn_sim.learning.manifold import QuaternionWeights, WeightManifold, weight_manifold
from lieednn_sim.network.componentwise import as_activation
from lieednn_sim.theory.matrix_group import MatrixLieGroup
from lieednn_sim.validation import Seed, as_floats, as_positive, as_seed
from lieednn_sim.values import Floats, frozen

# Called with the epochs done and the most epochs.
Progress = Callable[[int, int], None]

# The paper's epsilon in W / (epsilon + ||W||_1).
_EPSILON = 1e-12


@frozen
class TrainingProblem:
    """A target and everything of the network that is not learned.

    Attributes:
        target: ``(N, d)`` xi_d.
        bias: ``(N, d)``.
        gamma, mu, activation: parameters of the network.
        group: the group, None for SE(3), or `QuaternionWeights`.
        seed: seed of the initial weights.
    """

    target: Floats
    bias: Floats
    gamma: float
    mu: float
    activation: str
    group: MatrixLieGroup | QuaternionWeights | None
    seed: int

    @classmethod
    def checked(
        cls,
        target: ArrayLike,
        bias: ArrayLike,
        gamma: float,
        mu: float,
        activation: str,
        group: MatrixLieGroup | QuaternionWeights | None,
        seed: Seed,
    ) -> TrainingProblem:
        """Build from user input; a scalar bias applies to every coordinate.

        Raises:
            InputError: a value has the wrong shape or range.
        """
        dimension = weight_manifold(group).dimension
        goal = as_floats("target", target, ("N", dimension))
        if len(goal) == 0:
            raise InputError(f"target must have shape (N, {dimension}) with N >= 1, got (0, {dimension})")
        offset = as_floats("bias", bias, (), batched=True)
        offset = as_floats("bias", offset if offset.ndim else np.full(goal.shape, offset), goal.shape)
        if not offset.any():
            raise InputError("bias must not be zero: zero would be an equilibrium for all weights")
        return cls(
            target=goal,
            bias=offset,
            gamma=as_positive("gamma", gamma),
            mu=as_positive("mu", mu),
            activation=as_activation(activation),
            group=group,
            seed=as_seed("seed", seed),
        )

    @property
    def ratio(self) -> float:
        """mu/gamma."""
        return self.mu / self.gamma

    @property
    def rates(self) -> dict[str, Any]:
        """Arguments of a network's constructor besides weights and bias."""
        return {"gamma": self.gamma, "mu": self.mu, "activation": self.activation}

    def manifold(self) -> WeightManifold:
        """The manifold of the weights."""
        return weight_manifold(self.group)

    def solver(self) -> EquilibriumSolver:
        """A solver for the equilibrium of given weights."""
        return EquilibriumSolver(self.bias, self.ratio, self.activation)

    def initial_weight(self, start: int) -> Floats:
        """Random weights of the start-th try: U(-1, 1), divided by their 1-norm (Algorithm 1), ``(Nd, Nd)``."""
        n = self.target.size
        weight = np.random.default_rng([self.seed, start]).uniform(-1.0, 1.0, (n, n))
        return weight / (_EPSILON + np.abs(weight).sum(axis=0).max())
