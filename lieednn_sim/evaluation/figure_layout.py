"""Figures of the package: their colours and style, their arrangement, computed once, and their files."""

from __future__ import annotations

import os
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

from lieednn_sim import storage

# Okabe and Ito's palette, distinguishable by colour-blind readers, less the yellow that is lost on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_DPI = 130
STYLE: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    # Arms may have more links than there are colours.
    "axes.prop_cycle": cycler(linestyle=["-", "--", ":"]) * cycler(color=COLOURS),
    "legend.frameon": False,
}


def settle(figure: Figure, dpi: float) -> None:
    """Arrange a figure for a resolution ``dpi`` [1/inch] by its layout engine, and take the engine away.

    While a figure has one, even one that is spent, `Figure.savefig` draws everything twice, the first time for nothing
    but the layout.
    """
    figure.dpi = dpi
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
    # Without an engine means without the one of the user's own settings, too.
    with matplotlib.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure, atomically, when its layout has settled."""
    settle(figure, _DPI)
    with storage.atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=_DPI)
