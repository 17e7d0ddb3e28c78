"""Views of a comparison: one problem solved by several planners, side by side in 3D, for viser's player in the page."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lieednn_sim.errors import InputError
from lieednn_sim.registry import PLANNERS
from lieednn_sim.rendering.page import Recording, record
from lieednn_sim.studies.comparison.cases import replay
from lieednn_sim.studies.comparison.rows import Case, Row
from lieednn_sim.studies.comparison.statistics import in_order
from lieednn_sim.studies.comparison.study import settings_of
from lieednn_sim.studies.statistics import grouped
from lieednn_sim.studies.table import Table
from lieednn_sim.validation import as_count


@dataclass(frozen=True)
class View:
    """One problem solved by several planners.

    Attributes:
        rows: their rows in the table, from left to right.
        recording: their motions.
    """

    rows: tuple[Row, ...]
    recording: Recording

    @property
    def base64(self) -> str:
        """The recording as text for the page."""
        return base64.b64encode(self.recording.content).decode("ascii")


def choose_problems(table: Table[Row], count: int, controller: str) -> list[list[Case]]:
    """Choose up to ``count`` problems of a table, and at most four planners that solved each.

    The problems that most planners solved come first, each arm and scene once. The planner of LieEDNN with the most
    successes in the whole table is the first of every problem where it succeeded; the others take turns.

    Raises:
        InputError: ``count`` is not a whole number >= 0.
    """
    most = as_count("the number of problems", count, least=0)
    solved = [row for row in table.sorted_rows() if row.success and row.controller == controller]
    names = in_order((row.planner for row in solved), PLANNERS)
    totals = {name: sum(row.planner == name for row in solved) for name in names}
    best = max((name for name in totals if name.startswith("lieednn")), key=lambda name: totals[name], default=None)
    # Of each arm in each scene, the seed that the most planners solved; the first of several.
    problems = []
    for place in grouped(solved, ("arm", "scene")):
        seeds = sorted({row.seed for row in place.rows})
        seed = max(seeds, key=lambda seed: sum(row.seed == seed for row in place.rows))
        problems.append([row for row in place.rows if row.seed == seed])
    problems.sort(key=lambda rows: (best not in {row.planner for row in rows}, -len(rows)))
    shown = dict.fromkeys(totals, 0)
    chosen: list[list[Case]] = []
    for rows in problems[:most]:
        by_name = {row.planner: row.case for row in rows}
        # More would be too small to see.
        some = sorted(in_order(by_name, PLANNERS), key=lambda name: (name != best, shown[name]))[:4]
        for name in some:
            shown[name] += 1
        chosen.append([by_name[name] for name in some])
    return chosen


def view(
    table: Table[Row],
    cases: Sequence[Case],
    controller: str,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> View:
    """Plan and simulate cases of one problem again, and record them side by side.

    Raises:
        InputError: the table has no such case, or they are of several problems.
        LieEDNNError: viser is not installed.
    """
    rows = [table.rows.get((case.arm, case.scene, case.planner, controller, case.seed)) for case in cases]
    result = tuple(row for row in rows if row is not None)
    if len(result) < len(rows) or len({(row.arm, row.scene, row.seed) for row in result}) != 1:
        raise InputError("a view is of one problem that the table has, by one planner or more")
    settings = settings_of(table)
    rollouts = [replay(case, controller, settings, user_files=table.user_files) for case in cases]
    return View(result, record(rollouts, [case.planner for case in cases], progress=progress))
