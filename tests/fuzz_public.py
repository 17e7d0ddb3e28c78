"""Calls of everything public with any arguments: who is called, what is drawn, and what must hold."""

from __future__ import annotations

import enum
import functools
import importlib
import inspect
import io
import os
import pkgutil
import random
import sys
import traceback
import types
import typing
import warnings
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import lieednn_sim
from lieednn_sim import typecheck
from lieednn_sim.errors import LieEDNNError

# What NumPy may say to a function that its docstring calls unchecked: those of inner loops.
_UNCHECKED = (TypeError, ValueError, AttributeError, LookupError, OverflowError, MemoryError, Warning)


class Target(NamedTuple):
    """Something to call, and the class on an instance of which it is called, if any."""

    name: str
    owner: type | None
    function: Callable[..., Any]


@functools.cache
def public_values() -> dict[str, Any]:
    """All that public modules name in their ``__all__`` and that can be called, once each, by name."""
    found: dict[str, Any] = {}
    for info in pkgutil.walk_packages(lieednn_sim.__path__, "lieednn_sim."):
        # Neither private modules nor programs nor files, nor what needs an extra that is not installed.
        if any(part.startswith("_") or part in ("cli", "io") for part in info.name.split(".")):
            continue
        try:
            module = importlib.import_module(info.name)
        except (LieEDNNError, ImportError):
            continue
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            if callable(value) and not any(value is known for known in found.values()):
                found[f"{info.name}.{name}".removeprefix("lieednn_sim.")] = value
    return found


@functools.cache
def targets() -> list[Target]:
    """All functions, constructors, methods and properties that are public."""
    found = []
    for name, value in public_values().items():
        if not inspect.isclass(value):
            found.append(Target(name, None, value))
            continue
        if issubclass(value, dict | enum.Enum):
            continue
        if not inspect.isabstract(value):
            found.append(Target(name, None, value))
        for each in dir(value):
            owner = next((cls for cls in value.__mro__ if each in vars(cls)), object)
            public = not each.startswith("_") or each in ("__call__", "__getitem__")
            if not public or not owner.__module__.startswith("lieednn_sim"):
                continue
            raw = vars(owner)[each]
            if isinstance(raw, classmethod | staticmethod):
                found.append(Target(f"{name}.{each}", None, getattr(value, each)))
            elif isinstance(raw, types.FunctionType):
                found.append(Target(f"{name}.{each}", value, raw))
            elif isinstance(raw, property | functools.cached_property):
                found.append(Target(f"{name}.{each}", value, functools.partial(_get, each)))
    return found


def _get(name: str, self: object) -> Any:
    return getattr(self, name)


class Junk:
    """Something of no use whose text is too long."""

    def __repr__(self) -> str:
        return "junk" * 100_000


def junk() -> list[Any]:
    """What no parameter wants, or a few by chance."""
    numbers = [True, False, 0, -1, 3, 1.5, np.nan, 1j, 10**5000, 2**64 - 1, np.float16(1.0), Decimal("1.5")]
    texts = ["1", "text", "x" * 10**5, b"1", b"\xff" * 9, bytearray(b"ab"), memoryview(b"ab"), Path("\0")]
    lists = [[], [1], [1, [2, 3]], [None], ["a"], [[]], (1, 2), {}, {"a": 1}, {1: 2}, {1, 2}, range(3), range(10**12)]
    arrays = [np.array(1.0), np.array("a"), np.array([True]), np.zeros(3, dtype=object), np.zeros(3, dtype=complex)]
    arrays += [np.zeros((2, 2), dtype="U3"), np.array(["2020-01-01"], dtype="M8[D]"), np.zeros(2, dtype=[("a", float)])]
    arrays += [np.broadcast_to(np.int8(0), (2**40,)), np.broadcast_to(0.0, (2**20, 2**20)), np.ma.masked]
    others = [None, object(), Junk(), NotImplemented, ..., slice(2), iter([1]), (x for x in [1]), io.StringIO()]
    others += [np.random.default_rng(0), types.SimpleNamespace(), np.dtype(float), Exception("no"), lambda *_: None]
    return [*numbers, *texts, *lists, *arrays, *others]


