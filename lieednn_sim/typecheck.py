"""Checks of the arguments of public functions against their annotations.

A module that users import from ends with ``typecheck_public(globals())``. From then on its public functions and classes
refuse an argument of another type with an `InputError` that names it. Modules of this package import functions from the
modules that define them, without these checks; methods are checked for all callers. Shapes and entries of arrays are
checked by `validation.as_floats`, where the arrays are used.
"""

from __future__ import annotations

import inspect
import numbers
import os
import sys
import types
import typing
from collections import ChainMap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import wraps
from itertools import chain, repeat
from typing import Any, NamedTuple

import numpy as np
import scipy

from lieednn_sim.errors import InputError
from lieednn_sim.validation import quoted

# A function is left as it is if all its parameters have these annotations: `as_floats` checks them closely.
_CHECKED_WITHIN = {"ArrayLike", "ArrayLike | None", "Floats", "Floats | None", "Any", "object"}
# Hints on how to get an object of these types.
_SOURCES = {
    "Arm": "see Arm.load",
    "Motion": "see plan",
    "Rollout": "see simulate",
    "Following": "see follow",
    "MatrixLieGroup": "see lieednn_sim.theory.group",
    "PlannerOptions": "see PLANNERS[planner].options",
}


class _Hint(NamedTuple):
    """What an annotation asks for."""

    wanted: str  # in words
    accepts: Callable[[Any], bool]  # whether a value is of this kind, regardless of its parts
    # The parts of such a value that have their own hint: for each its place, such as ``[2]``, its hint, and the part.
    parts: Callable[[Any], Iterable[tuple[str, _Hint, Any]]] | None = None


class Array:
    """Stands for ``ArrayLike``, which is a union itself: its members would mix with those of another union."""


def typecheck_public(namespace: dict[str, Any]) -> None:
    """Let all public functions and classes of a module check the types of their arguments.

    The namespace is the module's ``globals()``. The public names are those of its ``__all__``; without one, as in the
    ``__init__`` of a subpackage, all names that it imports, and ``__all__`` is set to them. Functions are replaced in
    the namespace, and get this module as theirs, where pickle finds them; methods are replaced in their classes.
    """
    imported = [name for name, value in namespace.items() if not (name.startswith("_") or inspect.ismodule(value))]
    for name in namespace.setdefault("__all__", sorted({*imported} - {typecheck_public.__name__})):
        value = namespace[name]
        if isinstance(value, types.FunctionType):
            namespace[name] = checked = typechecked(value)
            if checked is not value:
                checked.__module__ = namespace["__name__"]
        elif isinstance(value, type):
            for cls in value.__mro__:
                if cls.__module__.startswith(__package__):
                    _check_methods(cls)


def _check_methods(cls: type) -> None:
    for name, value in list(vars(cls).items()):
        kind = type(value) if isinstance(value, classmethod | staticmethod) else None
        function = value if kind is None else value.__func__
        public = name in ("__init__", "__call__", "__getitem__") or not name.startswith("_")
        if public and isinstance(function, types.FunctionType):
            checked = typechecked(function, cls)
            if checked is not function:
                # So that pickle finds it, even if it was a function of a module.
                checked.__module__, checked.__qualname__ = cls.__module__, f"{cls.__qualname__}.{name}"
                setattr(cls, name, checked if kind is None else kind(checked))


def typechecked(function: Callable[..., Any], cls: type | None = None) -> Callable[..., Any]:
    """Wrap a function, or a method of a class, in a check of its arguments' types, unless it has one or needs none.

    It needs none if its docstring calls it unchecked, for inner loops. Annotations are read at the first call, when all
    modules are loaded.
    """
    annotations = {text for name, text in function.__annotations__.items() if name != "return"}
    if (
        "unchecked" in (function.__doc__ or "")
        or hasattr(function, "__typechecked__")
        or annotations <= (_CHECKED_WITHIN if function.__name__ != "__init__" else set())
    ):
        return function
    code, hints = inspect.unwrap(function).__code__, dict[str, _Hint]()
    positional = code.co_varnames[: code.co_argcount]

    @wraps(function)
    def checking(*arguments: Any, **options: Any) -> Any:
        if not hints:
            hints.update((name, _hint(kind)) for name, kind in annotations_of(function, cls).items())
        for name, value in chain(zip(positional, arguments, strict=False), options.items()):
            hint = hints.get(name)
            # The fast path: most values have no parts and the right type.
            if hint and (hint.parts or not hint.accepts(value)):
                _require(name, hint, value)
        return function(*arguments, **options)

    checking.__typechecked__ = True  # type: ignore[attr-defined]
    return checking


