"""The console of all commands, and its progress bar."""

from __future__ import annotations

import contextlib
import shlex
import sys
import textwrap
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer.report import ImportReport
from lieednn_sim.budget import reporting
from lieednn_sim.errors import NotCertifiedError

if TYPE_CHECKING:
    from lieednn_sim.network import ComponentwiseNetwork


class _Console(Console):
    def on_broken_pipe(self) -> None:
        raise BrokenPipeError  # handled by `main`; rich would exit with 1


# Output contains the user's texts, paths and messages, in which [brackets] and :colons: are no markup. In a terminal,
# long lines are broken between words.
console = _Console(markup=False, emoji=False, highlight=False, soft_wrap=not sys.stdout.isatty())


def to_stderr() -> Console:
    """A console for progress and errors."""
    return Console(stderr=True, markup=False, emoji=False, highlight=False)


@contextlib.contextmanager
def progress(what: str) -> Iterator[None]:
    """Show a progress bar of the work that the block reports (`budget.report`), if stderr is a terminal.

    Until the first report, only the time is shown.
    """
    description = TextColumn("{task.description:<10}", markup=False)
    columns = (description, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    stderr = to_stderr()
    with Progress(*columns, console=stderr, transient=True, disable=not stderr.is_terminal) as bar:
        shown = bar.add_task(what, total=None)
        with reporting(lambda done, total: bar.update(shown, completed=done, total=total)):
            yield


def print_import_report(arm: Arm, *, whole: bool = False) -> None:
    """Print the report of an imported arm, in a few lines or as a whole; nothing for arms of the package."""
    if arm.import_report is not None:
        console.print(f"{arm.name}, imported from {arm.source.name}:")
        console.print(str(arm.import_report) if whole else _summary(arm.import_report, str(arm.source)))


def _summary(report: ImportReport, file: str) -> str:
    """A report in at most four lines; the last one says how to read the whole report."""
    kept = sum(servo.kept for servo in report.servos)
    driven = f"{kept} kept, {len(report.servos) - kept} made"
    lines = [f"  links {', '.join(report.links)} on {report.base}; actuators: {driven}"]
    # Without the long list of bodies that come near each other.
    seen = [textwrap.shorten(text.partition(", between ")[0], 120, placeholder=" ...") for text in report.remarks]
    lines += [f"  look at: {text}" for text in seen[:2]]
    return "\n".join([*lines, f"  the whole report: lieednn-sim arms {shlex.quote(file)}"])


def print_stability(network: ComponentwiseNetwork, xi: ArrayLike, *, whole: bool = True) -> None:
    """Print how stable the equilibrium found from ``xi`` is; if ``whole``, all conditions and robustness bounds."""
    verdict = str(network.assess(xi))
    console.print(f"stability: {verdict if whole else verdict.splitlines()[0]}")
    if whole:
        with contextlib.suppress(NotCertifiedError):
            console.print(str(network.robustness()))


def wrote(*paths: str | Path) -> None:
    """Print the files written, those of a directory in one line."""
    for folder, files in groupby(map(Path, paths), key=lambda path: path.parent):
        first, *more = files
        names = ", ".join(file.name for file in (first, *more))
        console.print(f"wrote in {folder}: {names}" if more else f"wrote {first}", soft_wrap=True)
