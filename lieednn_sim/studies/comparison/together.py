"""One problem of a comparison, solved by several planners: their rollouts again."""

from __future__ import annotations

import os

from lieednn_sim.errors import InputError
from lieednn_sim.registry import PLANNERS
from lieednn_sim.simulation import Rollout
from lieednn_sim.studies.comparison.cases import replay
from lieednn_sim.studies.comparison.study import Comparison, settings_of
from lieednn_sim.studies.statistics import grouped
from lieednn_sim.validation import as_count


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
    most, table = as_count("count", count), Comparison.read(directory)
    solved = [row for row in table.sorted_rows() if row.success]
    if not solved:
        raise InputError(f"no planner solved a problem of {table.directory}: there is nothing to show")
    places = grouped(solved, ("arm", "scene", "controller", "seed"))
    rows = max(places, key=lambda place: len(place.rows)).rows
    networks = [name for name, entry in PLANNERS.items() if entry.network]
    ranked = sorted(rows, key=lambda row: (row.planner not in networks, row.tracking_rms_mm or 0.0))
    settings = settings_of(table)
    return {
        row.planner: replay(row.case, row.controller, settings, user_files=table.user_files) for row in ranked[:most]
    }
