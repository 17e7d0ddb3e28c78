"""Comparisons: all their cases on several cores or any executor, resumable."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from rich.console import Console

from lieednn_sim import filesystem
from lieednn_sim.arm import arm_names
from lieednn_sim.arm.scenes import SCENES
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.evaluation.cases import FREE, Settings, failed_case, run_case
from lieednn_sim.evaluation.entries import ARM, SCENE, Entry, enter, record
from lieednn_sim.evaluation.rows import Case
from lieednn_sim.evaluation.shards import Shard
from lieednn_sim.evaluation.statistics import numbers
from lieednn_sim.evaluation.table import R, Rows, Table
from lieednn_sim.evaluation.workers import run_each
from lieednn_sim.planning import missing_planners, planners
from lieednn_sim.simulation import controllers
from lieednn_sim.validation import as_choice, as_count, as_workers
from lieednn_sim.values import check_fields

DEFAULT_CONTROLLERS = ("position-servo", "inverse-dynamics")
DEFAULT_SCENES = (FREE, "window")
# CPU times of a case [s], planning and both default controllers, of the planners that need more than a second in the
# mean over the package's arms, free and behind the window, and of all others. Declared, not measured, so that which
# cases there are depends on no machine; the order of cases follows them until the table holds planning times.
SLOW_PLANNERS = {"lieednn-trained": 2.7, "trajectory-optimisation": 1.6, "rrt-star": 1.3}
SLOW_PLANNERS |= dict.fromkeys(("lieednn-filtered", "lieednn-guided"), 1.1)
_COST = 0.6


@dataclass(frozen=True)
class Selection:
    """What to compare; empty means all (for scenes and controllers, the default ones).

    Attributes:
        planners: names of `PLANNERS`; `compare` leaves out those whose package is missing.
        arms: names of `arm_names`, or files as for `Arm.load`, which are replaced by their names.
        scenes: names of scenes, or files of obstacles, likewise.
        controllers: names of `CONTROLLERS`.
        seeds: number of seeds, starting at 0.
        slow_seeds: number of seeds of the planners in `SLOW_PLANNERS`, at most ``seeds``; None for as many.
        entries: the arms and scenes from files; those given here can be referred to by name.

    Raises:
        FileError: a file is missing or cannot be read.
        InputError: a name is unknown (the message lists the known ones), a file holds no arm or scene, or
            ``slow_seeds`` is larger than ``seeds``.
    """

    planners: Sequence[str] = ()
    arms: Sequence[str] = ()
    scenes: Sequence[str] = ()
    controllers: Sequence[str] = ()
    seeds: int = 3
    entries: tuple[Entry, ...] = ()
    slow_seeds: int | None = None

    def __post_init__(self) -> None:
        entries = list(self.entries)
        for name, known, default in (
            ("planners", list(planners()), list(planners())),
            ("arms", arm_names(), arm_names()),
            ("scenes", list(SCENES), list(DEFAULT_SCENES)),
            ("controllers", list(controllers()), list(DEFAULT_CONTROLLERS)),
        ):
            given = getattr(self, name) or default
            kind = name.removesuffix("s")
            if kind in (ARM, SCENE):
                known += [entry.name for entry in entries if entry.kind == kind]
                given, own = enter(kind, given, known)
                entries += own
                known += [entry.name for entry in own]
            chosen = tuple(dict.fromkeys(given))
            for value in chosen:
                as_choice(kind, value, known)
            object.__setattr__(self, name, chosen)
        object.__setattr__(self, "entries", tuple(entries))
        check_fields(self, as_count, "seeds")
        if self.slow_seeds is not None and as_count("slow_seeds", self.slow_seeds) > self.seeds:
            raise InputError(f"slow_seeds must be at most seeds, {self.seeds}, got {self.slow_seeds}")

    def cases(self, absent: Collection[str] | None = None) -> list[Case]:
        """All combinations without absent planners, which are by default those whose package is missing."""
        absent = missing_planners() if absent is None else absent
        usable = [name for name in self.planners if name not in absent]
        few = self.seeds if self.slow_seeds is None else self.slow_seeds
        combinations = itertools.product(self.arms, self.scenes, usable, range(self.seeds))
        cases = itertools.starmap(Case, combinations)
        return [case for case in cases if case.seed < few or case.planner not in SLOW_PLANNERS]


def compare(
    directory: str | os.PathLike[str],
    selection: Selection,
    settings: Settings,
    *,
    jobs: int = 1,
    console: Console | None = None,
    executor: Executor | None = None,
    shard: Shard | None = None,
) -> Table:
    """Compute the rows that the directory's table lacks.

    A case is planned once for all controllers. Cases of one arm among the same obstacles are consecutive, so that a
    worker loads it once, with the slow ones first. Finished cases are kept when it is interrupted.

    Args:
        directory: directory of the table.
        selection: what to compare.
        settings: settings of all rows; a table made with others is refused.
        jobs: number of worker processes.
        console: console for a progress bar; None for no bar.
        executor: runs the cases instead of worker processes; the rows are the same.
        shard: compute only this shard of the cases, for `merging.merge`.

    Returns:
        The table, including rows of earlier runs.

    Raises:
        InputError: an argument is of another type, or ``jobs`` is less than 1.
        FileError: see `Table` and `entries.record`.
        LieEDNNError: a worker process died, or the executor gave up.
    """
    workers = as_workers("jobs", jobs)
    record(filesystem.make_directory(directory), selection.entries)
    absent = {name: reason for name, reason in missing_planners().items() if name in selection.planners}
    part = {} if shard is None else {"shard": shard.number, "shards": shard.of}
    table = Table(directory, settings, part and {**part, **asdict(selection), "absent": absent})
    cases = [case for case in selection.cases(absent) if shard is None or Shard.holding(case, shard.of) == shard]
    wanted = [(case, table.missing(case, selection.controllers)) for case in cases]
    costs = _planning_costs(table, selection)
    todo = sorted(
        ((case, names) for case, names in wanted if names),
        key=lambda job: (job[0].arm, job[0].scene, job[0].seed, -costs[job[0].planner]),
    )
    tasks = [(*job, settings) for job in todo]
    run = partial(run_case, entries=selection.entries) if selection.entries else run_case
    complete(table, run, failed_case, tasks, workers=workers, title="cases", console=console, executor=executor)
    return table


def complete(
    table: Rows[R],
    run: Callable[..., list[R]],
    failed: Callable[..., list[R]],
    todo: Sequence[tuple[Any, ...]],
    *,
    workers: int,
    title: str,
    console: Console | None,
    executor: Executor | None,
) -> None:
    """Compute the rows of cases in other processes and add them; finished ones are kept when it is interrupted.

    Args:
        table: the table to add to.
        run: computes the rows of a case, in another process.
        failed: makes the rows of a case that raised, from the same arguments and the reason.
        todo: arguments of each case.
        workers: most worker processes.
        title: title of the progress bar.
        console: console for the bar and for errors, or None.
        executor: runs the cases instead of worker processes, if given.

    Raises:
        FileError: the table cannot be written.
        LieEDNNError: a worker process died, or the executor gave up.
    """
    if not todo:
        return
    shown = console or Console(quiet=True)

    def add(case: tuple[Any, ...], rows: list[R], error: Exception | None) -> None:
        if error is not None:
            reason = f"error: {type(error).__name__}: {error}"
            shown.print("; ".join([reason, *getattr(error, "__notes__", ())]), markup=False, highlight=False)
            rows = failed(*case, reason)
        table.add(rows)

    try:
        run_each(run, todo, add, workers=workers, title=title, console=shown, executor=executor)
    except (BrokenExecutor, CancelledError):
        raise LieEDNNError(
            f"a worker process died (out of memory?); finished cases are kept in {table.csv}, the same command "
            "continues; --jobs 1 needs less memory"
            if executor is None
            else f"the executor gave up; finished cases are kept in {table.csv}, the same command continues"
        ) from None
    finally:
        table.save()


def _planning_costs(table: Table, selection: Selection) -> Mapping[str, float]:
    costs = {}
    for planner in selection.planners:
        known = numbers([row for row in table.rows.values() if row.planner == planner], "planning_s")
        costs[planner] = max(known) if known else SLOW_PLANNERS.get(planner, _COST)
    return costs
