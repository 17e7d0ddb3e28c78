"""Pages that show a motion in 3D: one HTML file that works offline, to play, scrub and turn.

A page has viser's player and a recording of one arm, or of several side by side that share their geometry.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lieednn_sim import io
from lieednn_sim._mujoco import kinematics_at
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.budget import report
from lieednn_sim.errors import InputError
from lieednn_sim.registry import optional_module
from lieednn_sim.rendering import scene_setup, viser_scene
from lieednn_sim.rendering.camera import check_camera
from lieednn_sim.rendering.overlay import KEY, PLANNED_COLOUR, PLANNED_RADIUS, TRACED_RADIUS
from lieednn_sim.rendering.viewpoint import Viewpoint, viewpoint
from lieednn_sim.rendering.viser_scene import Shapes, add_path, segments
from lieednn_sim.rendering.viser_server import quiet_server
from lieednn_sim.simulation import Rollout
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_path
from lieednn_sim.values import Floats, StrPath

__all__ = ["render_page"]

_RATE = 25  # poses per second
_WIDE = 16.0 / 9.0  # width / height of the widest picture for which a view is made
_MARGIN = 1.2  # room around what a view contains, as a factor
# viser's player fills the window below a caption. In a narrow window it zooms out, so that everything stays visible.
_STYLE = """<style>
body { display: flex; flex-direction: column; background: #fff; color: #1c1f23; }
header { display: flex; flex-wrap: wrap; gap: .1rem 1.2rem; padding: .55rem .9rem; font-size: .92rem; }
header i { display: inline-block; width: 1.3em; height: .3em; margin-right: .45em; vertical-align: .18em; }
#root { flex: 1; min-height: 0; }
@media (prefers-color-scheme: dark) { body { background: #1a1b1e; color: #e6e8ea; } }
</style><script>setInterval(() => {
  const eye = window.__viserMutable?.cameraControl, box = document.querySelector("#root canvas");
  const zoom = box && Math.min(1, box.clientWidth / box.clientHeight / RATIO);
  if (eye && zoom && Math.abs(eye.camera.zoom - zoom) > 1e-3) eye.zoomTo(zoom, false);
}, 200)</script>"""


def player(recording: str, *, title: str = "Motion", style: str = "", header: str = "") -> str:
    """A page with viser's player, the HTML ``header`` above it, and the HTML ``style`` in its head.

    The recording is in base64, or a placeholder that a script replaces. `LieEDNNError` if viser is not installed.
    """
    viser = optional_module("viser")
    page = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_text("utf-8")
    # Viser's own pages pass a recording by these two names; see `viser.infra.StateSerializer.as_html`.
    given = (
        f'<script>window.__VISER_EMBED_DATA__="{recording}";window.__VISER_EMBED_CONFIG__='
        '{darkMode:matchMedia("(prefers-color-scheme: dark)").matches};</script>'
    )
    page = page.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    # viser's notice of slow rendering without a graphics card would cover the arm; its menu of speeds cuts them off.
    rules = ".mantine-Notifications-root { display: none; } .mantine-Select-wrapper { min-width: 4.6em; }"
    page = page.replace("</head>", f"{given}<style>{rules}</style>{style}</head>", 1)
    return page.replace('<div id="root">', f'{header}<div id="root">', 1)


def render_page(rollout: Rollout, path: StrPath, *, camera: str | None = None, title: str = "") -> None:
    """Write a page that plays a rollout in 3D, with a timeline and a camera that the mouse moves.

    It shows the arm in its scene, the target, the planned path, the paths travelled so far by the end effector and by a
    hanging load, and a caption. It opens as a file, loads nothing from the network, and is light or dark as preferred.

    Args:
        rollout: the rollout.
        path: ``.html`` file.
        camera: the initial view, as for `render_video`.
        title: the planner's name, for the caption.

    Raises:
        InputError: the name does not end in .html, or there is no such camera.
        LieEDNNError: viser, of the extra ``view``, is not installed.
    """
    if as_path("path", path).suffix != ".html":
        raise InputError(f"a page's name must end in .html, got {Path(path).name!r}")
    check_camera(rollout.arm, camera)
    recording = record([rollout], camera=camera)
    place, rest = scene_setup.place(rollout.arm), f", then {rollout.hold:.2f} s at rest" if rollout.hold > 0.005 else ""
    texts = [f"<b>{escape(place)}</b>"]
    proof = "" if rollout.clearance is None else rollout.clearance.at()
    texts += [escape(word) for word in (title, rollout.controller, f"{rollout.motion_end:.2f} s{rest}", proof) if word]
    shown = KEY[: 2 + bool(PassiveJoints(rollout.arm).bodies.any())]
    texts += [f'<i style="background:rgb{colour}"></i>{word} path' for colour, word in shown]
    page = player(
        recording.base64,
        title=f"{title or 'Motion'} on {place}",
        style=_STYLE.replace("RATIO", f"{recording.ratio:.3f}"),
        header="<header>" + "".join(f"<span>{text}</span>" for text in texts) + "</header>",
    )
    io.save_text(path, page)


class Recording(NamedTuple):
    """Motions for viser's player.

    Attributes:
        content: the recording, a ``.viser`` file.
        ratio: least width / height of a picture that shows everything, 1 to 16/9.
    """

    content: bytes
    ratio: float

    @property
    def base64(self) -> str:
        """The content as text, for `player`."""
        return base64.b64encode(self.content).decode("ascii")


def record(rollouts: Sequence[Rollout], labels: Sequence[str] = (), *, camera: str | None = None) -> Recording:
    """Record rollouts of one arm on one clock.

    A single rollout is seen from the camera of its video; several stand in a row, seen from the same direction. Each is
    shown with its target, the planned path, the path that the end effector has travelled so far, and its label if
    there are labels. The camera is as for `render_page`.

    Raises:
        InputError: the rollouts are of several arms or scenes, or their number is not that of the labels.
        LieEDNNError: viser is not installed.
    """
    if not rollouts or len({rollout.arm.fingerprint for rollout in rollouts}) > 1:
        raise InputError("rollouts side by side must be of one arm in one scene, and there must be one at least")
    if labels and len(labels) != len(rollouts):
        raise InputError(f"labels must be one for each of {len(rollouts)} rollouts, got {len(labels)}")
    arm = rollouts[0].arm
    points = np.vstack([scene_setup.occupied(rollout) for rollout in rollouts])
    model, marker = scene_setup.staged(arm, points)
    shapes = Shapes(model)
    home = kinematics_at(model, rollouts[0].qpos[0])
    view = viewpoint(model, home, scene_setup.camera(arm, camera, points, rollouts[0]), points)
    offsets, ratio = np.zeros((1, 3)), float(np.clip(_MARGIN * view.ratio(points), 1.0, _WIDE))
    held = np.vstack([points, *map(_corners, (points, shapes.extent))])
    if len(rollouts) > 1:
        right = view.axes[0] * [1.0, 1.0, 0.0]
        right /= np.linalg.norm(right)
        # The gap between two arms is a tenth of their width.
        spacing = 1.1 * float(np.ptp(held @ right))
        offsets = np.outer(np.arange(len(rollouts)) * spacing, right)
        there = (held + offsets[:, None]).reshape(-1, 3)
        # A narrow field of view, so that all are seen from nearly the same side.
        view = Viewpoint(view.position, view.look_at, np.deg2rad(30.0)).back_off(there, _WIDE)
        ratio = _WIDE
    with quiet_server() as server:
        view.place(server)
        viser_scene.add_floor(server.scene, shapes)
        scale = scene_setup.scale(arm, points)
        copies = [
            _Copy(server.scene, shapes, marker, rollout, f"/{k}", offset, scale)
            for k, (rollout, offset) in enumerate(zip(rollouts, offsets, strict=True))
        ]
        for offset, label in zip(offsets, labels, strict=False):
            top = np.append(0.5 * (held.min(axis=0) + held.max(axis=0))[:2], _MARGIN * held[:, 2].max())
            size = {"font_size_mode": "scene", "font_scene_height": spacing / 16.0} if len(rollouts) > 1 else {}
            server.scene.add_label(f"/label {label}", label, position=top + offset, anchor="bottom-center", **size)
        recording = server.get_scene_serializer()
        total = 1 + int(max(rollout.t[-1] - rollout.t[0] for rollout in rollouts) * _RATE + 1e-6)
        for done in range(total):
            for copy in copies:
                copy.show(done / _RATE)
            recording.insert_sleep(1.0 / _RATE)
            report(done + 1, total)
        return Recording(recording.serialize(), ratio)


class _Copy:
    """One rollout's arm, target and paths, translated from their place in the model."""

    def __init__(
        self, scene: Any, shapes: Shapes, marker: int, rollout: Rollout, name: str, offset: Floats, scale: float
    ) -> None:
        self._rollout, self._nodes = rollout, viser_scene.ModelNodes(scene, shapes, name, offset=offset)
        self._way = way = rollout.link_position[:, -1]
        scene_setup.mark(rollout.arm, self._nodes.data, marker, rollout.target)
        self._samples = np.unique(np.linspace(0, len(rollout.t) - 1, 101, dtype=int))
        self._plan = scene_setup.planned_frames(rollout)[self._samples, -1, :3, 3]
        off = np.linalg.norm(self._plan - way[self._samples], axis=1)
        self._followed = off < scale * TRACED_RADIUS
        self._planned = add_path(scene, f"{name}/planned", self._plan, PLANNED_COLOUR, scale * PLANNED_RADIUS)
        self._trails = [
            (path, [path[0]], add_path(scene, f"{name}/{word}", path[[0, 0]], colour, scale * TRACED_RADIUS))
            for path, (colour, word) in zip((way, scene_setup.load_path(rollout)), KEY[1:], strict=True)
            if len(path)
        ]

    def show(self, time: float) -> None:
        """Move to a time [s] after the beginning, or to the end."""
        rollout = self._rollout
        k = min(round(time / rollout.timestep), len(rollout.t) - 1)
        self._nodes.show(rollout.qpos[k])
        for path, trail, node in self._trails:
            if np.linalg.norm(path[k] - trail[-1]) <= 1e-3:
                continue
            trail.append(path[k])
            node.points = segments(np.array(trail))
            if path is self._way:
                # Covered parts of the planned path are left out: at the same depth the two lines would flicker.
                covered = self._followed & (self._samples <= k)
                self._planned.points = segments(self._plan)[~(covered[:-1] & covered[1:])]


def _corners(points: Floats) -> Floats:
    """The corners ``(8, 3)`` of the box around points ``(P, 3)``; none without points."""
    if not len(points):
        return points
    return np.array(list(product(*zip(points.min(axis=0), points.max(axis=0), strict=True))))


typecheck_public(globals())
