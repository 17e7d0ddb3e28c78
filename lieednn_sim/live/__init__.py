"""The live view: a simulated arm in the browser. Its target can be dragged, and its links pushed, with the mouse.

`view` opens it. A `Session` is the simulation without a page, and a `Page` shows a session.
"""

from lieednn_sim.live.page import Page, view
from lieednn_sim.live.session import Session
from lieednn_sim.live.settings import Settings
from lieednn_sim.typecheck import typecheck_public

__all__ = ["Page", "Session", "Settings", "view"]

typecheck_public(globals())
