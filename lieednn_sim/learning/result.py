"""The outcome of a training."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from lieednn_sim.learning.equilibria import FlatEquilibrium
from lieednn_sim.learning.history import History
from lieednn_sim.learning.manifold import WeightPoint
from lieednn_sim.learning.problem import TrainingProblem
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.hopfield import HopfieldNetwork
from lieednn_sim.theory import GroupLieEDNN
from lieednn_sim.values import Floats, frozen


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
    network: LieEDNN | GroupLieEDNN | HopfieldNetwork | None
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


def conclude(
    problem: TrainingProblem,
    weight: Floats,
    point: WeightPoint | None,
    equilibrium: FlatEquilibrium,
    reason: StopReason,
    *,
    tolerance: float,
    history: History,
    epochs: int,
    starts: int,
    cpu_time: float,
) -> TrainingResult:
    """Check the last weights anew; ``point`` is None where they left the manifold."""
    manifold = problem.manifold()
    network = manifold.network(point, problem.bias, problem.rates) if point is not None else None
    if network is not None:
        weight = network.weight
    solver = problem.solver()
    found = solver.newton(weight, equilibrium.x, steps=50)
    error = float(np.abs(found.x - problem.target.ravel()).max()) if found.success else np.inf
    if point is not None:
        nearest = manifold.project(weight, point.alpha, "block-wise", point).weight
    else:
        nearest = manifold.project(weight, np.ones((len(problem.target), len(problem.target))), "scaled").weight
    return TrainingResult(
        success=error < tolerance and solver.sensitivity(weight, found).stable(),
        reason=reason,
        network=network,
        weight=weight,
        error=error,
        tolerance=tolerance,
        structure_error=float(np.linalg.norm(weight - nearest) / max(np.linalg.norm(weight), np.finfo(float).tiny)),
        history=history,
        epochs=epochs,
        starts=starts,
        cpu_time=cpu_time,
    )
