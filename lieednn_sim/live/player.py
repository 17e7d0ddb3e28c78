"""The controls of a live view for motions on one clock: planners compared, and recorded runs."""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.live.playback import MOST, Playback, Track, plan_tracks
from lieednn_sim.live.scene import GHOSTS, ArmScene
from lieednn_sim.live.session import Session
from lieednn_sim.live.settings import ready_planners
from lieednn_sim.live.worker import Worker

_NONE, _FIRST = "none", ("lieednn-shaped", "minimum-jerk")


class Player:
    """Plays motions as ghosts beside the live arm.

    Args:
        server: a `viser.ViserServer`; the controls are placed where its present container is.
        session: the session.
        scene: its scene.
        tracks: motions to play at first, such as of a recorded run.
    """

    def __init__(self, server: Any, session: Session, scene: ArmScene, tracks: Sequence[Track] = ()) -> None:
        gui = server.gui
        self._server, self._session, self._scene = server, session, scene
        self.playback = Playback()
        self._worker = Worker("comparison", lambda error: self._say(str(error)))
        choices = (_NONE, *ready_planners())
        with gui.add_folder("Compare planners", expand_by_default=False):
            firsts = [*_FIRST, *[_NONE] * MOST][:MOST]
            self._names = [
                gui.add_dropdown(f"planner {k + 1}", choices, initial_value=first) for k, first in enumerate(firsts)
            ]
            gui.add_button("plan and play", hint="from the start to the target").on_click(lambda _: self._plan())
        self._folder = gui.add_folder("Play", visible=False)
        with self._folder:
            self._legend = gui.add_html("")
            self._time = gui.add_slider("time s", 0.0, 1.0, step=0.01, initial_value=0.0)
            self._buttons = gui.add_button_group("", ("play", "step -", "step +", "clear"))
            self._loop = gui.add_checkbox("loop", True)
            self._live = gui.add_checkbox("live arm", True)
            self._save = gui.add_button("save the page", hint="one file that plays without a network", visible=False)
        self._time.on_update(self._seek)
        self._buttons.on_click(lambda event: self._clicked(event.target.value))
        self._loop.on_update(lambda _: setattr(self.playback, "loop", self._loop.value))
        self._live.on_update(lambda _: scene.show_arm(self._live.value))
        self._save.on_click(self._download)
        self._pending: tuple[list[Track], str] | None = None
        self._count = 0
        if tracks:
            self._live.value = False
            self._load(list(tracks), "")

    def close(self) -> None:
        """End the worker."""
        self._worker.close()

    def show(self, elapsed: float) -> None:
        """Let time pass [s] and move the ghosts; in the thread that shows the page."""
        if self._pending is not None:
            (tracks, said), self._pending = self._pending, None
            self._load(tracks, said)
        if self.playback.advance(elapsed):
            self._scene.show_ghosts(self.playback.configurations())
            self._count += 1
            if self.playback.playing and self._count % 5 == 0:
                self._time.value = round(self.playback.time, 2)

    def _load(self, tracks: list[Track], said: str) -> None:
        self.playback.load(tracks)
        self._scene.set_ghosts([track.path(self._session.arm) for track in tracks], solid=len(tracks) == 1)
        if tracks:
            self._time.max = max(round(self.playback.end, 2), 0.01)
        self._folder.visible = bool(tracks or said)
        self._save.visible = len(tracks) == 1 and tracks[0].rollout is not None
        lines = [
            f'<span style="color:rgb{GHOSTS[k]}">&#9632;</span> {escape(track.name)}, {track.t[-1]:.2f} s'
            for k, track in enumerate(tracks)
        ]
        self._legend.content = _block([*lines, *([escape(said)] if said else [])])

    def _plan(self) -> None:
        names = [menu.value for menu in self._names if menu.value != _NONE]
        session, worker = self._session, self._worker
        start, target = session.start, session.tick.target
        self._say("plans")

        def work() -> None:
            how: dict[str, Any] = {"seed": session.seed, "check": worker.check}
            tracks, failures = plan_tracks(copy.deepcopy(session.arm), names, start, target, **how)
            self._pending = tracks, "; ".join(f"{name}: {reason}" for name, reason in failures.items())

        worker.submit(work)

    def _say(self, said: str) -> None:
        self._folder.visible = True
        self._legend.content = _block([escape(said)])

    def _seek(self, event: Any) -> None:
        # Without a client it was this object that moved the slider.
        if event.client is not None:
            self.playback.playing = False
            self.playback.seek(self._time.value)

    def _clicked(self, what: str) -> None:
        if what == "play":
            self.playback.playing = not self.playback.playing
        elif what == "clear":
            self._pending = [], ""
            self._live.value = True
        else:
            self.playback.step(1 if what.endswith("+") else -1)
            self._time.value = round(self.playback.time, 2)

    def _download(self, event: Any) -> None:
        (track,) = self.playback.tracks
        assert track.rollout is not None
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "motion.html"
            try:
                track.rollout.to_html(path, title=track.name)
            except LieEDNNError as error:
                self._say(str(error))
                return
            event.client.send_file_download(path.name, path.read_bytes())


def _block(lines: Sequence[str]) -> str:
    return f'<div style="padding:.2em .9em .5em;font-size:.85em;line-height:1.5">{"<br>".join(lines)}</div>'
