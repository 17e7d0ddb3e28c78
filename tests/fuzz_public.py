"""Calls of everything public with any arguments: who is called, what is drawn, and what must hold."""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import functools
import importlib
import inspect
import io
import os
import pkgutil
import random
import reprlib
import traceback
import types
import typing
import warnings
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import lieednn_sim
from lieednn_sim import typecheck
from lieednn_sim.arm import Arm
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
    """All functions, constructors, and methods with parameters that are public."""
    found = []
    for name, value in public_values().items():
        if not inspect.isclass(value):
            found.append(Target(name, None, value))
            continue
        # Tuples take anything.
        if not (issubclass(value, tuple | dict | enum.Enum) or inspect.isabstract(value)):
            found.append(Target(name, None, value))
        for each in dir(value):
            owner = next((cls for cls in value.__mro__ if each in vars(cls)), object)
            public = not each.startswith("_") or each in ("__call__", "__getitem__")
            if not public or not owner.__module__.startswith("lieednn_sim"):
                continue
            raw = vars(owner)[each]
            if isinstance(raw, classmethod | staticmethod):
                found.append(Target(f"{name}.{each}", None, getattr(value, each)))
            elif isinstance(raw, types.FunctionType) and len(inspect.signature(raw).parameters) > 1:
                found.append(Target(f"{name}.{each}", value, raw))
    return found


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


# Texts that are good nowhere, and some that are good somewhere.
BAD_WORDS = ["", "a\0b", "x" * 5000, *["1e308", "nan", "-inf", "1_000", "٣", "../../..", "None", "[bold]", "-"]]
_GOOD_WORDS = """
    telescopic_pr telescopic_compound free poles home extended tanh uniform sign-matched position-servo reach track keep
    inverse-dynamics lieednn-certified minimum-jerk se3-geodesic RK45 RK4 Euler gradient gauss-newton squared newton
    length time m wxyz base SE(3) SO(2) SU(3) GL(2) R^3 affine(C^x) rgb_array draft disabled plan file.npz file.txt
    two.xml new .
"""
WORDS = [*BAD_WORDS, *_GOOD_WORDS.split(), "link 1"]
COUNTS = [0, 1, 1, 2, 2, 3, 5, 8, -1, 1000, 10**9, 2**53, 2**64 - 1, 10**5000]
# Lengths that are good somewhere, and those that are good nowhere.
SIZES = [0.0, 5e-324, 1e-308, 1e-160, 1e-99, 1e-8, 0.1, 0.5, 1.0, 2.0, np.pi, 1e3, 1e8, 1e50, 9e99]
BAD_SIZES = [1e101, 1.7e308, np.inf, -np.inf, np.nan]
SHAPES = [(), (0,), (1,), (3,), (6,), (8,), (2, 6), (4, 6), (1, 6), (0, 6), (3, 3), (6, 6), (4, 4), (24, 24), (2, 2)]
SHAPES += [(0, 0), (5, 2), (5, 3), (5, 7), (5, 8), (2, 3, 3), (7, 2, 6), (3, 0, 6), (2, 2, 3), (2, 2, 3, 3)]
PATHS = ["new.npz", "new.json", "new.csv", "new.gif", "new.html", "gone/new.npz", "folder", "file.npz", "file.txt"]

Things = Callable[[type], Any]


def _postures(things: Things) -> list[Any]:
    home, extended = (things(Arm).keyframe(name) for name in ("home", "extended"))
    return [home, extended, home.tolist(), home[None], np.stack([home, home]), 9.0 * home, home + 0.01]


def _twists(things: Things) -> list[Any]:
    xi = things(Arm).encode(things(Arm).keyframe("extended"))
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
    **dict.fromkeys(("longest", "seconds"), _one_of(1.0, 3.0)),
    **dict.fromkeys(("threads", "num_envs", "samples", "max_attempts"), _one_of(1, 2, 3, 0, 10**9)),
    **dict.fromkeys(("count", "jobs", "episodes"), _one_of(1, 0, -1)),
    "size": _one_of((64, 48), (10**9, 2), (3, 3)),
    "shape": _one_of((), (2,), (2, 3), (10**9, 10**9), (-1,)),
    "console": _one_of(None),
}


