"""Statistics over rows: groups, medians, success rates with intervals, and failures by reason."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.rows import BY_NAME, Case, Row
from lieednn_sim.simulation import CONTROLLERS

# The parts of a reason that vary from case to case: names in quotes, and numbers.
_QUOTED = re.compile(r"'[^']*'")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Group:
    """Rows with equal values in some columns.

    Attributes:
        key: these values.
        rows: at least one.
    """

    key: tuple[str, ...]
    rows: tuple[Row, ...]

    @property
    def total(self) -> int:
        """Number of rows."""
        return len(self.rows)

    @property
    def successes(self) -> int:
        """Rows that succeeded."""
        return sum(row.success for row in self.rows)

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % confidence interval of the success rate."""
        return wilson(self.successes, self.total)

    def values(self, column: str) -> list[float]:
        """The numbers in a column, without missing ones."""
        return numbers(self.rows, column)

    def median(self, column: str) -> float | None:
        """Median of `values`, or None."""
        found = self.values(column)
        return float(np.median(found)) if found else None

    def verdict(self) -> str:
        """Proven stability, such as "global 9/10, local 1/10"; "-" without a network."""
        found = [row.stability for row in motions(self.rows) if row.stability not in ("", "-")]
        if not found:
            return "-"
        if len(set(found)) == 1:
            return found[0]
        return ", ".join(
            f"{name} {found.count(name)}/{len(found)}" for name in ("global", "local", "none") if name in found
        )


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


def wilson(successes: int, total: int) -> tuple[float, float]:
    """Wilson's 95 % score interval of a proportion (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927).

    Raises:
        InputError: not 0 <= successes <= total, or total is 0.
    """
    if not 0 <= successes <= total or total == 0:
        raise InputError(f"need 0 <= successes <= total and total > 0, got {successes} of {total}")
    rate, z2 = successes / total, float(ndtri(0.975)) ** 2
    centre = rate + z2 / (2 * total)
    half = (z2 * (rate * (1.0 - rate) + z2 / (4 * total)) / total) ** 0.5
    low, high = ((centre + end) / (1.0 + z2 / total) for end in (-half, half))
    return max(low, 0.0), min(high, 1.0)


def grouped(rows: Iterable[Row], columns: Sequence[str]) -> list[Group]:
    """Rows grouped by the values of some columns, in the order of first occurrence."""
    found: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(getattr(row, name) for name in columns), []).append(row)
    return [Group(key, tuple(members)) for key, members in found.items()]


def motions(rows: Iterable[Row]) -> list[Row]:
    """One row for each motion, whose plan is the same for all controllers."""
    first: dict[Case, Row] = {}
    for row in rows:
        first.setdefault(row.case, row)
    return list(first.values())


def numbers(rows: Iterable[Row], column: str) -> list[float]:
    """The numbers in a column, without missing ones; one for each motion if the column belongs to the plan."""
    chosen = motions(rows) if BY_NAME[column].of_motion else rows
    found = (getattr(row, column) for row in chosen)
    return [float(value) for value in found if value is not None]


def seeds_by_planner(rows: Iterable[Row]) -> dict[str, int]:
    """Number of seeds of each planner."""
    found: dict[str, set[int]] = {}
    for row in rows:
        found.setdefault(row.planner, set()).add(row.seed)
    return {planner: len(seeds) for planner, seeds in found.items()}


def controllers_of(rows: Iterable[Row]) -> list[str]:
    """The controllers of rows, first those of the package in its order."""
    found = sorted({row.controller for row in rows})
    return [*(name for name in CONTROLLERS if name in found), *(name for name in found if name not in CONTROLLERS)]


def failures(rows: Iterable[Row]) -> list[Failure]:
    """Failures grouped by similar reasons, the most frequent first.

    A plan's failure counts once, not once for each controller.
    """
    failed = [row for row in rows if row.reason]
    once = [row for row in motions(failed) if not row.planned] + [row for row in failed if row.planned]
    found: dict[str, list[Row]] = {}
    for row in once:
        found.setdefault(pattern_of(row.reason), []).append(row)
    made = []
    for pattern, members in found.items():
        names = [row.planner for row in members]
        counts = sorted({name: names.count(name) for name in names}.items(), key=lambda item: (-item[1], item[0]))
        step, _, rest = pattern.partition(": ")
        made.append(Failure(step, rest, members[0].reason.partition(": ")[2], tuple(counts)))
    return sorted(made, key=lambda failure: (-failure.total, failure.step, failure.pattern))


def pattern_of(reason: str) -> str:
    """A reason with names and numbers replaced by an ellipsis."""
    return _NUMBER.sub("…", _QUOTED.sub("…", reason))
