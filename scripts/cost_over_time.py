"""Cost over time of the rival planners that improve what they found, beside RRT-Connect, which does not.

    python scripts/cost_over_time.py [--planners rrt-star,...] [--seeds 4] [--output results/cost_over_time]

The work allowed, which the planners' options count, doubles from run to run. Each run is a separate plan, with its CPU
time and the length of its joint path in units of the joints' velocity limits, which is what these planners minimise.
So planners need not watch a clock, and all columns except the CPU time are reproducible; compared with watching a
single run, curves are late by the times of the shorter runs, and never early. Smoothing and checks of the motion are
part of a run, as of every plan. The problems are all arms among poles, which rarely leave the straight path free, with
seeds from 2000 on. Lengths are divided by the shortest that any planner has for the problem; medians are over all
problems, with unsolved ones as the longest. Writes ``cost_over_time.csv`` with a row for each run,
``cost_over_time.md`` and ``cost_over_time.png``; an interrupted run can be continued.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from csv_rows import read_rows, write_rows
from matplotlib.figure import Figure

from lieednn_sim import io
from lieednn_sim._blas import one_blas_thread
from lieednn_sim.arm import arm_names
from lieednn_sim.budget import cpu_time
from lieednn_sim.errors import FileError, LieEDNNError, NoSolutionError
from lieednn_sim.evaluation.figure_layout import COLOURS, STYLE, save_figure
from lieednn_sim.planning import PLANNERS, plan
from lieednn_sim.planning.joint_space import joint_scale
from lieednn_sim.studies.comparison.cases import arm_and_target
from lieednn_sim.validation import as_choice, as_count

SCENE, FIRST_SEED = "poles", 2000
_CHECKS = "max_collision_checks"
# The work allowed in each run, by the option that counts it.
LADDERS: dict[str, tuple[str, tuple[object, ...]]] = {
    "rrt-connect": (_CHECKS, ((120_000,),)),
    **dict.fromkeys(("rrt-star", "informed-rrt-star", "aorrtc"), (_CHECKS, tuple((2_500 * 2**k,) for k in range(6)))),
    "bit-star": (_CHECKS, tuple((625 * 2**k,) for k in range(8))),
    "trajectory-optimisation": ("guesses", (1, 2, 4, 8)),
    "stomp": ("steps", tuple(2**k for k in range(9))),
}
# CPU times of the table [s], and of the curves.
TIMES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
CURVE = np.geomspace(0.02, 16.0, 160)
FIELDS = ("planner", "arm", "seed", "work", "length", "cpu_s", "reason")


@dataclass(frozen=True)
class Run:
    """A row of the table; the length of the joint path is infinite if there is none, for the ``reason``."""

    planner: str
    arm: str
    seed: int
    work: str
    length: float
    cpu_s: float
    reason: str = ""


def measured(planner: str, name: str, seed: int, work: object) -> Run:
    """One run."""
    arm, target = arm_and_target(name, SCENE, seed)
    kind = PLANNERS[planner].options
    assert kind is not None, "planners without options have no work to be allowed"
    begun, length, reason = cpu_time(), math.inf, ""
    try:
        q = plan(arm, target, planner=planner, seed=seed, options=kind(**{LADDERS[planner][0]: work})).motion.q
        length = float(np.linalg.norm(np.diff(q / joint_scale(arm), axis=0), axis=1).sum())
    except NoSolutionError as error:
        reason = str(error)
    return Run(planner, name, seed, allowed(planner, work), length, cpu_time() - begun, reason)


def allowed(planner: str, work: object) -> str:
    """The work allowed, in words: the option that counts it, and its value."""
    return f"{LADDERS[planner][0]} {np.ravel([work])[0]}"


def best_by(runs: Sequence[Run], times: Sequence[float]) -> dict[str, np.ndarray]:
    """For each planner, shortest lengths by some times [s], over the best known, ``(problems, times)``."""
    problems = sorted({(run.arm, run.seed) for run in runs})
    known = {one: min(run.length for run in runs if (run.arm, run.seed) == one) for one in problems}
    found = {name: np.full((len(problems), len(times)), np.inf) for name in dict.fromkeys(run.planner for run in runs)}
    for run in runs:
        if math.isfinite(run.length):
            row = found[run.planner][problems.index((run.arm, run.seed))]
            np.minimum(row, run.length / known[run.arm, run.seed], out=row, where=np.array(times) >= run.cpu_s)
    return found


def longest(runs: Sequence[Run], planner: str) -> float:
    """CPU time [s] of the longest run of a planner."""
    return max(run.cpu_s for run in runs if run.planner == planner)


def table(runs: Sequence[Run], command: str) -> str:
    """Medians by the times of `TIMES`, with the problems solved by then."""
    found = best_by(runs, TIMES)
    count = len({(run.arm, run.seed) for run in runs})
    lines = [
        "# Cost over time",
        "",
        f"`{command}`: median length of joint paths over the shortest that any planner has for the problem, of {count} "
        "problems, by CPU time; in brackets the number of problems solved by then; a dash where fewer than half are "
        "solved. Beyond its longest run a planner was given no more work.",
        "",
        "| planner | " + " | ".join(f"{t:g} s" for t in TIMES) + " | longest run [s] |",
        "| --- |" + " --- |" * (len(TIMES) + 1),
    ]
    for name, ratios in found.items():
        solved, median = np.isfinite(ratios).sum(axis=0), np.quantile(ratios, 0.5, axis=0, method="higher")
        cells = [
            f"{value:.3f} ({number})" if np.isfinite(value) else f"- ({number})"
            for value, number in zip(median, solved, strict=True)
        ]
        lines.append(f"| {name} | " + " | ".join([*cells, f"{longest(runs, name):.2g}"]) + " |")
    return "\n".join(lines) + "\n"


def plot(runs: Sequence[Run], path: Path) -> None:
    """The medians over time, as steps."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.5, 4.2), layout="constrained")
        axes = figure.subplots()
        for index, (name, ratios) in enumerate(best_by(runs, CURVE.tolist()).items()):
            median = np.quantile(ratios, 0.5, axis=0, method="higher")
            style = "-" if index < len(COLOURS) else "--"
            shown, run = np.where(np.isfinite(median), median, np.nan), longest(runs, name) >= CURVE
            colour = COLOURS[index % len(COLOURS)]
            axes.step(CURVE[run], shown[run], where="post", color=colour, ls=style, label=name)
            axes.step(CURVE, shown, where="post", color=colour, lw=0.8, ls=":")
        axes.set_xscale("log")
        axes.set_xlabel("CPU time [s]")
        axes.set_ylabel("joint path / shortest known")
        axes.set_title("median over problems, once half of them are solved; dotted: beyond the longest run", loc="left")
        axes.legend()
        save_figure(figure, path)


