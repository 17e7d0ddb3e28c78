"""Planners compared: arms, scenes, planners, controllers and seeds, measured into one table."""

from lieednn_sim.evaluation.cases import Case, Settings, replay, run_case
from lieednn_sim.evaluation.study import Selection, compare
from lieednn_sim.evaluation.summary import write_summary
from lieednn_sim.evaluation.table import Table, read_rows

__all__ = [
    "Case",
    "Selection",
    "Settings",
    "Table",
    "compare",
    "read_rows",
    "replay",
    "run_case",
    "write_summary",
]
