"""Base class of the planners' options: each field is checked against its default."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_count, as_positive, quoted


@dataclass(frozen=True)
class PlannerOptions:
    """Base class of the options of planners and of their parts, such as the filter and searches.

    A field with an integer default takes integers from 1 on; with another number, positive numbers; with a tuple, one
    or more of the same; with anything else, including True and False, values of the default's class. Numbers may have
    further bounds, in the field's metadata ``range``.

    Raises:
        InputError: a value is not allowed.
    """

    def __post_init__(self) -> None:
        for field in fields(self):
            value = _checked(field.name, getattr(self, field.name), field.default)
            low, high = field.metadata.get("range", (-math.inf, math.inf))
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, int | float) and not low <= number <= high:
                    raise InputError(f"{field.name} must be from {low:g} to {high:g}, got {number:g}")
            object.__setattr__(self, field.name, value)


def _checked(name: str, value: Any, default: Any) -> Any:
    if isinstance(default, tuple):
        if not isinstance(value, tuple | list) or not value:
            raise InputError(f"{name} must be a tuple of at least one number, got {quoted(value)}")
        return tuple(_checked(name, one, default[0]) for one in value)
    if isinstance(default, int) and not isinstance(default, bool):
        return as_count(name, value)
    if isinstance(default, float):
        return as_positive(name, value)
    if not isinstance(value, type(default)):
        raise InputError(f"{name} must be a {type(default).__name__}, got {quoted(value)}")
    return value
