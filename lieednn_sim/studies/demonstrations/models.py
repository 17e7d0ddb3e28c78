"""Models of the same demonstrations compared, on one set or many: reproduction, generalisation, and other starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lieednn_sim._blas import one_blas_thread
from lieednn_sim.budget import cpu_time
from lieednn_sim.evaluation.display import table
from lieednn_sim.evaluation.paths import PathErrors, path_errors
from lieednn_sim.learning.demonstrations import Demonstrations, align, load_demonstrations
from lieednn_sim.learning.demonstrations.alignment import displacement, twist_of
from lieednn_sim.learning.demonstrations.models import MotionModel
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.registry import RIVALS
from lieednn_sim.studies.rows import TableRow, column, outcome
from lieednn_sim.studies.study import Study
from lieednn_sim.studies.table import Table
from lieednn_sim.validation import Seed, as_count, as_generator
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from rich.console import Group

# Durations after which it is decided whether a start has arrived.
HORIZON = 10.0
# In units of the demonstrations' extent: distance from the goal that counts as arrived, motion per duration that counts
# as rest, and distance between points of rest that count as one attractor.
ARRIVED, AT_REST, ONE_ATTRACTOR = 1e-2, 1e-4, 5e-2
# Largest rotation of a random start from the goal [rad].
LARGEST_TURN = 0.9 * np.pi
# Number of starts run at once, limited by memory.
_BATCH = 500


@dataclass(frozen=True)
class Attraction:
    """Where random starts ended, after `HORIZON` durations.

    Attributes:
        starts: number of starts.
        arrived: number of them that ended within a hundredth of the demonstrations' extent from the goal.
        spurious: number of spurious attractors, places other than the goal at which starts came to rest.
    """

    starts: int
    arrived: int
    spurious: int


def random_starts(demonstrations: Demonstrations, count: int, seed: Seed = 0) -> Floats:
    """Random twists ``(count, 6)`` around the demonstrations.

    Positions are uniform in their bounding box, extended on all sides by its longest side; rotations, where poses were
    recorded, have a random axis and an angle of up to 162 degrees from the goal.
    """
    rng = as_generator("seed", seed)
    count = as_count("count", count)
    place = demonstrations.displaced[..., 3:].reshape(-1, 3)
    low, high = place.min(axis=0), place.max(axis=0)
    margin = np.ptp(place, axis=0).max()
    starts = np.zeros((count, 6))
    starts[:, 3:] = rng.uniform(low - margin, high + margin, (count, 3))
    if demonstrations.dof == 6:
        axis = rng.normal(size=(count, 3))
        starts[:, :3] = rng.uniform(0.0, LARGEST_TURN, (count, 1)) * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    elif demonstrations.dof == 2:
        starts[:, 5] = 0.0
    return twist_of(starts)


def attraction(model: MotionModel, demonstrations: Demonstrations, starts: Floats) -> Attraction:
    """Run a model from start twists ``(n, 6)``; in distances a radian counts as the demonstrations' ``lever`` [m]."""
    t = demonstrations.duration * np.array([0.0, HORIZON - 1.0, HORIZON])
    batches = [starts[k : k + _BATCH] for k in range(0, len(starts), _BATCH)]
    before, ends = (
        np.concatenate([displacement(model.reproduce(batch, t)[:, 1:]) for batch in batches])
        * demonstrations.scale
        / demonstrations.extent
    ).swapaxes(0, 1)
    arrived = np.linalg.norm(ends, axis=1) < ARRIVED
    resting = ends[~arrived & (np.linalg.norm(ends - before, axis=1) < AT_REST)]
    spurious = 0
    while len(resting):
        spurious += 1
        resting = resting[np.linalg.norm(resting - resting[0], axis=1) > ONE_ATTRACTOR]
    return Attraction(len(starts), int(arrived.sum()), spurious)


@dataclass(frozen=True)
class ModelRow:
    """One model of one set of demonstrations.

    Attributes:
        model: its name.
        n_parameters: number of fitted parameters.
        fit_s: CPU time of the fit [s].
        mean: errors against the mean demonstration, from its start.
        training: errors against each demonstration, from its start, on average.
        left_out: the same for models fitted without that demonstration; None with a single one, or if not requested.
        attraction: where random starts ended.
    """

    model: str
    n_parameters: int
    fit_s: float
    mean: PathErrors
    training: PathErrors
    left_out: PathErrors | None
    attraction: Attraction


def reproduction(
    model: MotionModel, demonstrations: Demonstrations, start: Floats, goal: Floats | None = None
) -> Floats:
    """Twists ``(K, 6)`` from a twist ``(6,)`` until the model's motion is over; to a ``goal`` if they are kept."""
    if isinstance(model, ShapedMotion) and demonstrations.goals_kept and goal is not None:
        model = model.toward(goal)
    # Instants of a reproduction.
    instants = 600
    return model.reproduce(start, np.linspace(0.0, model.durations * demonstrations.duration, instants))


