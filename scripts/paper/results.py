"""Results of all jobs: run, kept, grouped, and the few statistics that figures, tables and claims need."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from lieednn_sim import io
from lieednn_sim.budget import one_blas_thread
from lieednn_sim.errors import FileError
from lieednn_sim.studies.study import run_each
from paper import experiments
from paper.plan import INSIDE, Job, Plan

KIND = "paper-experiment"


@dataclass(frozen=True)
class Record:
    """Result of a job.

    Attributes:
        job: what was run.
        arrays: by name.
        values: scalars by name; what is infinite or undefined is NaN.
    """

    job: Job
    arrays: dict[str, np.ndarray]
    values: dict[str, Any]

    def __getitem__(self, name: str) -> Any:
        return self.values.get(name, float("nan"))


def run(job: Job) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Do a job, wherever that is; returns arrays and metadata of its result."""
    start = time.process_time()
    with one_blas_thread():
        arrays, values = experiments.KINDS[job.kind](**job.parameters)
    values = {**values, "job_seconds": time.process_time() - start}
    finite = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
    return arrays, {"values": finite, "parameters": job.parameters}


def load(job: Job, directory: Path) -> Record | None:
    """Read the result of a job; None when there is none that can be read."""
    try:
        arrays, meta = io.load_arrays(directory / f"{job.key}.npz", KIND)
        values = {k: float("nan") if v is None else v for k, v in meta["values"].items()}
    except (FileError, KeyError, AttributeError):
        return None
    return Record(job, arrays, values)


def run_all(jobs: Iterable[Job], directory: Path, workers: int, console: Console) -> list[str]:
    """Run the jobs without a result, on worker processes; each is a file of its own, so that the rest can go on.

    Returns:
        A line for each job that failed.

    Raises:
        KeyboardInterrupt: after the workers are stopped; what they finished is kept.
    """
    # Two groups may share a job.
    todo = {job.key: job for job in jobs if load(job, directory) is None}
    failures: list[str] = []

    def keep(task: tuple[Job], result: Any, error: Exception | None) -> None:
        (job,) = task
        if error is None:
            io.save_arrays(directory / f"{job.key}.npz", KIND, *result)
        else:
            failures.append(f"{job.name} {job.parameters}: {type(error).__name__}: {error}")
            console.print(f"[red]failed:[/red] {failures[-1]}", highlight=False)

    tasks = [(job,) for job in todo.values()]
    run_each(run, tasks, keep, workers=workers, title="experiments", console=console)
    return failures


@dataclass(frozen=True)
class Results:
    """What was found.

    Attributes:
        plan: what was run.
        groups: records by the name of their group, in the order of the seeds.
        missing: jobs without a result.
    """

    plan: Plan
    groups: dict[str, list[Record]]
    missing: tuple[Job, ...]

    @classmethod
    def collect(cls, plan: Plan, jobs: Iterable[Job], load: Callable[[Job], Record | None]) -> Results:
        """Load the records of the jobs."""
        groups: dict[str, list[Record]] = {}
        missing = []
        for job in jobs:
            record = load(job)
            if record is None:
                missing.append(job)
            else:
                groups.setdefault(job.name, []).append(record)
        return cls(plan, groups, tuple(missing))

    def __getitem__(self, name: str) -> list[Record]:
        return self.groups.get(name, [])

    def successes(self, name: str) -> list[Record]:
        """Records whose network has the target as a stable equilibrium, within the tolerance."""
        return [record for record in self[name] if record["success"]]

    def example(self) -> int | None:
        """The first target that is learned with P = 10, by the ablation, and if possible with every P in 8 to 16."""
        ablated = seeds(self.successes("no projection"))
        learned = {period: seeds(self.successes(f"P={period}")) & ablated for period in INSIDE}
        for names in (INSIDE, (10,)):
            common = set.intersection(*(learned[period] for period in names))
            if common:
                return min(common)
        return None

    def of(self, name: str, seed: int | None) -> Record | None:
        """The record of a target."""
        return next((record for record in self[name] if record.job.parameters.get("seed") == seed), None)


def seeds(records: Iterable[Record]) -> set[int]:
    """Targets of the records."""
    return {record.job.parameters["seed"] for record in records}


def column(records: Iterable[Record], name: str) -> np.ndarray:
    """A scalar of every record that has it."""
    values = np.array([float(record[name]) for record in records])
    return values[~np.isnan(values)]


def fraction(records: list[Record], name: str = "success") -> float:
    """Fraction of records for which a flag is set; NaN without records."""
    return float(np.mean([bool(record.values.get(name, False)) for record in records])) if records else float("nan")


def quantiles(values: np.ndarray, *levels: float) -> list[float]:
    """Quantiles, NaN of nothing."""
    return [float(x) for x in np.quantile(values, levels)] if len(values) else [float("nan")] * len(levels)


def curves(records: list[Record], name: str, grid: np.ndarray) -> np.ndarray:
    """A column of the stored histories on a common grid of epochs, ``(records, len(grid))``.

    A run that stopped keeps its last value.
    """
    rows = []
    for record in records:
        epoch = record.arrays["epoch"]
        rows.append(record.arrays[name][np.clip(np.searchsorted(epoch, grid, side="right") - 1, 0, None)])
    return np.array(rows)
