"""The page: a table of medians, plots, failures and videos in one HTML file without external resources."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jinja2

from lieednn_sim import io
from lieednn_sim.errors import InputError
from lieednn_sim.rendering.page import player
from lieednn_sim.studies.comparison.rows import BY_NAME, Row
from lieednn_sim.studies.comparison.statistics import controllers_of, failures, seeds_by_planner, verdict
from lieednn_sim.studies.comparison.summary import method
from lieednn_sim.studies.reactions.cases import MEASURED, Reaction
from lieednn_sim.studies.reactions.study import METHOD, groups
from lieednn_sim.studies.report.figures import plots
from lieednn_sim.studies.report.style import in_order, marks, number
from lieednn_sim.studies.report.videos import Clip
from lieednn_sim.studies.report.views import View
from lieednn_sim.studies.rows import Column
from lieednn_sim.studies.statistics import Group, grouped, motions, numbers, wilson
from lieednn_sim.studies.table import Table

# Columns of the page's table; all others are in the CSV file.
_SHOWN = (
    "final_worst_mm",
    "final_worst_deg",
    "tracking_rms_mm",
    "tracking_rms_deg",
    "tracking_max_mm",
    "clearance_mm",
    "tube_mm",
    "path_ranges",
    "path_m",
    "settling_s",
    "jerk_effector",
    "curvature",
    "velocity_fraction",
    "force_fraction",
    "gap_mm",
    "gap_deg",
    "planning_s",
)
# Values below this are rounding [mm, deg].
_ROUNDING = 1e-6
_VIOLATIONS = ("position_violations", "velocity_violations", "acceleration_violations")


@dataclass(frozen=True)
class _Cell:
    text: str
    value: float | None


@dataclass(frozen=True)
class _Line:
    arm: str
    scene: str
    planner: str
    controller: str
    successes: int
    total: int
    low: float
    high: float
    cells: tuple[_Cell, ...]
    violations: int
    stability: str


def write_page(
    path: str | os.PathLike[str],
    table: Table[Row],
    *,
    missing: Mapping[str, str] | None = None,
    views: Sequence[View] = (),
    clips: Sequence[Clip] = (),
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
        clips: videos to embed.
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
    names = in_order(row.planner for row in rows)
    controllers = controllers_of(rows)
    arms = sorted({row.arm for row in rows})
    columns, counts = _columns(), seeds_by_planner(rows).values()
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
            findings=findings(rows),
            columns=columns,
            heads=_heads(columns),
            lines=_lines(rows),
            plots={arm: plots([row for row in rows if row.arm == arm], controllers[0]) for arm in arms},
            failures=failures(rows),
            views=views,
            # What ends a script element must not be in the text of one.
            player=json.dumps(player("RECORDING")).replace("</", "<\\/") if views else "",
            clips=clips,
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
    environment.filters["rounded"] = lambda value: "-" if value is None else number(value, rounding=_ROUNDING)
    return environment


def _columns() -> list[Column]:
    """The columns of the page's table, with full headings for angles, which follow their distances."""
    columns: list[Column] = []
    for column in (BY_NAME[name] for name in _SHOWN):
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


def _lines(rows: Sequence[Row]) -> list[_Line]:
    groups = grouped(rows, ("arm", "scene", "planner", "controller"))
    order = in_order(row.planner for row in rows)
    groups.sort(key=lambda group: (*group.key[:2], order.index(group.key[2]), group.key[3]))
    return [_line(group) for group in groups]


def _line(group: Group[Row]) -> _Line:
    arm, scene, planner, controller = group.key
    low, high = group.interval
    cells = tuple(_cell(name, group.median(name)) for name in _SHOWN)
    violated = sum(any(getattr(row, name) for name in _VIOLATIONS) for row in group.rows)
    return _Line(
        arm, scene, planner, controller, group.successes, group.total, low, high, cells, violated, verdict(group.rows)
    )


def _cell(column: str, value: float | None) -> _Cell:
    if value is None:
        return _Cell("\N{EN DASH}", None)
    return _Cell(number(value, rounding=_ROUNDING if column.endswith(("_mm", "_deg")) else 0.0), value)


@dataclass(frozen=True)
class Finding:
    """A number, its label, and details."""

    value: str
    label: str
    detail: str


def findings(rows: Sequence[Row]) -> list[Finding]:
    """The headline numbers; those for which the table lacks data are left out."""
    if not rows:
        return []
    # Other controllers may track up to rounding, which leaves nothing to compare.
    controller = controllers_of(rows)[0]
    tracked = [row for row in rows if row.controller == controller]
    made = [
        _success(rows),
        _best_planners(rows),
        _least(tracked, "tracking_rms_mm", "mm", f"least median tracking RMS with {controller}"),
        _least(rows, "planning_s", "s", "least median planning time"),
        _clearance(rows),
        _stability(rows),
    ]
    return [finding for finding in made if finding is not None]


def _success(rows: Sequence[Row]) -> Finding:
    successes = sum(row.success for row in rows)
    low, high = wilson(successes, len(rows))
    return Finding(
        f"{successes / len(rows):.1%}",
        "of all rollouts succeed",
        f"{successes} of {len(rows)}, 95 % interval {low:.1%} to {high:.1%}",
    )


def _best_planners(rows: Sequence[Row]) -> Finding:
    groups = grouped(rows, ("planner",))
    best = max(group.successes / group.total for group in groups)
    names = in_order(group.key[0] for group in groups if group.successes / group.total == best)
    return Finding(f"{best:.1%}", "highest success of a planner", ", ".join(names))


def _least(rows: Sequence[Row], column: str, unit: str, label: str) -> Finding | None:
    medians = {group.key[0]: group.median(column) for group in grouped(rows, ("planner",))}
    found = {name: value for name, value in medians.items() if value is not None}
    if not found:
        return None
    best = min(in_order(found), key=lambda name: found[name])
    return Finding(f"{number(found[best], rounding=1e-6)} {unit}", label, best)


def _clearance(rows: Sequence[Row]) -> Finding | None:
    known = [(row.clearance_mm, row) for row in rows if row.clearance_mm is not None]
    if not known:
        return None
    value, worst = min(known, key=lambda pair: pair[0])
    label = "deepest penetration of any rollout" if value < 0.0 else "least clearance of any rollout"
    return Finding(
        f"{number(abs(value))} mm",
        label,
        f"{worst.planner} on {worst.arm}, {worst.scene}, seed {worst.seed}",
    )


def _stability(rows: Sequence[Row]) -> Finding | None:
    verdicts = [row.stability for row in motions(rows) if row.stability not in ("", "-")]
    if not verdicts:
        return None
    count = verdicts.count("global")
    excess = numbers(rows, "gap_end_mm")
    detail = f"{count} of {len(verdicts)} motions of networks"
    if excess:
        detail += f"; largest gap at the end of any plan {number(max(excess), rounding=1e-6)} mm"
    return Finding(f"{count / len(verdicts):.1%}", "proved globally stable", detail)
