"""One self-contained HTML page of a comparison."""

from lieednn_sim.evaluation.report.page import write_page
from lieednn_sim.evaluation.report.videos import Clip, choose_cases, film

__all__ = ["Clip", "choose_cases", "film", "write_page"]
