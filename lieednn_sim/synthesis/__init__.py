"""Certified synthesis: networks that have a proof of global stability by construction.

`synthesize` makes a network for a target in milliseconds. `shape` makes one that also follows a given curve to its
end, by hidden neurons. `CurveEncoder` has one network for all curves, and encodes each as the state at which the
hidden neurons start.
"""

from lieednn_sim.registry import BIAS_RULES
from lieednn_sim.synthesis.bias import bias_for
from lieednn_sim.synthesis.certified import RESIDUAL_TOLERANCE, Synthesis, synthesize, synthesize_many
from lieednn_sim.synthesis.shaping.encoder import CurveEncoder
from lieednn_sim.synthesis.shaping.shaping import Shaping, ShapingOptions, shape
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
