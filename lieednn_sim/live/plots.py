"""Small plots of the last ten seconds of a live view."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from lieednn_sim.live.snapshot import Snapshot
from lieednn_sim.rendering.viser_scene import require

# Time that the plots show [s], and the least time between two samples.
_SPAN, _STEP = 10.0, 0.1
# Least value on a logarithmic scale [mm], [1].
_LEAST = 1e-3
_BLUE, _GREEN, _ORANGE, _GREY = "#1f77b4", "#2f9e44", "#e67700", "#868e96"


class Plots:
    """Three plots: the distance from the target, the network's own under its bound, tracking error and clearance.

    Args:
        gui: viser's ``server.gui``; the plots are placed where its present container is.
    """

    def __init__(self, gui: Any) -> None:
        self._uplot = require("viser.uplot")[0]
        self._rows: deque[tuple[float, ...]] = deque()
        self._distance = self._plot(gui, "from the target [mm]", (("distance", _BLUE),))
        self._network = self._plot(gui, "network and proved bound", (("distance", _GREEN), ("bound", _GREY)))
        self._tracking = self._plot(gui, "tracking error [mm]", (("error", _ORANGE),))

    def _plot(self, gui: Any, title: str, series: tuple[tuple[str, str], ...]) -> Any:
        made, empty = self._uplot, np.array([0.0, 1.0])
        lines = [made.Series(label=name, stroke=colour, width=1.6) for name, colour in series]
        axis = {"stroke": _GREY, "grid": made.Axis_Grid(stroke="#86868633", width=1)}
        axis["ticks"] = made.Axis_Ticks(show=False)
        return gui.add_uplot(
            data=(empty, *[np.full(2, np.nan) for _ in series]),
            series=(made.Series(label="s"), *lines),
            title=title,
            scales={"x": made.Scale(time=False), "y": made.Scale(distr=3, log=10)},
            axes=(made.Axis(size=34, **axis), made.Axis(size=50, **axis)),
            legend=made.Legend(show=False),
            height=140,
        )

    def add(self, snapshot: Snapshot) -> None:
        """Add an instant to the plots; one that is not later than the last one begins them again."""
        tick, progress = snapshot.tick, snapshot.tick.progress
        if self._rows and tick.time < self._rows[-1][0]:
            self._rows.clear()
        if self._rows and tick.time - self._rows[-1][0] < _STEP:
            return
        network = (np.nan, np.nan) if progress is None else (progress.distance, progress.bound)
        values = (1e3 * snapshot.distance, *network, 1e3 * snapshot.tracking)
        self._rows.append((tick.time, *(max(value, _LEAST) for value in values)))
        while tick.time - self._rows[0][0] > _SPAN:
            self._rows.popleft()
        if len(self._rows) > 1:
            t, distance, own, bound, tracking = np.array(self._rows).T
            bound = np.where(np.isfinite(bound), bound, np.nan)
            self._distance.data = (t, distance)
            self._network.data = (t, own, bound)
            self._tracking.data = (t, tracking)
