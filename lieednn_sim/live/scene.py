"""The 3D scene and the table of a live view, which show one instant of its session; all in the page's thread."""

from __future__ import annotations

import copy
from collections import deque
from html import escape
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from lieednn_sim._mujoco import kinematics_at
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.contacts import moving_geoms
from lieednn_sim.evaluation.evaluation import SETTLED_ROTATION, SETTLED_TRANSLATION
from lieednn_sim.evaluation.metrics import pose_errors
from lieednn_sim.live.engine import Tick, certificate_of, network_policy
from lieednn_sim.live.session import Aim, Session
from lieednn_sim.rendering import scene_setup, viser_scene
from lieednn_sim.rendering.overlay import PLANNED_COLOUR, PLANNED_RADIUS, TRACED_COLOUR, TRACED_RADIUS
from lieednn_sim.rendering.viewpoint import viewpoint
from lieednn_sim.values import Floats, distances, rounded

# Colour of a target that the arm cannot reach, and of the arrow of a force [RGB].
_RED = (222, 45, 38)
# Most points of the travelled path, and the distance between two of them [m].
_TRAVELLED, _SPACING = 600, 2e-3
# Width / height of a picture in which the initial view shows all that the arm can reach.
_RATIO = 1.0
_GOOD, _BAD, _IDLE = "#2f9e44", "#e03131", "#868e96"
_TABLE = '<table style="width:100%;border-collapse:collapse;font-size:.82em;line-height:1.45">'
_NAME = '<td style="opacity:.65;padding-right:.7em;vertical-align:top;white-space:nowrap">'
_VALUE = '<td style="overflow-wrap:anywhere">'


class Snapshot(NamedTuple):
    """One instant of a session."""

    session: Session
    tick: Tick  # state of the loop
    aimed: Aim  # the target that was asked for last
    frames: RigidTransform  # link frames, poses of shape (N,)
    planned: RigidTransform  # link frames of the reference
    distance: float  # distance of the end effector from the target [m]
    angle: float  # the same as an angle [rad]
    tracking: float  # distance of the end effector from its reference [m]
    gap: Floats | None  # (2,) largest mechanism gap of a link [rad, m]; None without a network
    clearance: float  # least distance of two geoms whose distance the joints can change [m]; infinite beyond 0.6 m
    nearest: tuple[str, str]  # names of these geoms; empty beyond 0.6 m

    @property
    def arrived(self) -> bool:
        """Whether the end effector is within 1 mm and 0.1 degrees of the target."""
        return self.distance <= SETTLED_TRANSLATION and self.angle <= SETTLED_ROTATION

    @property
    def state(self) -> str:
        """What the arm does, in words: the policy's message does not tell whether the arm follows its reference."""
        there = np.allclose(self.tick.q_ref, self.tick.target, rtol=0.0, atol=1e-4)
        if there and self.tick.message == "moves" and not self.arrived:
            return f"its reference has arrived, the arm is still {_millimetres(self.tracking)} off"
        return "has arrived" if self.arrived else self.tick.message


class Observer:
    """Takes snapshots of a session, all in one thread."""

    def __init__(self, session: Session) -> None:
        self._session, self._arm = session, copy.deepcopy(session.arm)
        self._collisions = Collisions(self._arm)

    def look(self) -> Snapshot:
        """The present instant."""
        session, arm, tick = self._session, self._arm, self._session.tick
        poses = arm.link_poses(np.stack([tick.q, tick.q_ref, tick.target]))
        frames, planned, goals = poses[0], poses[1], poses[2]
        distance, angle = pose_errors(frames[-1], goals[-1])
        near = self._collisions.distances(tick.q, 0.6)
        changing = np.flatnonzero(np.abs(near.jacobian).max(axis=1, initial=0.0) > 1e-6)
        first = int(changing[0]) if len(changing) else None
        inner = network_policy(session.policy)
        return Snapshot(
            session,
            tick,
            session.aimed,
            frames,
            planned,
            float(distance),
            float(angle),
            float(pose_errors(frames[-1], planned[-1])[0]),
            None if inner is None else inner.gap.max(axis=0),
            np.inf if first is None else float(near.distance[first]),
            ("", "") if first is None else self._collisions.names(near.pairs[first]),
        )


