"""Metrics of a rollout, and planners compared: arms, scenes, planners, controllers and seeds in one table."""

from lieednn_sim.evaluation.cases import Settings, replay, run_case
from lieednn_sim.evaluation.evaluation import Evaluation
from lieednn_sim.evaluation.following import evaluate_following
from lieednn_sim.evaluation.metrics import evaluate
from lieednn_sim.evaluation.rows import Case, Row
from lieednn_sim.evaluation.study import Selection, compare
from lieednn_sim.evaluation.summary import write_summary
from lieednn_sim.evaluation.table import Table, read_rows
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "Case",
    "Evaluation",
    "Row",
    "Selection",
    "Settings",
    "Table",
    "compare",
    "evaluate",
    "evaluate_following",
    "read_rows",
    "replay",
    "run_case",
    "write_summary",
]

typecheck_public(globals())