class Draw:
    """Random arguments; ``things`` makes a good value of a class, or None."""

    def __init__(self, seed: int, things: Things) -> None:
        self.random, self.things = random.Random(seed), things

    def arguments(self, target: Target) -> dict[str, Any]:
        """Arguments by name: in half of the calls at most one of them is junk, in the others nearly a third."""
        parameters = list(inspect.signature(target.function).parameters.values())[target.owner is not None :]
        hints = _annotations(target)
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
                drawn[one.name] = self.of(hints.get(one.name, Any))
        return drawn

    def of(self, hint: Any) -> Any:
        """A value of a type."""
        kind, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
        choose = self.random.choice
        simple: dict[Any, Callable[[], Any]] = {
            float: self.number,
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
        made = self.things(kind) if isinstance(kind, type) else None
        if made is None and dataclasses.is_dataclass(kind) and kind in public_values().values():
            with contextlib.suppress(Exception):
                made = kind(**self.arguments(Target(kind.__name__, None, kind)))
        return choose(junk()) if made is None else made

    def number(self) -> float:
        """Of any size, mostly one that is good somewhere."""
        size = self.random.choice(SIZES if self.random.random() < 0.8 else BAD_SIZES)
        return self.random.choice([size, size, -size, self.random.uniform(-10.0, 10.0)])

    def array(self, *shapes: tuple[int, ...]) -> Any:
        """Of one of the shapes, mostly with entries of one good size; now and then of whole numbers, or a list."""
        rng, shape = np.random.default_rng(self.random.randrange(2**32)), self.random.choice(shapes or SHAPES)
        array = np.asarray(self.random.choice([0.1, 1.0, *SIZES]) * rng.normal(size=shape))
        if array.size and self.random.random() < 0.2:
            array.flat[rng.integers(array.size)] = self.number()
        if self.random.random() < 0.1:
            array = np.arange(array.size).reshape(shape)
        return array.tolist() if self.random.random() < 0.1 else array


def _annotations(target: Target) -> dict[str, Any]:
    """The types of the parameters of what is called."""
    if inspect.isclass(target.function):
        return typecheck.annotations_of(target.function.__init__, target.function)
    owner = target.owner or getattr(target.function, "__self__", None)
    return typecheck.annotations_of(getattr(target.function, "__func__", target.function), owner)


def leaves(value: Any, depth: int = 4, *, fields: bool = False) -> Iterator[Any]:
    """All numbers of a result, those of public fields of dataclasses included if asked for."""
    if isinstance(value, float | np.floating | np.ndarray) and np.asarray(value).dtype.kind in "fc":
        yield value
    elif isinstance(value, dict):
        yield from leaves(list(value.values()), depth, fields=fields)
    elif fields and dataclasses.is_dataclass(value):
        public = [item.name for item in dataclasses.fields(value) if not item.name.startswith("_")]
        yield from leaves([getattr(value, name) for name in public], depth, fields=fields)
    elif depth and isinstance(value, tuple | list):
        for item in value:
            yield from leaves(item, depth - 1, fields=fields)


def fault_of(function: Callable[..., Any], *arguments: Any, **named: Any) -> str:
    """Call, and tell what is wrong: nothing if there is a result without NaN, or an error of the package."""
    unchecked = "unchecked" in (function.__doc__ or "").lower()
    try:
        with warnings.catch_warnings(action="error"), contextlib.redirect_stdout(io.StringIO()):
            result = function(*arguments, **named)
            result = list(result) if inspect.isgenerator(result) else result
    except LieEDNNError as error:
        # What the caller calls a value appears whole.
        what = named.get("what", "")
        length = len(str(error)) - (len(what) if isinstance(what, str) else 0)
        return "" if length < 3000 else f"a message of {length} characters"
    except Exception as error:
        allowed = unchecked and isinstance(error, _UNCHECKED)
        return "" if allowed else "".join(traceback.format_exception(error)[-7:])
    # A constructor stores what it is given.
    if not (unchecked or inspect.isclass(function)) and any(np.isnan(leaf).any() for leaf in leaves(result)):
        return f"NaN in {result!r}"[:1000]
    return ""


def attempt(number: int) -> str:
    """Make a call by its number, and tell what is wrong with it, if anything."""
    from fuzz_things import fresh

    target = targets()[number % len(targets())]
    arguments = Draw(number, fresh).arguments(target)
    instance = () if target.owner is None else (fresh(target.owner),)
    fault = fault_of(target.function, *instance, **arguments)
    return f"{number} {target.name}({reprlib.repr(arguments)})\n{fault}" if fault else ""
