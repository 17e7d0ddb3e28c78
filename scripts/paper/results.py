"""Results of all jobs, grouped, and the few statistics that figures, tables and claims need."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from paper.plan import INSIDE, Job, Plan
from paper.runner import Record


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


def wilson(successes: int, count: int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson 1927)."""
    if count == 0:
        return 0.0, 1.0
    z, rate = 1.959964, successes / count
    centre = (rate + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * np.sqrt(rate * (1 - rate) / count + z * z / (4 * count * count))
    return float(max(0.0, centre - half)), float(min(1.0, centre + half))


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
    return np.array(rows).reshape(len(rows), *np.shape(grid), *np.shape(records[0].arrays[name])[1:])
