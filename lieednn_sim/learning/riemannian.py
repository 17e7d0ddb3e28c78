"""Learning on the weight manifold itself: every iterate has blocks alpha_ij Ad(theta_ij), so nothing is projected.

With delta = xi* - xi_d, S = I - (mu/gamma) W diag(phi'(xi*)) and B the derivative of W phi in the coordinates of
`tangent`, a step p of the weights moves the equilibrium by S^-1 (mu/gamma) B p to first order. Hence two methods:

- gradient: p = -rate (mu/gamma) B^T S^-T delta, the Riemannian gradient of E^2/2, with Armijo backtracking;
- gauss-newton: the shortest p with (mu/gamma) B p = -rate S delta, which needs no inverse of S.

The second leaves 7 N^2 - 6 N directions along which the equilibrium does not move to first order. Certified training
uses them: it learns log S_P of a Lyapunov diagonal P = S_P^2 along with the weights, and whenever the smoothed largest
eigenvalue of (mu/gamma) sym(S_P W_R S_P^-1) nears 1, log S_P and the neutral part of the weights descend its gradient.
Below 1 the network has only one equilibrium, globally stable, which can neither be lost nor jump.
"""

from __future__ import annotations

import numpy as np

from lieednn_sim.learning.equilibria import SensitivityMatrix
from lieednn_sim.learning.manifold import Network
from lieednn_sim.learning.options import RiemannianOptions
from lieednn_sim.learning.result import StopReason
from lieednn_sim.learning.tangent import (
    RowEquations,
    differential,
    loss_gradient,
    retract,
    rotational_weight,
    smoothed_eigenvalue,
)
from lieednn_sim.learning.training import Iterate, Training
from lieednn_sim.stability import Certificate, find_certificate, verify
from lieednn_sim.values import Floats

# Fraction of the largest jump at which a Gauss-Newton step aims, to leave room for second-order terms.
_AIM = 0.4
# In one epoch the barrier asks for this fraction of the excess, and at most this much. Where the squared slope is below
# the last number it asks for less, so that the weights come to rest at a minimum.
_BARRIER_GAIN = 0.3


