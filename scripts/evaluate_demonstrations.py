"""Learn from recorded demonstrations: RoboTasks' poses and LASA's handwriting, against other models.

    python scripts/evaluate_demonstrations.py FOLDER [--only robottasks,Angle,...] [--jobs 1]
                                              [--output results/demonstrations]

FOLDER holds ``robottasks/*.npy`` (centimetres, quaternions w x y z) and ``lasa/*.mat`` (millimetres); they are not part
of this project. Rows are kept in ``demonstrations.csv``, so an interrupted run can be continued; ``demonstrations.md``
is its summary. All columns except the times are reproducible.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from common import options, write
from rich.console import Console

from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.learning.demonstrations import align, load_demonstrations
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.registry import RIVALS
from lieednn_sim.studies.demonstrations.models import ModelRow, compare_models
from lieednn_sim.studies.rows import TableRow, column, grouped, outcome
from lieednn_sim.studies.study import Study, compute
from lieednn_sim.studies.table import Table

STARTS = 1000
NOTES = (
    "Each demonstration is seen from its own goal, all at equal fractions of their paths, a radian counting for 0.2 m.",
    "RMS, DTWD and Frechet distance are of dynamic time warps of 1000 samples of each path; DTWD is the sum over all",
    "pairs. `mean`: reproduction of the mean demonstration; `training`: of each from its own start; `left out`: the",
    "same by models that have not seen it. `arrived`, `spurious`: of random starts all around. `parameters`: numbers",
    "that were fitted and are not zero by construction. The network has the least of 8, 16, 32, 48 and 64 hidden",
    "neurons that comes as near as was asked for; the others have about as many parameters.",
    "Besides, its hidden neurons' start depends on the visible one (24 pairs of opposite switches). That response to",
    "the start, like `promp`'s covariance, is not counted among the parameters.",
    "",
    "`promp` keeps a distribution over paths and is conditioned on start and goal: it has no field, and arrives",
    "because of that. Its covariance is not counted among its parameters; the standard deviation added to it, 1 % of",
    "the extent, was chosen out of 0.1, 1 and 10 % on four of the sets. Means of `lpv-ds` are spoilt by shapes that no",
    "quadratic Lyapunov function allows; its starts that have not arrived, and are at no other attractor, are still on",
    "their paths. Errors are of warped pairs, since at equal fractions of the length a small hook at the beginning",
    "that is left out would shift all that follows.",
)
KINDS = {"robottasks": ("*.npy", "cm"), "lasa": ("*.mat", "mm")}
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


def table(found: Sequence[ModelScore], kind: str) -> list[str]:
    """A Markdown table with a row for each set and model, and the means of each model."""
    turns = kind == "robottasks"
    columns = ["RMS mm", *(["deg"] if turns else []), "DTWD mm", "Frechet mm"]
    heads = [f"{column}, {what}" for what in ("mean", "training", "left out") for column in columns]
    keys = ["rms_mm", *(["rms_deg"] if turns else []), "dtwd_mm", "frechet_mm"]
    shown = [*(f"{what}_{key}" for what in ("mean", "training", "left_out") for key in keys), "training_goal_mm"]
    lines = []
    for row in found:
        cells = [row.set, row.model, str(row.n_parameters), *(_number(getattr(row, name)) for name in shown)]
        lines.append([*cells, f"{row.arrived}/{row.starts}", str(row.spurious), f"{row.fit_s:.1f}"])
    for group in grouped(found, ("model",)):
        means = [_number(float(np.mean(group.values(name)))) for name in shown]
        lines.append(["**mean**", group.key[0], "", *means, "", "", ""])
    return markdown_table(["set", "model", "parameters", *heads, "goal mm", "arrived", "spurious", "fit s"], lines)


def verdicts(found: Sequence[ModelScore], kind: str) -> list[str]:
    """Requirements of the shaped network, and whether they hold."""
    sets = [{row.model: row for row in group.rows} for group in grouped(found, ("set",))]
    pairs = [(rows["lieednn-shaped"], rows["dmp"]) for rows in sets]
    arrived = all(ours.arrived == ours.starts and not ours.spurious for ours, _ in pairs)
    lines = [f"- Every start arrives, and there is no other attractor: {_holds(arrived)}."]
    if kind == "robottasks":
        near = [(ours.mean_rms_mm or 0.0) <= 2.0 and (ours.mean_rms_deg or 0.0) <= 0.5 for ours, _ in pairs]
        lines.append(f"- The mean demonstration within 2 mm and 0.5 degrees RMS: {_holds(*near)}.")
        for key, what in (("dtwd_mm", "DTWD"), ("rms_mm", "RMS of positions"), ("rms_deg", "RMS of turns")):
            better = [getattr(ours, f"left_out_{key}") <= getattr(dmp, f"left_out_{key}") for ours, dmp in pairs]
            lines.append(f"- {what} of demonstrations left out no more than the primitive's: {_holds(*better)}.")
    else:
        for part in ("training", "left_out"):
            mean = {group.key[0]: np.mean(group.values(f"{part}_dtwd_mm")) for group in grouped(found, ("model",))}
            best = mean["lieednn-shaped"]
            says = ", ".join(f"{name} {value:.0f}" for name, value in mean.items())
            lines.append(f"- Mean DTWD [mm], {part.replace('_', ' ')}: {says}.")
            lines.append(f"  No more than the primitive's: {_holds(bool(best <= mean['dmp']))}; ")
            lines[-1] += f"less than the stable mixture's: {_holds(bool(best < mean['lpv-ds']))}."
    return lines


def _holds(*each: bool) -> str:
    if len(each) == 1:
        return "holds" if each[0] else "**does not hold**"
    return f"holds in {sum(each)} of {len(each)}"


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.2f}"


def main(arguments: Sequence[str] | None = None) -> None:
    defaults: dict[str, Any] = {"only": "", "starts": STARTS, "jobs": 1}
    given = options(arguments, __doc__, "results/demonstrations", ["folder"], **defaults)
    wanted = set(filter(None, given.only.split(",")))
    files = [
        (kind, path, unit)
        for kind, (pattern, unit) in KINDS.items()
        for path in sorted((given.folder / kind).glob(pattern))
        if not wanted or {kind, path.stem} & wanted
    ]
    study = DemonstrationSets(files, given.starts)
    made = compute(study, given.output, jobs=given.jobs, console=Console(stderr=True))
    found = sorted(made.rows.values(), key=lambda row: (row.set, models().index(row.model)))
    lines = ["# Models of demonstrations", "", "`python scripts/evaluate_demonstrations.py FOLDER`", "", *NOTES, ""]
    for kind in KINDS:
        if sets := [row for row in found if row.kind == kind and row.success]:
            lines += [f"## {kind}", "", *verdicts(sets, kind), *table(sets, kind), ""]
    write(given.output / "demonstrations.md", "\n".join(lines))


if __name__ == "__main__":
    main()
