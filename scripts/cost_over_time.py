"""Cost over time of planners that improve their first path, beside RRT-Connect, which does not.

    python scripts/cost_over_time.py [--planners NAME ...] [--arms NAME ...] [--seeds 4] [--output ...]

Each run is a separate plan with a limit of work, counted by a planner's option, which doubles from run to run. A run
has a CPU time, smoothing and checks included, and the length of its joint path in units of the joints' velocity limits,
which these planners minimise. So no planner watches a clock, and all columns except the CPU time are reproducible;
compared with watching a single run, curves are late by the times of the shorter runs. The problems are all arms among
poles, with seeds from 2000 on. Medians count unsolved problems as the longest. Writes ``cost_over_time.md`` and
``cost_over_time.png``; an interrupted run goes on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from common import options, saved_rows, write

import lieednn_sim as ls
from lieednn_sim.budget import cpu_time
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.evaluation.figure_layout import COLOURS, drawn
from lieednn_sim.planning import PLANNERS
from lieednn_sim.planning.motion import joint_scale
from lieednn_sim.registry import DEFAULT_ARMS
from lieednn_sim.studies.comparison.case import arm_and_target

SCENE, FIRST_SEED = "poles", 2000
_CHECKS = "max_collision_checks"
# The work allowed in each run, by the option that counts it.
LADDERS: dict[str, tuple[str, tuple[int, ...]]] = {
    "rrt-connect": (_CHECKS, (120_000,)),
    **dict.fromkeys(("rrt-star", "informed-rrt-star", "aorrtc"), (_CHECKS, tuple(2_500 * 2**k for k in range(6)))),
    "bit-star": (_CHECKS, tuple(625 * 2**k for k in range(8))),
    "trajectory-optimisation": ("guesses", (1, 2, 4, 8)),
    "stomp": ("steps", tuple(2**k for k in range(9))),
}
# CPU times of the table [s], and of the curves.
TIMES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
CURVE = np.geomspace(0.02, 16.0, 160)


def measured(planner: str, arm: str, seed: int, work: int) -> dict[str, Any]:
    """One run: its CPU time [s], and the length of its joint path, None if there is none for a reason."""
    room, target = arm_and_target(arm, SCENE, seed)
    kind, option = PLANNERS[planner].options, LADDERS[planner][0]
    assert kind is not None, "planners without options have no work to be allowed"
    options = kind(**{option: (work,) if option == _CHECKS else work})
    start, length, reason = cpu_time(), None, ""
    try:
        q = ls.plan(room, target, planner=planner, seed=seed, options=options).motion.q
        length = float(np.linalg.norm(np.diff(q / joint_scale(room), axis=0), axis=1).sum())
    except NoSolutionError as error:
        reason = str(error)
    return {"length": length, "cpu_s": cpu_time() - start, "reason": reason}


def best_by(runs: Sequence[dict[str, Any]], times: Sequence[float]) -> dict[str, np.ndarray]:
    """For each planner, shortest lengths by some times [s], over the best known, ``(problems, times)``."""
    problems = sorted({(run["arm"], run["seed"]) for run in runs})
    known = {one: min(run["length"] for run in runs if (run["arm"], run["seed"]) == one) for one in problems}
    result = {run["planner"]: np.full((len(problems), len(times)), np.inf) for run in runs}
    for run in runs:
        if math.isfinite(run["length"]):
            problem = run["arm"], run["seed"]
            row = result[run["planner"]][problems.index(problem)]
            np.minimum(row, run["length"] / known[problem], out=row, where=np.array(times) >= run["cpu_s"])
    return result


def longest(runs: Sequence[dict[str, Any]], planner: str) -> float:
    """CPU time [s] of the longest run of a planner."""
    return float(max(run["cpu_s"] for run in runs if run["planner"] == planner))


def report(runs: Sequence[dict[str, Any]], command: str) -> list[str]:
    """Medians by the times of `TIMES`, with the problems solved by then."""
    rows = []
    for name, ratios in best_by(runs, TIMES).items():
        solved, median = np.isfinite(ratios).sum(axis=0), np.quantile(ratios, 0.5, axis=0, method="higher")
        cells = [
            f"{value:.3f} ({number})" if np.isfinite(value) else f"- ({number})"
            for value, number in zip(median, solved, strict=True)
        ]
        rows.append([name, *cells, f"{longest(runs, name):.2g}"])
    count = len({(run["arm"], run["seed"]) for run in runs})
    return [
        "# Cost over time",
        "",
        f"`{command}`: the length of a planner's joint path, divided by the shortest that any planner has for the "
        f"problem. Values are medians over {count} problems, by CPU time. The number in brackets is that of the "
        "problems solved by then; a dash means fewer than half. A planner was given no more work than in its longest "
        "run.",
        *markdown_table(["planner", *(f"{t:g} s" for t in TIMES), "longest run [s]"], rows),
    ]


def plot(runs: Sequence[dict[str, Any]], path: Path) -> None:
    """The medians over time, as steps."""
    with drawn(path, 7.5, 4.2) as figure:
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


def main(arguments: list[str] | None = None) -> None:
    """Measure missing runs, and write all three files."""
    able = [name for name in LADDERS if name not in PLANNERS.missing()]
    defaults: dict[str, Any] = {"planners": able, "arms": DEFAULT_ARMS, "seeds": 4}
    given = options(arguments, __doc__, "results/cost_over_time", choices={"planners": LADDERS}, **defaults)
    cases = [
        {"planner": planner, "arm": arm, "seed": seed, "work": work}
        for arm, seed, planner in product(given.arms, range(FIRST_SEED, FIRST_SEED + given.seeds), given.planners)
        for work in LADDERS[planner][1]
    ]
    runs = [run | {"length": run["length"] or math.inf} for run in saved_rows(given.output / "runs", cases, measured)]
    runs.sort(key=lambda run: list(LADDERS).index(run["planner"]))
    command = f"python scripts/cost_over_time.py --seeds {given.seeds}"
    write(given.output / "cost_over_time.md", report(runs, command))
    plot(runs, given.output / "cost_over_time.png")


if __name__ == "__main__":
    main()
