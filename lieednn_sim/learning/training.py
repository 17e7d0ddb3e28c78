"""A training: its problem, its result, and the loop of all algorithms, which tries starts until one succeeds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from enum import StrEnum
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from scipy.linalg.lapack import dlange

from lieednn_sim import io
from lieednn_sim.budget import cpu_time, report
from lieednn_sim.learning.manifold import Network, WeightManifold, WeightPoint
from lieednn_sim.learning.options import LearningOptions
from lieednn_sim.learning.sensitivity import EquilibriumSolver, FlatEquilibrium
from lieednn_sim.values import Floats, StrPath, frozen


@frozen
class History:
    """The course of a training: K rows, each for the weights at the beginning of an epoch.

    Attributes:
        epoch: ``(K,)`` epochs done before the row; rejected trials leave gaps.
        error: ``(K,)`` E = ||xi* - xi_d||_2, the printed loss.
        accuracy: ``(K,)`` fraction of coordinates within the tolerance of the target.
        rate: ``(K,)`` learning rate of the epoch.
        one_norm: ``(K,)`` ||W||_1.
        infinity_norm: ``(K,)`` ||W||_inf.
        equilibrium: ``(K, N, d)`` xi*.
    """

    epoch: Floats
    error: Floats
    accuracy: Floats
    rate: Floats
    one_norm: Floats
    infinity_norm: Floats
    equilibrium: Floats

    def __repr__(self) -> str:
        if not len(self):
            return "<History: empty>"
        last = f"error {self.error[0]:.3g} to {self.error[-1]:.3g}"
        return f"<History: {len(self)} rows up to epoch {self.epoch[-1]:g}, {last}>"

    def __len__(self) -> int:
        return len(self.error)

    def save(self, path: StrPath) -> None:
        """Write to an ``.npz`` file, atomically."""
        io.save_arrays(path, "training-history", vars(self), {})


class StopReason(StrEnum):
    """Why a training stopped."""

    CONVERGED = "converged"
    LOST_EQUILIBRIUM = "lost the equilibrium"
    UNSTABLE = "went unstable"
    STEP_VANISHED = "step vanished"
    EPOCHS_SPENT = "epochs spent"


@frozen
class TrainingResult:
    """Outcome of a training.

    Attributes:
        success: whether the final weights have a stable equilibrium within the tolerance of the target, checked anew.
        reason: why it stopped.
        network: the network, with weights on the manifold; None for the ablation without projection.
        weight: ``(Nd, Nd)`` the last weights: the network's, or those that left the manifold.
        error: largest coordinate of xi* - xi_d for these weights; infinite without an equilibrium.
        tolerance: the tolerance of `success`.
        structure_error: ||W - projected W|| / ||W|| in the Frobenius norm, the lost part of the group's structure. The
            ablation, which has no alpha, is projected with the best alpha of each block.
        history: history of the last start, epoch by epoch.
        epochs: epochs over all starts.
        starts: number of initial weights tried.
        cpu_time: CPU time [s].
    """

    success: bool
    reason: StopReason
    network: Network | None
    weight: Floats
    error: float
    tolerance: float
    structure_error: float
    history: History
    epochs: int
    starts: int
    cpu_time: float

    def __repr__(self) -> str:
        return f"<TrainingResult: {self.message}>"

    @property
    def message(self) -> str:
        """The outcome in a sentence."""
        tries = "" if self.starts == 1 else f" and {self.starts} starts"
        verdict = "" if self.success or self.reason is not StopReason.CONVERGED else ", not confirmed by a final check"
        return f"{self.reason} after {self.epochs} epochs{tries}: max |xi* - xi_d| is {self.error:.2g}{verdict}"


@frozen
class TrainingProblem:
    """A target xi_d ``(N, d)``, everything of the network that is not learned, and the seed of the initial weights."""

    target: Floats
    bias: Floats
    gamma: float
    mu: float
    activation: str
    manifold: WeightManifold
    seed: int

    @property
    def ratio(self) -> float:
        """mu/gamma."""
        return self.mu / self.gamma

    @property
    def rates(self) -> dict[str, Any]:
        """Arguments of a network's constructor besides weights and bias."""
        return {"gamma": self.gamma, "mu": self.mu, "activation": self.activation}

    def initial_weight(self, start: int) -> Floats:
        """Random weights of the start-th try: U(-1, 1), divided by their 1-norm (Algorithm 1), ``(Nd, Nd)``."""
        n, epsilon = self.target.size, 1e-12  # the paper's epsilon in W / (epsilon + ||W||_1)
        weight = np.random.default_rng([self.seed, start]).uniform(-1.0, 1.0, (n, n))
        return weight / (epsilon + np.abs(weight).sum(axis=0).max())


_Options = TypeVar("_Options", bound=LearningOptions)