def _require(name: str, hint: _Hint, value: Any) -> None:
    """Raise `InputError` if a value, or one of its parts, is not what is asked for."""
    if not hint.accepts(value):
        # The `repr` of any other object may be long and useless.
        shown = isinstance(value, None | str | bytes | numbers.Number | np.generic | Collection | type)
        given = quoted(value) if shown else _with_article(type(value).__name__)
        source = next((f"; {_SOURCES[word]}" for word in hint.wanted.split() if word in _SOURCES), "")
        public = [part for part, own in getattr(value, "__dict__", {}).items() if part[0] != "_" and hint.accepts(own)]
        wrapped = hasattr(value, "ptr") and hint.accepts(value.ptr)  # by dm_control
        source = "; give its .ptr" if wrapped else f"; give its .{public[0]}" if source and public else source
        raise InputError(f"{name} must be {hint.wanted}, got {given}{source}")
    for place, inner, part in () if hint.parts is None else hint.parts(value):
        _require(name + place, inner, part)


def annotations_of(function: Callable[..., Any], cls: type | None = None) -> dict[str, Any]:
    """The types that the annotations of a function's parameters mean, by name; arguments as for `typechecked`."""
    # A field may be inherited from another module, in which its annotation must be evaluated. Names that are imported
    # only for type checkers are SciPy's, and an alias of another module may use names of `typing`.
    modules = [vars(sys.modules[base.__module__]) for base in (cls.__mro__ if cls else ())]
    others = vars(scipy.spatial.transform), vars(typing)
    names = ChainMap({"ArrayLike": Array}, inspect.unwrap(function).__globals__, *modules, *others)
    result = {name: _evaluate(hint, names) for name, hint in function.__annotations__.items() if name != "return"}
    for hint in list(result.values()):
        if typing.get_origin(hint) is typing.Unpack:
            result |= typing.get_type_hints(*typing.get_args(hint))
    return result


def _evaluate(hint: Any, names: Mapping[str, Any]) -> Any:
    # Evaluated again if the result is a text: the name may be of an alias, or of a variable's bound, that is a text.
    hint = getattr(getattr(hint, "__bound__", None), "__forward_arg__", hint)
    return _evaluate(eval(hint, {}, names), names) if isinstance(hint, str) else hint


def _hint(hint: Any) -> _Hint:
    kind, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind in _PLAIN:
        return _PLAIN[kind]
    if kind in (typing.Union, types.UnionType):
        return _union([_hint(item) for item in inner])
    if isinstance(kind, typing.TypeVar):
        return _hint(kind.__bound__ or Any)
    if kind is type and inner:
        base = getattr(inner[0], "__bound__", inner[0])
        target = f"a subclass of {base.__name__}"
        return _Hint(target, lambda value: isinstance(value, type) and issubclass(value, base))
    if kind in (tuple, list, Sequence, Collection):
        fixed = kind is tuple and bool(inner) and Ellipsis not in inner
        return _sequence([_hint(item) for item in (inner if fixed else inner[:1])] or [_ANYTHING], fixed=fixed)
    if kind in (dict, Mapping) or typing.is_typeddict(kind):
        return _mapping(*map(_hint, inner or (Any, Any)))
    if not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return _ANYTHING
    package = kind.__module__.partition(".")[0]
    origin = "" if package == __package__ or package in sys.stdlib_module_names else f" of {package}"
    return _Hint(_with_article(kind.__name__) + origin, lambda value: isinstance(value, kind))


