"""Certified synthesis: networks that carry a proof of global stability, made in milliseconds."""

from lieednn_sim.synthesis.bias import BIAS_RULES, bias_for
from lieednn_sim.synthesis.certified import RESIDUAL_TOLERANCE, Synthesis, synthesize

__all__ = ["BIAS_RULES", "RESIDUAL_TOLERANCE", "Synthesis", "bias_for", "synthesize"]
