"""The results of all jobs: running and grouping them, and statistics for figures, tables and claims."""

from __future__ import annotations

import base64
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from common import saved_runs

from lieednn_sim import __version__
from paper import experiments
from paper.plan import INSIDE, Job, Plan


class Missing(Exception):
    """There are no results for a figure or a claim."""


@dataclass(frozen=True)
class Record:
    """Result of a job."""

    job: Job
    arrays: dict[str, np.ndarray]
    values: dict[str, Any]  # scalars; what is infinite or undefined is NaN

    def __getitem__(self, name: str) -> Any:
        return self.values.get(name, float("nan"))


def run(kind: str, parameters: dict[str, Any], _version: str) -> dict[str, Any]:
    """Do a job; returns its values, and a file of its arrays, in JSON."""
    start, file = time.process_time(), BytesIO()
    arrays, values = experiments.KINDS[kind](**parameters)
    np.savez_compressed(file, allow_pickle=False, **arrays)
    values = {**values, "job_seconds": time.process_time() - start}
    finite = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
    return {"values": finite, "arrays": base64.b64encode(file.getvalue()).decode()}


def run_all(jobs: Iterable[Job], directory: Path, workers: int) -> list[Record]:
    """The results of jobs, of which those without one are run on worker processes; see `saved_runs`."""
    asked = {job.key: (job.kind, job.parameters, __version__) for job in jobs}
    records = []
    for job, made in zip(jobs, saved_runs(directory, asked, run, workers), strict=True):
        values = {k: math.nan if v is None else v for k, v in made["values"].items()}
        with np.load(BytesIO(base64.b64decode(made["arrays"]))) as arrays:
            records.append(Record(job, dict(arrays), values))
    return records


@dataclass(frozen=True)
class Results:
    """The plan, and the records by the name of their group, in the order of the seeds."""

    plan: Plan
    groups: dict[str, list[Record]]

    @classmethod
    def collect(cls, plan: Plan, records: Iterable[Record]) -> Results:
        """Group the records."""
        groups: dict[str, list[Record]] = {}
        for record in records:
            groups.setdefault(record.job.name, []).append(record)
        return cls(plan, groups)

    def __getitem__(self, name: str) -> list[Record]:
        return self.groups.get(name, [])

    def successes(self, name: str) -> list[Record]:
        """Records whose network has the target as a stable equilibrium, within the tolerance."""
        return [record for record in self[name] if record["success"]]

    def require(self, *names: str) -> list[Record]:
        """Records of these groups, none of which may be empty; else `Missing`."""
        absent = [name for name in names if not self[name]]
        if absent:
            raise Missing(", ".join(absent))
        return [record for name in names for record in self[name]]

    def example(self) -> int:
        """The first target that is learned with P = 10, by the ablation, and if possible with every P in 8 to 16."""
        ablated = seeds(self.successes("no projection"))
        learned = {period: seeds(self.successes(f"P={period}")) & ablated for period in INSIDE}
        for names in (INSIDE, (10,)):
            common = set.intersection(*(learned[period] for period in names))
            if common:
                return min(common)
        raise Missing("an example")

    def of(self, name: str, seed: int) -> Record:
        """The record of a target; `Missing` without one."""
        for record in self[name]:
            if record.job.parameters["seed"] == seed:
                return record
        raise Missing(f"{name}, {seed}")


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
