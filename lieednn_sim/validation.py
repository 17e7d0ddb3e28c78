"""Checks of user input, so that bad values stop at the door with a message that helps."""

from __future__ import annotations

import operator
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.errors import InputError

Shape = tuple[int | str, ...]


def _describe(shape: Iterable[int | str]) -> str:
    return "(" + ", ".join(str(size) for size in shape) + ")"


def as_floats(name: str, value: ArrayLike, shape: Shape, *, batched: bool = False) -> NDArray[np.float64]:
    """Return ``value`` as a finite float64 array whose trailing axes match ``shape``.

    Args:
        name: what the value is called in the error message.
        value: anything NumPy can turn into an array of numbers.
        shape: required sizes; a string is a free size and must agree wherever it recurs.
        batched: allow any number of leading axes.

    Raises:
        InputError: not numeric, not finite, or of another shape.
    """
    try:
        if np.iscomplexobj(value):
            raise TypeError("complex numbers have no place here")
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be an array of numbers, got {type(value).__name__}: {error}") from None
    wanted = ("...", *shape) if batched else shape
    trailing = array.shape[len(array.shape) - len(shape) :] if batched else array.shape
    sizes: dict[str, int] = {}
    fits = len(trailing) == len(shape) and all(
        sizes.setdefault(want, size) == size if isinstance(want, str) else want == size
        for want, size in zip(shape, trailing, strict=True)
    )
    if not fits:
        raise InputError(f"{name} must have shape {_describe(wanted)}, got {_describe(array.shape)}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite, got {np.count_nonzero(~np.isfinite(array))} NaN or infinite entries")
    return array


def as_times(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Return ``value`` as at least two increasing times ``(K,)``, or raise `InputError`."""
    times = as_floats(name, value, ("K",))
    if len(times) < 2 or not (np.diff(times) > 0.0).all():
        raise InputError(f"{name} must hold at least two increasing times")
    return times


def as_positive(name: str, value: float) -> float:
    """Return ``value`` as a positive, finite float, or raise `InputError`."""
    number = float(as_floats(name, value, ()))
    if number <= 0:
        raise InputError(f"{name} must be positive, got {number:g}")
    return number


def as_count(name: str, value: int, least: int = 1) -> int:
    """Return ``value`` as an integer of at least ``least``, or raise `InputError`."""
    try:
        number = operator.index(value)
    except TypeError:
        raise InputError(f"{name} must be a whole number, got {value!r}") from None
    if number < least:
        raise InputError(f"{name} must be at least {least}, got {number}")
    return number


def as_seed(name: str, seed: int) -> int:
    """Return ``seed`` as a whole number >= 0, or raise `InputError`."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"{name} must be a whole number >= 0, got {seed!r}")
    return int(seed)


def as_generator(name: str, seed: int | np.random.Generator) -> np.random.Generator:
    """Return a random generator from a whole number >= 0, or the generator itself."""
    if isinstance(seed, np.random.Generator):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"{name} must be a whole number >= 0 or a numpy.random.Generator, got {seed!r}")
    return np.random.default_rng(seed)


def as_choice(name: str, value: str, allowed: Iterable[str]) -> str:
    """Return ``value`` when it is one of ``allowed``, or raise `InputError` that lists them."""
    choices = sorted(allowed)
    if value not in choices:
        raise InputError(f"no {name} {value!r}; allowed: {', '.join(choices)}")
    return value
