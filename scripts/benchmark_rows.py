"""A comparison with many made-up rows, to measure the memory that the rows themselves take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

from lieednn_sim.planning import PLANNERS
from lieednn_sim.studies import Case, Comparison, Row, Settings, Table, compute, write_summary
from lieednn_sim.studies.comparison.rows import COLUMNS
from lieednn_sim.studies.comparison.study import DEFAULT_CONTROLLERS
from lieednn_sim.studies.report import write_page
from lieednn_sim.studies.user_files import UserFile


class _Here(Executor):
    """An executor that runs tasks at once; processes would need memory of their own."""

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(function(*given, **named))
        return future


def _rows(
    case: Case, controllers: Sequence[str], settings: Settings, *, user_files: tuple[UserFile, ...] = ()
) -> list[Row]:
    values: dict[str, Any] = {column.name: 0.123456 * (case.seed + i) for i, column in enumerate(COLUMNS)}
    values |= dict.fromkeys((name for name in values if name.endswith("violations")), 0)
    return [
        Row(case.arm, case.scene, case.planner, name, case.seed, settings.mass_scale, **values) for name in controllers
    ]


class _Made(Comparison):
    """A comparison of many cases that take no time."""

    count = 0

    @property
    def run(self) -> Callable[..., list[Row]]:
        return _rows

    def todo(self, table: Table[Row]) -> list[tuple[Case, list[str], Settings]]:
        names = list(PLANNERS)
        cases = [Case("telescopic_pr", "free", names[k % len(names)], k // len(names)) for k in range(self.count)]
        return [(case, list(DEFAULT_CONTROLLERS), self.common) for case in cases]


def collect(folder: Path, rows: int) -> None:
    """Run a comparison."""
    _Made.count = rows // 2
    compute(_Made(), folder, executor=_Here())


def finish(folder: Path) -> None:
    """Write summary and page."""
    table = Comparison().open(folder)
    write_summary(folder / "comparison.md", table)
    write_page(folder / "comparison.html", table)
