"""Immutable results that compare equal when their contents are equal, and measured numbers in words.

Classes with arrays use `frozen`, others ``dataclass(frozen=True)``. Both set fields in their ``__post_init__`` by
`check_fields` and `set_fields`.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import wraps
from typing import Any, TypeVar, dataclass_transform
from weakref import WeakKeyDictionary

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]  # real arrays; their shapes are documented where they are used
Ints = NDArray[np.int_]
StrPath = str | os.PathLike[str]
_Class = TypeVar("_Class")


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def frozen(cls: type[_Class]) -> type[_Class]:
    """Make a class a frozen dataclass with read-only arrays, which compares equal when all its fields do.

    Arrays may also be within tuples, lists and dictionaries. The given arrays are not changed: the instance has
    read-only views of them. Arrays are equal if their shapes and entries are, with NaN equal to NaN. Equal instances
    have the same hash; `dataclasses.replace` makes a changed copy. All this also holds for unpickled and deep copies.
    The ``repr`` holds the first line of the class's own ``str``; else its fields, long ones by type and shape only.
    """
    result: Any = dataclass(frozen=True, eq=False, repr=False)(cls)
    initialise, names = result.__init__, [item.name for item in fields(result)]
    compared, told = ([item.name for item in fields(result) if getattr(item, use)] for use in ("compare", "repr"))

    @wraps(initialise)
    def __init__(self: Any, *arguments: Any, **named: Any) -> None:
        initialise(self, *arguments, **named)
        for name in names:
            object.__setattr__(self, name, _as_read_only(getattr(self, name)))

    def __repr__(self: Any) -> str:
        if "__str__" in vars(type(self)):
            return f"<{type(self).__qualname__}: {str(self).splitlines()[0]}>"
        return f"{type(self).__qualname__}({', '.join(f'{name}={_shown(getattr(self, name))}' for name in told)})"

    def __eq__(self: Any, other: object) -> Any:
        if type(other) is not type(self):
            return NotImplemented
        return all(_equal(getattr(self, name), getattr(other, name)) for name in compared)

    def __hash__(self: Any) -> int:
        values = (vars(self)[name] for name in compared)
        return hash((type(self), *(item.shape for item in values if isinstance(item, np.ndarray))))

    def __setstate__(self: Any, state: dict[str, Any]) -> None:
        # Unpickled and deep-copied arrays are writable.
        vars(self).update({name: _as_read_only(item) for name, item in state.items()})

    if cls.__repr__ is object.__repr__:
        result.__repr__ = __repr__
    result.__init__, result.__eq__, result.__hash__, result.__setstate__ = __init__, __eq__, __hash__, __setstate__
    return result


def weakly_cached(function: Callable[..., _Class]) -> Callable[..., _Class]:
    """Decorator: a cache for each thread. Its results live as long as the first argument, and must not refer to it."""
    results: WeakKeyDictionary[Any, dict[Any, _Class]] = WeakKeyDictionary()

    @wraps(function)
    def cached(first: Any, *others: Any, **named: Any) -> _Class:
        # Results may hold an `MjData`, which no two threads may use at once.
        known, key = results.setdefault(first, {}), (threading.get_ident(), *others, *named.items())
        if key not in known:
            known[key] = function(first, *others, **named)
        return known[key]

    return cached


def set_fields(value: Any, /, **fields: Any) -> None:
    """Set fields of a frozen dataclass, for its own `__post_init__`; arrays are copied and made read-only."""
    for name, item in fields.items():
        object.__setattr__(value, name, read_only(item.copy()) if isinstance(item, np.ndarray) else item)


def check_fields(value: Any, check: Callable[..., Any], *names: str, **how: Any) -> None:
    """Replace the named fields of a frozen dataclass by the results of a check of `validation`; arrays are kept."""
    for name in names:
        object.__setattr__(value, name, check(name, getattr(value, name), **how))


def read_only(array: Floats) -> Floats:
    """Make an array read-only, and return it."""
    array.setflags(write=False)
    return array


def rounded(value: float, least: float = 1e-4) -> str:
    """A measured number for people: three digits or more, and 0 below ``least``, where only rounding is left."""
    if abs(value) >= 1000.0:
        return f"{value:.0f}"
    return "0" if abs(value) < least else f"{value:.3g}"


def distances(translation: float, rotation: float) -> str:
    """A distance [m] and an angle [rad] in words."""
    return f"{rounded(1e3 * translation)} mm and {rounded(np.rad2deg(rotation))} degrees"


def _as_read_only(item: Any) -> Any:
    if isinstance(item, np.ndarray) and item.flags.writeable:
        item = item.view()
        item.flags.writeable = False
    # Exactly these types, since named tuples and other mappings have other constructors.
    elif type(item) in (tuple, list):
        return type(item)(map(_as_read_only, item))
    elif type(item) is dict:
        return {key: _as_read_only(entry) for key, entry in item.items()}
    return item


def _shown(item: Any) -> str:
    text, kind = repr(item), f"{type(item).__name__} {getattr(item, 'shape', '')}".strip()
    short = text if isinstance(item, str) else " ".join(text.split())
    return short if len(short) <= 120 or isinstance(item, str) else f"<{kind}>"


def _equal(first: Any, second: Any) -> bool:
    if first is second:
        return True
    if type(first) is not type(second):
        return bool(np.isscalar(first) and np.isscalar(second) and first == second)
    if isinstance(first, np.ndarray):
        return np.array_equal(first, second, equal_nan=first.dtype.kind in "fc")
    if isinstance(first, tuple | list):
        return len(first) == len(second) and all(map(_equal, first, second))
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(_equal(entry, second[key]) for key, entry in first.items())
    if isinstance(first, scipy.spatial.transform.RigidTransform | scipy.spatial.transform.Rotation):
        return np.array_equal(first.as_matrix(), second.as_matrix())
    return bool(first == second) or (isinstance(first, float) and first != first and second != second)
