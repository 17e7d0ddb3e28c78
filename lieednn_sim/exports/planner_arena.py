"""Tables of comparisons as benchmark logs of OMPL, whose own tool makes the database for Planner Arena from them."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from lieednn_sim.errors import InputError
from lieednn_sim.studies.comparison.case import settings_of
from lieednn_sim.studies.comparison.rows import COLUMNS, Row
from lieednn_sim.studies.comparison.study import Comparison
from lieednn_sim.studies.rows import grouped
from lieednn_sim.values import StrPath

# Names and SQL types of the properties of each run; the first two have OMPL's own names.
_PROPERTIES = (
    *(("time", "REAL"), ("solved", "BOOLEAN"), ("arrived", "BOOLEAN"), ("seed", "INTEGER")),
    *((column.name, "REAL") for column in COLUMNS if column.name != "planning_s"),
)


def write(comparisons: Mapping[str, StrPath], folder: Path) -> None:
    """Write ``<name>-<arm>-<scene>-<controller>.log`` for each part of each comparison; see `formats.export`.

    Each log is an experiment of OMPL, whose runs are the seeds: another target, and other obstacles, for each. ``time``
    is the CPU time of the planner, ``solved`` whether it planned a motion, and ``arrived`` whether the simulated arm
    came to the target without contact; the other columns are those of the comparison. `FileError` if a directory holds
    no comparison, `InputError` if one has no rows.
    """
    for name, directory in comparisons.items():
        table = Comparison.read(directory)
        if not table.rows:
            raise InputError(f"{table.path} has no rows: there is nothing to export")
        date = datetime.fromtimestamp(table.path.stat().st_mtime, UTC)
        head = {
            "version": f"lieednn_sim version {table.versions.get('lieednn_sim', 'unknown')}",
            "date": f"{date:%Y-%m-%d %H:%M:%S}",
            "setup": json.dumps({"settings": table.settings, "versions": table.versions}),
            "limit": f"{settings_of(table).time_budget:g}",
        }
        for part in grouped(table.rows.values(), ("arm", "scene", "controller")):
            # The name of a user's own controller is the path of its file.
            experiment = re.sub(r"[\s/\\:]+", "_", "-".join(map(str, part.key)))
            lines = _log(experiment, part.rows, **head)
            (folder / f"{name}-{experiment}.log").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _log(experiment: str, rows: Sequence[Row], *, version: str, date: str, setup: str, limit: str) -> list[str]:
    """The lines of a log; OMPL's reader finds each value by its place and the words around it."""
    planners = grouped(rows, ("planner",))
    lines = [
        version,
        f"Experiment {experiment}",
        "Running on unknown",
        f"Starting at {date}",
        *("<<<|", setup, "|>>>"),
        "0 is the random seed",
        f"{limit} seconds per run",
        "0 MB per run",
        f"{max(len(group.rows) for group in planners)} runs per planner",
        f"{sum(row.planning_s or 0.0 for row in rows):g} seconds spent to collect the data",
        "0 enum types",
        f"{len(planners)} planners",
    ]
    for group in planners:
        lines += [str(group.key[0]), "0 common properties", f"{len(_PROPERTIES)} properties for each run"]
        lines += [f"{name} {kind}" for name, kind in _PROPERTIES]
        lines.append(f"{len(group.rows)} runs")
        for row in group.rows:
            measured = [getattr(row, name) for name, _ in _PROPERTIES[4:]]
            values = [row.planning_s, int(row.planned), int(row.success), row.seed, *measured]
            lines.append("".join("; " if value is None else f"{value}; " for value in values))
        lines.append(".")
    return lines
