"""Style, layout and files of the package's figures, and what those over the time of a run have in common."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.rcsetup import cycler

from lieednn_sim import io
from lieednn_sim.simulation import Rollout
from lieednn_sim.values import Floats, StrPath

# Okabe and Ito's palette, distinguishable for colour-blind readers, without the yellow that is invisible on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_DPI = 130
_PUSH = "0.85"  # colour
MOST_ROWS = 12  # of a plot of joints or links
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


@contextlib.contextmanager
def over_time(rollout: Rollout, path: StrPath, unit: str, title: str) -> Iterator[Any]:
    """One axis over the times of a run, for the block to draw on, with the run's events."""
    with drawn(path, 10.0, 3.4) as figure:
        axis = subplots(figure, rollout.t, 1, 1)[0, 0]
        yield axis
        set_label(axis, unit, title)
        axis.set_xlabel("time [s]")
        mark_events(axis, rollout)
        fitted_legend(figure, entries_of(axis) | events(rollout))


def subplots(figure: Figure, t: Floats, rows: int, columns: int) -> Any:
    """Axes ``(rows, columns)`` over the times t."""
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
    # Once for all: updating their common range after every line takes longer than the drawing.
    margin = matplotlib.rcParams["axes.xmargin"] * (t[-1] - t[0])
    axes[0, 0].set_xlim(t[0] - margin, t[-1] + margin)
    return axes


def set_label(axis: Any, unit: str, title: str = "", **font: Any) -> None:
    """Set the label of the ordinate, and the title."""
    axis.set_ylabel(unit, **font)
    axis.set_title(title, loc="left", **font)


def mark_events(axis: Any, rollout: Rollout) -> None:
    """Mark the end of the motion by a line, and each push by a band."""
    axis.axvline(rollout.motion_end, color="0.35", lw=0.9, ls="-.")
    for push in rollout.disturbances.pushes:
        axis.axvspan(push.start, min(push.end, rollout.t[-1]), color=_PUSH, zorder=0)


def events(rollout: Rollout) -> dict[str, Any]:
    """Entries of a legend for what `mark_events` draws."""
    end = {"end of the motion": Line2D([], [], color="0.35", lw=0.9, ls="-.")}
    return end | ({"push": Patch(color=_PUSH)} if rollout.disturbances.pushes else {})