class ArmScene:
    """An arm in the scene of a `viser.ViserServer`, with its target as a handle.

    Attributes:
        handle: viser's transform controls at the target; the mouse moves them.
        frames: viser's node of the reference's link frames.
        trace: the path travelled so far.
        surfaces: viser's nodes of the arm's moving surfaces, with the names of their bodies.
    """

    def __init__(self, server: Any, arm: Arm, aimed: Aim) -> None:
        scene, self._arm = server.scene, arm
        points = scene_setup.reached(arm)
        model, self._marker = scene_setup.staged(arm, points)
        shapes = viser_scene.Shapes(model)
        self._scale = scene_setup.scale(arm, points)
        home = kinematics_at(model, arm.qpos(arm.keyframe("home")))
        seen = viewpoint(model, home, scene_setup.camera(arm, None, points), points)
        self._view, self._reached = seen.back_off(points, _RATIO), points
        self._view.place(server)
        server.on_client_connect(self._make_room)
        viser_scene.add_floor(scene, shapes)
        self._nodes = viser_scene.ModelNodes(scene, shapes, "/arm")
        marked = int(np.flatnonzero(model.body_mocapid == self._marker)[0])
        self._glass = [(node, node.color) for node in self._nodes.surfaces.get(marked, [])]
        moving = set(model.geom_bodyid[moving_geoms(model)].tolist()) - {marked}
        self.surfaces = [
            (node, model.body(body).name)
            for body, nodes in self._nodes.surfaces.items()
            for node in nodes
            if body in moving and model.body(body).name and model.body_mocapid[model.body_rootid[body]] < 0
        ]
        place = {"position": aimed.position, "wxyz": aimed.quaternion, "depth_test": False}
        self.handle = scene.add_transform_controls("/target handle", scale=0.28 * self._scale, line_width=3.0, **place)
        # The label is visible even if the target is inside an obstacle.
        self._refusal = scene.add_label("/refused", "cannot be reached", visible=False, anchor="bottom-left")
        blank = np.zeros((2, 3))
        self._planned = viser_scene.add_path(scene, "/planned", blank, PLANNED_COLOUR, PLANNED_RADIUS * self._scale)
        self._travelled = viser_scene.add_path(scene, "/travelled", blank, TRACED_COLOUR, TRACED_RADIUS * self._scale)
        self.trace: deque[Floats] = deque(maxlen=_TRAVELLED)
        self._path: Floats | None = blank
        axes = {"axes_length": 0.2 * self._scale, "axes_radius": 0.006 * self._scale}
        self.frames = scene.add_batched_axes(
            "/frames", batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (arm.n_links, 1)),
            batched_positions=np.zeros((arm.n_links, 3)), **axes,
        )  # fmt: skip
        size = {"shaft_radius": 0.012, "head_radius": 0.03, "head_length": 0.06}
        size = {name: value * self._scale for name, value in size.items()}
        self._arrow = scene.add_arrows("/force", np.array([[np.zeros(3), np.ones(3)]]), _RED, visible=False, **size)

    async def _make_room(self, client: Any) -> None:
        """On a narrow screen, where the controls take the lower part, show the arm in the upper one."""
        camera = client.camera
        if camera.aspect > _RATIO:
            return
        # The arm takes three quarters of the width, and is three tenths of the height above the middle.
        view = self._view.back_off(self._reached, 0.75 * camera.aspect)
        height = 2.0 * np.linalg.norm(view.position - view.look_at) * np.tan(0.5 * camera.fov)
        lower = 0.3 * float(height) * view.axes[1]
        with client.atomic():
            camera.position, camera.look_at = view.position - lower, view.look_at - lower

    def show(self, snapshot: Snapshot, path: Floats | None) -> None:
        """Move everything to an instant, with the path ahead ``(P, 3)``, or None if it is not known."""
        tick, aimed = snapshot.tick, snapshot.aimed
        data = self._nodes.data
        data.mocap_pos[self._marker], data.mocap_quat[self._marker] = aimed.position, aimed.quaternion
        self._nodes.show(self._arm.qpos(tick.q))
        refused = bool(aimed.problem)
        if refused != self._refusal.visible:
            for node, colour in self._glass:
                node.color = _RED if refused else colour
            self._refusal.visible = refused
        if refused:
            self._refusal.position = aimed.position
        self.frames.batched_positions = np.asarray(snapshot.planned.translation, dtype=np.float32)
        self.frames.batched_wxyzs = snapshot.planned.rotation.as_quat(scalar_first=True).astype(np.float32)
        tip = np.asarray(snapshot.frames[-1].translation)
        if not self.trace or np.linalg.norm(tip - self.trace[-1]) > _SPACING:
            self.trace.append(tip)
            self._travelled.points = viser_scene.segments(np.array(self.trace))
        if path is not self._path:
            self._path = path
            self._planned.visible = path is not None
            if path is not None:
                self._planned.points = viser_scene.segments(path)
        self._arrow.visible = pushed = bool(tick.force.any())
        if pushed:
            # 3 mm per newton, at most 0.8 m.
            length = min(3e-3, 0.8 / float(np.linalg.norm(tick.force))) * self._scale
            self._arrow.points = np.array([[tick.pushed, tick.pushed + length * tick.force]], dtype=np.float32)


