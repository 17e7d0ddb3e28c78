"""The page: winners, medians, plots, motions in 3D and failures in one HTML file without external resources."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import jinja2

from lieednn_sim import io
from lieednn_sim.errors import InputError
from lieednn_sim.registry import CONTROLLERS, PLANNERS
from lieednn_sim.rendering.page import Recording, player, record
from lieednn_sim.studies.comparison import summary
from lieednn_sim.studies.comparison.case import replay, settings_of
from lieednn_sim.studies.comparison.rows import BY_NAME, SHOWN, Case, Row
from lieednn_sim.studies.comparison.summary import QUESTIONS, winners
from lieednn_sim.studies.reactions.study import MEASURED, Reaction
from lieednn_sim.studies.reactions.summary import METHOD, groups
from lieednn_sim.studies.report.figures import FAMILIES, family, plots
from lieednn_sim.studies.rows import Column, Group, grouped
from lieednn_sim.studies.table import Table
from lieednn_sim.validation import as_count
from lieednn_sim.values import StrPath


class View(NamedTuple):
    """One problem solved by several planners.

    Attributes:
        rows: their rows in the table, from left to right.
        recording: their motions.
    """

    rows: tuple[Row, ...]
    recording: Recording


def choose_problems(table: Table[Row], count: int, controller: str) -> list[list[Case]]:
    """Choose up to ``count`` problems of a table, and at most four planners that solved each.

    Each arm and scene has one problem; those that most planners solved come first. The LieEDNN planner with the most
    successes in the whole table is the first one in every problem that it solved; the others take turns.
    """
    most = as_count("the number of problems", count, least=0)
    solved = [row for row in table.rows.values() if row.success and row.controller == controller]
    names = summary.in_order((row.planner for row in solved), PLANNERS)
    totals = {name: sum(row.planner == name for row in solved) for name in names}
    best = max((name for name in totals if name.startswith("lieednn")), key=lambda name: totals[name], default=None)
    # For each arm in each scene, the first of the seeds that the most planners solved.
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
        # More than four would be too small to see.
        some = sorted(summary.in_order(by_name, PLANNERS), key=lambda name: (name != best, shown[name]))[:4]
        for name in some:
            shown[name] += 1
        chosen.append([by_name[name] for name in some])
    return chosen


def view(table: Table[Row], cases: Sequence[Case], controller: str) -> View:
    """Plan and simulate cases of one problem again, and record them side by side.

    Raises:
        InputError: the table lacks one of the cases, or they belong to several problems.
        LieEDNNError: viser is not installed.
    """
    rows = [table.rows.get((case.arm, case.scene, case.planner, controller, case.seed)) for case in cases]
    result = tuple(row for row in rows if row is not None)
    if len(result) < len(rows) or len({(row.arm, row.scene, row.seed) for row in result}) != 1:
        raise InputError("a view needs cases of one problem, all of them in the table")
    settings = settings_of(table)
    rollouts = [replay(case, controller, settings, user_files=table.user_files) for case in cases]
    return View(result, record(rollouts, [case.planner for case in cases]))


def write_page(
    path: StrPath,
    table: Table[Row],
    *,
    missing: Mapping[str, str] | None = None,
    views: Sequence[View] = (),
    command: str = "",
    date: str = "",
    reactions: Table[Reaction] | None = None,
) -> None:
    """Write the page of a comparison; the same table gives the same page.

    Args:
        path: the file to write.
        table: table of the comparison.
        missing: planners that could not be compared, with the reason.
        views: problems to show in 3D; all share one copy of viser's player.
        command: command that made the table.
        date: date for the page's head; none when empty, so that the page depends on the table alone.
        reactions: results of the reactive benchmark, for a section of their own.

    Raises:
        InputError: the table is empty, or ``reactions`` is of another kind.
        FileError: the file cannot be written.
    """
    rows, reacted = list(table.rows.values()), [] if reactions is None else list(reactions.rows.values())
    if not rows:
        raise InputError(f"the table {table.path} is empty; there is nothing to show")
    if not all(isinstance(row, Reaction) for row in reacted):
        raise InputError("reactions must be a table of the reactive benchmark, got one of another kind")
    names = summary.in_order((row.planner for row in rows), PLANNERS)
    controllers = summary.in_order((row.controller for row in rows), CONTROLLERS)
    arms = sorted({row.arm for row in rows})
    won = winners(rows, controllers[0])
    columns, counts = _columns(), summary.seeds_by_planner(rows).values()
    lines = grouped(rows, ("arm", "scene", "planner", "controller"))
    lines.sort(key=lambda group: (*group.key[:2], names.index(group.key[2]), group.key[3]))
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("lieednn_sim.studies.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"rounded": summary.shown, "violations": _violations, "verdict": summary.verdict}
    known = {"arms": arms, "planners": names, "controllers": controllers, "columns": columns, "lines": lines}
    known |= {"date": date, "command": command, "views": views, "winners": won, "measured": MEASURED}
    # Heads are the text, its explanation, and whether the column is numeric.
    page = environment.get_template("page.html").render(
        known,
        method=summary.method(table),
        scenes=sorted({row.scene for row in rows}),
        seeds=" to ".join(map(str, sorted({min(counts), max(counts)}))),
        count=len(rows),
        settings=table.settings,
        versions=table.versions,
        missing=dict(sorted((missing or {}).items())),
        colours={name: FAMILIES[family(name)] for name in names},
        families={name: colour for name, colour in FAMILIES.items() if name in map(family, names)},
        heads_of_winners=[(scene, "", False) for scene in won],
        questions={name: BY_NAME.get(column) for name, (column, _) in QUESTIONS.items()},
        value_of=lambda value, column: summary.shown(value, column.name) if column else f"{100 * value:.0f} %",
        heads=[
            *((name, "", False) for name in ("planner", "arm", "scene", "controller")),
            ("success", "rollouts without contact that end at their target", True),
            *((column.heading, column.meaning, True) for column in columns),
            ("with violations", "rollouts with a joint beyond its position, velocity or acceleration limit", True),
            ("stability", "what is proved of the network", False),
        ],
        plots={arm: plots([row for row in rows if row.arm == arm], controllers[0]) for arm in arms},
        failures=summary.failures(rows),
        # "</" would end the script element that holds this text.
        player=json.dumps(player("RECORDING")).replace("</", "<\\/") if views else "",
        reactions=groups(reacted) if reacted else [],
        reaction_heads=[
            *((name, "", False) for name in ("policy", "scene", "disturbance")),
            *((name, "", True) for name in ("arrived", "touched", "back")),
            *((column.heading, "", True) for column in MEASURED),
        ],
        reaction_method=METHOD,
    )
    io.save_text(path, page)


def _violations(group: Group[Row]) -> int:
    """Number of rollouts with a joint beyond one of its limits."""
    names = [name for name in BY_NAME if name.endswith("_violations")]
    return sum(any(getattr(row, name) for name in names) for row in group.rows)


def _columns() -> list[Column]:
    """The columns of the page's table, with full headings for angles, which follow their distances."""
    columns: list[Column] = []
    for column in SHOWN:
        own = column.heading != "[deg]"
        columns.append(column if own else replace(column, heading=columns[-1].heading.replace("[mm]", "[deg]")))
    return columns
