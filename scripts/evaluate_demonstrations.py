"""Learn from recorded demonstrations: RoboTasks' poses and LASA's handwriting, against other models.

    python scripts/evaluate_demonstrations.py FOLDER [--only robottasks,Angle,...] [--output results/demonstrations]

FOLDER holds ``robottasks/*.npy`` (centimetres, quaternions w x y z) and ``lasa/*.mat`` (millimetres); they are not part
of this project. The results for each set are a file in the output folder, which is not computed again if it exists, so
an interrupted run can be continued; ``demonstrations.md`` is the table of all results in the folder. All columns except
the times are reproducible.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lieednn_sim import filesystem, storage
from lieednn_sim.evaluation.demonstrations import compare_models
from lieednn_sim.learning.demonstrations import align, load_demonstrations
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.synthesis import ShapingOptions

STARTS = 1000
# The larger numbers are used only if the first is not enough: no model has few parameters.
OPTIONS = ShapingOptions(neurons=(8, 16), placed=(32, 48))
NOTES = (
    "Each demonstration is seen from its own goal, all at equal shares of their way, a radian counting for 0.2 m. RMS,",
    "DTWD and Frechet distance are of dynamic time warps of 1000 samples of each path; DTWD is the sum over all pairs.",
    "`mean`: reproduction of the mean demonstration; `training`: of each from its own start; `left out`: the same by",
    "models that have not seen it. `arrived`, `spurious`: of random starts all around. `parameters`: numbers that",
    "were fitted and are not zero by construction. The network has 8 or 16 hidden neurons, or 32 or 48 with",
    "placed switches where fewer do not come as near as was asked for; the others have about as many parameters.",
    "",
    "`promp` keeps a distribution over paths and is conditioned on start and goal: it has no field, and arrives",
    "because of that. Its covariance is not counted among its parameters; the standard deviation added to it, 1 % of",
    "the extent, was chosen out of 0.1, 1 and 10 % on four of the sets. Means of `lpv-ds` are spoilt by shapes that no",
    "quadratic Lyapunov function allows; its starts that have not arrived, and are at no other attractor, are still on",
    "their way. Errors are of warped pairs, since at equal shares of the length a small hook at the beginning that is",
    "left out would shift all that follows.",
)
KINDS = {"robottasks": ("*.npy", "cm"), "lasa": ("*.mat", "mm")}


def evaluate(path: Path, kind: str, starts: int) -> dict[str, Any]:
    """Results of all models for the demonstrations in one file."""
    demonstrations = align(load_demonstrations([path], unit=KINDS[kind][1]))
    shaped = ShapedMotion.fit(demonstrations, options=OPTIONS)
    rows, _ = compare_models(demonstrations, shaped, OPTIONS, starts=starts)
    return {
        "kind": kind,
        "set": path.stem,
        "demonstrations": len(demonstrations),
        "extent_mm": 1e3 * demonstrations.extent,
        "hidden_neurons": shaped.network.n_hidden,
        "certified": shaped.network.certified,
        "models": [asdict(row) for row in rows],
    }


def table(found: Sequence[dict[str, Any]], kind: str) -> list[str]:
    """A Markdown table with a row for each set and model, and the means of each model."""
    turns = kind == "robottasks"
    columns = ["RMS mm", *(["deg"] if turns else []), "DTWD mm", "Frechet mm"]
    heads = [f"{column}, {what}" for what in ("mean", "training", "left out") for column in columns]
    head = ["set", "model", "parameters", *heads, "goal mm", "arrived", "spurious", "fit s"]
    lines = ["| " + " | ".join(head) + " |", "| --- " * len(head) + "|"]
    keys = ["rms_mm", *(["rms_deg"] if turns else []), "dtwd_mm", "frechet_mm"]
    numbers: dict[str, list[list[float]]] = {}
    for one in found:
        for row in one["models"]:
            values = [row[what][key] for what in ("mean", "training", "left_out") for key in keys]
            values.append(row["training"]["goal_mm"])
            numbers.setdefault(row["model"], []).append(values)
            reached = row["attraction"]
            shown = [_number(value) for value in values]
            cells = [one["set"], row["model"], str(row["n_parameters"]), *shown]
            cells += [f"{reached['arrived']}/{reached['starts']}", str(reached["spurious"]), f"{row['fit_s']:.1f}"]
            lines.append("| " + " | ".join(cells) + " |")
    for model, values in numbers.items():
        shown = [_number(value) for value in np.mean(values, axis=0)]
        lines.append("| " + " | ".join(["**mean**", model, "", *shown, "", "", ""]) + " |")
    return lines


def verdicts(found: Sequence[dict[str, Any]], kind: str) -> list[str]:
    """Requirements of the shaped network, and whether they hold."""
    rows = [{row["model"]: row for row in one["models"]} for one in found]
    pairs = [(row["lieednn-shaped"], row["dmp"]) for row in rows]
    there = [ours["attraction"] for ours, _ in pairs]
    arrived = all(one["arrived"] == one["starts"] and not one["spurious"] for one in there)
    lines = [f"- Every start arrives, and there is no other attractor: {_holds(arrived)}."]
    if kind == "robottasks":
        near = [ours["mean"]["rms_mm"] <= 2.0 and ours["mean"]["rms_deg"] <= 0.5 for ours, _ in pairs]
        lines.append(f"- The mean demonstration within 2 mm and 0.5 degrees RMS: {_holds(*near)}.")
        for key, what in (("dtwd_mm", "DTWD"), ("rms_mm", "RMS of positions"), ("rms_deg", "RMS of turns")):
            better = [ours["left_out"][key] <= dmp["left_out"][key] for ours, dmp in pairs]
            lines.append(f"- {what} of demonstrations left out no more than the primitive's: {_holds(*better)}.")
    else:
        for part in ("training", "left_out"):
            mean = {name: np.mean([row[name][part]["dtwd_mm"] for row in rows]) for name in rows[0]}
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="kinds or names of sets, separated by commas")
    parser.add_argument("--starts", type=int, default=STARTS)
    parser.add_argument("--output", type=Path, default=Path("results/demonstrations"))
    given = parser.parse_args(arguments)
    directory = filesystem.make_directory(given.output)
    wanted = set(filter(None, given.only.split(",")))
    for kind, (pattern, _) in KINDS.items():
        for path in sorted((given.folder / kind).glob(pattern)):
            cache = directory / f"{path.stem}.json"
            if not cache.exists() and (not wanted or {kind, path.stem} & wanted):
                storage.save_json(cache, evaluate(path, kind, given.starts))
                print(f"{path.stem}: done", flush=True)
    found = [json.loads(cache.read_text()) for cache in sorted(directory.glob("*.json"))]
    lines = ["# Models of demonstrations", "", "`python scripts/evaluate_demonstrations.py FOLDER`", "", *NOTES, ""]
    for kind in KINDS:
        sets = [one for one in found if one["kind"] == kind]
        if sets:
            lines += [f"## {kind}", "", *verdicts(sets, kind), "", *table(sets, kind), ""]
    with filesystem.atomic_text(directory / "demonstrations.md") as stream:
        stream.write("\n".join(lines))
    print(directory / "demonstrations.md")


if __name__ == "__main__":
    main()
