"""What judges one rollout or one path: metrics, their causes, and plots."""

from lieednn_sim.evaluation.evaluation import Evaluation
from lieednn_sim.evaluation.following import evaluate_following
from lieednn_sim.evaluation.metrics import evaluate
from lieednn_sim.typecheck import typecheck_public

__all__ = ["Evaluation", "evaluate", "evaluate_following"]

typecheck_public(globals())
