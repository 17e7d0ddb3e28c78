"""Worker processes of the studies, with progress and interruption."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import multiprocessing
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, ProcessPoolExecutor, wait
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from lieednn_sim._processes import WorkerContext
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.registry import CONTROLLERS, PLANNERS, POLICIES, Registry

_OF_USERS: tuple[Registry[Any], ...] = PLANNERS, POLICIES, CONTROLLERS  # kinds to which users add


@contextlib.contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes, which are stopped at once when the block fails or is interrupted.

    None of them survives the block, however it ends; other children of this process are left alone.
    """
    if sys.platform == "win32":
        workers = min(workers, 61)  # the most that a pool can have there
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, mp_context=WorkerContext(), initializer=_prepare_worker, initargs=_added())
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
) -> None:
    """Run tasks on worker processes, or in this process where one is enough; `LieEDNNError` if a worker died.

    ``todo`` holds each task's arguments, with which, its result and its exception ``done`` is called here when it ends,
    in any order. What goes to worker processes and back must be picklable.
    """
    workers = min(workers, len(todo))
    pools = worker_pool(workers) if workers > 1 else contextlib.nullcontext()
    times = (TimeElapsedColumn(), TextColumn("done, left"), TimeRemainingColumn())
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), *times)
    with pools as pool, Progress(*columns, console=console) as progress:
        ended = _here(run, todo) if pool is None else _on_workers(pool, run, todo, 2 * workers)
        for outcome in progress.track(ended, total=len(todo), description=title):
            done(*outcome)


_Outcome = tuple[tuple[Any, ...], Any, Exception | None]


def _here(run: Callable[..., Any], todo: Sequence[tuple[Any, ...]]) -> Iterator[_Outcome]:
    for task in todo:
        try:
            ended: _Outcome = task, run(*task), None
        except Exception as error:
            ended = task, None, error
        yield ended


def _on_workers(
    pool: ProcessPoolExecutor, run: Callable[..., Any], todo: Sequence[tuple[Any, ...]], ahead: int
) -> Iterator[_Outcome]:
    """The outcomes of tasks as they end; few are submitted ahead, so that memory does not grow with the study."""
    waiting = iter(todo)
    try:
        running = {pool.submit(run, *task): task for task in itertools.islice(waiting, ahead)}
        while running:
            ended = wait(running, return_when=FIRST_COMPLETED).done
            # What is finished counts before a worker that died.
            for future in sorted(ended, key=lambda future: isinstance(future.exception(), BrokenExecutor)):
                task, error = running.pop(future), future.exception()
                if isinstance(error, BrokenExecutor) or not isinstance(error, Exception | None):
                    raise error
                yield task, None if error else future.result(), error
            running |= {pool.submit(run, *task): task for task in itertools.islice(waiting, len(ended))}
    except BrokenExecutor:
        raise LieEDNNError(
            "a worker process died, of too little memory, or because a script that starts workers has no "
            "`if __name__ == '__main__':`; finished work is kept, the same command continues, and one job needs less "
            "memory"
        ) from None


def _added() -> tuple[list[str], list[tuple[int, str]]]:
    """Modules of what users added, which workers must import, and names as ``file.py:thing`` by kinds' indices."""
    entries = [entry for kind in _OF_USERS for entry in kind.entries.values()]
    modules = sorted({str(entry.place.__module__) for entry in entries if not entry.own} - {"__main__"})
    return modules, [(k, name) for k, kind in enumerate(_OF_USERS) for name in kind.entries if ":" in name]


def _prepare_worker(modules: Sequence[str], files: Sequence[tuple[int, str]]) -> None:
    # Rows report what is missing then.
    for name in modules:
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    for kind, name in files:
        with contextlib.suppress(Exception):
            _OF_USERS[kind].find(name)