def compare_models(
    demonstrations: Demonstrations,
    shaped: ShapedMotion,
    *,
    rivals: Sequence[str] | None = None,
    aligned: Demonstrations | None = None,
    starts: int = 1000,
    leave_one_out: bool = True,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[ModelRow], dict[str, MotionModel]]:
    """Compare a shaped network with models that have as many parameters.

    Args:
        demonstrations: the demonstrations.
        shaped: the network fitted to all of them.
        rivals: names of `RIVALS`; by default all.
        aligned: if goals are kept, the same demonstrations with aligned goals: rivals know one goal. An error is the
            same seen from either.
        starts: number of random starts, see `random_starts`.
        leave_one_out: fit each model again without each of the demonstrations, the network with as many hidden neurons.
        seed: seed of the starts.
        progress: called with the steps done and their total.

    Returns:
        A row for each model, and the models by name, the network first.
    """
    names = [shaped.name, *(RIVALS if rivals is None else rivals)]
    for name in names[1:]:
        RIVALS.find(name)
    n, places = len(demonstrations), random_starts(demonstrations, starts, seed)
    folds = range(n) if leave_one_out and n > 1 else range(0)
    rows: list[ModelRow] = []
    models: dict[str, MotionModel] = {}
    with one_blas_thread():
        for number, name in enumerate(names):
            start = cpu_time()
            shown = demonstrations if aligned is None or name == shaped.name else aligned
            model = shaped if name == shaped.name else _fit(shaped, name, shown)
            seconds = shaped.cpu_time if name == shaped.name else cpu_time() - start
            without = []
            for k in folds:
                if progress:
                    progress(number * (len(folds) + 1) + k, len(names) * (len(folds) + 1))
                without.append(_errors(_fit(shaped, name, shown.without(k)), shown, shown.twists[k]))
            row = ModelRow(
                model=name,
                n_parameters=model.n_parameters,
                fit_s=seconds,
                mean=_errors(model, shown, shown.mean),
                training=mean_of([_errors(model, shown, twist) for twist in shown.twists]),
                left_out=mean_of(without) if without else None,
                attraction=attraction(model, shown, places),
            )
            rows.append(row)
            models[name] = model
    return rows, models


def _fit(shaped: ShapedMotion, name: str, demonstrations: Demonstrations) -> MotionModel:
    """A model with about as many parameters as a shaped network, and of its kind if it is one."""
    if name == ShapedMotion.name:
        options, family = shaped.shaping.options, shaped.response is not None
        return ShapedMotion.fit(demonstrations, options=options, family=family)
    model: MotionModel = RIVALS[name].load()(demonstrations, shaped.n_parameters)
    return model


def _errors(model: MotionModel, demonstrations: Demonstrations, shown: Floats) -> PathErrors:
    return path_errors(reproduction(model, demonstrations, shown[0], shown[-1]), shown, demonstrations.lever)


def family_deviation(shaped: ShapedMotion, demonstrations: Demonstrations) -> float | None:
    """Largest standard deviation of a family's position along the mean motion [m]; None without a spread."""
    if shaped.spread is None:
        return None
    covariance = shaped.covariance(demonstrations.mean[0], demonstrations.t)[:, 3:, 3:]
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).max()))


def mean_of(items: Sequence[Any]) -> Any:
    """The mean of every number of dataclasses alike, also of those within dataclasses and tuples."""
    first = items[0]
    if isinstance(first, tuple):
        return tuple(map(mean_of, zip(*items, strict=True)))
    if isinstance(first, float):
        return float(np.mean(items))
    return replace(first, **{f.name: mean_of([getattr(item, f.name) for item in items]) for f in fields(first)})


def models_table(rows: Sequence[ModelRow], *, turns: bool) -> Group:
    """Tables of a comparison for the terminal; ``turns`` if poses were recorded."""
    from rich.console import Group

    angle = ["deg"] if turns else []
    errors = table("reproduction", "model", "path", "RMS mm", *angle, "DTWD mm", "Frechet mm", "goal mm")
    starts = table("models and starts elsewhere", "model", "parameters", "fit s", "arrived", "spurious attractors")
    for row in rows:
        name = row.model
        for path, result in (("mean", row.mean), ("training", row.training), ("left out", row.left_out)):
            if result is None:
                continue
            cells = [f"{result.rms_mm:.2f}", *([f"{result.rms_deg:.2f}"] if turns else [])]
            cells += [f"{result.dtwd_mm:.0f}", f"{result.frechet_mm:.2f}", f"{result.goal_mm:.2g}"]
            errors.add_row(name, path, *cells)
            name = ""
        reached = row.attraction
        shown = [str(row.n_parameters), f"{row.fit_s:.1f}", f"{reached.arrived}/{reached.starts}"]
        starts.add_row(row.model, *shown, str(reached.spurious))
    errors.caption = (
        "From the start of the mean and of each demonstration; left out: fitted without the one compared with."
    )
    return Group(errors, starts)


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
