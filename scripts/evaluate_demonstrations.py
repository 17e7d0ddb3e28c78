"""Learn from recorded demonstrations: RoboTasks' poses and LASA's handwriting, against other models.

    python scripts/evaluate_demonstrations.py FOLDER [--only robottasks,Angle,...] [--jobs 1]
                                              [--output results/demonstrations]

FOLDER holds ``robottasks/*.npy`` (centimetres, quaternions w x y z) and ``lasa/*.mat`` (millimetres); they are not part
of this project. Rows are kept in ``OUTPUT/runs``, so an interrupted run goes on; ``demonstrations.md`` has the tables.
All columns except the times are reproducible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from common import options, saved_runs, write

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.learning.demonstrations import align, load_demonstrations
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.studies.demonstrations.models import ModelRow, compare_models

STARTS = 1000
NOTES = (
    "Each demonstration is seen from its own goal, and resampled at equal fractions of its path, where a radian counts "
    "as 0.2 m. RMS, DTWD and Frechet distance compare 1000 samples of each path after dynamic time warping: at equal "
    "fractions of the length, a small hook left out at the beginning would shift all that follows. DTWD is the sum "
    "over all pairs.\n\n- `mean`: the model reproduces the mean demonstration.\n- `training`: it reproduces each "
    "demonstration from that one's start.\n- `left out`: the same by models that have not seen the demonstration.\n- "
    "`arrived`, `spurious`: of random starts all around, how many reach the goal, and at how many other attractors "
    "starts come to rest.\n- `parameters`: fitted numbers that are not zero by construction.\n\nThe network has 8, 16, "
    "32, 48 or 64 hidden neurons, the least that meet the required accuracy; the others have about as many parameters. "
    "The start of its hidden neurons also depends on the start of the visible one (24 pairs of opposite switches). "
    "These, like the covariance of `promp`, are not counted among the parameters.\n\n`promp` keeps a distribution over "
    "paths and is conditioned on start and goal: it has no field, and arrives because of that. The standard deviation "
    "added to its covariance, 1 % of the extent, was chosen out of 0.1, 1 and 10 % on four of the sets. Means of "
    "`lpv-ds` are spoilt by shapes that no quadratic Lyapunov function allows; its starts that have neither arrived "
    "nor reached another attractor are still on their paths.",
)
KINDS = {"robottasks": ("*.npy", "cm"), "lasa": ("*.mat", "mm")}


def scores(path: Path, unit: str, starts: int) -> list[dict[str, Any]]:
    """A row for each model of the demonstrations in a file, the network first; no rows if they cannot be fitted."""
    try:
        demonstrations = align(load_demonstrations([path], unit=unit))
        rows, _ = compare_models(demonstrations, ShapedMotion.fit(demonstrations), starts=starts)
    except LieEDNNError as error:
        print(f"{path}: {error}")
        return []
    return [scored(path.stem, row) for row in rows]


def scored(name: str, row: ModelRow) -> dict[str, Any]:
    """The row of a table for a model of a set: see `ModelRow`, with `PathErrors` by part."""
    parts = {"mean": row.mean, "training": row.training, "left_out": row.left_out}
    errors = {
        f"{part}_{key}": value for part, result in parts.items() if result for key, value in asdict(result).items()
    }
    there = {"parameters": row.n_parameters, "fit_s": row.fit_s, **asdict(row.attraction)}
    return {"set": name, "model": row.model, **there, **errors}


def table(found: Sequence[dict[str, Any]], kind: str) -> list[str]:
    """A Markdown table with a row for each set and model, and the means of each model."""
    turns = kind == "robottasks"
    columns = ["RMS mm", *(["deg"] if turns else []), "DTWD mm", "Frechet mm"]
    heads = [f"{column}, {what}" for what in ("mean", "training", "left out") for column in columns]
    keys = ["rms_mm", *(["rms_deg"] if turns else []), "dtwd_mm", "frechet_mm"]
    shown = [*(f"{what}_{key}" for what in ("mean", "training", "left_out") for key in keys), "training_goal_mm"]
    lines = []
    for row in found:
        cells = [row["set"], row["model"], row["parameters"], *(_number(row[name]) for name in shown)]
        lines.append([*cells, f"{row['arrived']}/{row['starts']}", row["spurious"], f"{row['fit_s']:.1f}"])
    for model in dict.fromkeys(row["model"] for row in found):
        means = [_number(_mean(found, model, name)) for name in shown]
        lines.append(["**mean**", model, "", *means, "", "", ""])
    return markdown_table(["set", "model", "parameters", *heads, "goal mm", "arrived", "spurious", "fit s"], lines)


def _mean(found: Sequence[dict[str, Any]], model: str, name: str) -> float:
    return float(np.mean([row[name] for row in found if row["model"] == model]))


def verdicts(found: Sequence[dict[str, Any]], kind: str) -> list[str]:
    """Requirements of the shaped network, and whether they hold."""
    both = ([row for row in found if row["model"] == name] for name in ("lieednn-shaped", "dmp"))
    pairs = list(zip(*both, strict=True))
    arrived = all(ours["arrived"] == ours["starts"] and not ours["spurious"] for ours, _ in pairs)
    lines = [f"- Every start arrives, and there is no other attractor: {_holds(arrived)}."]
    if kind == "robottasks":
        near = [ours["mean_rms_mm"] <= 2.0 and ours["mean_rms_deg"] <= 0.5 for ours, _ in pairs]
        lines.append(f"- The mean demonstration is reproduced within 2 mm and 0.5 degrees RMS: {_holds(*near)}.")
        for key, what in (("dtwd_mm", "DTWD"), ("rms_mm", "RMS of positions"), ("rms_deg", "RMS of turns")):
            better = [ours[f"left_out_{key}"] <= dmp[f"left_out_{key}"] for ours, dmp in pairs]
            lines.append(f"- {what} of demonstrations left out is at most that of `dmp`: {_holds(*better)}.")
    else:
        for part in ("training", "left_out"):
            models = dict.fromkeys(row["model"] for row in found)
            mean = {model: _mean(found, model, f"{part}_dtwd_mm") for model in models}
            best = mean["lieednn-shaped"]
            says = ", ".join(f"{name} {value:.0f}" for name, value in mean.items())
            lines.append(f"- Mean DTWD [mm], {part.replace('_', ' ')}: {says}.")
            lines.append(f"  At most that of `dmp`: {_holds(bool(best <= mean['dmp']))}; ")
            lines[-1] += f"less than that of `lpv-ds`: {_holds(bool(best < mean['lpv-ds']))}."
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
    lines = ["# Models of demonstrations", "", "`python scripts/evaluate_demonstrations.py FOLDER`", "", *NOTES, ""]
    for kind, (pattern, unit) in KINDS.items():
        paths = [path for path in (given.folder / kind).glob(pattern) if not wanted or {kind, path.stem} & wanted]
        runs = {f"{kind}-{path.stem}": (path, unit, given.starts) for path in sorted(paths)}
        made = saved_runs(given.output / "runs", runs, scores, given.jobs)
        sets = [row for rows in made for row in rows]
        lines += [f"Not fitted: {path}." for (path, *_), rows in zip(runs.values(), made, strict=True) if not rows]
        lines += [f"## {kind}", "", *verdicts(sets, kind), *table(sets, kind), ""] if sets else []
    write(given.output / "demonstrations.md", lines)


if __name__ == "__main__":
    main()
