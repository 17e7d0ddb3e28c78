"""Run jobs in worker processes; each result is a file of its own, so that an interrupted run can go on."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from lieednn_sim import io
from lieednn_sim.errors import FileError
from lieednn_sim.studies.workers import run_each
from paper import experiments
from paper.plan import Job

_KIND = "paper-experiment"


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
    begun = time.process_time()
    arrays, values = experiments.KINDS[job.kind](**job.parameters)
    values = {**values, "job_seconds": time.process_time() - begun}
    finite = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
    return arrays, {"values": finite, "parameters": job.parameters}


def load(job: Job, directory: Path) -> Record | None:
    """Read the result of a job; None when there is none that can be read."""
    try:
        arrays, meta = io.load_arrays(directory / f"{job.key}.npz", _KIND)
        values = {k: float("nan") if v is None else v for k, v in meta["values"].items()}
    except (FileError, KeyError, AttributeError):
        return None
    return Record(job, arrays, values)


def run_all(
    jobs: Iterable[Job], directory: Path, workers: int, console: Console, executor: Executor | None = None
) -> tuple[int, list[str]]:
    """Run the jobs without a result, on worker processes or an executor.

    Returns:
        How many jobs were run, and a line for each that failed.

    Raises:
        KeyboardInterrupt: after the workers are stopped; what they finished is kept.
    """
    # Two groups may share a job.
    todo = {job.key: job for job in jobs if load(job, directory) is None}
    failures: list[str] = []

    def keep(task: tuple[Job], result: Any, error: Exception | None) -> None:
        (job,) = task
        if error is None:
            io.save_arrays(directory / f"{job.key}.npz", _KIND, *result)
        else:
            failures.append(f"{job.name} {job.parameters}: {type(error).__name__}: {error}")
            console.print(f"[red]failed:[/red] {failures[-1]}", highlight=False)

    tasks = [(job,) for job in todo.values()]
    run_each(run, tasks, keep, workers=workers, title="experiments", console=console, executor=executor)
    return len(todo), failures
