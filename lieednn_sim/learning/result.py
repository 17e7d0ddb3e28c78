"""The outcome of a training, and its history, epoch by epoch."""

from __future__ import annotations

import os
from dataclasses import fields
from enum import StrEnum

import numpy as np
from scipy.linalg.lapack import dlange

from lieednn_sim import io
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.learning.manifold import Network
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, check_fields, frozen


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

    def __post_init__(self) -> None:
        check_fields(self, as_floats, *(field.name for field in fields(self)[:-1]), shape=("K",))
        check_fields(self, as_floats, "equilibrium", shape=("K", "N", "d"))
        if len({len(getattr(self, field.name)) for field in fields(self)}) != 1:
            raise InputError("the columns of a history must have the same length")

    def __repr__(self) -> str:
        if not len(self):
            return "<History: empty>"
        last = f"error {self.error[0]:.3g} to {self.error[-1]:.3g}"
        return f"<History: {len(self)} rows up to epoch {self.epoch[-1]:g}, {last}>"

    def __len__(self) -> int:
        return len(self.error)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to an ``.npz`` file, atomically."""
        columns = {field.name: getattr(self, field.name) for field in fields(self)}
        io.save_arrays(path, "training-history", columns, {})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> History:
        """Read a file of `save`; `FileError` says what is wrong with it."""
        arrays, _ = io.load_arrays(path, "training-history")
        names = [field.name for field in fields(cls)]
        columns = io.take(arrays, path, *names)
        try:
            return cls(*columns)
        except InputError as error:
            raise FileError(f"{path} is not a valid training history: {error}") from None


class Recorder:
    """Collects the rows of a `History` for a target ``(N, d)``; can be truncated to an earlier length."""

    def __init__(self, target: Floats, tolerance: float) -> None:
        self._target, self._tolerance = target, tolerance
        self._scalars: list[tuple[float, float, float, float]] = []
        self._equilibria: list[Floats] = []

    def __len__(self) -> int:
        return len(self._scalars)

    def add(self, epoch: int, x: Floats, rate: float, weight: Floats) -> None:
        """Append a row for flat weights with the flat equilibrium ``x``, which is not copied."""
        # LAPACK's norms of the transpose, which is in its memory order, in a third of the time of NumPy's reductions.
        transposed = weight.T
        self._scalars.append((epoch, rate, dlange("I", transposed), dlange("1", transposed)))
        self._equilibria.append(x)

    def cut(self, length: int) -> None:
        """Delete all rows from ``length`` on."""
        del self._scalars[length:], self._equilibria[length:]

    def history(self) -> History:
        """The rows so far, as arrays."""
        epoch, rate, one_norm, infinity_norm = np.array(self._scalars, dtype=np.float64).reshape(-1, 4).T.copy()
        equilibrium = np.array(self._equilibria, dtype=np.float64).reshape(-1, *self._target.shape)
        delta = (equilibrium - self._target).reshape(len(epoch), self._target.size)
        accuracy = (np.abs(delta) < self._tolerance).mean(axis=1)
        return History(epoch, np.linalg.norm(delta, axis=1), accuracy, rate, one_norm, infinity_norm, equilibrium)


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
