"""Certified synthesis: networks with a proof of global stability, made in milliseconds, or shaped to follow a curve."""

from lieednn_sim.synthesis.attempts import RESIDUAL_TOLERANCE
from lieednn_sim.synthesis.bias import BIAS_RULES, bias_for
from lieednn_sim.synthesis.certified import synthesize, synthesize_many
from lieednn_sim.synthesis.result import Synthesis
from lieednn_sim.synthesis.shaping import CurveEncoder, Shaping, ShapingOptions, shape
from lieednn_sim.typecheck import typecheck_public

__all__ = [
    "BIAS_RULES",
    "RESIDUAL_TOLERANCE",
    "CurveEncoder",
    "Shaping",
    "ShapingOptions",
    "Synthesis",
    "bias_for",
    "shape",
    "synthesize",
    "synthesize_many",
]

typecheck_public(globals())
