"""Statistics over rows of any table: groups, medians, success rates with intervals, and reasons alike."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any, Generic, TypeVar

import numpy as np

from lieednn_sim.studies.rows import TableRow

R = TypeVar("R", bound=TableRow)


@dataclass(frozen=True)
class Group(Generic[R]):
    """One row or more with equal values, the key, in some columns."""

    key: tuple[str, ...]
    rows: tuple[R, ...]

    @property
    def total(self) -> int:
        """Number of rows."""
        return len(self.rows)

    @property
    def successes(self) -> int:
        """Rows that succeeded."""
        return sum(map(attrgetter("success"), self.rows))

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % confidence interval of the success rate."""
        return wilson(self.successes, self.total)

    def values(self, column: str) -> list[float]:
        """The numbers in a column, without missing ones."""
        return numbers(self.rows, column)

    def median(self, column: str) -> float | None:
        """Median of `values`, or None."""
        result = self.values(column)
        return float(np.median(result)) if result else None


def wilson(successes: int, total: int) -> tuple[float, float]:
    """Wilson's 95 % score interval of a proportion (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    # Slow to import, and asked for at the end of a study.
    from scipy.stats import binomtest

    interval = binomtest(successes, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def grouped(rows: Iterable[R], columns: Sequence[str]) -> list[Group[R]]:
    """Rows grouped by the values of some columns, in the order of first occurrence."""
    result: dict[tuple[str, ...], list[R]] = {}
    for row in rows:
        result.setdefault(tuple(getattr(row, name) for name in columns), []).append(row)
    return [Group(key, tuple(members)) for key, members in result.items()]


def motions(rows: Iterable[R]) -> list[R]:
    """One row for each motion, whose plan is the same for all controllers."""
    first: dict[Any, R] = {}
    for row in rows:
        first.setdefault(row.motion, row)
    return list(first.values())


def numbers(rows: Sequence[R], column: str) -> list[float]:
    """The numbers in a column, without missing ones; one for each motion if the column belongs to the plan."""
    if not rows:
        return []
    of_motion = next(entry.metadata["of_motion"] for entry in fields(rows[0]) if entry.name == column)
    result = (getattr(row, column) for row in (motions(rows) if of_motion else rows))
    return [float(value) for value in result if value is not None]


def pattern_of(reason: str) -> str:
    """The reason of a failure with names and numbers replaced by an ellipsis, to group similar ones."""
    return re.sub(r"'[^']*'|[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?", "…", reason)
