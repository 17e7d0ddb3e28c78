"""Rows of tables: their keys and columns, declared once as the fields of a dataclass."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

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
