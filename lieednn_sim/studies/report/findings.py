"""Headline numbers of a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lieednn_sim.studies.comparison.rows import Row
from lieednn_sim.studies.comparison.statistics import controllers_of
from lieednn_sim.studies.report.style import in_order, number
from lieednn_sim.studies.statistics import grouped, motions, numbers, wilson


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
