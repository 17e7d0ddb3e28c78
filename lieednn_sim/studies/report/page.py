"""The page: a table of medians, plots, motions in 3D and failures in one HTML file without external resources."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

import jinja2

from lieednn_sim import io
from lieednn_sim.errors import InputError
from lieednn_sim.registry import PLANNERS
from lieednn_sim.rendering.page import player
from lieednn_sim.studies.comparison.rows import BY_NAME, SHOWN, Row
from lieednn_sim.studies.comparison.statistics import controllers_of, failures, in_order, seeds_by_planner, verdict
from lieednn_sim.studies.comparison.summary import method, shown
from lieednn_sim.studies.reactions.cases import MEASURED, Reaction
from lieednn_sim.studies.reactions.study import METHOD, groups
from lieednn_sim.studies.report.figures import marks, plots
from lieednn_sim.studies.report.views import View
from lieednn_sim.studies.rows import Column
from lieednn_sim.studies.statistics import Group, grouped
from lieednn_sim.studies.table import Table


def write_page(
    path: str | os.PathLike[str],
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
        views: problems to show in 3D; with them the page has viser's player once.
        command: command that made the table.
        date: date for the page's head; none when empty, so that the page depends on the table alone.
        reactions: results of the reactive benchmark, for a section of their own.

    Raises:
        InputError: the table is empty, or ``reactions`` is of another kind.
        FileError: the file cannot be written.
    """
    rows, reacted = table.sorted_rows(), [] if reactions is None else reactions.sorted_rows()
    if not rows:
        raise InputError(f"the table {table.path} is empty; there is nothing to show")
    if not all(isinstance(row, Reaction) for row in reacted):
        raise InputError("reactions must be a table of the reactive benchmark, got one of another kind")
    names = in_order((row.planner for row in rows), PLANNERS)
    controllers = controllers_of(rows)
    arms = sorted({row.arm for row in rows})
    columns, counts = _columns(), seeds_by_planner(rows).values()
    lines = grouped(rows, ("arm", "scene", "planner", "controller"))
    lines.sort(key=lambda group: (*group.key[:2], names.index(group.key[2]), group.key[3]))
    page = (
        _environment()
        .get_template("page.html")
        .render(
            method=method(table),
            date=date,
            command=command,
            arms=arms,
            scenes=sorted({row.scene for row in rows}),
            planners=names,
            controllers=controllers,
            seeds=" to ".join(map(str, sorted({min(counts), max(counts)}))),
            count=len(rows),
            settings=table.settings,
            versions=table.versions,
            missing=dict(sorted((missing or {}).items())),
            marks=marks(names),
            columns=columns,
            heads=_heads(columns),
            groups=lines,
            plots={arm: plots([row for row in rows if row.arm == arm], controllers[0]) for arm in arms},
            failures=failures(rows),
            views=views,
            # What ends a script element must not be in the text of one.
            player=json.dumps(player("RECORDING")).replace("</", "<\\/") if views else "",
            reactions=groups(reacted) if reacted else [],
            reaction_heads=_reaction_heads(),
            reaction_method=METHOD,
        )
    )
    with io.atomic_text(path) as stream:
        stream.write(page)


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("lieednn_sim.studies.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"rounded": shown, "violations": _violations, "verdict": verdict}
    return environment


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


def _heads(columns: Sequence[Column]) -> list[tuple[str, str, bool]]:
    """Text of each heading, its explanation, and whether its column is numeric."""
    return [
        *((name, "", False) for name in ("planner", "arm", "scene", "controller")),
        ("success", "rollouts without contact that end at their target", True),
        *((column.heading, column.meaning, True) for column in columns),
        ("with violations", "rollouts with a joint beyond its position, velocity or acceleration limit", True),
        ("stability", "what is proved of the network", False),
    ]


def _reaction_heads() -> list[tuple[str, str, bool]]:
    """As `_heads`, for the table of the reactive benchmark."""
    numbers = ("arrived", "touched", "back", *(column.heading for column in MEASURED))
    return [(name, "", False) for name in ("policy", "scene", "disturbance")] + [(name, "", True) for name in numbers]
