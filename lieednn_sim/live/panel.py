"""The controls of a live view: menus, buttons, numbers and plots beside the scene."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from lieednn_sim.live.scene import ArmScene, Snapshot, status
from lieednn_sim.live.session import SPEEDS, Session
from lieednn_sim.policies.making import PLANNED
from lieednn_sim.registry import CONTROLLERS, PLANNERS, POLICIES, optional_module
from lieednn_sim.rendering import scene_setup
from lieednn_sim.values import Floats

_DIRECTIONS = {
    sign + axis: factor * unit
    for axis, unit in zip("xyz", np.eye(3), strict=True)
    for sign, factor in (("+", 1.0), ("-", -1.0))
}
_BLUE, _GREEN, _ORANGE, _GREY = "#1f77b4", "#2f9e44", "#e67700", "#868e96"
# Largest force [N], and the distance of the mouse from a dragged link at which the slider's force acts on it [m].
_STRONGEST, _STRETCH = 500.0, 0.3


class Panel:
    """The controls of one page of a `viser.ViserServer`, beside the scene, for the session."""

    def __init__(self, server: Any, session: Session, scene: ArmScene) -> None:
        self._server, self._session, self._scene, self._draws = server, session, scene, 0
        gui = server.gui
        gui.main_panel.dock_right()
        gui.set_panel_label(scene_setup.place(session.arm))
        self._theme(dark=False)
        self._status = gui.add_html("")
        for name, buttons in (("", ("pause", "reset")), ("target", ("home", "random"))):
            gui.add_button_group(name, buttons).on_click(lambda event: self._clicked(event.target.value))
        # Whether the target's direction counts, besides its position.
        hint = "otherwise the end effector may turn as it likes"
        self.direction_counts = gui.add_checkbox("hold its direction", True, hint=hint)
        speed = gui.add_slider("speed", *SPEEDS, step=0.1, initial_value=1.0)
        speed.on_update(lambda _: setattr(session, "speed", float(speed.value)))
        with gui.add_folder("Push"):
            self._link = gui.add_dropdown("link", session.arm.link_names, initial_value=session.arm.link_names[-1])
            self._along = gui.add_dropdown("along", tuple(_DIRECTIONS))
            self._force = gui.add_slider("force N", 10.0, _STRONGEST, step=10.0, initial_value=150.0)
            gui.add_button("push", hint="for 0.2 s; or drag a link with the mouse").on_click(lambda _: self._push())
        with gui.add_folder("Policy and plant"):
            self._menus()
        with gui.add_folder("Last ten seconds"):
            self._plots = Plots(gui)
        with gui.add_folder("View", expand_by_default=False):
            frames = gui.add_checkbox("link frames", True, hint="of the reference")
            frames.on_update(lambda _: setattr(scene.frames, "visible", frames.value))
            shade = gui.add_checkbox("dark", False)
            shade.on_update(lambda _: self._theme(dark=shade.value))

    def spring(self, grabbed: Sequence[float], mouse: Sequence[float]) -> Floats:
        """The force ``(3,)`` [N] of a spring from a grabbed point to the mouse, at most the force of the slider."""
        away = np.subtract(mouse, grabbed) / _STRETCH
        return np.asarray(float(self._force.value) * away / max(1.0, float(np.linalg.norm(away))))

    def show(self, snapshot: Snapshot) -> None:
        """Refresh numbers and plots."""
        self._status.content = status(snapshot)
        self._plots.add(snapshot)

    def _theme(self, *, dark: bool) -> None:
        self._server.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)

    def _menus(self) -> None:
        gui, settings = self._server.gui, self._session.wanted

        def slider(label: str, field: str, low: float, high: float, step: float, hint: str | None = None) -> Any:
            value = getattr(settings, field)  # it may be outside the usual range
            return gui.add_slider(label, min(low, value), max(high, value), step=step, initial_value=value, hint=hint)

        planners = tuple(name for name, entry in PLANNERS.items() if not entry.install)
        hint = f"for the policies {' and '.join(PLANNED)}"
        menus = {
            "policy": gui.add_dropdown("policy", tuple(POLICIES), initial_value=settings.policy),
            "planner": gui.add_dropdown("planner", planners, initial_value=settings.planner, hint=hint),
            "rho": slider("rho", "rho", 0.05, 1.0, 0.05, "of lieednn-shaped"),
            "filtered": gui.add_checkbox("safety filter", settings.filtered),
            "controller": gui.add_dropdown("controller", tuple(CONTROLLERS), initial_value=settings.controller),
            "payload": slider("payload kg", "payload", 0.0, 5.0, 0.25),
            "mass_scale": slider("mass scale", "mass_scale", 0.5, 2.0, 0.05),
        }
        for name, menu in menus.items():
            menu.on_update(lambda event, name=name: self._session.choose(**{name: event.target.value}))

    def _push(self) -> None:
        self._session.push(self._link.value, float(self._force.value) * _DIRECTIONS[self._along.value])

    def _clicked(self, what: str) -> None:
        session = self._session
        if what == "pause":
            session.paused = not session.paused
        elif what == "reset":
            self._scene.trace.clear()
            session.reset()
        elif what == "home":
            session.aim_at("home")
        else:
            self._draws += 1
            session.aim_randomly(self._draws)


class Plots:
    """Three plots in the present container of viser's gui: distances of arm and network to the target, and tracking."""

    def __init__(self, gui: Any) -> None:
        self._uplot = optional_module("viser.uplot")
        self._rows: deque[tuple[float, ...]] = deque()
        self._distance = self._plot(gui, "from the target [mm]", (("distance", _BLUE),))
        self._network = self._plot(gui, "network and proved bound", (("distance", _GREEN), ("bound", _GREY)))
        self._tracking = self._plot(gui, "tracking error [mm]", (("error", _ORANGE),))

    def _plot(self, gui: Any, title: str, series: tuple[tuple[str, str], ...]) -> Any:
        result, empty = self._uplot, np.array([0.0, 1.0])
        lines = [result.Series(label=name, stroke=colour, width=1.6) for name, colour in series]
        axis = {"stroke": _GREY, "grid": result.Axis_Grid(stroke="#86868633", width=1)}
        axis["ticks"] = result.Axis_Ticks(show=False)
        return gui.add_uplot(
            data=(empty, *[np.full(2, np.nan) for _ in series]),
            series=(result.Series(label="s"), *lines),
            title=title,
            scales={"x": result.Scale(time=False), "y": result.Scale(distr=3, log=10)},
            axes=(result.Axis(size=34, **axis), result.Axis(size=50, **axis)),
            legend=result.Legend(show=False),
            height=140,
        )

    def add(self, snapshot: Snapshot) -> None:
        """Add an instant to the plots; one that is earlier than the last one clears them first."""
        tick, progress = snapshot.tick, snapshot.tick.progress
        if self._rows and tick.time < self._rows[-1][0]:
            self._rows.clear()
        if self._rows and tick.time - self._rows[-1][0] < 0.1:
            return
        network = (np.nan, np.nan) if progress is None else (progress.distance, progress.bound)
        values = (1e3 * snapshot.distance, *network, 1e3 * snapshot.tracking)
        # The scale is logarithmic, so values have a positive lower bound.
        self._rows.append((tick.time, *(max(value, 1e-3) for value in values)))
        while tick.time - self._rows[0][0] > 10.0:
            self._rows.popleft()
        if len(self._rows) > 1:
            t, distance, own, bound, tracking = np.array(self._rows).T
            bound = np.where(np.isfinite(bound), bound, np.nan)
            self._distance.data = (t, distance)
            self._network.data = (t, own, bound)
            self._tracking.data = (t, tracking)
