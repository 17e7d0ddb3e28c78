"""The base class of studies: cases that run on several cores, into a table that can be continued."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, Generic, TypeVar

from rich.console import Console

from lieednn_sim import io
from lieednn_sim.studies.rows import TableRow
from lieednn_sim.studies.table import SUFFIX, Table
from lieednn_sim.studies.user_files import UserFile
from lieednn_sim.studies.workers import run_each
from lieednn_sim.validation import as_workers

R = TypeVar("R", bound=TableRow)


class Study(ABC, Generic[R]):
    """Base class of studies: it says which cases there are, how the rows of one are computed, and what all rows share.

    Attributes:
        name: name of the table's file without suffix, and of the progress bar.
        kind: class of the rows.
        run: the function that computes the rows of a case from its arguments in `todo`. It runs in another process, so
            it must be defined at the top of a module. Where a case fails, its rows carry the reason; an exception
            counts as a bug.
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

    def open(self, directory: str | os.PathLike[str]) -> Table[R]:
        """The table in a directory, which is created if it is missing; raises as `Table.begin`."""
        path = io.make_directory(directory) / f"{self.name}{SUFFIX}"
        return Table.begin(path, self.kind, self.settings(), self.user_files)


def compute(
    study: Study[R], directory: str | os.PathLike[str], *, jobs: int = 1, console: Console | None = None
) -> Table[R]:
    """The table of a directory, with the rows that it lacked computed; finished cases are kept when interrupted.

    Args:
        study: the study.
        directory: directory of the table.
        jobs: number of worker processes; with 1 the cases run in this process. A script that starts workers needs
            `if __name__ == "__main__":`, as always with Python's `multiprocessing`.
        console: console for a progress bar and for errors; None for neither.

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

    run_each(run, todo, add, workers=workers, title=study.name, console=shown)
    return table
