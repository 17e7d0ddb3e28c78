"""Studies: tables of many cases, whose computation can be interrupted, resumed, and divided among machines.

`compare` is the study that compares planners; `Study` is the base class for studies of one's own.
"""

from lieednn_sim.studies.comparison.rows import Case, Row
from lieednn_sim.studies.comparison.study import Comparison, Settings, compare, replay, run_case
from lieednn_sim.studies.comparison.summary import write_summary
from lieednn_sim.studies.study import Study, compute
from lieednn_sim.studies.table import Table
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "Case",
    "Comparison",
    "Row",
    "Settings",
    "Study",
    "Table",
    "compare",
    "compute",
    "replay",
    "run_case",
    "write_summary",
]

typecheck_public(globals())
