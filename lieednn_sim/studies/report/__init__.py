"""One self-contained HTML page of a comparison."""

from lieednn_sim.studies.report.page import View, choose_problems, view, write_page
from lieednn_sim.typecheck import typecheck_public

__all__ = ["View", "choose_problems", "view", "write_page"]

typecheck_public(globals())
