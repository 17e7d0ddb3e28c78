"""The comparison of models on many sets of recorded demonstrations, as a study that can be continued."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from lieednn_sim.learning.demonstrations import align, load_demonstrations
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.registry import RIVALS
from lieednn_sim.studies.demonstrations.models import ModelRow, compare_models
from lieednn_sim.studies.rows import TableRow, column, outcome
from lieednn_sim.studies.study import Study
from lieednn_sim.studies.table import Table

_error = partial(column, meaning="see `ModelRow` and `PathErrors`")


@dataclass(frozen=True, slots=True)
class ModelScore(TableRow):
    """The errors of a model of one set of demonstrations; see `ModelRow`.

    Attributes:
        kind: where the set is from; together with the next two, the key of the row.
        set: name of the set.
        model: name of the model.
        success: whether the models could be fitted.
        reason: why they could not; empty on success.
    """

    _key = ("kind", "set", "model")

    kind: str
    set: str
    model: str
    success: bool = outcome()
    reason: str = ""
    n_parameters: int | None = column("parameters", "number of fitted parameters")
    starts: int | None = column("starts", "number of random starts")
    arrived: int | None = column("arrived", "random starts that arrived")
    spurious: int | None = column("spurious", "places elsewhere at which other starts came to rest")
    fit_s: float | None = column("fit s", "CPU time of the fit", timed=True)
    mean_rms_mm: float | None = _error("RMS mm, mean")
    mean_rms_deg: float | None = _error("deg, mean")
    mean_dtwd_mm: float | None = _error("DTWD mm, mean")
    mean_frechet_mm: float | None = _error("Frechet mm, mean")
    mean_goal_mm: float | None = _error("goal mm, mean")
    training_rms_mm: float | None = _error("RMS mm, training")
    training_rms_deg: float | None = _error("deg, training")
    training_dtwd_mm: float | None = _error("DTWD mm, training")
    training_frechet_mm: float | None = _error("Frechet mm, training")
    training_goal_mm: float | None = _error("goal mm, training")
    left_out_rms_mm: float | None = _error("RMS mm, left out")
    left_out_rms_deg: float | None = _error("deg, left out")
    left_out_dtwd_mm: float | None = _error("DTWD mm, left out")
    left_out_frechet_mm: float | None = _error("Frechet mm, left out")
    left_out_goal_mm: float | None = _error("goal mm, left out")


def score(kind: str, path: str, unit: str, starts: int) -> list[ModelScore]:
    """A row for each model of the demonstrations in a file."""
    demonstrations = align(load_demonstrations([Path(path)], unit=unit))
    shaped = ShapedMotion.fit(demonstrations)
    rows, _ = compare_models(demonstrations, shaped, starts=starts)
    return [scored(kind, Path(path).stem, row) for row in rows]


def scored(kind: str, name: str, row: ModelRow) -> ModelScore:
    """The row of a table for a model of a set."""
    parts = {"mean": row.mean, "training": row.training, "left_out": row.left_out}
    # What rows hold of `PathErrors`.
    kept = ("rms_mm", "rms_deg", "dtwd_mm", "frechet_mm", "goal_mm")
    errors = {
        f"{part}_{key}": getattr(result, key) for part, result in parts.items() if result is not None for key in kept
    }
    there = asdict(row.attraction)
    return ModelScore(kind, name, row.model, n_parameters=row.n_parameters, fit_s=row.fit_s, **there, **errors)


def models() -> list[str]:
    """Names of the models, the network first."""
    return [ShapedMotion.name, *RIVALS]


def failed(kind: str, path: str, _unit: str, _starts: int, reason: str) -> list[ModelScore]:
    """Rows of models that could not be fitted, with the reason."""
    return [ModelScore(kind, Path(path).stem, model, reason=reason) for model in models()]


@dataclass(frozen=True)
class DemonstrationSets(Study[ModelScore]):
    """A shaped network and its rivals on sets of demonstrations, each in a file.

    Attributes:
        files: where each set is from, its file, and its unit of length, ``"m"``, ``"cm"`` or ``"mm"``.
        starts: number of random starts.
    """

    name, kind = "demonstrations", ModelScore
    run, failed = staticmethod(score), staticmethod(failed)

    files: Sequence[tuple[str, Path, str]]
    starts: int = 1000

    def settings(self) -> Mapping[str, Any]:
        """See `Study`."""
        return {"starts": self.starts}

    def todo(self, table: Table[ModelScore]) -> list[tuple[str, str, str, int]]:
        """See `Study`."""
        return [
            (kind, str(path), unit, self.starts)
            for kind, path, unit in self.files
            if any((kind, path.stem, model) not in table.rows for model in models())
        ]
