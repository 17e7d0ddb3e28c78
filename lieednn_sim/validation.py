"""Checks of user input, with error messages that help."""

from __future__ import annotations

import math
import operator
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.errors import InputError

# As in NumPy, but without None: results are functions of their arguments.
Seed = int | np.random.SeedSequence | np.random.Generator

# Larger than any meaningful length, angle, rate or weight; products of three such numbers do not overflow.
LARGEST = 1e100
_QUOTED = 80  # most characters of a refused value that messages quote
TURN = 6.3  # a full turn, rounded up [rad]: larger angles of orientations were probably given in degrees
MOST_ENTRIES = 2**27  # most entries of an array: a gibibyte of float64


def _describe(shape: tuple[int | str, ...]) -> str:
    return f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"


def quoted(value: object) -> str:
    """The ``repr`` of a value for a message, shortened if it is long."""
    if isinstance(value, str | bytes) and len(value) > _QUOTED:
        return f"{value[:_QUOTED]!r} ... ({len(value)} characters)"
    if isinstance(value, np.ndarray):
        return f"an array of shape {_describe(value.shape)}"
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 4 * _QUOTED:
        # Python refuses to print integers of more than some thousands of digits.
        return f"a whole number of {value.bit_length()} bits"
    if isinstance(value, list | tuple | set | frozenset | dict):
        return f"a {type(value).__name__} of {len(value)}"
    text = repr(value).replace("\n", " ")
    return text if len(text) <= _QUOTED else f"{text[:_QUOTED]} ... ({len(text)} characters)"


def as_floats(
    name: str, value: ArrayLike, shape: tuple[int | str, ...], *, batched: bool = False, largest: float = LARGEST
) -> NDArray[np.float64]:
    """Return ``value`` as a finite float64 array of a shape, or raise `InputError`.

    A string in the shape is a free size, equal wherever it recurs. A batched value may have any number of leading axes;
    no entry may exceed the largest size.
    """
    # Fast path for inner loops.
    if type(value) is np.ndarray and value.dtype == np.float64:
        array = value
    elif type(value) in (float, np.float64):
        array = np.asarray(value)
    else:
        array = as_array(name, value, shape, batched)
    _require_shape(name, array.shape, shape, batched)
    # Fast path for training loops: if the sum of squares is small, no entry is large. It takes a third of the time of
    # finding the largest entry; a NaN makes both comparisons false. Long vectors are left out, since BLAS would use
    # several threads, which then spin on the processors of callers with their own threads.
    if array.size < 1000 and np.vdot(array, array) < largest * largest:
        return array
    if not np.maximum.reduce(np.abs(array), axis=None, initial=0.0) <= largest:
        if not np.isfinite(array).all():
            if array.ndim == 0:
                raise InputError(f"{name} must be finite, got {None if value is None else float(array)}")
            count = np.count_nonzero(~np.isfinite(array))
            first = np.argwhere(~np.isfinite(array))[0].tolist()
            where = f"in row {first[0]}" if array.ndim == 2 else f"at {first}"
            raise InputError(f"{name} must be finite, got {count} NaN or infinite entries, the first {where}")
        raise InputError(f"{name} must not exceed {largest:g} in size, got {np.abs(array).max():g}")
    return array


def as_array(name: str, value: Any, shape: tuple[int | str, ...] = (), batched: bool = True) -> NDArray[np.float64]:
    """Return ``value`` as a float64 array that need not be finite, by default of any shape, or raise `InputError`."""
    try:
        # A known shape is checked first, before a large array is copied.
        if isinstance(value, np.ndarray):
            _require_shape(name, value.shape, shape, batched)
        elif isinstance(value, Sequence) and len(value) > MOST_ENTRIES:
            raise InputError(f"{name} must have at most {MOST_ENTRIES} entries, got {len(value)}")
        given = value if isinstance(value, np.ndarray) else np.asarray(value)
        if given.dtype.kind == "c":
            raise TypeError("complex numbers are not allowed")
        if np.ma.is_masked(given):
            raise TypeError("masked entries are not allowed")
        if given.dtype.kind in "bSUmMV" or not _only_numbers(value):
            raise TypeError("every entry must be a number")
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, MemoryError, RuntimeError) as error:
        if isinstance(error, InputError):
            raise
        # NumPy's messages may repeat a long string.
        why = f": {error}" if len(str(error)) <= 2 * _QUOTED else ""
        raise InputError(f"{name} must be an array of numbers, got {type(value).__name__}{why}") from None


def _only_numbers(value: Any) -> bool:
    """Whether a sequence holds neither truth values nor texts, which NumPy would turn into numbers."""
    if isinstance(value, list | tuple):
        return all(map(_only_numbers, value))
    return not isinstance(value, bool | np.bool_ | str | bytes)


def _require_shape(name: str, given: tuple[int, ...], shape: tuple[int | str, ...], batched: bool) -> None:
    trailing = given[len(given) - len(shape) :] if batched else given
    sizes: dict[str, int] = {}
    fits = trailing == shape or (
        len(trailing) == len(shape)
        and all(
            sizes.setdefault(want, size) == size if isinstance(want, str) else want == size
            for want, size in zip(shape, trailing, strict=True)
        )
    )
    if not fits:
        target = ("...", *shape) if batched else shape
        raise InputError(f"{name} must have shape {_describe(target)}, got {_describe(given)}")
    if math.prod(given) > MOST_ENTRIES:
        raise InputError(f"{name} must have at most {MOST_ENTRIES} entries, got shape {_describe(given)}")


