"""Times and ratios of the benchmark: what is measured several times, and a row with minimum, median and maximum."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

HEADINGS = ("what", "minimum", "median", "maximum", "aim")


@dataclass(frozen=True)
class Row:
    """A figure measured several times, and what it should be at least or at most, if anything."""

    what: str
    samples: Sequence[float]
    aim: str = ""

    @property
    def spread(self) -> dict[str, float]:
        """Minimum, median and maximum."""
        low, middle, high = np.quantile(self.samples, [0.0, 0.5, 1.0])
        return {"minimum": float(low), "median": float(middle), "maximum": float(high)}

    def cells(self) -> list[str]:
        """The row as in the table, under `HEADINGS`."""
        return [self.what, *(_rounded(value) for value in self.spread.values()), self.aim]


def _rounded(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 20.0 else f"{value:.1f}" if abs(value) >= 4.0 else f"{value:.2f}"


def seconds(what: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Time that a call takes [s]; processor time by default, which other load on the machine disturbs less."""
    begun = clock()
    what()
    return clock() - begun


def time_ratios(
    one: Callable[[], object],
    other: Callable[[], object],
    repeats: int,
    clock: Callable[[], float] = time.process_time,
) -> list[float]:
    """Ratios of the time of one call to that of another, measured in turns, so that other load affects both."""
    return [seconds(one, clock) / seconds(other, clock) for _ in range(repeats)]