# Texts that are good somewhere, and some that are good nowhere.
_TEXTS = """
    telescopic_pr telescopic_compound free poles home extended tanh uniform sign-matched position-servo reach track keep
    inverse-dynamics lieednn-certified minimum-jerk se3-geodesic RK45 RK4 Euler gradient gauss-newton squared newton
    length time m wxyz base SE(3) SO(2) SU(3) GL(2) R^3 affine(C^x) rgb_array draft disabled plan nan 1_000 ٣ ../../..
    None [bold] - file.npz file.txt two.xml new .
"""
WORDS = [*_TEXTS.split(), "", "a\0b", "x" * 5000, "link 1"]
COUNTS = [0, 1, 1, 2, 2, 3, 5, 8, -1, 1000, 10**9, 2**53, 2**64 - 1, 10**5000]
SIZES = [0.0, 1.0, 0.1, 0.5, 2.0, -1.0, 5e-324, 1e-160, 1e-8, 1e3, 1e8, 1e50, 9e99, 1.7e308, np.inf, -np.inf, np.nan]
SHAPES = [(), (0,), (1,), (3,), (6,), (8,), (2, 6), (4, 6), (1, 6), (0, 6), (3, 3), (6, 6), (4, 4), (24, 24), (2, 2)]
SHAPES += [(0, 0), (5, 2), (5, 3), (5, 7), (5, 8), (2, 3, 3), (7, 2, 6), (3, 0, 6), (2, 2, 3), (2, 2, 3, 3)]
PATHS = ["new.npz", "new.json", "new.csv", "new.gif", "new.html", "gone/new.npz", "folder", "file.npz", "file.txt"]

Things = Callable[[str], Any]


def _postures(things: Things) -> list[Any]:
    arm = things("Arm")
    home = arm.keyframe("home")
    return [home, arm.keyframe("extended"), home.tolist(), home[None], np.stack([home, home]), 9.0 * home, home + 0.01]


def _twists(things: Things) -> list[Any]:
    xi = things("Arm").encode(things("Arm").keyframe("extended"))
    return [xi, 0.5 * xi, xi.tolist(), xi[:1], np.stack([xi, xi]), np.linspace(0.5 * xi, xi, 5), 0.0 * xi]


def _one_of(*values: Any) -> Callable[[Things], list[Any]]:
    return lambda _: list(values)


# Good values by the name of a parameter: what an annotation does not tell, and work that ends within seconds.
BY_NAME: dict[str, Callable[[Things], list[Any]]] = {
    **dict.fromkeys(("q", "qd", "start", "qpos", "qvel", "velocity", "wanted", "action", "actions"), _postures),
    **dict.fromkeys(("xi", "xi_dot", "twist", "twists", "curves", "x"), _twists),
    "target": lambda things: [*_postures(things), *_twists(things)],
    **dict.fromkeys(("path", "directory"), _one_of(*PATHS)),
    "model": _one_of("two.xml", "folder", "gone.xml"),
    "planner": _one_of("minimum-jerk", "se3-geodesic", "lieednn-certified", "nobody"),
    **dict.fromkeys(("duration", "hold", "time_limit"), _one_of(0.1, 0.5, 1.0, 0.0, -1.0, 1e9)),
    **dict.fromkeys(("max_time_scale", "time_budget"), _one_of(1.0, 3.0)),
    **dict.fromkeys(("threads", "num_envs", "samples", "max_attempts"), _one_of(1, 2, 3, 0, 10**9)),
    **dict.fromkeys(("count", "jobs", "episodes"), _one_of(1, 0, -1)),
    "size": _one_of((64, 48), (10**9, 2), (3, 3)),
    "shape": _one_of((), (2,), (2, 3), (10**9, 10**9), (-1,)),
    "console": _one_of(None),
}


