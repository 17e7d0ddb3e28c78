"""Searches beside the control loop, in a process of their own, since a thread would hold the interpreter's lock."""

from __future__ import annotations

import os
import pickle
import threading
import warnings
import weakref
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from typing import Any, TypeVar

from lieednn_sim._processes import LoneWorkerProcess, WorkerContext
from lieednn_sim.arm import Arm
from lieednn_sim.budget import one_blas_thread
from lieednn_sim.errors import LieEDNNError, PlanError
from lieednn_sim.registry import optional_module

_T = TypeVar("_T")
# In the searching process, the arm of the next searches.
_ARM: Arm | None = None


def aside(arm: Arm, search: Callable[..., _T], *arguments: Any) -> Future[_T]:
    """Call a function of the package, with the arm and other arguments, beside the control loop; calls take turns.

    The process starts with the first call. An arm, without its spec, is sent with the first of several calls for it in
    a row. If no process can be started, or it was ended, a thread takes its place, and a warning says so.
    """
    return _searcher(os.getpid()).submit(arm, search, *arguments)


def found(search: Future[_T]) -> _T:
    """What a call of `aside` returned; raises `PlanError` with the message of its error, or if its process ended."""
    try:
        return search.result()
    except LieEDNNError as error:
        raise PlanError(str(error)) from None
    except BrokenExecutor:
        raise PlanError("the process that searched has ended") from None


def get_ready(arm: Arm) -> None:
    """Start the process ahead of the first search, and import what searches need."""
    aside(arm, _import)


def _import(_: Arm) -> None:
    optional_module("ompl.geometric")


class _Searcher:
    # One worker, since OMPL's random numbers are global.
    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: weakref.ref[Arm] | None = None
        self._pool: Executor = ProcessPoolExecutor(1, mp_context=WorkerContext(LoneWorkerProcess))

    def submit(self, arm: Arm, *call: Any) -> Future[Any]:
        with self._lock:
            try:
                return self._submitted(arm, *call)
            # Errors of multiprocessing, such as that a daemonic process may have no children.
            except (AssertionError, OSError, RuntimeError) as error:
                said = f"searches run in a thread, which may delay periods, since there is no process for them: {error}"
                warnings.warn(said, RuntimeWarning, stacklevel=4)
                self._pool, self._last = ThreadPoolExecutor(1, "searches"), None
                return self._submitted(arm, *call)

    def _submitted(self, arm: Arm, *call: Any) -> Future[Any]:
        if self._last is None or self._last() is not arm:
            # MuJoCo cannot pickle a spec. The arm is pickled here, so that a failure raises here.
            self._pool.submit(_take, pickle.dumps(replace(arm.without_visuals, spec=None)))
            self._last = weakref.ref(arm)
        return self._pool.submit(_call, *call)


@cache
def _searcher(_: int) -> _Searcher:
    # One for each process, since what it runs does not survive a fork.
    return _Searcher()


def _take(arm: bytes) -> None:
    global _ARM
    _ARM = pickle.loads(arm)


def _call(search: Callable[..., _T], *arguments: Any) -> _T:
    with one_blas_thread():
        return search(_ARM, *arguments)
