"""The base class of studies: cases that run on worker processes, into a table that can be continued."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import multiprocessing
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, ProcessPoolExecutor, wait
from functools import partial
from typing import Any, ClassVar, Generic

from rich.console import Console

from lieednn_sim import io
from lieednn_sim._processes import WorkerContext
from lieednn_sim.budget import report, reporting
from lieednn_sim.entries import Registry
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.registry import CONTROLLERS, PLANNERS, POLICIES
from lieednn_sim.studies.rows import R
from lieednn_sim.studies.table import SUFFIX, Table
from lieednn_sim.studies.user_files import UserFile
from lieednn_sim.validation import as_workers
from lieednn_sim.values import StrPath

_OF_USERS: tuple[Registry[Any], ...] = PLANNERS, POLICIES, CONTROLLERS  # kinds to which users add
_Entry = tuple[int, str, str]  # of a user: see `_of_users`


class Study(ABC, Generic[R]):
    """Base class of studies: defines the cases, how the rows of a case are computed, and the settings of all rows.

    Attributes:
        name: name of the table's file without suffix.
        kind: class of the rows.
        run: the function that computes the rows of a case from its arguments in `todo`. It runs in another process, so
            it must be defined at the top of a module. If a case fails, its rows carry the reason; exceptions are bugs.
        failed: the function that makes the rows of a case that raised, from its arguments in `todo` and the reason.
        user_files: the user's arms and scenes; where there are any, `run` gets them as ``user_files``.
    """

    name: ClassVar[str]
    kind: type[R]
    run: Callable[..., list[R]]
    failed: Callable[..., list[R]]
    user_files: tuple[UserFile, ...] = ()

    def settings(self) -> Mapping[str, Any]:
        """Settings of all rows; a table that was made with others is refused."""
        return {}

    @abstractmethod
    def todo(self, table: Table[R]) -> Sequence[tuple[Any, ...]]:
        """Arguments of the cases whose rows the table lacks."""

    def open(self, directory: StrPath) -> Table[R]:
        """The table in a directory, which is created if it is missing; raises as `Table.begin`."""
        path = io.make_directory(directory) / f"{self.name}{SUFFIX}"
        return Table.begin(path, self.kind, self.settings(), self.user_files)


def compute(study: Study[R], directory: StrPath, *, jobs: int = 1, console: Console | None = None) -> Table[R]:
    """Compute the rows that the table of a directory lacks; finished cases are kept when interrupted.

    Progress in cases is reported (`budget.reporting`).

    Args:
        directory: directory of the table.
        jobs: number of worker processes; with 1 the cases run in this process. A script that starts workers needs
            `if __name__ == "__main__":`, as always with Python's `multiprocessing`.
        console: console for errors; None for none.

    Raises:
        InputError: ``jobs`` is less than 1.
        FileError: see `Table.begin`; or the table cannot be written.
        LieEDNNError: a worker process died.
    """
    workers = as_workers("jobs", jobs)
    table = study.open(directory)
    todo = study.todo(table)
    if not todo:
        return table
    run = partial(study.run, user_files=study.user_files) if study.user_files else study.run
    shown = console or Console(quiet=True)

    def add(case: tuple[Any, ...], rows: list[R], error: Exception | None) -> None:
        if error is not None:
            reason = f"error: {type(error).__name__}: {error}"
            shown.print("; ".join([reason, *getattr(error, "__notes__", ())]), markup=False, highlight=False)
            rows = study.failed(*case, reason)
        table.add(rows)

    chosen = {name for kind in _OF_USERS for name in getattr(study, kind.plural, ())}
    run_each(run, todo, add, workers=workers, needed=tuple(it for it in _of_users() if it[1] in chosen))
    return table


@contextlib.contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes, which are stopped at once when the block fails or is interrupted.

    None of them survives the block; other children of this process are left alone. `LieEDNNError` if it may have none.
    """
    if sys.platform == "win32":
        workers = min(workers, 61)  # the most that a pool can have there
    if multiprocessing.current_process().daemon:
        raise LieEDNNError("a daemonic process, such as one of multiprocessing.Pool, can start no workers: use one job")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, mp_context=WorkerContext(), initializer=_prepare_worker, initargs=_of_users())
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
    needed: tuple[_Entry, ...] = (),
) -> None:
    """Run tasks on worker processes, or in this process where one is enough; `LieEDNNError` if a worker died.

    ``todo`` holds the arguments of each task. When one ends, in any order, ``done`` is called in this process with its
    arguments, its result and its exception, and progress is reported (`budget.reporting`). All must be picklable.
    ``needed`` are entries of users that workers must find.
    """
    workers = min(workers, len(todo))
    with worker_pool(workers) if workers > 1 else contextlib.nullcontext() as pool:
        if pool and needed and (lacking := next(_on_workers(pool, _unknown, [needed] * workers, workers))[1]):
            raise LieEDNNError(f"workers do not find {', '.join(lacking)}: give it as file.py:name, or use one job")
        ended = _here(run, todo) if pool is None else _on_workers(pool, run, todo, 2 * workers)
        for count, outcome in enumerate(ended, 1):
            done(*outcome)
            report(count, len(todo))


_Outcome = tuple[tuple[Any, ...], Any, Exception | None]


def _here(run: Callable[..., Any], todo: Sequence[tuple[Any, ...]]) -> Iterator[_Outcome]:
    for task in todo:
        try:
            with reporting(lambda *_: None):  # the task's own progress is not shown
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
            # Finished tasks are yielded before the error of a worker that died.
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


def _of_users() -> tuple[_Entry, ...]:
    """Entries that users have added: indices of their kinds, their names, and modules for workers to import."""
    entries = ((k, *item) for k, kind in enumerate(_OF_USERS) for item in kind.entries.items())
    return tuple((k, name, str(entry.place.__module__)) for k, name, entry in entries if not entry.own)


def _prepare_worker(*entries: _Entry) -> None:
    for kind, name, module in entries:
        # Errors are ignored here: `_unknown`, or the rows, report what is missing.
        with contextlib.suppress(Exception):
            _OF_USERS[kind].find(name) if ":" in name else importlib.import_module(module)


def _unknown(*entries: _Entry) -> list[str]:
    return [f"{_OF_USERS[kind].kind} {name!r}" for kind, name, _ in entries if name not in _OF_USERS[kind]]
