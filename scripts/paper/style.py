"""How the figures look, and how they are written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

from lieednn_sim import io
from lieednn_sim.evaluation import figure_layout
from lieednn_sim.evaluation.figure_layout import fix_layout
from paper.plan import TOLERANCE

COLOURS = figure_layout.COLOURS
BLUE, VERMILION, GREEN, PURPLE, *_ = COLOURS
# Dashes for each colour, so that lines differ in grey print.
DASHES = ("-", "--", "-.", ":")
GREY = "0.45"
# With every one of the 24 coordinates within the tolerance E is below this.
SETTLED = np.sqrt(24.0) * TOLERANCE
# For the width of a page [inch], at which fonts have these sizes [pt].
WIDTH = 6.75
STYLE: Any = {
    **figure_layout.STYLE,
    **dict.fromkeys(("font.size", "axes.labelsize"), 8.5),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 8),
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.3,
    "axes.linewidth": 0.7,
    "axes.prop_cycle": cycler(color=COLOURS),
    "legend.handlelength": 2.2,
    # Text stays text in the PDF.
    "pdf.fonttype": 42,
}


def figure(height: float) -> Figure:
    """An empty figure of the page's width."""
    return Figure(figsize=(WIDTH, height), layout="constrained")


def letter(*axes: Axes) -> None:
    """The panels' letters, as captions refer to them."""
    for axis, text in zip(axes, "abcd", strict=False):
        axis.set_title(f"({text})", loc="left", fontsize=8.5, pad=4)


def save(drawn: Figure, directory: Path, name: str) -> str:
    """Write a PDF for print and a PNG for the report; returns the PNG's name."""
    fix_layout(drawn, drawn.dpi)  # the layout is the same for both
    # No dates in the files: the same results give the same bytes.
    with io.atomic_path(directory / f"{name}.pdf") as path:
        drawn.savefig(path, metadata={"CreationDate": None})
    with io.atomic_path(directory / f"{name}.png") as path:
        drawn.savefig(path, dpi=150, metadata={"Software": None})
    return f"{name}.png"
