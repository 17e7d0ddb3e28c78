"""Certified synthesis: networks that carry a proof of global stability, made in milliseconds, or shaped by a curve."""

from lieednn_sim.synthesis.attempts import RESIDUAL_TOLERANCE, Synthesis
from lieednn_sim.synthesis.bias import BIAS_RULES, bias_for
from lieednn_sim.synthesis.certified import synthesize, synthesize_many
from lieednn_sim.synthesis.shaping import Shaping, ShapingOptions, shape

__all__ = [
    "BIAS_RULES",
    "RESIDUAL_TOLERANCE",
    "Shaping",
    "ShapingOptions",
    "Synthesis",
    "bias_for",
    "shape",
    "synthesize",
    "synthesize_many",
]