def status(snapshot: Snapshot) -> str:
    """What the policy does, what is proved about it, and its errors: HTML that is readable on dark and on white."""
    session, tick, progress = snapshot.session, snapshot.tick, snapshot.tick.progress
    if problem := snapshot.aimed.problem or session.failure:
        said, colour = problem, _BAD
    elif session.busy:
        said, colour = "plans", _IDLE
    else:
        said, colour = snapshot.state, "inherit"
    rows = [
        ("policy", escape(tick.policy or "waits for a policy")),
        ("proof", _proof(snapshot)),
        ("to the target", distances(snapshot.distance, snapshot.angle)),
    ]
    if progress is not None:
        bound = f" &le; {progress.bound:.3g} proved" if np.isfinite(progress.bound) else ", no bound proved"
        # Smaller distances are rounding errors.
        rows += [("of the network", "below 1e-9" if progress.distance < 1e-9 else f"{progress.distance:.3g}{bound}")]
    if snapshot.gap is not None:
        rows += [("mechanism gap", distances(snapshot.gap[1], snapshot.gap[0]))]
    nearest = " and ".join(escape(name) for name in snapshot.nearest)
    clearance = f"{_millimetres(snapshot.clearance)}<br>{nearest}" if any(snapshot.nearest) else "more than 600 mm"
    pace = f"{tick.time:.1f} s, {session.achieved:.2f} times real time"
    if session.paused:
        pace = f"{tick.time:.1f} s, paused"
    elif session.achieved <= 0.95 * session.speed:
        pace = f'<b style="color:{_BAD}">{pace} instead of {session.speed:g}: this machine is too slow</b>'
    if (way := session.way) is not None and not way.clearance.reason:
        where = "inside" if way.holds(tick.q) else f'<b style="color:{_BAD}">outside</b>'
        proved = f'<b style="color:{_GOOD if way.clearance.proved else _BAD}">{way.clearance.at()}</b>'
        rows += [("way ahead", f"{proved}<br>the arm is {where}")]
    rows += [("clearance", clearance), ("tracking error", _millimetres(snapshot.tracking)), ("time", pace)]
    table = "".join(f"<tr>{_NAME}{name}</td>{_VALUE}{value}</td></tr>" for name, value in rows)
    line = f'<div style="color:{colour};min-height:2.7em;font-size:.88em;padding-bottom:.3em">{escape(said)}</div>'
    return f'<div style="padding:.2em .9em .5em">{line}{_TABLE}{table}</table></div>'


def _proof(snapshot: Snapshot) -> str:
    progress, result = snapshot.tick.progress, certificate_of(snapshot.session.policy)
    if result is None:
        return f'<span style="color:{_IDLE}">none</span>'
    word, colour = ("certified", _GOOD) if result.valid else ("not certified", _BAD)
    largest = f"&lambda;<sub>max</sub> {result.lambda_max:.3g} against &gamma;/&mu; {result.bound:.3g}"
    rate = "" if progress is None else f"<br>rate {progress.rate:.3g} /s"
    return f'<b style="color:{colour}">{word}</b><br>{largest}{rate}'


def _millimetres(value: float) -> str:
    return f"{rounded(1e3 * value)} mm" if abs(value) >= 1e-6 else "below 1 µm"
