"""Time budgets and progress: limits on the CPU time of a piece of work, checked in its loops, and progress callbacks.

    with time_limit(10.0):
        ...  # every loop inside calls `check_time`, which raises `OutOfTimeError` once ten seconds are spent
    with reporting(print):
        ...  # work inside whose total amount is known calls `report`

The CPU time is that of the calling thread, so that other load on the machine does not count; in `one_blas_thread` it is
all that the work takes. Only that error depends on the clock: within its budget, work has the same result as without.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from functools import cache
from typing import Any

from lieednn_sim.errors import OutOfTimeError
from lieednn_sim.validation import as_positive

__all__ = ["reporting", "time_limit"]

DEFAULT_TIME_BUDGET = 60.0  # CPU time of a planner [s]; far more than any needs for the arms of the package

cpu_time = time.thread_time  # CPU time that the calling thread has used [s], from an arbitrary zero

# Time at which the present work must end, by `cpu_time`, and its budget [s].
_LIMIT: ContextVar[tuple[float, float] | None] = ContextVar("lieednn_sim time limit", default=None)
_REPORT: ContextVar[Callable[[int, int], object]] = ContextVar("lieednn_sim report", default=lambda *_: None)
# The limit of BLAS is the process's: it is here once for each context, and the last one, in any thread, lifts it.
_BLAS_LOCK, _BLAS_LIMITS = threading.Lock(), list[Any]()


def as_time_budget(name: str, value: float) -> float:
    """Return ``value`` as a positive number of seconds, or infinity for no limit; else raise `InputError`."""
    return math.inf if isinstance(value, float) and value == math.inf else as_positive(name, value)


@contextlib.contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Give the block a budget of CPU time [s] in this thread, or infinity; of nested limits the earlier one counts.

    The limit decides only whether there is a result, never which one.
    """
    seconds = as_time_budget("seconds", seconds)
    mine, outer = (cpu_time() + seconds, seconds), _LIMIT.get()
    token = _LIMIT.set(mine if outer is None else min(mine, outer))
    try:
        yield
    finally:
        _LIMIT.reset(token)


def default_limit() -> contextlib.AbstractContextManager[None]:
    """`DEFAULT_TIME_BUDGET`, unless the work has a limit already."""
    return time_limit(DEFAULT_TIME_BUDGET) if _LIMIT.get() is None else contextlib.nullcontext()


@contextlib.contextmanager
def reporting(progress: Callable[[int, int], object]) -> Iterator[None]:
    """Let the work of the block in this thread call ``progress`` with (done, total); its exceptions end the work."""
    token = _REPORT.set(progress)
    try:
        yield
    finally:
        _REPORT.reset(token)


def report(done: int, total: int) -> None:
    """Pass the amount of work done and the total amount to the callback of `reporting`, if there is one."""
    _REPORT.get()(done, total)


def out_of_time() -> bool:
    """Whether the budget of the present work is spent, for places where no exception may be raised."""
    limit = _LIMIT.get()
    return limit is not None and cpu_time() > limit[0]


def check_time() -> None:
    """Raise `OutOfTimeError` if the budget of the present work is spent; to be called in loops."""
    limit = _LIMIT.get()
    if limit is not None and cpu_time() > limit[0]:
        raise OutOfTimeError(
            f"out of time: the budget of {limit[1]:g} s of CPU time is spent and the planner is not done; "
            "allow more (time_limit, --time-budget), or use another planner, target or seed"
        )


@cache
def _blas() -> Any:
    # Imported on first use: threadpoolctl sets an environment variable, which importing this package must not do.
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Context in which BLAS uses one thread; more threads are slower for small matrices, and results would vary."""
    with _BLAS_LOCK:
        limit = _BLAS_LIMITS[0] if _BLAS_LIMITS else _blas().limit(limits=1, user_api="blas")
        with _blas().limit(limits=1, user_api="blas"):  # once it is left, threadpoolctl 3.8 obeys other threads, too
            _BLAS_LIMITS.append(limit)
    try:
        yield
    finally:
        with _BLAS_LOCK:
            if _BLAS_LIMITS.pop() not in _BLAS_LIMITS:
                with limit:
                    pass
