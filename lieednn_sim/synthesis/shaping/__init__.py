"""Shaping: certified networks whose transient follows a given curve."""

from lieednn_sim.synthesis.shaping.shaping import Shaping, ShapingOptions, shape
from lieednn_sim.typecheck import typecheck_public

__all__ = ["Shaping", "ShapingOptions", "shape"]

typecheck_public(globals())
