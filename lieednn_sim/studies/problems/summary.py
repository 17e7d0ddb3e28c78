"""The summary of planners on published problems, in Markdown."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict

from lieednn_sim import io
from lieednn_sim.studies.markdown import escaped, table_head, table_line
from lieednn_sim.studies.problems.study import MEASURED, Solution, Statistic
from lieednn_sim.studies.statistics import pattern_of, wilson

# Largest number of problems named for a kind of failure.
_NAMED = 10
_STATISTICS = ("mean", "std", "median", "75 %", "98 %")
METHOD = (
    "Motions lead from the published start to the published joint goal, within the limits of position and velocity of "
    "the robot's URDF and of accelerations derived from its efforts, free of contact at every sample of 2 ms. No "
    "clearance is required, since starts and goals have none. A planner has {budget:g} s of CPU time, on one core, for "
    "a problem. Problems whose start or goal touches something or breaks a limit are skipped: they count neither as "
    "solved nor as failed. The solve time covers everything from the problem to the timed motion. Statistics are over "
    "solved problems. The C-space path is a Euclidean length in radians, for slides in metres."
)


def write_problems(path: str | os.PathLike[str], robot: str, rows: Sequence[Solution], budget: float) -> None:
    """Write the numbers solved, by planner and set, statistics by planner, and the reasons of failures.

    Args:
        path: the file to write.
        robot: name of the robot.
        rows: rows of a table, see `study.PublishedProblems`.
        budget: CPU time for each problem [s].
    """
    names = list(dict.fromkeys(row.planner for row in rows))
    sets = sorted({row.problem for row in rows})
    by_planner = {name: [row for row in rows if row.planner == name] for name in names}
    lines = [f"# Published problems: {robot}", "", METHOD.format(budget=budget), "", "## Solved", ""]
    lines += table_head(["planner", "problems", "skipped", "failed", "solved", "95 %", *sets])
    for name, own in by_planner.items():
        asked = [row for row in own if not row.skipped]
        of_sets = [[row for row in asked if row.problem == one] for one in sets]
        solved = [_solved(asked), _interval(asked), *map(_solved, of_sets)]
        failed = sum(not row.success for row in asked)
        lines.append(table_line([name, str(len(own)), str(len(own) - len(asked)), str(failed), *solved]))
    lines += ["", "## Statistics", "", *table_head(["planner", "metric", *_STATISTICS])]
    for name, own in by_planner.items():
        for column in MEASURED:
            values = [value for row in own if row.success and (value := getattr(row, column.name)) is not None]
            if found := Statistic.of(values):
                cells = [f"{value:.3g}" for value in asdict(found).values()]
                lines.append(table_line([name, f"{column.name}: {column.heading}", *cells]))
    lines += ["", "## Skipped and failed", ""]
    alike: dict[tuple[str, str], list[Solution]] = {}
    for row in rows:
        if row.reason:
            alike.setdefault((row.planner, pattern_of(row.reason)), []).append(row)
    for (name, _), members in alike.items():
        which = ", ".join(f"{row.problem} {row.number}" for row in members[:_NAMED]) + ", ..." * (len(members) > _NAMED)
        lines.append(f"- {len(members)} x {name}, as: {escaped(members[0].reason)} ({escaped(which)})")
    if not alike:
        lines.append("- none")
    with io.atomic_text(path) as stream:
        stream.write("\n".join(lines) + "\n")


def _solved(rows: Sequence[Solution]) -> str:
    return f"{sum(row.success for row in rows)} of {len(rows)}"


def _interval(rows: Sequence[Solution]) -> str:
    """Wilson's interval of the success rate."""
    return "{:.0%} to {:.0%}".format(*wilson(sum(row.success for row in rows), len(rows))) if rows else "-"
