"""The summary of a comparison in Markdown, and its statistics: winners, proven stability, seeds, and failures."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from lieednn_sim import io
from lieednn_sim.evaluation.display import escaped, markdown_table
from lieednn_sim.evaluation.evaluation import SETTLED_ROTATION, SETTLED_TRANSLATION
from lieednn_sim.registry import PLANNERS
from lieednn_sim.studies.comparison.case import settings_of
from lieednn_sim.studies.comparison.rows import COLUMNS, Row
from lieednn_sim.studies.rows import Column, Group, grouped, motions
from lieednn_sim.studies.table import Table
from lieednn_sim.values import StrPath, rounded

_NOT_SUMMARISED = ("motion_s", "gap_end_deg", "final_effector_deg")


def write_summary(path: StrPath, table: Table[Row], missing: Mapping[str, str] | None = None) -> None:
    """Write success and medians by arm, scene, planner and controller, and the reasons of failures.

    Planners ``missing`` could not be compared, with the reason.
    """
    rows = list(table.rows.values())
    of_motion = [column for column in COLUMNS if column.of_motion and column.name not in _NOT_SUMMARISED]
    of_rollout = [column for column in COLUMNS if not column.of_motion and column.name not in _NOT_SUMMARISED]
    lines = ["# Planners and controllers compared", "", method(table), ""]
    if missing:
        lines += ["## Not compared", "", *(f"- {name}: {reason}" for name, reason in sorted(missing.items())), ""]
    result = []
    for group in grouped(rows, ("arm", "scene", "planner")):
        own = motions(group.rows)
        planned = f"{sum(row.planned for row in own)} of {len(own)}"
        result.append([*map(escaped, group.key), planned, verdict(group.rows), *_medians(group, of_motion)])
    followed = []
    for group in grouped(rows, ("arm", "scene", "planner", "controller")):
        low, high = group.interval
        cells = [*map(escaped, group.key), f"{group.successes} of {group.total}", f"{low:.0%} to {high:.0%}"]
        followed.append([*cells, *_medians(group, of_rollout)])
    heads = ["arm", "scene", "planner", "made", "stability", *(column.heading for column in of_motion)]
    lines += ["## Motions", *markdown_table(heads, result)]
    heads = ["arm", "scene", "planner", "controller", "success", "95 %", *(column.heading for column in of_rollout)]
    lines += ["", "## Tracking", *markdown_table(heads, followed)]
    lines += ["", "## Failures", ""]
    for failure in failures(rows):
        counts = ", ".join(f"{name} {count}" for name, count in failure.counts)
        lines.append(f"- {failure.total} x {failure.step}, as: {escaped(failure.example)} ({escaped(counts)})")
    if lines[-1] == "":
        lines.append("- none")
    io.save_text(path, "\n".join(lines) + "\n")


def method(table: Table[Row]) -> str:
    """The method and the meaning of the numbers, for the head of a report."""
    settings = settings_of(table)
    scale, counts = settings.mass_scale, seeds_by_planner(table.rows.values())
    most = max(counts.values(), default=0)
    fewer = ", ".join(f"{name} {count}" for name, count in sorted(counts.items()) if count < most)
    masses = "" if scale == 1.0 else f" with {scale:g} times the masses the controllers know"
    return (
        f"Each motion leads from home to a random reachable target in {settings.duration:g} s and is simulated{masses} "
        f"until {settings.hold:g} s afterwards. A rollout succeeds if nothing touches and every link ends within "
        f"{1e3 * SETTLED_TRANSLATION:g} mm and {np.rad2deg(SETTLED_ROTATION):.1g} deg of the target. Tracking errors "
        "are relative to the planned joints, without the mechanism gap. The tube is the largest s with this proof: if "
        "every link is off by a shift s and by a turn that moves the end effector by s, anywhere on the way, the "
        "network still ends at the target and nothing touches. Only motions that are the path of a certified network "
        "have a tube; nothing is proved about how other motions would go on. Medians are over the seeds with a value, "
        "so a planner that fails on hard targets is judged by easy ones. A planner that has spent "
        f"{settings.time_budget:g} s of CPU time on a problem has failed. All numbers except the planning time are "
        "reproducible."
        + (f" Planners have {most} seeds; these have fewer, so their rows say less: {fewer}." if fewer else "")
    )


def _medians(group: Group[Row], columns: Sequence[Column]) -> list[str]:
    return [shown(group.median(column.name), column.name) for column in columns]


def shown(value: float | None, column: str = "_mm") -> str:
    """A measured number for people, by the name of its column; a dash where there is none."""
    # Distances and angles below 1e-6 mm or degrees are rounding.
    return "-" if value is None else rounded(value, 1e-6 if column.endswith(("_mm", "_deg")) else 0.0)


@dataclass(frozen=True)
class Failure:
    """Failures at one step whose reasons differ only in names and numbers, which are ellipses in the pattern."""

    step: str
    pattern: str
    example: str  # one reason in full
    counts: tuple[tuple[str, int], ...]  # numbers of rows by planner, largest first

    @property
    def total(self) -> int:
        """Number of rows."""
        return sum(count for _, count in self.counts)


def verdict(rows: Iterable[Row]) -> str:
    """The proven stability of the rows' networks, such as "global 9/10, local 1/10"; "-" without a network."""
    results = [row.stability for row in motions(rows) if row.stability not in ("", "-")]
    if not results:
        return "-"
    if len(set(results)) == 1:
        return results[0]
    names = [name for name in ("global", "local", "none") if name in results]
    return ", ".join(f"{name} {results.count(name)}/{len(results)}" for name in names)


