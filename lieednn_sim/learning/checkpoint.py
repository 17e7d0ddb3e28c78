"""Checkpoints of `projected.train`."""

from __future__ import annotations

import os
from dataclasses import asdict, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lieednn_sim import storage
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.learning.equilibria import FlatEquilibrium
from lieednn_sim.learning.history import History, Recorder
from lieednn_sim.learning.manifold import QuaternionWeights, WeightPoint
from lieednn_sim.learning.options import TrainingOptions
from lieednn_sim.learning.problem import TrainingProblem
from lieednn_sim.learning.result import StopReason
from lieednn_sim.theory.groups import catalogue_name
from lieednn_sim.theory.groups import group as group_by_name
from lieednn_sim.theory.matrix_group import MatrixLieGroup
from lieednn_sim.validation import as_count, as_floats, as_positive
from lieednn_sim.values import Floats

# What `storage.kind` says of a checkpoint.
KIND = "training"


class TrainingState(NamedTuple):
    """State right after a projection: what a rejected trial returns to, and what a checkpoint stores.

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


_COUNTERS = ("epoch", "rows", "start", "start_epoch")


def save(
    path: str | os.PathLike[str],
    problem: TrainingProblem,
    options: TrainingOptions,
    state: TrainingState,
    recorder: Recorder,
    seconds: float,
) -> None:
    """Write everything that `load` needs, atomically."""
    recorder.cut(state.rows)
    arrays: dict[str, NDArray[Any]] = {
        "target": problem.target,
        "bias": problem.bias,
        "weight": state.weight,
        "alpha": state.alpha,
        "point_alpha": state.point.alpha,
        "x": state.equilibrium.x,
        "error": np.array(state.error),
        **{f"element_{name}": value for name, value in state.point.elements.items()},
        **{f"history_{name}": value for name, value in recorder.history().arrays().items()},
    }
    meta = {
        "options": asdict(options),
        "group": _group_name(problem.group),
        "seed": problem.seed,
        "rates": problem.rates,
        "state": {name: getattr(state, name) for name in _COUNTERS},
        "rate": state.rate,
        "found": state.equilibrium.success,
        "reason": state.reason,
        "seconds": seconds,
    }
    storage.save_arrays(path, KIND, arrays, meta)


def load(
    path: str | os.PathLike[str],
) -> tuple[TrainingProblem, TrainingOptions, TrainingState, Recorder, float]:
    """Read a file of `save`: problem, options, state, history and seconds so far.

    Raises:
        FileError: the file cannot be read or is no checkpoint.
    """
    arrays, meta = storage.load_arrays(path, KIND)
    rows = {field.name: f"history_{field.name}" for field in fields(History)}
    storage.take(arrays, path, "target", "bias", "weight", "alpha", "point_alpha", "x", "error", *rows.values())
    try:
        group = _group_of(meta["group"])
        problem = TrainingProblem.checked(
            arrays["target"], arrays["bias"], **meta["rates"], group=group, seed=meta["seed"]
        )
        n, size = len(problem.target), problem.target.size
        elements = {
            name.removeprefix("element_"): value for name, value in arrays.items() if name.startswith("element_")
        }
        manifold = problem.manifold()
        point = manifold.point(as_floats("point_alpha", arrays["point_alpha"], (n, n)), elements)
        # A network checks its elements, be they rotations or of another group.
        manifold.network(point, problem.bias, problem.rates)
        history = History(**{name: arrays[key] for name, key in rows.items()})
        if history.equilibrium.shape[1:] != problem.target.shape:
            raise InputError(f"the history is of states {history.equilibrium.shape[1:]}, not {problem.target.shape}")
        options = TrainingOptions(**meta["options"])
        recorder = Recorder.from_history(history, problem.target, options.tolerance)
        counters = {name: as_count(name, meta["state"][name], least=0) for name in _COUNTERS}
        if counters["rows"] > len(recorder):
            raise InputError(f"{counters['rows']} rows of history are promised, {len(recorder)} are there")
        state = TrainingState(
            weight=as_floats("weight", arrays["weight"], (size, size)),
            alpha=as_floats("alpha", arrays["alpha"], (n, n)),
            point=point,
            equilibrium=problem.solver().at(as_floats("x", arrays["x"], (size,)), success=bool(meta["found"])),
            rate=as_positive("rate", meta["rate"]),
            error=float(arrays["error"]),
            reason=None if meta["reason"] is None else StopReason(meta["reason"]),
            **counters,
        )
        return problem, options, state, recorder, float(meta["seconds"])
    except (KeyError, TypeError, ValueError, AttributeError, InputError) as error:
        raise FileError(f"{path} is not a valid training checkpoint ({type(error).__name__}: {error})") from None


def _group_name(group: MatrixLieGroup | QuaternionWeights | None) -> str | None:
    if group is None:
        return None
    return QuaternionWeights.name if isinstance(group, QuaternionWeights) else catalogue_name(group)


def _group_of(name: str | None) -> MatrixLieGroup | QuaternionWeights | None:
    if name is None:
        return None
    return QuaternionWeights() if name == QuaternionWeights.name else group_by_name(name)
