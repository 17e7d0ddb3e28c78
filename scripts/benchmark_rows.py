"""A comparison with many made-up rows, to measure the memory that the rows themselves take."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

from lieednn_sim.evaluation import Case, Row, Settings, Table, write_summary
from lieednn_sim.evaluation.cases import failed_case
from lieednn_sim.evaluation.report import write_page
from lieednn_sim.evaluation.rows import COLUMNS
from lieednn_sim.evaluation.study import DEFAULT_CONTROLLERS, complete
from lieednn_sim.planning import planners


class _Here(Executor):
    """An executor that runs tasks at once; processes would need memory of their own."""

    def submit(self, function: Any, /, *given: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(function(*given, **named))
        return future


def _rows(case: Case, controllers: tuple[str, ...], settings: Settings) -> list[Row]:
    values: dict[str, Any] = {column.name: 0.123456 * (case.seed + i) for i, column in enumerate(COLUMNS)}
    values |= dict.fromkeys((name for name in values if name.endswith("violations")), 0)
    return [
        Row(case.arm, case.scene, case.planner, name, case.seed, settings.mass_scale, **values) for name in controllers
    ]


def collect(folder: Path, rows: int) -> None:
    """Run a comparison, except for sorting its table."""
    table, settings, names = Table(folder, Settings()), Settings(), list(planners())
    table.save = lambda *_: None  # type: ignore[method-assign]
    cases = [Case("telescopic_pr", "free", names[k % len(names)], k // len(names)) for k in range(rows // 2)]
    tasks = [(case, DEFAULT_CONTROLLERS, settings) for case in cases]
    complete(table, _rows, failed_case, tasks, workers=1, title="cases", console=None, executor=_Here())


def finish(folder: Path) -> None:
    """Sort the table, and write summary and page."""
    table = Table(folder, Settings())
    table.save()
    write_summary(folder / "comparison.md", table)
    write_page(folder / "comparison.html", table)
