"""Certified synthesis: networks that have a proof of global stability by construction.

`synthesize` makes a network for a target in milliseconds. `shape` makes one that also follows a given curve to its
end, by hidden neurons. `CurveEncoder` has one network for all curves, and encodes each as their start.
"""

from lieednn_sim.registry import BIAS_RULES as BIAS_RULES
from lieednn_sim.synthesis.bias import bias_for as bias_for
from lieednn_sim.synthesis.certified import RESIDUAL_TOLERANCE as RESIDUAL_TOLERANCE
from lieednn_sim.synthesis.certified import Synthesis as Synthesis
from lieednn_sim.synthesis.certified import synthesize as synthesize
from lieednn_sim.synthesis.certified import synthesize_many as synthesize_many
from lieednn_sim.synthesis.shaping.encoder import CurveEncoder as CurveEncoder
from lieednn_sim.synthesis.shaping.shaping import Shaping as Shaping
from lieednn_sim.synthesis.shaping.shaping import ShapingOptions as ShapingOptions
from lieednn_sim.synthesis.shaping.shaping import shape as shape
from lieednn_sim.typecheck import typecheck_public

typecheck_public(globals())
