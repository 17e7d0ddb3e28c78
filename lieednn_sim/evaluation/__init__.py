"""Evaluation of one rollout or one path: metrics, plots, and the causes of a final error."""

from lieednn_sim.evaluation.evaluation import Evaluation
from lieednn_sim.evaluation.metrics import evaluate, evaluate_following
from lieednn_sim.typecheck import typecheck_public

__all__ = ["Evaluation", "evaluate", "evaluate_following"]

typecheck_public(globals())
