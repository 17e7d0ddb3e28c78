"""Rows of tables: their keys, measured columns, and cells in a CSV file."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self

from lieednn_sim.errors import InputError
from lieednn_sim.values import set_fields


@dataclass(frozen=True)
class Column:
    """A measured column.

    Attributes:
        name: name of the row's attribute, and of the column in the CSV file.
        heading: short heading with the unit.
        meaning: explanation in one line.
        of_motion: whether it belongs to the plan, so that it is the same for every controller.
    """

    name: str
    heading: str
    meaning: str
    of_motion: bool = False


def column(heading: str, meaning: str, *, of_motion: bool = False) -> Any:
    """A field of a row for a measured number, or None; arguments as in `Column`."""
    return field(default=None, metadata={"heading": heading, "meaning": meaning, "of_motion": of_motion})


def outcome() -> Any:
    """The field ``success`` of a row: whether its ``reason`` is empty."""
    return field(default=True, init=False)


def columns_of(kind: type[TableRow]) -> tuple[Column, ...]:
    """The measured columns of a kind of row."""
    return tuple(Column(entry.name, **entry.metadata) for entry in fields(kind) if entry.metadata)


@dataclass(frozen=True, slots=True)
class TableRow:
    """A row of a table, with a field for each column, among them ``success`` (see `outcome`) and ``reason``.

    Numbers are rounded to the digits of the file, so that a table is the same after saving and reading.
    """

    # The fields that form the key of a row, and the digits of numbers.
    _key: ClassVar[tuple[str, ...]]
    _digits: ClassVar[int]

    def __post_init__(self) -> None:
        kept: dict[str, Any] = {}
        for entry in fields(self):
            if isinstance(value := getattr(self, entry.name), float):
                kept[entry.name] = float(f"{value:.{self._digits}g}")
            elif isinstance(value, str):
                # A row is one line. Interned, since many rows share their texts.
                kept[entry.name] = sys.intern(" ".join(value.splitlines()))
                if entry.name == "reason" and value:
                    kept["success"] = False
        set_fields(self, **kept)

    @property
    def key(self) -> tuple[Any, ...]:
        """The values that identify the row."""
        return tuple(getattr(self, name) for name in self._key)

    @property
    def motion(self) -> Any:
        """A key that rows of the same planned motion have in common; by default, the key of the row."""
        return self.key

    def as_texts(self) -> dict[str, str]:
        """The row's cells in a CSV file."""
        return {entry.name: self._as_text(getattr(self, entry.name)) for entry in fields(self)}

    @classmethod
    def from_texts(cls, texts: dict[str, str]) -> Self:
        """The inverse of `as_texts`; `ValueError` if a cell does not have its column's type."""
        if texts.keys() != {entry.name for entry in fields(cls)} or None in texts.values():
            raise InputError("a row has too many or too few columns")
        if texts["success"] != ("no" if texts["reason"] else "yes"):
            raise InputError(f"success is {texts['success']!r} where the reason of a failure is {texts['reason']!r}")
        return cls(**{entry.name: _value(texts[entry.name], str(entry.type)) for entry in fields(cls) if entry.init})

    def _as_text(self, value: bool | int | float | str | None) -> str:
        if isinstance(value, bool):
            return "yes" if value else "no"
        return "" if value is None else f"{value:.{self._digits}g}" if isinstance(value, float) else str(value)


def _value(text: str, kind: str) -> bool | int | float | str | None:
    """The value of a cell in a column with an annotated type."""
    if kind in ("str", "bool"):
        return text if kind == "str" else text == "yes"
    if kind.endswith("None") and not text:
        return None
    return int(text) if kind.startswith("int") else float(text)