class Draw:
    """Random arguments; ``things`` makes a good value of a class by its name, or None."""

    def __init__(self, seed: int, things: Things) -> None:
        self.random, self.things = random.Random(seed), things

    def arguments(self, target: Target) -> dict[str, Any]:
        """Arguments by name: in half of the calls at most one of them is junk, in the others nearly a third."""
        parameters = list(inspect.signature(target.function).parameters.values())[target.owner is not None :]
        mild, spoilt = self.random.random() < 0.5, self.random.randrange(len(parameters) + 1)
        drawn = {}
        for index, one in enumerate(parameters):
            given = one.default is one.empty or self.random.random() < 0.4
            if not given or one.kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD):
                continue
            if index == spoilt if mild else self.random.random() < 0.3:
                drawn[one.name] = self.random.choice(junk())
            elif one.name in BY_NAME and self.random.random() < 0.8:
                drawn[one.name] = self.random.choice(BY_NAME[one.name](self.things))
            else:
                drawn[one.name] = self.of(_type_of(one, target))
        return drawn

    def of(self, hint: Any) -> Any:
        """A value of a type."""
        kind, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
        choose = self.random.choice
        simple: dict[Any, Callable[[], Any]] = {
            float: lambda: choose([*SIZES, self.random.uniform(-10.0, 10.0)]),
            int: lambda: choose(COUNTS),
            str: lambda: choose(WORDS),
            bool: lambda: choose([True, False]),
            **dict.fromkeys((os.PathLike, Path), lambda: Path(choose(PATHS))),
            **dict.fromkeys((typecheck.Array, np.ndarray), self.array),
            type: lambda: choose([int, Junk]),
            Callable: lambda: choose([lambda *_: None, lambda first=0.0, *_: first, lambda *_: 0.1 * np.ones(8)]),
            np.random.Generator: lambda: np.random.default_rng(0),
            slice: lambda: choose([slice(None), slice(0, 2), slice(9, 3)]),
            range: lambda: choose([range(0), range(3), range(2, 4)]),
            type(None): lambda: None,
        }
        if kind in (typing.Union, types.UnionType):
            return self.of(choose(inner))
        if isinstance(kind, typing.TypeVar):
            return self.of(kind.__bound__)
        if kind is typing.Literal:
            return choose(inner)
        if kind in simple:
            return simple[kind]()
        if kind is tuple and inner and Ellipsis not in inner:
            return tuple(map(self.of, inner))
        if kind in (tuple, list, Sequence, Iterable, Collection):
            return [self.of(inner[0]) for _ in range(choose([0, 1, 1, 2, 3]))]
        if kind in (dict, Mapping):
            keys = [self.of(inner[0]) for _ in range(choose([0, 1, 2]))]
            return {key: self.of(inner[1]) for key in keys if isinstance(key, Hashable)}
        made = self.things(getattr(kind, "__name__", str(kind)))
        return choose(junk()) if made is None else made

    def array(self) -> Any:
        """Mostly of good entries, now and then with a bad one, of whole numbers, or as a list."""
        rng, shape = np.random.default_rng(self.random.randrange(2**32)), self.random.choice(SHAPES)
        array = self.random.choice([0.1, 1.0, *SIZES[:13]]) * rng.normal(size=shape)
        if array.size and self.random.random() < 0.1:
            array.flat[rng.integers(array.size)] = self.random.choice(SIZES)
        if self.random.random() < 0.1:
            array = np.arange(array.size).reshape(shape)
        return array.tolist() if self.random.random() < 0.2 else array


def _type_of(parameter: inspect.Parameter, target: Target) -> Any:
    """The type that a parameter's annotation means where it stands, or where a base class stands."""
    function = target.function
    cls = function if inspect.isclass(function) else None
    modules = [base.__module__ for base in (cls.__mro__ if cls else ())] or [inspect.unwrap(function).__module__]
    scope = {name: value for module in reversed(modules) for name, value in vars(sys.modules[module]).items()}
    if cls is None:
        scope |= getattr(inspect.unwrap(getattr(function, "__func__", function)), "__globals__", {})
    return typecheck._evaluate(parameter.annotation, scope)


def _leaves(value: Any, depth: int = 4) -> Iterator[Any]:
    """All numbers of a result."""
    if isinstance(value, float | np.floating | np.ndarray) and np.asarray(value).dtype.kind in "fc":
        yield value
    elif depth and isinstance(value, tuple | list | dict):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _leaves(item, depth - 1)


def fault_of(target: Target, arguments: Mapping[str, Any], things: Things) -> str:
    """Call, and tell what is wrong: nothing if there is a result without NaN, or an error of the package."""
    instance = () if target.owner is None else (things(target.owner.__name__),)
    unchecked = "unchecked" in (target.function.__doc__ or "").lower()
    try:
        with warnings.catch_warnings(action="error"), redirect_stdout(io.StringIO()):
            result = target.function(*instance, **arguments)
            result = list(result) if inspect.isgenerator(result) else result
    except LieEDNNError as error:
        # What the caller calls a value appears whole.
        what = arguments.get("what", "")
        length = len(str(error)) - (len(what) if isinstance(what, str) else 0)
        return "" if length < 3000 else f"a message of {length} characters"
    except Exception as error:
        allowed = unchecked and isinstance(error, _UNCHECKED)
        return "" if allowed else "".join(traceback.format_exception(error)[-7:])
    # A constructor stores what it is given.
    if not (unchecked or inspect.isclass(target.function)) and any(np.isnan(leaf).any() for leaf in _leaves(result)):
        return f"NaN in {result!r}"[:1000]
    return ""


def shown(target: Target, arguments: Mapping[str, Any]) -> str:
    """The call as a line of code."""

    def one(value: Any) -> str:
        try:
            return " ".join(repr(value)[:300].split())
        except Exception:
            return f"<{type(value).__name__}>"

    return f"{target.name}({', '.join(f'{name}={one(value)}' for name, value in arguments.items())})"


def attempt(number: int) -> str:
    """Make a call by its number, and tell what is wrong with it, if anything."""
    from fuzz_things import fresh

    target = targets()[number % len(targets())]
    arguments = Draw(number, fresh).arguments(target)
    fault = fault_of(target, arguments, fresh)
    return f"{number} {shown(target, arguments)}\n{fault}" if fault else ""
