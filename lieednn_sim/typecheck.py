"""Arguments of public functions checked against their annotations, which say what is wanted anyway.

A module that users import from ends with ``typecheck_public(globals())``. From then on the functions and classes in its
``__all__`` refuse an argument of another type with an `InputError` that names it. Modules of this package import
functions from where they are defined, past these checks; methods are checked for everyone. Shapes and entries of arrays
are for `validation.as_floats`, where the arrays are used.
"""

from __future__ import annotations

import builtins
import inspect
import numbers
import os
import sys
import types
import typing
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import is_dataclass
from functools import wraps
from itertools import chain, repeat
from typing import Any, NamedTuple

import numpy as np

from lieednn_sim.errors import InputError
from lieednn_sim.validation import quoted

_SPECIAL_METHODS = ("__init__", "__call__", "__getitem__")
# A function is left as it is if all its parameters have these annotations: `as_floats` checks them closely.
_CHECKED_WITHIN = {"ArrayLike", "ArrayLike | None", "Floats", "Floats | None", "Any", "object"}
_WORDS = {str: "a string", os.PathLike: "a path", bool: "True or False", int: "a whole number", float: "a number"}
# Where to get what a user does not have at hand.
_SOURCES = {
    "Arm": "see Arm.load",
    "Motion": "see plan",
    "Rollout": "see simulate",
    "Following": "see follow",
    "MatrixLieGroup": "see lieednn_sim.theory.group",
    "PlannerOptions": "see PLANNERS[planner].options",
}


class _Fault(NamedTuple):
    """What is wrong, and where within the argument: ``[2]`` in the third item of a list."""

    place: str
    wanted: str
    given: object


_Find = Callable[[Any], _Fault | None]


class _Check(NamedTuple):
    """What is wanted, in words, and what finds the fault of a value."""

    wanted: str
    find: _Find


class _Array:
    """Stands for ``ArrayLike``, whose members could not be told from the others of a union."""


def typecheck_public(namespace: dict[str, Any]) -> None:
    """Let all functions and classes in a module's ``__all__`` check the types of their arguments.

    Args:
        namespace: the module's ``globals()``. Functions are replaced there, and are from then on this module's, where
            pickle finds them; methods are replaced in their classes.
    """
    for name in namespace["__all__"]:
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
        if isinstance(function, types.FunctionType) and (name in _SPECIAL_METHODS or not name.startswith("_")):
            checked = typechecked(function, cls)
            if checked is not function:
                setattr(cls, name, checked if kind is None else kind(checked))


def typechecked(function: Callable[..., Any], cls: type | None = None) -> Callable[..., Any]:
    """A function that checks the types of its arguments; the function itself if it does so already, or needs not.

    A function whose docstring calls it unchecked, for inner loops, needs not.

    Args:
        function: the function. Its annotations are read at the first call, when all modules are loaded.
        cls: the class whose method it is.
    """
    hints = {hint for name, hint in function.__annotations__.items() if name != "return"}
    if (
        "unchecked" in (function.__doc__ or "")
        or hasattr(function, "__typechecked__")
        or hints <= (_CHECKED_WITHIN if function.__name__ != "__init__" else set())
    ):
        return function
    checks: tuple[list[tuple[str, _Find]], tuple[str, _Find], dict[str, _Find]] | None = None

    @wraps(function)
    def checking(*arguments: Any, **options: Any) -> Any:
        nonlocal checks
        checks = checks or _checks(function, cls)
        positional, beyond, named = checks
        for value, (name, find) in zip(arguments, chain(positional, repeat(beyond)), strict=False):
            if (fault := find(value)) is not None:
                raise _error(name, fault)
        for name, value in options.items():
            if name in named and (fault := named[name](value)) is not None:
                raise _error(name, fault)
        return function(*arguments, **options)

    checking.__typechecked__ = True  # type: ignore[attr-defined]
    return checking


