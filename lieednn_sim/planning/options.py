"""Base class of the planners' options: each field is checked by its type."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, get_args, get_origin, get_type_hints

from lieednn_sim.errors import InputError
from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION
from lieednn_sim.validation import as_choice, as_count, as_positive, quoted
from lieednn_sim.values import set_fields

# The types of a class's annotations, evaluated once.
_kinds: Callable[[type], dict[str, Any]] = cache(get_type_hints)


@dataclass(frozen=True)
class PlannerOptions:
    """Base class of the options of planners, of their parts, and of policies.

    A field's annotation says what it takes: ``int`` an integer from 1 on, ``float`` a positive number, ``tuple[...]``
    one or more items, any other class an instance of it. The field's metadata may bound numbers further by ``range``,
    and list the allowed names by ``choices``.

    Raises:
        InputError: a value is not allowed.
    """

    def __post_init__(self) -> None:
        kinds = _kinds(type(self))
        for entry in fields(self):
            value = _checked(entry.name, getattr(self, entry.name), kinds[entry.name])
            low, high = entry.metadata.get("range", (-math.inf, math.inf))
            for item in value if isinstance(value, tuple) else (value,):
                if isinstance(item, int | float) and not low <= item <= high:
                    raise InputError(f"{entry.name} must be from {low:g} to {high:g}, got {item:g}")
                if "choices" in entry.metadata:
                    as_choice(entry.name, item, entry.metadata["choices"])
            set_fields(self, **{entry.name: value})


def given_options(
    what: str, kind: type[PlannerOptions] | None, options: PlannerOptions | None
) -> tuple[PlannerOptions, ...]:
    """The options to call ``what`` with: those given, or the defaults of the class ``kind``; none if it is None.

    `InputError` if the options given are of another class, or ``what`` has none.
    """
    if options is not None and (kind is None or not isinstance(options, kind)):
        allowed = "has no options" if kind is None else f"takes options of class {kind.__name__}"
        raise InputError(f"{what} {allowed}, got {type(options).__name__}")
    return () if kind is None else (kind() if options is None else options,)


@dataclass(frozen=True)
class NetworkOptions(PlannerOptions):
    """Base class of the options of planners that make networks.

    Attributes:
        activation: a name of `network.ACTIVATIONS`.
    """

    activation: str = field(default=DEFAULT_ACTIVATION, kw_only=True, metadata={"choices": ACTIVATIONS})


def _checked(name: str, value: Any, kind: Any) -> Any:
    if get_origin(kind) is tuple:
        if not isinstance(value, tuple | list) or not value:
            raise InputError(f"{name} must be a tuple of at least one number, got {quoted(value)}")
        return tuple(_checked(name, item, get_args(kind)[0]) for item in value)
    if kind in (int, float):
        return as_count(name, value) if kind is int else as_positive(name, value)
    if not isinstance(value, kind):
        raise InputError(f"{name} must be a {kind.__name__}, got {quoted(value)}")
    return value
