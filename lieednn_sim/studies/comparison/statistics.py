"""Statistics of a comparison: proven stability, seeds, and failures by reason."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from lieednn_sim.registry import CONTROLLERS
from lieednn_sim.studies.comparison.rows import Row
from lieednn_sim.studies.statistics import motions, pattern_of


@dataclass(frozen=True)
class Failure:
    """Failures whose reasons differ only in names and numbers.

    Attributes:
        step: where it failed: "problem", "plan", "simulation", "contact", "arrival" or "error".
        pattern: the reason with names and numbers replaced by an ellipsis.
        example: one reason in full.
        counts: number of rows by planner, largest first.
    """

    step: str
    pattern: str
    example: str
    counts: tuple[tuple[str, int], ...]

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
    return ", ".join(
        f"{name} {results.count(name)}/{len(results)}" for name in ("global", "local", "none") if name in results
    )


def seeds_by_planner(rows: Iterable[Row]) -> dict[str, int]:
    """Number of seeds of each planner."""
    result: dict[str, set[int]] = {}
    for row in rows:
        result.setdefault(row.planner, set()).add(row.seed)
    return {planner: len(seeds) for planner, seeds in result.items()}


def in_order(names: Iterable[str], known: Iterable[str]) -> list[str]:
    """Each name once, in the order of a registry, unknown ones last."""
    result, first = set(names), list(known)
    return [name for name in first if name in result] + sorted(result.difference(first))


def controllers_of(rows: Iterable[Row]) -> list[str]:
    """The controllers of rows, in the order of the registry."""
    return in_order((row.controller for row in rows), CONTROLLERS)


def failures(rows: Iterable[Row]) -> list[Failure]:
    """Failures grouped by similar reasons, the most frequent first.

    A plan's failure counts once, not once for each controller.
    """
    failed = [row for row in rows if row.reason]
    once = [row for row in motions(failed) if not row.planned] + [row for row in failed if row.planned]
    result: dict[str, list[Row]] = {}
    for row in once:
        result.setdefault(pattern_of(row.reason), []).append(row)
    created = []
    for pattern, members in result.items():
        names = [row.planner for row in members]
        counts = sorted({name: names.count(name) for name in names}.items(), key=lambda item: (-item[1], item[0]))
        step, _, rest = pattern.partition(": ")
        created.append(Failure(step, rest, members[0].reason.partition(": ")[2], tuple(counts)))
    return sorted(created, key=lambda failure: (-failure.total, failure.step, failure.pattern))
