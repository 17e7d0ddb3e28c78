"""The console of all commands, and its progress bar."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from lieednn_sim.arm import Arm
from lieednn_sim.budget import reporting
from lieednn_sim.errors import NotCertifiedError
from lieednn_sim.evaluation.display import table
from lieednn_sim.network import ComponentwiseNetwork


class _Console(Console):
    def on_broken_pipe(self) -> None:
        raise BrokenPipeError  # handled by `main`; rich would exit with 1


# Output contains the user's texts, paths and messages: [brackets] and :colons: in it are not markup.
console = _Console(markup=False, emoji=False, highlight=False, soft_wrap=True)


def to_stderr() -> Console:
    """A console for progress and errors."""
    return Console(stderr=True, markup=False, emoji=False, highlight=False)


@contextlib.contextmanager
def progress(what: str) -> Iterator[None]:
    """Show a progress bar on stderr, if that is a terminal, of what the block reports (`budget.report`).

    Until then, only the time is shown.
    """
    description = TextColumn("{task.description:<10}", markup=False)
    columns = (description, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    stderr = to_stderr()
    with Progress(*columns, console=stderr, transient=True, disable=not stderr.is_terminal) as bar:
        shown = bar.add_task(what, total=None)
        with reporting(lambda done, total: bar.update(shown, completed=done, total=total)):
            yield


def print_import_report(arm: Arm) -> None:
    """Print the report of an imported arm; nothing for another arm."""
    if arm.import_report is None:
        return
    rows = table(f"{arm.name}: imported from {arm.source.name}", "what", "how")
    rows.columns[1].justify = "left"
    rows.columns[1].overflow = "fold"
    for line in str(arm.import_report).splitlines():
        what, _, how = line.partition(": ")
        rows.add_row(what, how)
    console.print(rows)


def print_stability(network: ComponentwiseNetwork, xi: ArrayLike) -> None:
    """Print the stability conditions at the equilibrium found from ``xi``, and bounds on pushes, targets and steps."""
    console.print(f"stability: {network.assess(xi)}")
    with contextlib.suppress(NotCertifiedError):
        console.print(str(network.robustness()))


def one_norm(network: ComponentwiseNetwork, xi: ArrayLike) -> str:
    """The 1-norm of the weights, and its least value for any network with the equilibrium ``xi``."""
    result, least = np.linalg.norm(network.weight, 1), network.smallest_one_norm(xi)
    return f"{result:.2f} (no network with this equilibrium below {least:.2f})"


def wrote(*paths: object) -> None:
    """Print the files written."""
    for path in paths:
        console.print(f"wrote {path}")
