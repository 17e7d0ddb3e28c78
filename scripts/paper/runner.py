"""Run jobs in worker processes; each result is a file of its own, so that an interrupted run can go on."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from lieednn_sim import storage
from lieednn_sim.errors import FileError
from lieednn_sim.evaluation.workers import progress_bar, worker_pool
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


def run(job: Job, path: Path) -> None:
    """Do a job and write its result; the path comes from the main process, which knows which code began the run."""
    begun = time.process_time()
    arrays, values = experiments.KINDS[job.kind](**job.parameters)
    values = {**values, "job_seconds": time.process_time() - begun}
    finite = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
    storage.save_arrays(path, _KIND, arrays, {"values": finite, "parameters": job.parameters})


def load(job: Job, directory: Path) -> Record | None:
    """Read the result of a job; None when there is none that can be read."""
    try:
        arrays, meta = storage.load_arrays(directory / f"{job.key}.npz", _KIND)
        values = {k: float("nan") if v is None else v for k, v in meta["values"].items()}
    except (FileError, KeyError, AttributeError):
        return None
    return Record(job, arrays, values)


def run_all(jobs: Iterable[Job], directory: Path, workers: int, console: Console) -> tuple[int, list[str]]:
    """Run what has no result yet.

    Returns:
        How many jobs were run, and a line for each that failed.

    Raises:
        KeyboardInterrupt: after the workers are stopped; what they finished is kept.
    """
    # Two groups may share a job.
    todo = {job.key: job for job in jobs if load(job, directory) is None}
    if not todo:
        return 0, []
    failures: list[str] = []
    with worker_pool(min(workers, len(todo))) as pool, progress_bar(console) as progress:
        task = progress.add_task("experiments", total=len(todo))
        running: dict[Future[None], Job] = {
            pool.submit(run, job, directory / f"{job.key}.npz"): job for job in todo.values()
        }
        for future in as_completed(running):
            error = future.exception()
            if isinstance(error, BrokenProcessPool):
                raise error
            if error is not None:
                job = running[future]
                failures.append(f"{job.name} {job.parameters}: {type(error).__name__}: {error}")
                console.print(f"[red]failed:[/red] {failures[-1]}", highlight=False)
            progress.update(task, advance=1, description=running[future].name)
    return len(todo), failures