class Iterate(NamedTuple):
    """Weights of a training with their equilibrium, the learning rate, and the error before."""

    weight: Floats  # (Nd, Nd)
    alpha: Floats  # (N, N) learned strengths
    point: WeightPoint  # the weights' point on the manifold, or that of their last projection
    equilibrium: FlatEquilibrium  # equilibrium of the weights
    log_scale: Floats  # (3N,) log S_P of a certificate that is learned; empty otherwise
    rate: float  # learning rate
    error: float = np.inf  # E of the epoch before


class Training(ABC, Generic[_Options]):
    """A training; subclasses say how weights change from one epoch to the next."""

    def __init__(self, problem: TrainingProblem, options: _Options) -> None:
        self.problem, self.options = problem, options
        self.manifold, self.goal, self.ratio = problem.manifold, problem.target.ravel(), problem.ratio
        self.solver = EquilibriumSolver(problem.bias, problem.ratio, problem.activation)
        self.rows: list[tuple[float, float, float, float, Floats]] = []  # rows of the present start's history
        self.epoch = 0  # epochs done, over all starts

    @abstractmethod
    def initial(self, weight: Floats) -> Iterate:
        """The first iterate of a start from weights ``(Nd, Nd)``."""

    @abstractmethod
    def advance(self, before: Iterate, end: int) -> tuple[Iterate, StopReason | None]:
        """The next iterate, and the reason if the start ends there, or None; it must end at the epoch ``end``.

        The history must then hold the rows of the iterates that led to this one, and no others.
        """

    @abstractmethod
    def network(self, last: Iterate) -> Network | None:
        """The network of the last iterate; None where its weights are not on the manifold."""

    def accepts(self, network: Network | None) -> bool:
        """Whether a network whose stable equilibrium is the target meets all other demands."""
        return True

    def run(self, first: Floats | None) -> TrainingResult:
        """Train until a start succeeds or none is left; ``first`` are the first start's weights, random by default."""
        started, options = cpu_time(), self.options
        for start in range(options.restarts + 1):
            weight = first if first is not None and start == 0 else self.problem.initial_weight(start)
            last, reason = self._descend(weight, options.end(start, self.epoch))
            if reason is StopReason.CONVERGED or self.epoch >= options.most_epochs:
                break
        result = self._checked(last, reason, start + 1)
        return replace(result, cpu_time=cpu_time() - started)

    def _descend(self, weight: Floats, end: int) -> tuple[Iterate, StopReason]:
        """The last iterate of a start, and why it ends there, at the epoch ``end`` at the latest."""
        self.rows.clear()
        now = self.initial(weight)
        reason = None if now.equilibrium.success else StopReason.LOST_EQUILIBRIUM
        while reason is None:
            now, reason = self.advance(now, end)
            report(self.epoch, self.options.most_epochs)
        self.record(self.epoch, now, now.rate)
        return now, reason

    def record(self, epoch: int, now: Iterate, rate: float) -> None:
        """Append a row to the history: the iterate at the beginning of an epoch, whose learning rate is ``rate``."""
        # LAPACK's norms, of the transpose for its memory order, take a third of the time of NumPy's reductions.
        transposed = now.weight.T
        self.rows.append((epoch, rate, dlange("I", transposed), dlange("1", transposed), now.equilibrium.x))

    def _history(self) -> History:
        *scalars, states = zip(*self.rows, strict=True)
        epoch, rate, one_norm, infinity_norm = (np.array(column, dtype=np.float64) for column in scalars)
        equilibrium = np.array(states).reshape(-1, *self.problem.target.shape)
        delta = equilibrium.reshape(len(epoch), -1) - self.goal
        accuracy = (np.abs(delta) < self.options.tolerance).mean(axis=1)
        return History(epoch, np.linalg.norm(delta, axis=1), accuracy, rate, one_norm, infinity_norm, equilibrium)

    def arrived(self, now: Iterate) -> bool:
        """Whether every coordinate is within the tolerance."""
        return bool(np.abs(now.equilibrium.x - self.goal).max() < self.options.tolerance)

    def stable(self, now: Iterate) -> bool:
        """Whether the equilibrium is stable."""
        return self.solver.sensitivity(now.weight, now.equilibrium).stable()

    def _checked(self, last: Iterate, reason: StopReason, starts: int) -> TrainingResult:
        """The result, with the last weights checked anew."""
        network = self.network(last)
        weight = last.weight if network is None else network.weight
        equilibrium = self.solver.newton(weight, last.equilibrium.x, steps=50)
        error = float(np.abs(equilibrium.x - self.goal).max()) if equilibrium.success else np.inf
        if network is not None:
            nearest = self.manifold.project(weight, last.point.alpha, "block-wise", last.point).weight
        else:
            nearest = self.manifold.project(weight, np.ones_like(last.alpha), "scaled").weight
        tolerance, size = self.options.tolerance, max(np.linalg.norm(weight), np.finfo(float).tiny)
        stable = error < tolerance and self.solver.sensitivity(weight, equilibrium).stable()
        outcome = stable and self.accepts(network), reason, network, weight, error, tolerance
        lost, history = float(np.linalg.norm(weight - nearest) / size), self._history()
        return TrainingResult(*outcome, lost, history, self.epoch, starts, cpu_time=0.0)
