"""Worker processes of the studies, with progress and interruption."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import itertools
import math
import multiprocessing
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from functools import cache, partial
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from time import monotonic
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.registry import CONTROLLERS, PLANNERS, POLICIES

# Tasks submitted at once: enough for a cluster, while memory does not grow with the study.
_AHEAD = 4096
# Largest fraction of a process's time that `released` takes; when it last did its work, and how long that took [s].
_RELEASING = 0.05
_released = (-math.inf, 0.0)
# What reaches a whole process group, and whether the system can block it.
_GROUP, _BLOCKS = {signal.SIGINT}, hasattr(signal, "pthread_sigmask")
# Most processes that a pool can have on Windows.
_MOST_ON_WINDOWS = 61


class _Worker(SpawnProcess):
    """A process that starts with Ctrl-C blocked, so that none ends it with a traceback before it is prepared.

    Windows cannot block it; the traceback is all that differs there.
    """

    def start(self) -> None:
        if not _BLOCKS:
            super().start()
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _GROUP)
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(SpawnContext):
    Process = _Worker


@contextlib.contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes, which are stopped at once when the block fails or is interrupted.

    None of them survives the block, however it ends; other children of this process are left alone.
    """
    context: Any = _Context()
    workers = min(workers, _MOST_ON_WINDOWS) if sys.platform == "win32" else workers
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare_worker, initargs=(_modules(),))
    try:
        yield pool
    except BaseException:
        # Including Ctrl-C: a job may take a minute, and its worker ignores the signal.
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        # Waits for the workers to finish or to be terminated.
        pool.shutdown()


def run_each(
    run: Callable[..., Any],
    todo: Sequence[tuple[Any, ...]],
    done: Callable[[tuple[Any, ...], Any, Exception | None], None],
    *,
    workers: int,
    title: str,
    console: Console,
    executor: Executor | None = None,
) -> None:
    """Run tasks on worker processes, or on an executor, which stays open.

    Args:
        run: runs a task; it, its arguments and results must be picklable.
        todo: arguments of each task.
        done: called here when a task ends, in any order, with its arguments, its result, and its exception.
        workers: most worker processes, without an executor.
        title: title of the progress bar.
        console: console for the bar.
        executor: runs the tasks instead of worker processes.

    Raises:
        BrokenExecutor: a worker process died.
        LieEDNNError: the executor has lost its workers, or has unsuitable ones.
        CancelledError: the executor gave up a task.
    """
    if not todo:
        return
    waiting, ended = iter(todo), queue.SimpleQueue[Future[Any]]()
    running: dict[Future[Any], tuple[Any, ...]] = {}
    pools = worker_pool(min(workers, len(todo))) if executor is None else contextlib.nullcontext(executor)
    with pools as pool, progress_bar(console) as progress:
        bar = progress.add_task(title, total=len(todo))
        try:
            for _ in todo:
                for task in itertools.islice(waiting, _AHEAD - len(running)):
                    future = pool.submit(partial(released, run), *task)
                    running[future] = task
                    future.add_done_callback(ended.put)
                future = ended.get()
                task, error = running.pop(future), future.exception()
                if isinstance(error, BrokenExecutor) and executor is not None:
                    raise LieEDNNError(
                        f"the executor gave up: {error}; finished work is kept, the same command continues"
                    )
                if isinstance(error, Exception) and not isinstance(error, BrokenExecutor):
                    done(task, None, error)
                else:
                    done(task, future.result(), None)
                progress.update(bar, advance=1)
        finally:
            # Worker processes are stopped by `worker_pool` instead.
            for future in running if executor is not None else ():
                future.cancel()


def released(run: Callable[..., Any], *task: Any) -> Any:
    """Run a task, then return the memory that it used to the system.

    A reference cycle of a few Python objects may hold megabytes of MuJoCo's or OMPL's, which Python does not count when
    it decides whether to collect cycles; and arrays of many sizes leave holes in the heap of glibc, which keeps them.
    Without this, workers grew from 0.2 to 0.8 GB in a thousand cases. In an executor's process, where a collection has
    much to search, it is done less often than after each task, so that it takes at most a twentieth of the time.
    """
    global _released
    try:
        return run(*task)
    finally:
        begun, (last, took) = monotonic(), _released
        if took <= _RELEASING * (begun - last):
            gc.collect()
            _trim()(0)
            _released = monotonic(), monotonic() - begun


@cache
def _trim() -> Callable[[int], Any]:
    """Glibc's `malloc_trim`; elsewhere a function that does nothing."""
    try:
        return getattr(ctypes.CDLL(None), "malloc_trim", lambda _: 0)
    except TypeError:  # Windows gives no handle of the program itself
        return lambda _: 0


def progress_bar(console: Console) -> Progress:
    """The progress bar of a study."""
    times = (TimeElapsedColumn(), TextColumn("done, left"), TimeRemainingColumn())
    return Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), *times, console=console)


def exit_code(work: Callable[[], Path], console: Console, kept: str) -> int:
    """Run ``work`` and print the path that it returns; returns 0, 130 when interrupted, or 1 with the error printed."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        path = work()
    except KeyboardInterrupt:
        console.print(f"stopped; finished {kept} are kept, the same command continues from there")
        return 130
    except BrokenExecutor:
        console.print("a worker process died (out of memory?); the same command continues, --jobs 1 needs less memory")
        return 1
    except (LieEDNNError, OSError) as error:
        console.print(f"error: {error}", markup=False, emoji=False, highlight=False)
        return 1
    print(path)
    return 0


def _modules() -> list[str]:
    """Modules of the user's planners, policies and controllers, which workers must import to register these."""
    entries = [entry for kind in (PLANNERS, POLICIES, CONTROLLERS) for entry in kind.entries.values()]
    return sorted({str(entry.place.__module__) for entry in entries if not entry.own} - {"__main__"})


def _prepare_worker(modules: Sequence[str]) -> None:
    for name in modules:
        # Rows report what is missing then.
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    # Ctrl-C reaches the whole process group; the main process stops the workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if _BLOCKS:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _GROUP)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # What is imported stays: with it, `released` would take 50 ms in place of 2.
    gc.freeze()


def _end_with_parent() -> None:
    """End this worker when the main process is killed; a pool's worker would wait forever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
