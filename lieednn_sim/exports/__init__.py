"""Motions, comparisons and episodes in the file formats of other tools: `export` in any of `FORMATS`, and `record`."""

from lieednn_sim.exports.formats import export, record
from lieednn_sim.registry import FORMATS
from lieednn_sim.typecheck import typecheck_public

__all__ = ["FORMATS", "export", "record"]

typecheck_public(globals())
