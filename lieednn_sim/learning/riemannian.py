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

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._blas import one_blas_thread
from lieednn_sim.budget import cpu_time
from lieednn_sim.learning.equilibria import FlatEquilibrium, SensitivityMatrix
from lieednn_sim.learning.history import Recorder
from lieednn_sim.learning.manifold import WeightPoint
from lieednn_sim.learning.options import RiemannianOptions
from lieednn_sim.learning.problem import Progress, TrainingProblem
from lieednn_sim.learning.result import StopReason, TrainingResult, conclude
from lieednn_sim.learning.tangent import (
    RowEquations,
    differential,
    loss_gradient,
    retract,
    rotational_weight,
    smoothed_eigenvalue,
)
from lieednn_sim.network import DEFAULT_ACTIVATION, LieEDNN
from lieednn_sim.stability import Certificate, find_certificate, verify
from lieednn_sim.validation import Seed
from lieednn_sim.values import Floats

# Armijo's condition: the loss must fall by at least this fraction of what its slope predicts.
_SUFFICIENT_DECREASE = 1e-4
# Fraction of the largest jump at which a Gauss-Newton step aims, to leave room for second-order terms.
_AIM = 0.4
# The smoothed eigenvalue lies above the largest by at most log(3N) / sharpness.
_SHARPNESS = 16.0
# In one epoch the barrier asks for this fraction of the excess, and at most this much. Where the squared slope is below
# the last number it asks for less, so that the weights come to rest at a minimum.
_BARRIER_GAIN = 0.3
_LARGEST_DROP = 0.1
_LEAST_SQUARED_SLOPE = 0.3


def train_riemannian(
    target: ArrayLike,
    options: RiemannianOptions | None = None,
    *,
    bias: ArrayLike = 0.125,
    gamma: float = 1.0,
    mu: float = 1.0,
    activation: str = DEFAULT_ACTIVATION,
    seed: Seed = 0,
    progress: Progress | None = None,
) -> TrainingResult:
    """Learn weights on the manifold of SE(3) whose equilibrium is the target.

    Args:
        target: ``(N, 6)`` xi_d.
        options: Gauss-Newton without a certificate by default.
        bias: ``(N, 6)``, or one number for all.
        gamma: decay rate of the network.
        mu: scale of its interaction.
        activation: a name of `network.ACTIVATIONS`.
        seed: seed of the initial weights; the same seed gives the same network.
        progress: called with the epochs done and the largest number of epochs.

    Returns:
        The outcome; where `success` is false, `reason` says why. Certified training succeeds only with a network that
        carries a valid certificate.

    Raises:
        InputError: a value has the wrong shape or range.
    """
    problem = TrainingProblem.checked(target, bias, gamma, mu, activation, None, seed)
    chosen = RiemannianOptions() if options is None else options
    with one_blas_thread():
        return _RiemannianTraining(problem, chosen, progress).run()


@dataclass(frozen=True)
class _Iterate:
    """Weights, their equilibrium, and the log S_P ``(3N,)`` that goes with them."""

    point: WeightPoint
    weight: Floats
    equilibrium: FlatEquilibrium
    log_scale: Floats


