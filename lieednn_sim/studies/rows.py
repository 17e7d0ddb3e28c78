"""Rows of tables: keys and columns, declared once as the fields of a dataclass; groups of rows and their statistics."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from operator import attrgetter
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from lieednn_sim.values import set_fields


@dataclass(frozen=True)
class Column:
    """A measured column."""

    name: str  # of the row's attribute, and of the column in the table
    heading: str  # with the unit
    meaning: str  # in one line
    of_motion: bool = False  # whether it belongs to the plan, so that it is the same for every controller
    timed: bool = False  # whether it is a time that was measured, which differs between runs
    # Its place in the page's table, from the left, after those of the same place before it; 0 for in its files only.
    shown: int = 0


def column(heading: str, meaning: str, *, of_motion: bool = False, timed: bool = False, shown: int = 0) -> Any:
    """A field of a row for a measured number, or None; arguments as in `Column`."""
    about = {"heading": heading, "meaning": meaning, "of_motion": of_motion, "timed": timed, "shown": shown}
    return field(default=None, metadata=about)


def outcome() -> Any:
    """The field ``success`` of a row: whether its ``reason`` is empty."""
    return field(default=True, init=False)


def columns_of(kind: type[TableRow]) -> tuple[Column, ...]:
    """The measured columns of a kind of row."""
    return tuple(Column(entry.name, **entry.metadata) for entry in fields(kind) if entry.metadata)


@dataclass(frozen=True, slots=True)
class TableRow:
    """A row of a table, with a field for each column, among them ``success`` (see `outcome`) and ``reason``."""

    # The fields that form the key of a row.
    _key: ClassVar[tuple[str, ...]]

    def __post_init__(self) -> None:
        texts = {entry.name: value for entry in fields(self) if isinstance(value := getattr(self, entry.name), str)}
        # A row is one line in every export. Interned, since many rows share their texts.
        lines = {name: sys.intern(" ".join(text.splitlines())) for name, text in texts.items()}
        set_fields(self, **lines, success=not lines["reason"])

    @property
    def key(self) -> tuple[Any, ...]:
        """The values that identify the row."""
        return tuple(getattr(self, name) for name in self._key)

    @property
    def motion(self) -> Any:
        """A key that rows of the same planned motion have in common; by default, the key of the row."""
        return self.key


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
        """The numbers in a column, without missing ones; one for each motion if the column belongs to the plan."""
        of_motion = next(entry.metadata["of_motion"] for entry in fields(self.rows[0]) if entry.name == column)
        result = (getattr(row, column) for row in (motions(self.rows) if of_motion else self.rows))
        return [float(value) for value in result if value is not None]

    def median(self, column: str) -> float | None:
        """Median of `values`, or None."""
        result = self.values(column)
        return float(np.median(result)) if result else None


def wilson(successes: int, total: int) -> tuple[float, float]:
    """Wilson's 95 % score interval of a proportion (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    square = 1.959963984540054**2  # of the normal distribution's quantile
    centre, spread = successes + 0.5 * square, square * (successes * (1.0 - successes / total) + 0.25 * square)
    low, high = ((centre + sign * spread**0.5) / (total + square) for sign in (-1.0, 1.0))
    return low if successes else 0.0, high if successes < total else 1.0


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
