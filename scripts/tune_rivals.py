"""Try other settings of the rival planners on problems that no table uses, and report which are better.

    python scripts/tune_rivals.py [--planners rrt-connect,...] [--seeds 3] [--output results/tuning]

Besides the defaults, each number among a planner's options is halved and doubled, one option at a time, lists of
numbers as a whole. The problems are all arms among window, shelf and poles, with seeds from 1000 on; those of `compare`
and of the other scripts begin at 0. A setting is better if it solves more problems than the defaults, or as many with
paths shorter by more than 2 % in the median over problems that both solve. Lengths are those of joint paths in units of
the joints' velocity limits, which these planners minimise. Writes ``tuning.csv`` with a row for each problem and
setting, and ``tuning.md``; an interrupted run can be continued.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import fields, replace
from functools import lru_cache

import numpy as np
from csv_rows import read_rows, write_rows

from lieednn_sim import filesystem
from lieednn_sim._blas import one_blas_thread
from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.planning import PLANNERS, plan
from lieednn_sim.planning.joint_space import joint_scale
from lieednn_sim.planning.options import PlannerOptions

SCENES, FIRST_SEED, TIME_BUDGET = ("window", "shelf", "poles"), 1000, 60.0
RIVALS = tuple(name for name, planner in PLANNERS.items() if planner.options and not name.startswith("lieednn"))
DEFAULTS = "defaults"
# Fraction by which a path must be shorter to count as such.
SHORTER = 0.98
FIELDS = ("planner", "setting", "arm", "scene", "seed", "length", "cpu_s", "reason")


def settings(options: PlannerOptions) -> dict[str, PlannerOptions]:
    """The defaults, and options with a number halved or doubled, where allowed; by the change."""
    found = {DEFAULTS: options}
    for field, factor in itertools.product(fields(options), (0.5, 2.0)):
        value = getattr(options, field.name)
        first = value[0] if isinstance(value, tuple) else value
        if isinstance(first, bool) or not isinstance(first, int | float):
            continue
        changed = [type(one)(one * factor) for one in (value if isinstance(value, tuple) else (value,))]
        try:
            other = replace(options, **{field.name: tuple(changed) if isinstance(value, tuple) else changed[0]})
        except LieEDNNError:
            continue  # out of the range that the option allows
        if getattr(other, field.name) != value:
            found[f"{field.name} x {factor:g}"] = other
    return found


@lru_cache(maxsize=4)
def problem(name: str, scene: str, seed: int) -> tuple[Arm, np.ndarray]:
    """An arm among obstacles, and its target."""
    arm = Arm.load(name, scene, seed)
    return arm, draw_target(arm, seed)


def row(planner: str, setting: str, options: PlannerOptions, name: str, scene: str, seed: int) -> dict[str, str]:
    """The result of a planner with a setting; without a length if it finds no motion."""
    known = dict(zip(FIELDS, (planner, setting, name, scene, str(seed)), strict=False))
    arm, target = problem(name, scene, seed)
    try:
        with one_blas_thread():
            made = plan(arm, target, planner=planner, seed=seed, time_budget=TIME_BUDGET, options=options)
    except LieEDNNError as error:
        return known | {"length": "", "cpu_s": "", "reason": str(error)}
    length = np.linalg.norm(np.diff(made.motion.q / joint_scale(arm), axis=0), axis=1).sum()
    return known | {"length": f"{length:.6g}", "cpu_s": f"{made.cpu_time:.3g}", "reason": ""}


def summary(rows: list[dict[str, str]], command: str) -> str:
    """A Markdown table for each planner, and a sentence on settings better than the defaults."""
    lines = ["# Settings of the rivals", "", f"`{command}`. What is tried, and what is better: see the script.", ""]
    for planner, group in itertools.groupby(rows, key=lambda one: one["planner"]):
        by_setting: dict[str, dict[tuple[str, ...], dict[str, str]]] = {}
        for one in group:
            by_setting.setdefault(one["setting"], {})[one["arm"], one["scene"], one["seed"]] = one
        usual = by_setting.get(DEFAULTS, {})
        lines += [f"## {planner}", "", "| setting | arrives | path in the defaults' | CPU s | |", "|" + " --- |" * 5]
        for setting, found in by_setting.items():
            arrived, (more, ratio) = [one for one in found.values() if one["length"]], compared(found, usual)
            better = setting != DEFAULTS and (more > 0 or (more == 0 and ratio < SHORTER))
            cost = np.median([float(one["cpu_s"]) for one in arrived]) if arrived else np.nan
            told = "better" if better else ""
            lines.append(f"| {setting} | {len(arrived)} of {len(found)} | {ratio:.3f} | {cost:.2f} | {told} |")
        lines.append("")
    return "\n".join(lines)


def compared(
    found: dict[tuple[str, ...], dict[str, str]], usual: dict[tuple[str, ...], dict[str, str]]
) -> tuple[int, float]:
    """Number of problems that one setting solves beyond another, and the median ratio of their path lengths."""
    both = [key for key in found if key in usual]
    more = sum(bool(found[key]["length"]) - bool(usual[key]["length"]) for key in both)
    ratios = [
        float(found[key]["length"]) / float(usual[key]["length"])
        for key in both
        if found[key]["length"] and usual[key]["length"]
    ]
    return more, float(np.median(ratios)) if ratios else np.nan


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--planners", default=",".join(RIVALS), help="(default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=3, help="for each arm and scene (default: %(default)s)")
    parser.add_argument("--arms", default=",".join(arm_names()), help="(default: all)")
    parser.add_argument("--output", default="results/tuning", help="directory (default: %(default)s)")
    options = parser.parse_args(arguments)
    table = filesystem.make_directory(options.output) / "tuning.csv"
    rows = read_rows(table)
    done = {tuple(one[name] for name in FIELDS[:5]) for one in rows}
    chosen = options.planners.split(",")
    if unknown := [name for name in chosen if name not in RIVALS]:
        parser.error(f"no rival with settings: {', '.join(unknown)}; allowed: {', '.join(RIVALS)}")
    for planner in chosen:
        if (missing := PLANNERS.missing().get(planner)) is not None:
            print(f"{planner} is not installed: {missing}", flush=True)
            continue
        kind = PLANNERS[planner].options
        assert kind is not None
        seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
        # Settings in the inner loop, so that each problem is loaded once.
        for name, scene, seed in itertools.product(options.arms.split(","), SCENES, seeds):
            for setting, values in settings(kind()).items():
                if (planner, setting, name, scene, str(seed)) in done:
                    continue
                rows.append(row(planner, setting, values, name, scene, seed))
                print(*rows[-1].values(), sep=", ", flush=True)
                write_rows(table, FIELDS, rows)
    rows.sort(key=lambda one: RIVALS.index(one["planner"]))
    text = summary(rows, f"python scripts/tune_rivals.py --planners {options.planners} --seeds {options.seeds}")
    with filesystem.atomic_text(table.with_suffix(".md")) as stream:
        stream.write(text)
    print(text)


if __name__ == "__main__":
    main()
