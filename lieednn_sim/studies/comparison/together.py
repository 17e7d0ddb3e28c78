"""Problems of a comparison that several planners solved: which, and their rollouts again."""

from __future__ import annotations

from collections.abc import Sequence

from lieednn_sim.errors import InputError
from lieednn_sim.registry import PLANNERS
from lieednn_sim.simulation import Rollout
from lieednn_sim.studies.comparison.cases import replay
from lieednn_sim.studies.comparison.rows import Case, Row
from lieednn_sim.studies.comparison.statistics import in_order
from lieednn_sim.studies.comparison.study import settings_of
from lieednn_sim.studies.statistics import grouped
from lieednn_sim.studies.table import Table
from lieednn_sim.validation import as_count

# Planners shown together: more would be too small to see.
_TOGETHER = 4
_OWN = "lieednn"


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
    best = max((name for name in totals if name.startswith(_OWN)), key=lambda name: totals[name], default=None)
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
        some = sorted(in_order(by_name, PLANNERS), key=lambda name: (name != best, shown[name]))[:_TOGETHER]
        for name in some:
            shown[name] += 1
        chosen.append([by_name[name] for name in some])
    return chosen


def replay_together(table: Table[Row], cases: Sequence[Case], controller: str) -> dict[str, Rollout]:
    """Plan and simulate cases of a table again, by their planners.

    Raises:
        InputError: there are no cases.
        LieEDNNError: a case cannot be planned or simulated again.
    """
    if not cases:
        raise InputError(f"no planner solved a problem of {table.path}: there is nothing to show")
    settings = settings_of(table)
    return {case.planner: replay(case, controller, settings, user_files=table.user_files) for case in cases}