class _RiemannianTraining:
    def __init__(self, problem: TrainingProblem, options: RiemannianOptions, progress: Progress | None) -> None:
        self.problem, self.options, self.progress = problem, options, progress
        self.manifold, self.solver = problem.manifold(), problem.solver()
        self.goal, self.ratio = problem.target.ravel(), problem.ratio
        self.recorder = Recorder(problem.target, options.tolerance)
        self.epoch = 0

    def run(self) -> TrainingResult:
        """Try one start after the other."""
        begun, options = cpu_time(), self.options
        for start in range(options.restarts + 1):
            last, reason = self._descend(self._initial(start))
            if reason is StopReason.CONVERGED:
                break
        result = conclude(
            self.problem,
            last.weight,
            last.point,
            last.equilibrium,
            reason,
            tolerance=options.tolerance,
            history=self.recorder.history(),
            epochs=self.epoch,
            starts=start + 1,
            cpu_time=0.0,
        )
        if options.certified and isinstance(result.network, LieEDNN):
            proof = self._certificate(last)
            network = replace(result.network, lyapunov_diagonal=proof.lyapunov_diagonal if proof.valid else None)
            result = replace(result, network=network, success=result.success and network.certified)
        return replace(result, cpu_time=cpu_time() - begun)

    def _initial(self, start: int) -> _Iterate:
        n = len(self.problem.target)
        point = self.manifold.project(self.problem.initial_weight(start), np.ones((n, n)), "scaled")
        weight = point.weight
        return _Iterate(point, weight, self.solver.first(weight), np.zeros(3 * n))

    def _iterate(
        self, point: WeightPoint, x: Floats, log_scale: Floats, nearby: SensitivityMatrix | None = None
    ) -> _Iterate:
        """The iterate with the equilibrium near ``x``."""
        weight = point.weight
        return _Iterate(point, weight, self.solver.newton(weight, x, nearby), log_scale)

    def _descend(self, now: _Iterate) -> tuple[_Iterate, StopReason]:
        """From one start until there is a reason to stop."""
        options = self.options
        first = checked = self.epoch
        rate = options.initial_rate
        self.recorder.cut(0)
        while now.equilibrium.success:
            delta = now.equilibrium.x - self.goal
            self.recorder.add(self.epoch, now.equilibrium.x, rate, now.weight)
            nearby = self.solver.sensitivity(now.weight, now.equilibrium)
            due = self.epoch - checked >= options.stability_interval
            if self._arrived(now) and (not options.certified or self._proved(now, search=due)):
                return now, StopReason.CONVERGED
            if self.epoch - first >= options.max_start_epochs:
                return now, StopReason.EPOCHS_SPENT
            if nearby.singular:
                return now, StopReason.LOST_EQUILIBRIUM
            if options.method == "gradient":
                trial, decrease = self._gradient_step(now, delta, rate, nearby)
            else:
                trial, decrease = self._gauss_newton_step(now, delta, rate, nearby), -np.inf
            self.epoch += 1
            if self.progress is not None:
                self.progress(self.epoch, options.max_start_epochs * (options.restarts + 1))
            if self._followed(now, trial, decrease) and (not due or self._stable(trial)):
                if due:
                    checked = self.epoch
                now, rate = trial, min(options.max_rate, rate * options.grow)
            elif (rate := rate * options.shrink) < options.min_rate:
                return now, StopReason.STEP_VANISHED
            else:
                # The row is rewritten with the epoch and the rate of the next trial.
                self.recorder.cut(len(self.recorder) - 1)
        return now, StopReason.LOST_EQUILIBRIUM

    def _arrived(self, now: _Iterate) -> bool:
        return bool(np.abs(now.equilibrium.x - self.goal).max() < self.options.tolerance)

    def _stable(self, now: _Iterate) -> bool:
        return self.solver.sensitivity(now.weight, now.equilibrium).stable()

    def _followed(self, now: _Iterate, trial: _Iterate, decrease: float) -> bool:
        """Whether the trial has the same equilibrium, slightly moved, and the loss fell by at least ``decrease``."""
        before, after = now.equilibrium.x, trial.equilibrium.x
        if not trial.equilibrium.success or np.abs(after - before).max() > self.options.max_jump:
            return False
        if not self._loss(after) <= self._loss(before) - decrease:
            return False
        return not self._arrived(trial) or self._stable(trial)

    def _loss(self, x: Floats) -> float:
        return 0.5 * float((x - self.goal) @ (x - self.goal))

    def _gradient_step(
        self, now: _Iterate, delta: Floats, rate: float, nearby: SensitivityMatrix
    ) -> tuple[_Iterate, float]:
        """The trial against the gradient, and how much E^2/2 must fall."""
        gradient = loss_gradient(differential(now.point, now.equilibrium.output), nearby, delta, self.ratio)
        trial = self._iterate(retract(now.point, -rate * gradient), now.equilibrium.x, now.log_scale, nearby)
        return trial, _SUFFICIENT_DECREASE * rate * float(np.vdot(gradient, gradient))

    def _gauss_newton_step(self, now: _Iterate, delta: Floats, rate: float, nearby: SensitivityMatrix) -> _Iterate:
        """The trial with the shortest step towards the target, plus the certificate's neutral step."""
        longest = _AIM * self.options.max_jump
        aim = delta * (longest / max(longest, np.abs(delta).max()))
        equations = RowEquations(differential(now.point, now.equilibrium.output), self.options.damping)
        step = equations.shortest(nearby.matrix @ (-rate / self.ratio * aim))
        log_scale = now.log_scale
        if self.options.certified:
            value, in_point, in_log_scale = smoothed_eigenvalue(now.point, log_scale, self.ratio, _SHARPNESS)
            if value > self.options.barrier:
                # Not scaled by the rate: the certificate takes precedence over the target.
                neutral = equations.neutral(in_point)
                slope = float(np.vdot(neutral, neutral) + in_log_scale @ in_log_scale)
                drop = min(_BARRIER_GAIN * (value - self.options.barrier), _LARGEST_DROP)
                length = drop / max(slope, _LEAST_SQUARED_SLOPE)
                step, log_scale = step - length * neutral, log_scale - length * in_log_scale
        return self._iterate(retract(now.point, step), now.equilibrium.x, log_scale, nearby)

    def _proved(self, now: _Iterate, *, search: bool) -> bool:
        """Whether the learned diagonal certifies the weights, or with ``search`` any that is found."""
        return self._learned_certificate(now).valid or (search and self._certificate(now).valid)

    def _learned_certificate(self, now: _Iterate) -> Certificate:
        weight, rates = rotational_weight(now.point), {"gamma": self.problem.gamma, "mu": self.problem.mu}
        return verify(np.exp(2.0 * now.log_scale), weight, **rates)

    def _certificate(self, now: _Iterate) -> Certificate:
        """The better one of the learned certificate and the best that can be found."""
        found = find_certificate(rotational_weight(now.point), gamma=self.problem.gamma, mu=self.problem.mu)
        return min(self._learned_certificate(now), found, key=lambda proof: proof.lambda_max + proof.rounding)
