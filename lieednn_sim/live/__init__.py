"""The live view: a simulated arm in the browser, whose target is dragged and whose links are pushed."""

from lieednn_sim.live.page import Page
from lieednn_sim.live.session import Session
from lieednn_sim.live.settings import Settings
from lieednn_sim.live.viewing import view
from lieednn_sim.typecheck import typecheck_public

__all__ = ["Page", "Session", "Settings", "view"]

typecheck_public(globals())