def as_path(name: str, value: object) -> Path:
    """Return ``value`` as a path that the system accepts, or raise `InputError`.

    An empty string is refused: `Path` would take it for the current directory.
    """
    if not isinstance(value, str | os.PathLike):
        raise InputError(f"{name} must be a string or a path, got {type(value).__name__}")
    text = os.fspath(value)
    if not text:
        raise InputError(f"{name} must be a path, got ''; the current directory is '.'")
    try:
        if not isinstance(text, str) or "\0" in text:
            raise ValueError
        lengths = [len(os.fsencode(part)) for part in text.split("/")]
    except ValueError:
        raise InputError(f"{name} must be a path without NUL or broken characters, got {quoted(text)}") from None
    # Limits of Linux; the limit of a path includes its final zero byte.
    if max(lengths) > 255 or sum(lengths) + len(lengths) > 4096:
        raise InputError(f"{name} is too long for a path, got {quoted(text)}")
    return Path(text)


def as_finite(name: str, result: NDArray[Any]) -> NDArray[Any]:
    """Return a computed array, or raise `InputError` if the input was too large for double precision."""
    if not np.isfinite(result).all():
        raise InputError(f"{name} is beyond the range of double precision for this input; make the input smaller")
    return result


def as_times(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Return ``value`` as at least two increasing times ``(K,)``, or raise `InputError`."""
    times = as_floats(name, value, ("K",))
    wanted = f"{name} must hold at least two increasing times"
    if len(times) < 2:
        raise InputError(f"{wanted}, got {len(times)}")
    increasing = np.diff(times) > 0.0
    if not increasing.all():
        k = int(np.argmin(increasing)) + 1
        raise InputError(f"{wanted}, got {times[k]:.15g} after {times[k - 1]:.15g} in row {k}")
    return times


def as_positive(name: str, value: float) -> float:
    """Return ``value`` as a positive float from 1 / `LARGEST` to `LARGEST`, or raise `InputError`."""
    # Fast path for inner loops; a NaN makes the comparison false.
    if type(value) is float and 1.0 / LARGEST <= value <= LARGEST:
        return value
    number = float(as_floats(name, value, ()))
    if number <= 0:
        raise InputError(f"{name} must be positive, got {number:g}")
    if number < 1.0 / LARGEST:
        raise InputError(f"{name} must be at least {1.0 / LARGEST:g}, got {number:g}")
    return number


def as_nonnegative(name: str, value: float, largest: float = LARGEST) -> float:
    """Return ``value`` as a float from 0 to ``largest``, or raise `InputError`."""
    number = float(as_floats(name, value, (), largest=largest))
    if number < 0.0:
        raise InputError(f"{name} must not be negative, got {number:g}")
    return number


def as_ratio(gamma: float, mu: float) -> float:
    """Return gamma/mu of two positive floats, from 1 / `LARGEST` to `LARGEST` like them, or raise `InputError`."""
    return as_positive("gamma/mu", as_positive("gamma", gamma) / as_positive("mu", mu))


def as_count(name: str, value: int, least: int = 1, most: int = 2**53) -> int:
    """Return ``value`` as an integer from ``least`` to ``most``, or raise `InputError`."""
    try:
        if isinstance(value, bool):
            raise TypeError
        number = operator.index(value)
    except TypeError:
        raise InputError(f"{name} must be a whole number, got {quoted(value)}") from None
    if number < least:
        raise InputError(f"{name} must be at least {least}, got {quoted(number)}")
    if number > most:
        raise InputError(f"{name} must be at most {most}, got {quoted(number)}")
    return number


def as_workers(name: str, value: int | None) -> int:
    """Return a number of threads or processes, by default that of the processors, or raise `InputError`."""
    # At most more than the processors of any machine, and fewer than a system refuses.
    return as_count(name, os.cpu_count() or 1 if value is None else value, most=1024)


def as_seed(name: str, seed: Seed) -> int:
    """Return ``seed``, or a number drawn from a generator, as a whole number below 2^128, or raise `InputError`."""
    if isinstance(seed, np.random.Generator | np.random.SeedSequence):
        return int(np.random.default_rng(seed).integers(2**63))
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"{name} must be a whole number >= 0, got {quoted(seed)}")
    if int(seed).bit_length() > 128:
        raise InputError(f"{name} must be below 2^128, got {quoted(seed)}")
    return int(seed)


def as_generator(name: str, seed: Seed) -> np.random.Generator:
    """Return a random generator from a seed as in `as_seed`, or the generator itself."""
    known = isinstance(seed, np.random.Generator | np.random.SeedSequence)
    return np.random.default_rng(seed if known else as_seed(name, seed))


def as_choice(name: str, value: str, allowed: Iterable[str], further: str = "") -> str:
    """Return ``value`` if it is one of ``allowed``, or raise an `InputError` that lists these and ``further``."""
    choices = sorted(allowed)  # some elements of a model have no name
    # Only strings are compared: an array would be compared elementwise.
    if not isinstance(value, str) or value not in choices:
        known = ", ".join(filter(None, [*choices, further])) or "none"
        raise InputError(f"no {name} {quoted(value)}; allowed: {known}")
    return value