class RiemannianTraining(Training[RiemannianOptions]):
    """Steps along the manifold, each taken only if the equilibrium follows it."""

    # Epoch of the last check of stability.
    _checked_at = 0

    def initial(self, weight: Floats) -> Iterate:
        """See `Training`."""
        n = len(self.problem.target)
        point = self.manifold.project(weight, np.ones((n, n)), "scaled")
        weight, self._checked_at = point.weight, self.epoch
        rate = self.options.initial_rate
        return Iterate(weight, point.alpha, point, self.solver.first(weight), np.zeros(3 * n), rate)

    def network(self, last: Iterate) -> Network:
        """See `Training`; with a certificate if one was to be learned."""
        parameters = self.problem.rates
        if self.options.certified and (proof := self._certificate(last)).valid:
            parameters["lyapunov_diagonal"] = proof.lyapunov_diagonal
        return self.manifold.network(last.point, self.problem.bias, parameters)

    def accepts(self, network: Network | None) -> bool:
        """See `Training`."""
        return not self.options.certified or (network is not None and network.certified)

    def advance(self, before: Iterate, end: int) -> tuple[Iterate, StopReason | None]:
        """One step, or none where it is rejected."""
        options = self.options
        due = self.epoch - self._checked_at >= options.stability_interval
        if self.arrived(before) and (not options.certified or self._proved(before, search=due)):
            return before, StopReason.CONVERGED
        if self.epoch >= end:
            return before, StopReason.EPOCHS_SPENT
        nearby = self.solver.sensitivity(before.weight, before.equilibrium)
        if nearby.singular:
            return before, StopReason.LOST_EQUILIBRIUM
        if options.direction == "gradient":
            trial, decrease = self._gradient_step(before, nearby)
        else:
            trial, decrease = self._gauss_newton_step(before, nearby), -np.inf
        row = self.epoch
        self.epoch += 1
        if self._followed(before, trial, decrease) and (not due or self.stable(trial)):
            self.recorder.add(row, before.equilibrium.x, before.rate, before.weight)
            if due:
                self._checked_at = self.epoch
            return trial._replace(rate=min(options.max_rate, before.rate * options.grow)), None
        rate = before.rate * options.shrink
        return before._replace(rate=rate), StopReason.STEP_VANISHED if rate < options.min_rate else None

    def _moved(self, before: Iterate, step: Floats, log_scale: Floats, nearby: SensitivityMatrix) -> Iterate:
        """The iterate a step away, with the equilibrium near that of before."""
        point = retract(before.point, step)
        weight = point.weight
        equilibrium = self.solver.newton(weight, before.equilibrium.x, nearby)
        return Iterate(weight, point.alpha, point, equilibrium, log_scale, before.rate)

    def _followed(self, now: Iterate, trial: Iterate, decrease: float) -> bool:
        """Whether the trial has the same equilibrium, slightly moved, and the loss fell by at least ``decrease``."""
        before, after = now.equilibrium.x, trial.equilibrium.x
        if not trial.equilibrium.success or np.abs(after - before).max() > self.options.max_jump:
            return False
        if not self._loss(after) <= self._loss(before) - decrease:
            return False
        return not self.arrived(trial) or self.stable(trial)

    def _loss(self, x: Floats) -> float:
        return 0.5 * float((x - self.goal) @ (x - self.goal))

    def _gradient_step(self, now: Iterate, nearby: SensitivityMatrix) -> tuple[Iterate, float]:
        """The trial against the gradient, and how much E^2/2 must fall."""
        delta = now.equilibrium.x - self.goal
        gradient = loss_gradient(differential(now.point, now.equilibrium.output), nearby, delta, self.ratio)
        trial = self._moved(now, -now.rate * gradient, now.log_scale, nearby)
        # Armijo's condition: the loss must fall by at least this fraction of what its slope predicts.
        sufficient_decrease = 1e-4
        return trial, sufficient_decrease * now.rate * float(np.vdot(gradient, gradient))

    def _gauss_newton_step(self, now: Iterate, nearby: SensitivityMatrix) -> Iterate:
        """The trial with the shortest step towards the target, plus the certificate's neutral step."""
        delta = now.equilibrium.x - self.goal
        longest = _AIM * self.options.max_jump
        aim = delta * (longest / max(longest, np.abs(delta).max()))
        equations = RowEquations(differential(now.point, now.equilibrium.output), self.options.damping)
        step = equations.shortest(nearby.matrix @ (-now.rate / self.ratio * aim))
        log_scale = now.log_scale
        # The smoothed eigenvalue lies above the largest by at most log(3N) / sharpness.
        sharpness = 16.0
        largest_drop = 0.1
        least_squared_slope = 0.3
        if self.options.certified:
            value, in_point, in_log_scale = smoothed_eigenvalue(now.point, log_scale, self.ratio, sharpness)
            if value > self.options.barrier:
                # Not scaled by the rate: the certificate takes precedence over the target.
                neutral = equations.neutral(in_point)
                slope = float(np.vdot(neutral, neutral) + in_log_scale @ in_log_scale)
                drop = min(_BARRIER_GAIN * (value - self.options.barrier), largest_drop)
                length = drop / max(slope, least_squared_slope)
                step, log_scale = step - length * neutral, log_scale - length * in_log_scale
        return self._moved(now, step, log_scale, nearby)

    def _proved(self, now: Iterate, *, search: bool) -> bool:
        """Whether the learned diagonal certifies the weights, or with ``search`` any that is found."""
        return self._learned_certificate(now).valid or (search and self._certificate(now).valid)

    def _learned_certificate(self, now: Iterate) -> Certificate:
        weight, rates = rotational_weight(now.point), {"gamma": self.problem.gamma, "mu": self.problem.mu}
        return verify(np.exp(2.0 * now.log_scale), weight, **rates)

    def _certificate(self, now: Iterate) -> Certificate:
        """The better one of the learned certificate and the best that can be found."""
        certificate = find_certificate(rotational_weight(now.point), gamma=self.problem.gamma, mu=self.problem.mu)
        return min(self._learned_certificate(now), certificate, key=lambda proof: proof.lambda_max + proof.rounding)
