"""Style, layout and files of the package's figures."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

from lieednn_sim import io
from lieednn_sim.values import StrPath

# Okabe and Ito's palette, distinguishable for colour-blind readers, without the yellow that is invisible on white.
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


def fix_layout(figure: Figure, dpi: float) -> None:
    """Lay out a figure for a resolution ``dpi`` [1/inch] by its layout engine, then remove the engine.

    With an engine, `Figure.savefig` draws everything twice, the first time only for the layout.
    """
    figure.dpi = dpi
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
    # The user's own settings must not supply an engine either.
    with matplotlib.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)


@contextlib.contextmanager
def drawn(path: StrPath, width: float, height: float) -> Iterator[Figure]:
    """A figure of the package's style, its sides in inches, which is drawn in the block and saved after it."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        figure.align_ylabels()
        save_figure(figure, path)


def fitted_legend(figure: Figure, entries: Mapping[str, Any], most: int = 7) -> None:
    """Explain handles by their names above all axes, ``most`` of them in a row, or as many as the figure is wide."""
    figure.dpi = _DPI
    for columns in range(min(len(entries), most), 0, -1):
        how: Any = {"loc": "outside upper center", "ncols": columns}
        legend = figure.legend(list(entries.values()), list(entries), **how)
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


def entries_of(axis: Any) -> dict[str, Any]:
    """Entries of a legend for everything on an axis that has a name."""
    handles, labels = axis.get_legend_handles_labels()
    return dict(zip(labels, handles, strict=True))


def save_figure(figure: Figure, path: StrPath) -> None:
    """Lay out a figure and write it atomically."""
    fix_layout(figure, _DPI)
    with io.atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=_DPI)
