"""What the planners' options have in common: each field is checked against its default."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_count, as_positive, quoted


@dataclass(frozen=True)
class PlannerOptions:
    """Base of the options of planners.

    A field whose default is a whole number takes whole numbers from 1 on, one whose default is another number positive
    ones, one whose default is a tuple any number of these, and any other what is of its default's class.

    Raises:
        InputError: a value is something else.
    """

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, _checked(field.name, getattr(self, field.name), field.default))


def _checked(name: str, value: Any, default: Any) -> Any:
    if isinstance(default, tuple):
        if not isinstance(value, tuple | list) or not value:
            raise InputError(f"{name} must be a tuple of at least one number, got {quoted(value)}")
        return tuple(_checked(name, one, default[0]) for one in value)
    if isinstance(default, int):
        return as_count(name, value)
    if isinstance(default, float):
        return as_positive(name, value)
    if not isinstance(value, type(default)):
        raise InputError(f"{name} must be a {type(default).__name__}, got {quoted(value)}")
    return value
