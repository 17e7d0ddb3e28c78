"""Shaping: certified networks whose transient follows a given curve."""

from lieednn_sim.synthesis.shaping.shaping import Shaping, ShapingOptions, shape

__all__ = ["Shaping", "ShapingOptions", "shape"]
