"""Projective manifold learning (paper, Algorithm 1), in the variants of `TrainingOptions`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._blas import one_blas_thread
from lieednn_sim.budget import check_time, cpu_time
from lieednn_sim.learning.equilibria import FlatEquilibrium, SensitivityMatrix
from lieednn_sim.learning.history import Recorder
from lieednn_sim.learning.manifold import QuaternionWeights, WeightPoint
from lieednn_sim.learning.options import TrainingOptions
from lieednn_sim.learning.problem import Progress, TrainingProblem
from lieednn_sim.learning.result import StopReason, TrainingResult, conclude
from lieednn_sim.learning.sensitivity import gauss_newton_direction, strength_gradient, weight_gradient
from lieednn_sim.network import DEFAULT_ACTIVATION
from lieednn_sim.theory.matrix_group import MatrixLieGroup
from lieednn_sim.validation import Seed, as_floats
from lieednn_sim.values import Floats

# Tolerance of the equilibrium relative to its distance from the target, so that its error does not affect E.
_RELATIVE_TOLERANCE = 1e-6
_LEAST_TOLERANCE = 1e-12


def train(
    target: ArrayLike,
    options: TrainingOptions | None = None,
    *,
    bias: ArrayLike = 0.125,
    gamma: float = 1.0,
    mu: float = 1.0,
    activation: str = DEFAULT_ACTIVATION,
    group: MatrixLieGroup | QuaternionWeights | None = None,
    initial_weight: ArrayLike | None = None,
    seed: Seed = 0,
    progress: Progress | None = None,
) -> TrainingResult:
    """Learn weights whose equilibrium is the target, projecting onto the manifold every few epochs.

    A single neuron reaches few targets, since one block rotates omega and v together and keeps the angle between them.

    Args:
        target: ``(N, 6)`` xi_d, or ``(N, d)`` with a group of dimension d.
        options: the repaired Algorithm 1 by default.
        bias: ``(N, d)``, or one number for all.
        gamma: decay rate of the network.
        mu: scale of its interaction.
        activation: a name of `network.ACTIVATIONS`.
        group: another group than SE(3), or `manifold.QuaternionWeights` for quaternions, d = 4.
        initial_weight: ``(Nd, Nd)`` weights of the first start; by default, and for every other start, random ones of
            1-norm 1, as in the paper.
        seed: seed of the initial weights; the same seed gives the same network.
        progress: called with the epochs done and the largest number of epochs.

    Returns:
        The outcome; where `success` is false, `reason` says why.

    Raises:
        InputError: a value has the wrong shape or range.
    """
    problem = TrainingProblem.checked(target, bias, gamma, mu, activation, group, seed)
    chosen = TrainingOptions() if options is None else options
    size = problem.target.size
    first = None if initial_weight is None else as_floats("initial_weight", initial_weight, (size, size))
    training = _ProjectedTraining(problem, chosen)
    with one_blas_thread():
        training.begin(0, weight=first)
        return training.run(progress)


class _State(NamedTuple):
    """State of a training after a projection, to which a rejected trial returns.

    Attributes:
        weight: ``(Nd, Nd)``.
        alpha: ``(N, N)`` learned strengths.
        point: the last projection of the weights.
        equilibrium: equilibrium of the weights.
        rate: learning rate.
        error: E of the last epoch, to which the adaptive rate compares the next one.
        epoch: epochs done, over all starts.
        rows: rows of history up to here.
        start: number of the initial weights.
        start_epoch: epoch at which this start began.
        reason: why this start ended; None while it goes on.
    """

    weight: Floats
    alpha: Floats
    point: WeightPoint
    equilibrium: FlatEquilibrium
    rate: float
    error: float
    epoch: int
    rows: int
    start: int
    start_epoch: int
    reason: StopReason | None = None


class _ProjectedTraining:
    def __init__(self, problem: TrainingProblem, options: TrainingOptions) -> None:
        self.problem, self.options = problem, options
        self.manifold, self.solver = problem.manifold(), problem.solver()
        self.goal = problem.target.ravel()
        self.recorder = Recorder(problem.target, options.tolerance)
        self.anchor: _State

    def begin(self, start: int, epoch: int = 0, weight: Floats | None = None) -> None:
        """New initial weights: random ones, unless they are given."""
        options, n = self.options, len(self.problem.target)
        if weight is None:
            weight = self.problem.initial_weight(start)
        alpha = np.full((n, n), options.initial_alpha or 1.0 / (3.0 * n))
        point = self.manifold.project(
            weight, alpha, "block-wise" if options.projection == "none" else options.projection
        )
        if options.step_control == "tracked" and options.projection != "none":
            # Algorithm 1 starts off the manifold; a trial, which may be rejected, needs a point on it to return to.
            weight, alpha = point.weight, point.alpha
        self.recorder.cut(0)
        rk45 = options.equilibrium == "rk45"
        equilibrium = self.solver.flow(weight, np.zeros(len(weight))) if rk45 else self.solver.first(weight)
        self.anchor = _State(weight, alpha, point, equilibrium, options.initial_rate, np.inf, epoch, 0, start, epoch)

    def run(self, progress: Progress | None) -> TrainingResult:
        """Train until there is a reason to stop."""
        start = cpu_time()
        while self.anchor.reason is None or self._may_restart():
            if self.anchor.reason is None:
                self._advance()
            else:
                self.begin(self.anchor.start + 1, self.anchor.epoch)
            if progress is not None:
                progress(self.anchor.epoch, self.options.max_epochs)
        last = self.anchor
        self.recorder.cut(last.rows)
        self.recorder.add(last.epoch, last.equilibrium.x, last.rate, last.weight)
        return conclude(
            self.problem,
            last.weight,
            None if self.options.projection == "none" else last.point,
            last.equilibrium,
            last.reason or StopReason.EPOCHS_SPENT,
            tolerance=self.options.tolerance,
            history=self.recorder.history(),
            epochs=last.epoch,
            starts=last.start + 1,
            cpu_time=cpu_time() - start,
        )

    def _find(self, weight: Floats, x: Floats, nearby: SensitivityMatrix | None = None) -> FlatEquilibrium:
        """The equilibrium near ``x``, to a small fraction of its distance from the target.

        Where Newton's method fails and the training would end, the network is run, as Algorithm 1 does in every epoch:
        it often still settles.
        """
        if self.options.equilibrium == "rk45":
            return self.solver.flow(weight, x)
        delta = x - self.goal
        tolerance = max(_RELATIVE_TOLERANCE * math.sqrt(delta.dot(delta)), _LEAST_TOLERANCE)
        found = self.solver.newton(weight, x, nearby, tolerance=tolerance)
        if found.success or self.options.step_control == "tracked":
            # A tracked trial is repeated with a smaller step instead, which costs less and keeps the equilibrium.
            return found
        return self.solver.settled(weight, x, tolerance=tolerance)

    def _may_restart(self) -> bool:
        last = self.anchor
        left = last.start < self.options.restarts and last.epoch < self.options.max_epochs
        return left and last.reason is not StopReason.CONVERGED

    def _advance(self) -> None:
        """The epochs from one projection to the next."""
        options, before = self.options, self.anchor
        self.recorder.cut(before.rows)
        if not before.equilibrium.success:
            self.anchor = before._replace(reason=StopReason.LOST_EQUILIBRIUM)
            return
        allowed = options.max_epochs
        if before.start < options.restarts:
            allowed = min(allowed, before.start_epoch + options.max_start_epochs)
        if before.epoch >= allowed:
            self.anchor = before._replace(reason=StopReason.EPOCHS_SPENT)
            return
        state, arrived = before, False
        for _ in range(options.period):
            state, arrived = self._step(state)
            if not state.equilibrium.success or state.epoch >= allowed:
                break
        if state.equilibrium.success and options.projection != "none":
            point = self.manifold.project(state.weight, state.alpha, options.projection, state.point)
            weight = point.weight
            equilibrium = self._find(weight, state.equilibrium.x)
            state = state._replace(weight=weight, alpha=point.alpha, point=point, equilibrium=equilibrium)
        tracked = options.step_control == "tracked"
        lost = not state.equilibrium.success
        if lost or (tracked and np.abs(state.equilibrium.x - before.equilibrium.x).max() > options.max_jump):
            # Back to the last weights that have the equilibrium.
            rate = before.rate * options.shrink if tracked else before.rate
            reason: StopReason | None = StopReason.LOST_EQUILIBRIUM
            if tracked:
                reason = StopReason.STEP_VANISHED if rate < options.min_rate else None
            self.anchor = before._replace(epoch=state.epoch, rate=rate, reason=reason)
            return
        if tracked:
            state = state._replace(rate=min(options.max_rate, state.rate * options.grow))
        if options.verified_stop:
            arrived = bool(np.abs(state.equilibrium.x - self.goal).max() < options.tolerance)
        checks = state.epoch // options.stability_interval > before.epoch // options.stability_interval
        if (arrived or checks) and not self.solver.sensitivity(state.weight, state.equilibrium).stable():
            state = state._replace(reason=StopReason.UNSTABLE)
        elif arrived:
            state = state._replace(reason=StopReason.CONVERGED)
        self.anchor = state

    def _step(self, state: _State) -> tuple[_State, bool]:
        """One epoch of Algorithm 1 without the projection, and whether its stop test passed as printed."""
        check_time()
        options, ratio = self.options, self.problem.ratio
        now = state.equilibrium
        delta = now.x - self.goal
        error = math.sqrt(delta.dot(delta))
        rate = state.rate
        if options.step_control == "adaptive":
            factor = options.grow if error < state.error else options.shrink
            rate = min(max(rate * factor, options.min_rate), options.max_rate)
        self.recorder.add(state.epoch, now.x, rate, state.weight)
        # The length is at most sqrt(n) times the largest coordinate, so this is computed only when it may hold.
        arrived = error < options.tolerance * math.sqrt(delta.size) and bool(np.abs(delta).max() < options.tolerance)
        weight, alpha, nearby = state.weight, state.alpha, None
        if error > 0.0:
            nearby = self.solver.sensitivity(weight, now)
            if nearby.singular:
                return state._replace(equilibrium=now._replace(success=False), epoch=state.epoch + 1), False
            if options.direction == "gradient":
                direction = weight_gradient(nearby.solve_transposed(delta), now.output, ratio)
                if options.loss == "norm":
                    direction /= error
            else:
                direction = gauss_newton_direction(nearby.matrix, now.output, delta, ratio)
            weight = weight - rate * direction
            if options.learn_alpha and options.projection not in ("scaled", "none"):
                change = strength_gradient(direction, state.point.adjoints)
                if options.direction == "gauss-newton":
                    change /= np.einsum("ijab,ijab->ij", state.point.adjoints, state.point.adjoints)
                alpha = alpha - rate * change
        found, epoch, rows = self._find(weight, now.x, nearby), state.epoch + 1, len(self.recorder)
        after = _State(weight, alpha, state.point, found, rate, error, epoch, rows, state.start, state.start_epoch)
        return after, arrived