def seeds_by_planner(rows: Iterable[Row]) -> dict[str, int]:
    """Number of seeds of each planner."""
    return {group.key[0]: len({row.seed for row in group.rows}) for group in grouped(rows, ("planner",))}


def in_order(names: Iterable[str], known: Iterable[str]) -> list[str]:
    """Each name once, in the order of a registry, unknown ones last."""
    result, first = set(names), list(known)
    return [name for name in first if name in result] + sorted(result.difference(first))


def failures(rows: Iterable[Row]) -> list[Failure]:
    """Failures grouped by similar reasons, the most frequent first; a failed plan counts once for all controllers."""
    failed = [row for row in rows if row.reason]
    once = [row for row in motions(failed) if not row.planned] + [row for row in failed if row.planned]
    result: dict[str, list[Row]] = {}
    for row in once:
        pattern = re.sub(r"'[^']*'|[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?", "…", row.reason)
        result.setdefault(pattern, []).append(row)
    created = []
    for pattern, members in result.items():
        counts = sorted(Counter(row.planner for row in members).items(), key=lambda item: (-item[1], item[0]))
        step, _, rest = pattern.partition(": ")
        created.append(Failure(step, rest, members[0].reason.partition(": ")[2], tuple(counts)))
    return sorted(created, key=lambda failure: (-failure.total, failure.step, failure.pattern))


#: Questions, with the column that answers each, and whether larger is better; the first one is answered by arrival.
QUESTIONS = {
    "arrives": ("", True),
    "is planned soonest": ("planning_s", False),
    "is shortest": ("path_ranges", False),
    "is smoothest": ("jerk_joints", False),
    "keeps clear, proved": ("proved_clearance_mm", True),
    "withstands pushes, proved": ("tube_mm", True),
}
# Planners that arrive at least this fraction as often as the best are compared further; medians this close are ties.
_NEARLY, _TIE = 0.95, 0.02


class Win(NamedTuple):
    """The best planners in one respect: their names, their value, and the next name and value, if there is one."""

    names: tuple[str, ...]
    value: float
    next: tuple[str, float] | None


def winners(rows: Sequence[Row], controller: str) -> dict[str, dict[str, Win | None]]:
    """The winners of each scene, by question; None where no planner has a value, for example no proved clearance.

    Planners with less than half of the seeds are left out. Planners that arrive at nearly as many targets as the best
    one are compared by their medians over the problems that all of them solved. The value of arrival is a fraction.
    """
    seeds = seeds_by_planner(rows)
    enough = [name for name in seeds if 2 * seeds[name] >= max(seeds.values())]
    result: dict[str, dict[str, Win | None]] = {}
    for place in grouped([row for row in rows if row.controller == controller and row.planner in enough], ("scene",)):
        groups = {group.key[0]: group for group in grouped(place.rows, ("planner",))}
        share = {name: groups[name].successes / groups[name].total for name in in_order(groups, PLANNERS)}
        good = [name for name, part in share.items() if part >= _NEARLY * max(share.values())]
        solved = [{(row.arm, row.seed) for row in groups[name].rows if row.success} for name in good]
        common = set.intersection(*solved)
        alike = {name: [row for row in groups[name].rows if (row.arm, row.seed) in common] for name in good}
        result[place.key[0]] = {}
        for question, (column, more) in QUESTIONS.items():
            values = share
            if column:
                medians = {
                    name: Group((name,), tuple(motions(own))).median(column) for name, own in alike.items() if own
                }
                values = {name: value for name, value in medians.items() if value is not None}
            result[place.key[0]][question] = _win(values, more)
    return result


def _win(values: dict[str, float], more: bool) -> Win | None:
    if not values:
        return None
    order = sorted(values.items(), key=itemgetter(1), reverse=more)
    best = order[0][1]
    ties = [name for name, value in order if abs(value - best) <= _TIE * abs(best)]
    return Win(tuple(in_order(ties, PLANNERS)), best, order[len(ties)] if len(ties) < len(order) else None)
