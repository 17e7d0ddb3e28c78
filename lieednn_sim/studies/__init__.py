"""Studies: tables of many cases, whose computation can be interrupted, resumed, and divided among machines.

`compare` is the study that compares planners; `Study` is the base class for studies of one's own.
"""

from lieednn_sim.studies.comparison.case import Settings as Settings
from lieednn_sim.studies.comparison.case import replay as replay
from lieednn_sim.studies.comparison.case import run_case as run_case
from lieednn_sim.studies.comparison.rows import Case as Case
from lieednn_sim.studies.comparison.rows import Row as Row
from lieednn_sim.studies.comparison.study import Comparison as Comparison
from lieednn_sim.studies.comparison.study import compare as compare
from lieednn_sim.studies.comparison.summary import write_summary as write_summary
from lieednn_sim.studies.study import Study as Study
from lieednn_sim.studies.study import compute as compute
from lieednn_sim.studies.table import Table as Table
from lieednn_sim.typecheck import typecheck_public

typecheck_public(globals())
