"""Learning a network for a target by one of the algorithms, and the first of them, projective manifold learning."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.budget import check_time, one_blas_thread
from lieednn_sim.errors import InputError
from lieednn_sim.learning import sensitivity
from lieednn_sim.learning.manifold import GroupWeights, Network, QuaternionWeights, SE3Weights, WeightManifold
from lieednn_sim.learning.options import RiemannianOptions, TrainingOptions
from lieednn_sim.learning.riemannian import RiemannianTraining
from lieednn_sim.learning.sensitivity import FlatEquilibrium, SensitivityMatrix
from lieednn_sim.learning.training import Iterate, StopReason, Training, TrainingProblem, TrainingResult
from lieednn_sim.network import DEFAULT_ACTIVATION
from lieednn_sim.network.componentwise import as_activation
from lieednn_sim.theory.matrix_group import MatrixLieGroup
from lieednn_sim.validation import Seed, as_floats, as_positive, as_seed
from lieednn_sim.values import Floats


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

    `TrainingOptions` select the paper's Algorithm 1 and its variants, which project the weights onto the manifold every
    few epochs; `RiemannianOptions` select steps on the manifold itself, which can also learn a certificate.
    Progress is reported in epochs (`budget.reporting`).

    A single neuron reaches few targets, since one block rotates omega and v together and keeps the angle between them.

    Args:
        target: ``(N, 6)`` xi_d, or ``(N, d)`` with a group of dimension d.
        options: the repaired Algorithm 1 by default.
        bias: ``(N, d)``, or one number for all.
        gamma, mu: decay rate and scale of the interaction.
        activation: a name of `network.ACTIVATIONS`.
        group: another group than SE(3), or `manifold.QuaternionWeights` for quaternions, d = 4; only `TrainingOptions`.
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


class ProjectedTraining(Training[TrainingOptions]):
    """Unconstrained steps of the weights, which are projected onto the manifold every few epochs (Algorithm 1)."""

    def initial(self, weight: Floats) -> Iterate:
        """See `Training`; Algorithm 1 does not start on the manifold."""
        options, n = self.options, len(self.problem.target)
        alpha = np.full((n, n), 1.0 / (3.0 * n))
        kind = "block-wise" if options.projection == "none" else options.projection
        point = self.manifold.project(weight, alpha, kind)
        if options.step_control == "tracked" and options.projection != "none":
            # A trial, which may be rejected, needs a point on the manifold to return to.
            weight, alpha = point.weight, point.alpha
        rk45 = options.equilibrium == "rk45"
        equilibrium = self.solver.flow(weight, np.zeros(len(weight))) if rk45 else self.solver.first(weight)
        return Iterate(weight, alpha, point, equilibrium, np.empty(0), options.initial_rate)

    def network(self, last: Iterate) -> Network | None:
        """See `Training`."""
        if self.options.projection == "none":
            return None
        return self.manifold.network(last.point, self.problem.bias, self.problem.rates)

    def advance(self, before: Iterate, end: int) -> tuple[Iterate, StopReason | None]:
        """The epochs from one projection to the next."""
        options, rows, first = self.options, len(self.rows), self.epoch
        if first >= end:
            return before, StopReason.EPOCHS_SPENT
        now, arrived = before, False
        for _ in range(options.period):
            now, arrived = self._step(now)
            if not now.equilibrium.success or self.epoch >= end:
                break
        if now.equilibrium.success and options.projection != "none":
            point = self.manifold.project(now.weight, now.alpha, options.projection, now.point)
            weight = point.weight
            equilibrium = self._find(weight, now.equilibrium.x)
            now = now._replace(weight=weight, alpha=point.alpha, point=point, equilibrium=equilibrium)
        tracked = options.step_control == "tracked"
        lost = not now.equilibrium.success
        if lost or (tracked and np.abs(now.equilibrium.x - before.equilibrium.x).max() > options.max_jump):
            del self.rows[rows:]  # back to the last weights that have the equilibrium
            if not tracked:
                return before, StopReason.LOST_EQUILIBRIUM
            rate = before.rate * options.shrink
            return before._replace(rate=rate), StopReason.STEP_VANISHED if rate < options.min_rate else None
        if tracked:
            now = now._replace(rate=min(options.max_rate, now.rate * options.grow))
        if options.verified_stop:
            arrived = self.arrived(now)
        due = self.epoch // options.stability_interval > first // options.stability_interval
        if (arrived or due) and not self.stable(now):
            return now, StopReason.UNSTABLE
        return now, StopReason.CONVERGED if arrived else None

    def _find(self, weight: Floats, x: Floats, nearby: SensitivityMatrix | None = None) -> FlatEquilibrium:
        """The equilibrium near ``x``, to a small fraction of its distance from the target.

        Where Newton's method fails and the training would end, the network is integrated, as Algorithm 1 does in every
        epoch: it often still settles.
        """
        if self.options.equilibrium == "rk45":
            return self.solver.flow(weight, x)
        delta = x - self.goal
        # Relative to the equilibrium's distance from the target, so that its error does not affect E.
        tolerance = max(1e-6 * math.sqrt(delta.dot(delta)), 1e-12)
        result = self.solver.newton(weight, x, nearby, tolerance=tolerance)
        if result.success or self.options.step_control == "tracked":
            # A tracked trial is repeated with a smaller step instead, which costs less and keeps the equilibrium.
            return result
        return self.solver.settled(weight, x, tolerance=tolerance)

    def _step(self, now: Iterate) -> tuple[Iterate, bool]:
        """One epoch of Algorithm 1 without the projection, and whether its stop test passed as printed."""
        check_time()
        options, ratio, equilibrium, rate = self.options, self.ratio, now.equilibrium, now.rate
        delta = equilibrium.x - self.goal
        error = math.sqrt(delta.dot(delta))
        if options.step_control == "adaptive":
            factor = options.grow if error < now.error else options.shrink
            rate = min(max(rate * factor, options.min_rate), options.max_rate)
        self.record(self.epoch, now, rate)
        self.epoch += 1
        # The length is at most sqrt(n) times the largest coordinate, so the test is computed only where it may pass.
        arrived = error < options.tolerance * math.sqrt(delta.size) and self.arrived(now)
        weight, alpha, nearby = now.weight, now.alpha, None
        if error > 0.0:
            nearby = self.solver.sensitivity(weight, equilibrium)
            if nearby.singular:
                return now._replace(equilibrium=equilibrium._replace(success=False)), False
            if options.direction == "gradient":
                direction = sensitivity.weight_gradient(nearby.solve_transposed(delta), equilibrium.output, ratio)
                if options.loss == "norm":
                    direction /= error
            else:
                direction = sensitivity.gauss_newton_direction(nearby.matrix, equilibrium.output, delta, ratio)
            weight = weight - rate * direction
            if options.learn_alpha and options.projection not in ("scaled", "none"):
                change = sensitivity.strength_gradient(direction, now.point.adjoints)
                if options.direction == "gauss-newton":
                    change /= np.einsum("ijab,ijab->ij", now.point.adjoints, now.point.adjoints)
                alpha = alpha - rate * change
        reached = self._find(weight, equilibrium.x, nearby)
        return Iterate(weight, alpha, now.point, reached, now.log_scale, rate, error), arrived