def main(arguments: list[str] | None = None) -> int:
    """Measure missing runs, and write all three files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--planners", default=",".join(name for name in LADDERS if name not in PLANNERS.missing()))
    parser.add_argument("--arms", default=",".join(arm_names()))
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--output", type=Path, default=Path("results/cost_over_time"))
    options = parser.parse_args(arguments)
    try:
        names = [as_choice("planner", name, LADDERS) for name in options.planners.split(",")]
        arms = [as_choice("arm", name, arm_names()) for name in options.arms.split(",")]
        seeds = as_count("seeds", options.seeds)
        path = io.make_directory(options.output) / "cost_over_time.csv"
        runs = _read(path)
    except LieEDNNError as error:
        parser.error(str(error))
    done = {(run.planner, run.arm, run.seed, run.work) for run in runs}
    for arm in arms:
        for seed in range(FIRST_SEED, FIRST_SEED + seeds):
            for planner, work in [(one, work) for one in names for work in LADDERS[one][1]]:
                if (planner, arm, seed, allowed(planner, work)) in done:
                    continue
                with one_blas_thread():
                    runs.append(measured(planner, arm, seed, work))
                print(*vars(runs[-1]).values(), sep=", ", file=sys.stderr)
                write_rows(path, FIELDS, map(vars, runs))
    runs.sort(key=lambda run: list(LADDERS).index(run.planner))
    text = table(runs, f"python scripts/cost_over_time.py --seeds {seeds}")
    with io.atomic_text(options.output / "cost_over_time.md") as file:
        file.write(text)
    plot(runs, options.output / "cost_over_time.png")
    print(text)
    return 0


def _read(path: Path) -> list[Run]:
    try:
        return [
            Run(
                row["planner"],
                row["arm"],
                int(row["seed"]),
                row["work"],
                float(row["length"]),
                float(row["cpu_s"]),
                row["reason"],
            )
            for row in read_rows(path)
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(f"{path} is no table of this script ({error}); choose another --output") from None


if __name__ == "__main__":
    raise SystemExit(main())