def _error(name: str, fault: _Fault) -> InputError:
    value = fault.given
    # The text of any other object may be long, and of no use.
    shown = isinstance(value, None | str | bytes | numbers.Number | np.generic | Collection)
    given = quoted(value) if shown or inspect.isclass(value) else _with_article(type(value).__name__)
    hint = next((f"; {_SOURCES[word]}" for word in fault.wanted.split() if word in _SOURCES), "")
    return InputError(f"{name}{fault.place} must be {fault.wanted}, got {given}{hint}")


def _checks(
    function: Callable[..., Any], cls: type | None
) -> tuple[list[tuple[str, _Find]], tuple[str, _Find], dict[str, _Find]]:
    """How to check the arguments of a function: by position, those beyond, and by name."""
    own: dict[str, Any] = inspect.unwrap(function).__globals__
    positional: list[tuple[str, _Find]] = []
    beyond: tuple[str, _Find] = ("", _accept)
    named: dict[str, _Find] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        hint, scope = parameter.annotation, own
        if function.__name__ == "__init__" and is_dataclass(cls) and name != "self":
            # A field may be inherited from another module, where its annotation has its meaning.
            owners = (base for base in cls.__mro__ if name in vars(base).get("__annotations__", {}))
            scope = vars(sys.modules[next(owners, cls).__module__])
        if parameter.kind is parameter.VAR_KEYWORD:
            for options in typing.get_args(_evaluate(hint, scope)):  # of `Unpack`
                scope = vars(sys.modules[options.__module__])
                named |= {key: _check(_evaluate(text, scope)).find for key, text in options.__annotations__.items()}
            continue
        find = _accept if hint is parameter.empty else _check(_evaluate(hint, scope)).find
        if parameter.kind is parameter.VAR_POSITIONAL:
            beyond = name, find
            continue
        if parameter.kind is not parameter.KEYWORD_ONLY:
            positional.append((name, find))
        named[name] = find
    return positional, beyond, named


def _evaluate(hint: Any, scope: Mapping[str, Any]) -> Any:
    text = hint.__forward_arg__ if isinstance(hint, typing.ForwardRef) else hint
    # Twice, if it is the name of an alias that is a text itself.
    return _evaluate(eval(text, {}, _Names(scope, ArrayLike=_Array)), scope) if isinstance(text, str) else text


class _Names(dict[str, Any]):
    """Names in a module; for what it imports for type checkers alone, a class that is recognised by its name."""

    def __missing__(self, name: str) -> Any:
        known = getattr(builtins, name, None) or getattr(typing, name, None)  # an alias of elsewhere may have these
        return known or type(name, (), {"__module__": __package__, "__by_name__": True})


def _accept(_: object) -> None:
    return None


def _check(hint: Any) -> _Check:
    kind, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind in (typing.Union, types.UnionType):
        return _union([_check(one) for one in inner])
    if isinstance(kind, typing.TypeVar):
        return _check(kind.__bound__ or Any)
    if kind is None or kind is type(None):
        return _simple("None", lambda value: value is None)
    if kind in (_Array, np.ndarray):
        return _simple("an array of numbers", _is_array)
    if kind in _NUMBERS:
        return _simple(_WORDS[kind], _NUMBERS[kind])
    if kind is Callable:
        return _simple("a function", callable)
    if kind is type and inner and isinstance(base := getattr(inner[0], "__bound__", inner[0]), type):
        wanted = f"a subclass of {base.__name__}"
        return _simple(wanted, lambda value: inspect.isclass(value) and issubclass(value, base))
    if kind is tuple and inner and Ellipsis not in inner:
        return _tuple([_check(one) for one in inner])
    if kind in (tuple, list, Sequence, Collection, Iterable):
        return _sequence(_check(inner[0] if inner else Any), any_iterable=kind in (Collection, Iterable))
    if kind in (dict, Mapping) or typing.is_typeddict(kind):
        return _mapping(*(_check(one) for one in inner or (Any, Any)))
    if not isinstance(kind, type) or kind in (object, Any) or getattr(kind, "_is_protocol", False):
        return _Check("anything", _accept)
    if hasattr(kind, "__by_name__"):
        names = kind.__name__
        return _simple(_with_article(names), lambda value: names in (base.__name__ for base in type(value).__mro__))
    package = kind.__module__.partition(".")[0]
    origin = "" if package == __package__ or package in sys.stdlib_module_names else f" of {package}"
    return _simple(_WORDS.get(kind) or _with_article(kind.__name__) + origin, lambda value: isinstance(value, kind))


