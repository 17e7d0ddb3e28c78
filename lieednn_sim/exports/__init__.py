"""Motions and comparisons in the file formats of other tools; see `FORMATS`."""

from lieednn_sim.exports.formats import FORMATS, Format, export
from lieednn_sim.exports.recording import record
from lieednn_sim.typecheck import typecheck_public

__all__ = ["FORMATS", "Format", "export", "record"]

typecheck_public(globals())
