"""One self-contained HTML page of a comparison."""

from lieednn_sim.studies.report.page import write_page
from lieednn_sim.studies.report.videos import Clip, choose_cases, film
from lieednn_sim.typecheck import typecheck_public

__all__ = ["Clip", "choose_cases", "film", "write_page"]

typecheck_public(globals())
