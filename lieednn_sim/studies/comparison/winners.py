"""The winners of each scene: the planners that are best in one respect, on problems that all good planners solved."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple

from lieednn_sim.registry import PLANNERS
from lieednn_sim.studies.comparison.rows import Row
from lieednn_sim.studies.comparison.summary import in_order, seeds_by_planner
from lieednn_sim.studies.rows import Group, grouped, motions

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
