"""Planners on MotionBenchMaker's problems for the Panda, the UR5 and the Fetch, in one table.

    python scripts/motion_bench_maker.py FOLDER [--robots panda ur5 fetch] [--planners NAME ...] [--problems 100]
                                         [--jobs 1] [--output results/motion_bench_maker]

FOLDER is the ``resources`` of VAMP's repository, which is not part of this project; docs/howto/published_problems.md
says how the problems are posed. The rows are kept in the output, so an interrupted run goes on;
``motion_bench_maker.md`` has the statistics of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from common import options, write
from rich.console import Console

from lieednn_sim.cli.console import progress
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.studies.problems.motion_bench_maker import ProblemSets
from lieednn_sim.studies.problems.study import PublishedProblems, Solution
from lieednn_sim.studies.study import compute

ROBOTS = ("panda", "ur5", "fetch")
PLANNERS = ("rrt-connect", "lieednn-shaped", "minimum-jerk")
BUDGET = 10.0
METHOD = (
    "Each motion leads from the published start to the published joint goal, without contact. It keeps the position "
    "and velocity limits of the robot's URDF, and acceleration limits derived from its effort limits. No clearance is "
    f"required, since starts and goals have none. A planner has {BUDGET:g} s of CPU time on one core for each problem. "
    "A problem whose start or goal touches something or breaks a limit is skipped: it counts neither as solved nor as "
    "failed.\n\n- **solve time**: from the problem to the timed motion, without the import of toppra.\n- **C-space "
    "path**: Euclidean length in radians; slides count in metres.\n- **proved**: the fraction of a motion's time for "
    "which it is proved, at every instant, that nothing touches; mean.\n\nStatistics are over the solved problems. "
    "Four numbers are mean / median / 75 % / 98 %. [How problems are posed, and what others "
    "publish](../../docs/howto/published_problems.md)."
)
HEADINGS = (
    *("robot", "planner", "problems", "skipped", "solved, of asked"),
    *("solve time [s]", "C-space path [rad]", "motion time [s]", "proved"),
)
SHOWN = ("solve_time", "cspace_path_length", "motion_time")


def report(rows: dict[str, Sequence[Solution]]) -> list[str]:
    """The statistics of all robots, and what failed."""
    cells, failures = [], []
    for robot, found in rows.items():
        for planner in dict.fromkeys(row.planner for row in found):
            own = [row for row in found if row.planner == planner]
            asked = [row for row in own if not row.skipped]
            solved = [row for row in asked if row.success]
            cells.append([robot, f"`{planner}`", len(own), len(own) - len(asked), f"{len(solved)} of {len(asked)}"])
            for values in ([getattr(row, name) for row in solved] for name in SHOWN):
                shown = (np.mean(values), *np.percentile(values, (50, 75, 98))) if values else ()
                cells[-1].append(" / ".join(f"{value:.3g}" for value in shown) or "-")
            proved = [row.proved_fraction or 0.0 for row in solved]
            cells[-1].append(f"{np.mean(proved):.3%}" if proved else "-")
            lost = [f"{row.problem} {row.number}" for row in asked if not row.success]
            if lost and planner != "minimum-jerk":
                failures.append(f"- {robot}, `{planner}`: {', '.join(lost)}")
    return [
        "# MotionBenchMaker's problems",
        "",
        METHOD,
        *markdown_table(HEADINGS, cells),
        *("", "Problems that searching planners did not solve:", ""),
        *(failures or ["- none"]),
    ]


def main(arguments: list[str] | None = None) -> None:
    """Compute missing rows, then write the table."""
    defaults: dict[str, Any] = {"robots": ROBOTS, "planners": PLANNERS, "problems": 100, "jobs": 1}
    given = options(arguments, __doc__, "results/motion_bench_maker", ["folder"], **defaults)
    rows: dict[str, Sequence[Solution]] = {}
    for robot in given.robots:
        study = PublishedProblems(ProblemSets(given.folder / robot), given.planners, given.problems, BUDGET)
        with progress(robot):
            made = compute(study, given.output / robot, jobs=given.jobs, console=Console(stderr=True))
        rows[robot] = list(made.rows.values())
    write(given.output / "motion_bench_maker.md", report(rows))


if __name__ == "__main__":
    main()
