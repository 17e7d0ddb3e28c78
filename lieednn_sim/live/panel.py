"""The controls of a live view: menus, buttons, numbers and plots beside the scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lieednn_sim.live.playback import Track
from lieednn_sim.live.player import Player
from lieednn_sim.live.plots import Plots
from lieednn_sim.live.scene import ArmScene
from lieednn_sim.live.session import SPEEDS, Session
from lieednn_sim.live.settings import PLANNED, ready_planners
from lieednn_sim.live.snapshot import Snapshot
from lieednn_sim.live.status import status
from lieednn_sim.registry import CONTROLLERS, POLICIES
from lieednn_sim.values import Floats

_DIRECTIONS = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
# Largest force [N], and the distance of the mouse at which a dragged link feels the force of the slider [m].
_STRONGEST, _STRETCH = 500.0, 0.3


class Panel:
    """The controls of one page.

    Args:
        server: a `viser.ViserServer`.
        session: the session that they control.
        scene: the scene beside them.
        tracks: motions to play at first.
        dark: whether the page is dark at first.

    Attributes:
        player: plays motions beside the live arm.
    """

    def __init__(
        self, server: Any, session: Session, scene: ArmScene, *, tracks: Sequence[Track] = (), dark: bool = False
    ) -> None:
        self._server, self._session, self._scene, self._draws = server, session, scene, 0
        gui = server.gui
        gui.main_panel.dock_right()
        gui.set_panel_label(f"{session.arm.name}" + ("" if session.arm.scene == "free" else f", {session.arm.scene}"))
        self._theme(dark)
        self._status = gui.add_html("")
        self._run = gui.add_button_group("", ("pause", "reset"))
        self._run.on_click(lambda event: self._clicked(event.target.value))
        self._targets = gui.add_button_group("target", ("home", "random"))
        self._targets.on_click(lambda event: self._clicked(event.target.value))
        self._direction_counts = gui.add_checkbox(
            "hold its direction", True, hint="otherwise the end effector may turn as it likes"
        )
        speed = gui.add_slider("speed", *SPEEDS, step=0.1, initial_value=1.0)
        speed.on_update(lambda _: setattr(session, "speed", float(speed.value)))
        self.player = Player(server, session, scene, tracks)
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
            frames.on_update(lambda _: scene.show_frames(frames.value))
            shade = gui.add_checkbox("dark", dark)
            shade.on_update(lambda _: self._theme(shade.value))

    @property
    def holds_direction(self) -> bool:
        """Whether the target's direction counts, besides its position."""
        return bool(self._direction_counts.value)

    def spring(self, grabbed: Sequence[float], mouse: Sequence[float]) -> Floats:
        """The force ``(3,)`` [N] of a spring from a grabbed point to the mouse, at most that of the slider."""
        away = np.subtract(mouse, grabbed) / _STRETCH
        return np.asarray(float(self._force.value) * away / max(1.0, float(np.linalg.norm(away))))

    def show(self, snapshot: Snapshot) -> None:
        """Refresh numbers and plots."""
        self._status.content = status(snapshot)
        self._plots.add(snapshot)

    def _theme(self, dark: bool) -> None:
        self._server.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)

    def _menus(self) -> None:
        gui, wanted = self._server.gui, self._session.wanted
        menus = {
            "policy": gui.add_dropdown("policy", tuple(POLICIES), initial_value=wanted.policy),
            "planner": gui.add_dropdown(
                "planner",
                ready_planners(),
                initial_value=wanted.planner,
                hint=f"for the policies {' and '.join(PLANNED)}",
            ),
            "rho": gui.add_slider("rho", 0.05, 1.0, step=0.05, initial_value=wanted.rho, hint="of lieednn-shaped"),
            "filtered": gui.add_checkbox("safety filter", wanted.filtered),
            "controller": gui.add_dropdown("controller", tuple(CONTROLLERS), initial_value=wanted.controller),
            "payload": gui.add_slider("payload kg", 0.0, 5.0, step=0.25, initial_value=wanted.payload),
            "mass_scale": gui.add_slider("mass scale", 0.5, 2.0, step=0.05, initial_value=wanted.mass_scale),
        }
        for name, menu in menus.items():
            menu.on_update(lambda event, name=name: self._session.choose(**{name: event.target.value}))

    def _push(self) -> None:
        force = float(self._force.value) * np.array(_DIRECTIONS[self._along.value])
        self._session.push(self._link.value, force)

    def _clicked(self, what: str) -> None:
        session = self._session
        if what == "pause":
            session.paused = not session.paused
        elif what == "reset":
            self._scene.forget_path()
            session.reset()
        elif what == "home":
            session.aim_at("home")
        else:
            self._draws += 1
            session.aim_randomly(self._draws)
