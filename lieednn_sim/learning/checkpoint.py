"""Checkpoints of `projected.train`: the state of a training, from which the same call can continue."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import NamedTuple

import numpy as np

from lieednn_sim import io
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.learning.equilibria import FlatEquilibrium
from lieednn_sim.learning.history import History, Recorder
from lieednn_sim.learning.manifold import WeightPoint
from lieednn_sim.learning.options import TrainingOptions
from lieednn_sim.learning.problem import TrainingProblem
from lieednn_sim.learning.result import StopReason
from lieednn_sim.values import Floats

# The kind of the file of a checkpoint.
KIND = "training"
_NUMBERS = ("rate", "error", "epoch", "rows", "start", "start_epoch")


class TrainingState(NamedTuple):
    """State of a training after a projection, to which a rejected trial returns and which a checkpoint stores.

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


def save(
    path: str | os.PathLike[str],
    problem: TrainingProblem,
    options: TrainingOptions,
    state: TrainingState,
    recorder: Recorder,
    cpu_time: float,
) -> None:
    """Write everything that `load` needs, atomically."""
    recorder.cut(state.rows)
    numbers = [*(getattr(state, name) for name in _NUMBERS), state.equilibrium.success, cpu_time]
    arrays = {
        "weight": state.weight,
        "alpha": state.alpha,
        "point_alpha": state.point.alpha,
        "x": state.equilibrium.x,
        "numbers": np.array(numbers, dtype=np.float64),
        **{f"element_{name}": value for name, value in state.point.elements.items()},
        **{f"history_{name}": value for name, value in recorder.history().arrays().items()},
    }
    meta = {"problem": _fingerprint(problem, options), "seed": problem.seed, "reason": state.reason}
    io.save_arrays(path, KIND, arrays, meta)


def load(
    path: str | os.PathLike[str], problem: TrainingProblem, options: TrainingOptions
) -> tuple[TrainingState, Recorder, float]:
    """Read a file of `save`: state, history and CPU time so far [s].

    Raises:
        FileError: the file cannot be read, is no checkpoint, or one of another problem or other options.
    """
    arrays, meta = io.load_arrays(path, KIND)
    if meta.get("problem") != _fingerprint(problem, options):
        raise FileError(f"{path} is the checkpoint of a training with another target, other options or another seed")
    elements, rows = (
        {name.removeprefix(part): value for name, value in arrays.items() if name.startswith(part)}
        for part in ("element_", "history_")
    )
    try:
        rate, error, *counts, success, spent = arrays["numbers"].tolist()
        epoch, length, start, start_epoch = map(int, counts)
        recorder = Recorder.from_history(History(**rows), problem.target, options.tolerance)
        state = TrainingState(
            arrays["weight"],
            arrays["alpha"],
            problem.manifold().point(arrays["point_alpha"], elements),
            problem.solver().at(arrays["x"], success=bool(success)),
            rate,
            error,
            epoch,
            length,
            start,
            start_epoch,
            None if meta["reason"] is None else StopReason(meta["reason"]),
        )
    except (KeyError, TypeError, ValueError, InputError) as wrong:
        raise FileError(f"{path} is not a valid training checkpoint ({wrong})") from None
    return state, recorder, spent


def seed_of(path: str | os.PathLike[str]) -> int:
    """The seed of the training of a checkpoint; raises `FileError` if the file is none."""
    return int(io.load_arrays(path, KIND)[1].get("seed", -1))


def _fingerprint(problem: TrainingProblem, options: TrainingOptions) -> str:
    """Of everything that the result of a training depends on, and that must be the same for it to continue."""
    group = getattr(problem.group, "name", None)
    meta = {"options": asdict(options), "rates": problem.rates, "group": group, "seed": problem.seed}
    return io.fingerprint({"target": problem.target, "bias": problem.bias}, meta)
