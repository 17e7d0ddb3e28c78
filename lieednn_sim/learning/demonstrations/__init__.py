"""Learning from demonstrations: recorded motions of a frame, their alignment, and models of them."""

from lieednn_sim.learning.demonstrations.alignment import Demonstrations, align
from lieednn_sim.learning.demonstrations.learned import LearnedMotion
from lieednn_sim.learning.demonstrations.recording import Demonstration, load_demonstrations
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.typecheck import typecheck_public

__all__ = ["Demonstration", "Demonstrations", "LearnedMotion", "ShapedMotion", "align", "load_demonstrations"]

typecheck_public(globals())
