"""Shaping: certified networks whose transient follows a given curve, stored in the weights or in the start."""

from lieednn_sim.synthesis.shaping.encoder import CurveEncoder
from lieednn_sim.synthesis.shaping.shaping import Shaping, ShapingOptions, shape
from lieednn_sim.typecheck import typecheck_public

__all__ = ["CurveEncoder", "Shaping", "ShapingOptions", "shape"]

typecheck_public(globals())
