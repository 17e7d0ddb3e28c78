"""A training: the problem, and the loop of all algorithms, one start after the other until one arrives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from lieednn_sim.budget import cpu_time
from lieednn_sim.learning.manifold import Network, WeightManifold, WeightPoint
from lieednn_sim.learning.options import LearningOptions
from lieednn_sim.learning.result import Recorder, StopReason, TrainingResult
from lieednn_sim.learning.sensitivity import EquilibriumSolver, FlatEquilibrium
from lieednn_sim.values import Floats, frozen

Progress = Callable[[int, int], None]  # called with the epochs done and the most epochs


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
    """Weights of a training, and what goes with them."""

    weight: Floats  # (Nd, Nd)
    alpha: Floats  # (N, N) learned strengths
    point: WeightPoint  # the weights' point on the manifold, or that of their last projection
    equilibrium: FlatEquilibrium  # equilibrium of the weights
    log_scale: Floats  # (3N,) log S_P of a certificate that is learned; empty otherwise
    rate: float  # learning rate
    error: float = np.inf  # E of the epoch before


class Training(ABC, Generic[_Options]):
    """A training; subclasses say how weights change from one epoch to the next."""

    def __init__(self, problem: TrainingProblem, options: _Options, progress: Progress | None) -> None:
        self.problem, self.options, self._progress = problem, options, progress
        self.manifold, self.goal, self.ratio = problem.manifold, problem.target.ravel(), problem.ratio
        self.solver = EquilibriumSolver(problem.bias, problem.ratio, problem.activation)
        self.recorder = Recorder(problem.target, options.tolerance)
        self.epoch = 0  # epochs done, over all starts

    @abstractmethod
    def initial(self, weight: Floats) -> Iterate:
        """The first iterate of a start from weights ``(Nd, Nd)``."""

    @abstractmethod
    def advance(self, before: Iterate, end: int) -> tuple[Iterate, StopReason | None]:
        """The next iterate, and why the start ends there, or None; at the epoch ``end`` it should.

        Rows of the history are those of the iterate and of those that led to it.
        """

    @abstractmethod
    def network(self, last: Iterate) -> Network | None:
        """The network of the last iterate; None where its weights are off the manifold."""

    def accepts(self, network: Network | None) -> bool:
        """Whether a network with the target as its stable equilibrium is what was asked for."""
        return True

    def run(self, first: Floats | None) -> TrainingResult:
        """Train until a start arrives or none is left; ``first`` are weights for the first one, random by default."""
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
        self.recorder.cut(0)
        now = self.initial(weight)
        reason = None if now.equilibrium.success else StopReason.LOST_EQUILIBRIUM
        while reason is None:
            now, reason = self.advance(now, end)
            if self._progress is not None:
                self._progress(self.epoch, self.options.most_epochs)
        self.recorder.add(self.epoch, now.equilibrium.x, now.rate, now.weight)
        return now, reason

    def arrived(self, now: Iterate) -> bool:
        """Whether every coordinate is within the tolerance."""
        return bool(np.abs(now.equilibrium.x - self.goal).max() < self.options.tolerance)

    def stable(self, now: Iterate) -> bool:
        """Whether the equilibrium is."""
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
        stable = error < self.options.tolerance and self.solver.sensitivity(weight, equilibrium).stable()
        return TrainingResult(
            success=stable and self.accepts(network),
            reason=reason,
            network=network,
            weight=weight,
            error=error,
            tolerance=self.options.tolerance,
            structure_error=float(np.linalg.norm(weight - nearest) / max(np.linalg.norm(weight), np.finfo(float).tiny)),
            history=self.recorder.history(),
            epochs=self.epoch,
            starts=starts,
            cpu_time=0.0,
        )
