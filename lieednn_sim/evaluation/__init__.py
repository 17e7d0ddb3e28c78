"""Evaluation of a rollout: metrics, plots, and the causes of an error that is left at the end."""

from lieednn_sim.evaluation.evaluation import Evaluation
from lieednn_sim.evaluation.metrics import evaluate, evaluate_following
from lieednn_sim.typecheck import typecheck_public

__all__ = ["Evaluation", "evaluate", "evaluate_following"]

typecheck_public(globals())