def _with_article(name: str) -> str:
    """The name of a class in a sentence; a plural such as ``Disturbances`` has no article."""
    return name if name.endswith("s") else f"an {name}" if name[0] in "AEIOUaeiou" else f"a {name}"


def _simple(wanted: str, accepts: Callable[[Any], bool]) -> _Check:
    return _Check(wanted, lambda value: None if accepts(value) else _Fault("", wanted, value))


def _is_number(value: object) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "iuf" and value is not np.ma.masked
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def _is_whole(value: object) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "iu"
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


_NUMBERS: dict[Any, Callable[[Any], bool]] = {
    bool: lambda value: isinstance(value, bool | np.bool_),
    int: lambda value: type(value) is int or _is_whole(value),
    float: lambda value: type(value) is float or _is_number(value),
}


def _is_array(value: object) -> bool:
    return hasattr(value, "__array__") or _is_number(value) or _is_list(value)


def _is_list(value: object) -> bool:
    """Whether a value is a sequence, or another collection but text and mappings; arrays have an axis at least."""
    if isinstance(value, list | tuple):
        return True
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Collection) and not isinstance(value, str | bytes | bytearray | Mapping)


def _union(checks: list[_Check]) -> _Check:
    # Whoever gave something wants it, and not None.
    wanted = " or ".join(dict.fromkeys(check.wanted for check in checks if check.wanted != "None"))

    def find(value: Any) -> _Fault | None:
        within = None
        for check in checks:
            if (fault := check.find(value)) is None:
                return None
            within = fault if fault.place else within
        return within or _Fault("", wanted, value)

    return _Check(wanted, find)


def _sequence(item: _Check, *, any_iterable: bool) -> _Check:
    wanted = "a list" if item.find is _accept else f"a list, each item {item.wanted}"

    def find(value: Any) -> _Fault | None:
        if not _is_list(value):
            # What can be read only once is left to the function.
            once = isinstance(value, Iterable) and not isinstance(value, Collection)
            accepted = any_iterable and (once or isinstance(value, Mapping))
            return None if accepted else _Fault("", wanted, value)
        # Items of an array of numbers, or of a range, are all alike, and may be many.
        alike = isinstance(value, range) or (isinstance(value, np.ndarray) and value.dtype != object)
        return _first((f"[{index}]", item, one) for index, one in enumerate(value[:1] if alike else value))

    return _Check(wanted, find)


def _tuple(items: list[_Check]) -> _Check:
    wanted = f"a tuple of {len(items)}"
    if len({item.wanted for item in items}) == 1:
        wanted += f", each item {items[0].wanted}"

    def find(value: Any) -> _Fault | None:
        if not _is_list(value) or len(value) != len(items):
            return _Fault("", wanted, value)
        return _first((f"[{index}]", check, one) for index, (check, one) in enumerate(zip(items, value, strict=True)))

    return _Check(wanted, find)


def _mapping(key: _Check, item: _Check) -> _Check:
    def find(value: Any) -> _Fault | None:
        if not isinstance(value, Mapping):
            return _Fault("", "a dictionary", value)
        keys = ((": its keys", key, name) for name in value)
        return _first(chain(keys, ((f"[{quoted(name)}]", item, one) for name, one in value.items())))

    return _Check("a dictionary", find)


def _first(parts: Iterable[tuple[str, _Check, Any]]) -> _Fault | None:
    """The first fault in parts of a value, each with its place and its check."""
    for place, check, value in parts:
        if (fault := check.find(value)) is not None:
            return fault._replace(place=place + fault.place)
    return None
