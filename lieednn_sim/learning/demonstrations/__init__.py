"""Learning from demonstrations: recorded motions of a frame, what they have in common, and models of them."""

from lieednn_sim.learning.demonstrations.alignment import Demonstrations, align
from lieednn_sim.learning.demonstrations.files import load_demonstrations
from lieednn_sim.learning.demonstrations.recording import Demonstration

__all__ = ["Demonstration", "Demonstrations", "align", "load_demonstrations"]
