"""One problem of a comparison, solved by several planners: their rollouts again."""

from __future__ import annotations

import os

from lieednn_sim.errors import InputError
from lieednn_sim.registry import PLANNERS
from lieednn_sim.simulation import Rollout
from lieednn_sim.studies.comparison.cases import Settings, replay
from lieednn_sim.studies.comparison.rows import Row
from lieednn_sim.studies.statistics import grouped
from lieednn_sim.studies.table import how_made, read_rows
from lieednn_sim.studies.user_files import recorded_files
from lieednn_sim.validation import as_count, as_path


def replay_together(directory: str | os.PathLike[str], count: int = 4) -> dict[str, Rollout]:
    """Plan and simulate again what several planners made of one problem, by their names.

    It is the problem that most planners solved, the first of them in the table's order. Planners that make a network
    come first, then the others by their tracking error.

    Args:
        directory: directory of a comparison, which is not changed.
        count: largest number of planners.

    Raises:
        FileError: it holds no comparison.
        InputError: no planner solved anything, or the count is not positive.
        LieEDNNError: a case cannot be planned or simulated again.
    """
    most, folder = as_count("count", count), as_path("the name of a comparison's directory", directory)
    settings = Settings(**how_made(folder / "comparison.json", "comparison")["settings"])
    solved = [row for row in read_rows(folder / "comparison.csv", Row).values() if row.success]
    if not solved:
        raise InputError(f"no planner solved a problem of {folder}: there is nothing to show")
    places = grouped(sorted(solved, key=lambda row: row.key), ("arm", "scene", "controller", "seed"))
    rows = max(places, key=lambda place: len(place.rows)).rows
    networks = [name for name, entry in PLANNERS.items() if entry.network]
    ranked = sorted(rows, key=lambda row: (row.planner not in networks, row.tracking_rms_mm or 0.0))
    files = recorded_files(folder)
    return {row.planner: replay(row.case, row.controller, settings, user_files=files) for row in ranked[:most]}