def _with_article(name: str) -> str:
    """The name of a class in a sentence; a plural such as ``Disturbances`` has no article."""
    return name if name.endswith("s") else f"an {name}" if name[0] in "AEIOUaeiou" else f"a {name}"


def _is_number(value: object, abstract: type, kinds: str) -> bool:
    """Whether a value is a number but no truth value, or an array without axes of one of these kinds of types."""
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in kinds and value is not np.ma.masked
    return isinstance(value, abstract) and not isinstance(value, bool)


def _is_real(value: object) -> bool:
    return type(value) is float or _is_number(value, numbers.Real, "iuf")


def _is_list(value: object) -> bool:
    """Whether a value is a sequence or another collection, except texts and mappings; arrays need at least one axis."""
    if not isinstance(value, Collection) or isinstance(value, str | bytes | bytearray | Mapping):
        return False
    return getattr(value, "ndim", 1) > 0  # also of arrays of other libraries, whose length would raise


_ANYTHING = _Hint("anything", lambda _: True)
_PLAIN: dict[Any, _Hint] = {
    **dict.fromkeys((Any, object), _ANYTHING),
    **dict.fromkeys(
        (Array, np.ndarray, np.typing.NDArray),  # the last is a type of its own since NumPy 2.5
        _Hint("an array of numbers", lambda value: hasattr(value, "__array__") or _is_real(value) or _is_list(value)),
    ),
    **dict.fromkeys((None, type(None)), _Hint("None", lambda value: value is None)),
    Callable: _Hint("a function", callable),
    # An iterator can be read only once, so its items are left to the function.
    Iterable: _Hint("a list", lambda value: _is_list(value) or isinstance(value, Iterator)),
    str: _Hint("a string", lambda value: isinstance(value, str)),
    os.PathLike: _Hint("a path", lambda value: isinstance(value, os.PathLike)),
    bool: _Hint("True or False", lambda value: isinstance(value, bool | np.bool_)),
    int: _Hint("a whole number", lambda value: type(value) is int or _is_number(value, numbers.Integral, "iu")),
    float: _Hint("a number", _is_real),
}


def _union(hints: list[_Hint]) -> _Hint:
    # Messages leave out None: a user who gave a value did not mean None.
    target = " or ".join(dict.fromkeys(hint.wanted for hint in hints if hint.wanted != "None"))

    def parts(value: Any) -> Iterable[tuple[str, _Hint, Any]]:
        # The first hint that accepts the value is the only one, since no annotation has two kinds of lists.
        find = next(hint for hint in hints if hint.accepts(value)).parts
        return find(value) if find else ()

    simple = all(hint.parts is None for hint in hints)
    return _Hint(target, lambda value: any(hint.accepts(value) for hint in hints), None if simple else parts)


def _sequence(items: list[_Hint], *, fixed: bool) -> _Hint:
    target = f"a tuple of {len(items)}" if fixed else "a list"
    if len({item.wanted for item in items} - {_ANYTHING.wanted}) == 1:
        target += f", each item {items[0].wanted}"

    def parts(value: Any) -> Iterable[tuple[str, _Hint, Any]]:
        # Items of an array of numbers, or of a range, are all alike and may be many: one of them is checked.
        alike = isinstance(value, range) or (isinstance(value, np.ndarray) and value.dtype != object)
        pairs = zip(items if fixed else repeat(items[0]), value[:1] if alike else value, strict=False)
        return ((f"[{index}]", *pair) for index, pair in enumerate(pairs))

    return _Hint(target, lambda value: _is_list(value) and (not fixed or len(value) == len(items)), parts)


def _mapping(key: _Hint, item: _Hint) -> _Hint:
    def parts(value: Any) -> Iterable[tuple[str, _Hint, Any]]:
        keys = ((": its keys", key, name) for name in value)
        return chain(keys, ((f"[{quoted(name)}]", item, entry) for name, entry in value.items()))

    return _Hint("a dictionary", lambda value: isinstance(value, Mapping), parts)
