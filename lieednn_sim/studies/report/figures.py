"""Figures of a comparison as SVG, with the colours of text and lines inherited from the page."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FormatStrFormatter, Locator, LogFormatterMathtext, LogLocator, MaxNLocator, NullLocator

from lieednn_sim.evaluation.figure_layout import COLOURS, fix_layout
from lieednn_sim.registry import PLANNERS
from lieednn_sim.studies.comparison.rows import BY_NAME, Row
from lieednn_sim.studies.comparison.summary import in_order
from lieednn_sim.studies.rows import Column, Group, grouped

# Placeholders that `_svg` replaces by the page's colours, so that figures are readable in light and dark mode.
_INK, _FAINT = "#010203", "#040506"
_STYLE: Any = {
    "font.size": 9,
    "font.family": "sans-serif",
    "svg.fonttype": "none",
    **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor"), _INK),
    **dict.fromkeys(("axes.edgecolor", "xtick.color", "ytick.color", "grid.color"), _FAINT),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "axes.spines.left"), False),
    "grid.alpha": 0.35,
    "grid.linewidth": 0.6,
    "ytick.major.size": 0,
    "legend.frameon": False,
}
_SCENE_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_MARKS = 200  # most marks of a line: more would merge, and take megabytes


# Families of planners, by the modules of these.
_NETWORKS, _OTHERS = "networks with a proof", "others"
_OF_MODULE = {
    "interpolation": "straight ways and primitives",
    **dict.fromkeys(("sampling", "cbirrt"), "random trees"),
    **dict.fromkeys(("optimisation", "stomp"), "optimisation"),
}
#: Families of planners, with their colours in all figures and tables.
FAMILIES = dict(zip((_NETWORKS, *dict.fromkeys(_OF_MODULE.values()), _OTHERS), (*COLOURS[:4], "#8C8C8C"), strict=True))


def family(name: str) -> str:
    """The family of a planner, which does not depend on what else is compared."""
    entry = PLANNERS.entries.get(name)
    if entry is None or not isinstance(entry.place, str):
        return _OTHERS
    return _NETWORKS if entry.network else _OF_MODULE.get(entry.place.partition(":")[0].rpartition(".")[2], _OTHERS)


class Plot(NamedTuple):
    """A figure of the page."""

    title: str
    caption: str
    svg: str


# Columns that are drawn, and those of them that have a logarithmic axis.
_DRAWN = ("tracking_rms_mm", "clearance_mm", "planning_s", "path_ranges", "jerk_effector")
_LOGARITHMIC = ("tracking_rms_mm", "planning_s", "jerk_effector")


def plots(rows: Sequence[Row], controller: str) -> list[Plot]:
    """Plot distributions of measured columns by planner and scene, for the rows of one arm and one controller."""
    chosen = [row for row in rows if row.controller == controller]
    drawn = [name for name in _DRAWN if chosen and Group((), tuple(chosen)).values(name)]
    return [_distribution(chosen, BY_NAME[name], controller) for name in drawn]


def _few_ticks(low: float, high: float) -> Locator:
    """Ticks at 1, 2, 5 of each decade, or at even steps where fewer than two would be seen."""
    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    ticks = np.outer(decades, (1.0, 2.0, 5.0)).ravel()
    if np.count_nonzero((low <= ticks) & (ticks <= high)) < 2:
        return MaxNLocator(4)  # LogLocator would then choose more labels than there is room for
    return LogLocator(subs=(1.0, 2.0, 5.0), numticks=8)


def _distribution(rows: Sequence[Row], column: Column, controller: str) -> Plot:
    planners, scenes = in_order((row.planner for row in rows), PLANNERS), sorted({row.scene for row in rows})
    thinned, logarithmic = False, column.name in _LOGARITHMIC
    # Errors below this are rounding; logarithmic axes do not show them [mm].
    floor = 1e-6
    with matplotlib.rc_context(_STYLE | {"svg.hashsalt": column.name}):
        figure = Figure(figsize=(4.7, 0.95 + 0.34 * len(planners)), layout="constrained")
        axes = figure.subplots()
        axes.set_yticks(range(len(planners)), planners)
        axes.set_ylim(len(planners) - 0.4, -0.6)
        axes.grid(axis="x")
        for group in grouped(rows, ("planner", "scene")):
            planner, place = group.key[0], scenes.index(group.key[1])
            values = np.array(group.values(column.name))
            if logarithmic:
                values = np.maximum(values, floor)
            if not len(values):
                continue
            y, colour = planners.index(planner) + 0.42 * ((place + 0.5) / len(scenes) - 0.5), FAMILIES[family(planner)]
            axes.plot(np.percentile(values, [25, 75]), [y, y], color=colour, lw=5, alpha=0.3, solid_capstyle="butt")
            shown = values
            if len(values) > _MARKS:
                thinned = True
                shown = np.sort(values)[np.linspace(0, len(values) - 1, _MARKS).astype(int)]
            # Spread by a fixed pattern, so that equal values are distinguishable and every run is the same.
            spread = y + 0.07 * (np.arange(len(shown)) % 3 - 1)
            axes.plot(shown, spread, _SCENE_MARKERS[place % 7], color=colour, ms=2.8, alpha=0.75, mew=0)
            axes.plot([np.median(values)] * 2, [y - 0.16, y + 0.16], color=colour, lw=2.2)
        if logarithmic:
            axes.set_xscale("log")
            low, high = axes.get_xlim()
            # Labels at 1, 2, 5 below two decades, and at powers of ten above.
            few = high < 100.0 * low
            axes.xaxis.set_major_locator(_few_ticks(low, high) if few else LogLocator(numticks=8))
            axes.xaxis.set_minor_locator(NullLocator())
            axes.xaxis.set_major_formatter(FormatStrFormatter("%g") if few else LogFormatterMathtext())
        elif column.name == "clearance_mm":
            axes.axvline(0.0, color=_INK, lw=0.9, ls="--")
        else:
            axes.set_xlim(left=0.0)
        axes.set_xlabel(column.heading)
        handles = [
            Line2D([], [], ls="", marker=_SCENE_MARKERS[i % 7], color=_INK, ms=5, label=scene)
            for i, scene in enumerate(scenes)
        ]
        figure.legend(handles=handles, loc="outside upper right", ncols=4, handletextpad=0.1, columnspacing=1.2)
        svg = _svg(figure)
    each = "one mark a motion" if column.of_motion else f"one mark a rollout with {controller}"
    note = "; values below 10⁻⁶ mm are drawn there" if column.name == "tracking_rms_mm" else ""
    if thinned:
        note += f"; at most {_MARKS} in a line are marked, evenly spaced in rank"
    return Plot(column.heading, f"{column.meaning}: {each}, bar: quartiles, line: median{note}", svg)


def _svg(figure: Figure) -> str:
    """The figure as an SVG element for a page, without prologue, styles or clashing ids."""
    buffer = io.StringIO()
    fix_layout(figure, 72)  # an SVG's resolution
    figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<style.*?</style>", "", text, count=1, flags=re.DOTALL)
    used = set(re.findall(r"#([\w-]+)", text))
    text = re.sub(r' id="([\w-]+)"', lambda result: result[0] if result[1] in used else "", text)
    # Size and fonts come from the page.
    text = re.sub(r' (width|height)="[^"]*"', "", text, count=2)
    text = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font-size: \1px", text)
    return text.replace(_INK, "currentColor").replace(_FAINT, "var(--line-strong)").strip()
