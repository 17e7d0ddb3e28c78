"""Projective manifold learning (paper, Algorithm 1), in the variants of `TrainingOptions`."""

from __future__ import annotations

import math

import numpy as np

from lieednn_sim.budget import check_time
from lieednn_sim.learning.manifold import Network
from lieednn_sim.learning.options import TrainingOptions
from lieednn_sim.learning.sensitivity import (
    FlatEquilibrium,
    SensitivityMatrix,
    gauss_newton_direction,
    strength_gradient,
    weight_gradient,
)
from lieednn_sim.learning.training import Iterate, StopReason, Training
from lieednn_sim.values import Floats


class ProjectedTraining(Training[TrainingOptions]):
    """Steps of the weights as they are, projected onto the manifold every few epochs."""

    def initial(self, weight: Floats) -> Iterate:
        """See `Training`; Algorithm 1 starts off the manifold."""
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
        options, rows, first = self.options, len(self.recorder), self.epoch
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
            self.recorder.cut(rows)  # back to the last weights that have the equilibrium
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

        Where Newton's method fails and the training would end, the network is run, as Algorithm 1 does in every epoch:
        it often still settles.
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
        options, ratio = self.options, self.ratio
        equilibrium = now.equilibrium
        delta = equilibrium.x - self.goal
        error = math.sqrt(delta.dot(delta))
        rate = now.rate
        if options.step_control == "adaptive":
            factor = options.grow if error < now.error else options.shrink
            rate = min(max(rate * factor, options.min_rate), options.max_rate)
        self.recorder.add(self.epoch, equilibrium.x, rate, now.weight)
        self.epoch += 1
        # The length is at most sqrt(n) times the largest coordinate, so this is computed only when it may hold.
        arrived = error < options.tolerance * math.sqrt(delta.size) and self.arrived(now)
        weight, alpha, nearby = now.weight, now.alpha, None
        if error > 0.0:
            nearby = self.solver.sensitivity(weight, equilibrium)
            if nearby.singular:
                return now._replace(equilibrium=equilibrium._replace(success=False)), False
            if options.direction == "gradient":
                direction = weight_gradient(nearby.solve_transposed(delta), equilibrium.output, ratio)
                if options.loss == "norm":
                    direction /= error
            else:
                direction = gauss_newton_direction(nearby.matrix, equilibrium.output, delta, ratio)
            weight = weight - rate * direction
            if options.learn_alpha and options.projection not in ("scaled", "none"):
                change = strength_gradient(direction, now.point.adjoints)
                if options.direction == "gauss-newton":
                    change /= np.einsum("ijab,ijab->ij", now.point.adjoints, now.point.adjoints)
                alpha = alpha - rate * change
        reached = self._find(weight, equilibrium.x, nearby)
        return Iterate(weight, alpha, now.point, reached, now.log_scale, rate, error), arrived
