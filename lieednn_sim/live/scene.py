"""The 3D scene of a live view: arm, target, paths and frames."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.contacts import moving_geoms
from lieednn_sim.live.session import Aim
from lieednn_sim.live.snapshot import Snapshot
from lieednn_sim.rendering import scene_setup, viser_scene
from lieednn_sim.rendering.overlay import PLANNED_COLOUR, PLANNED_RADIUS, TRACED_COLOUR, TRACED_RADIUS
from lieednn_sim.values import Floats

# Colour of a target that the arm cannot reach, and of the force on a link [RGB].
_RED = (222, 45, 38)
# Most points of the travelled path, and the distance between two of them [m].
_TRAVELLED, _SPACING = 600, 2e-3
# Width / height of a picture in which all that the arm reaches is seen at first.
_RATIO = 1.0


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
        seen = viser_scene.viewpoint(model, home, scene_setup.camera(arm, None, points), points)
        self._view, self._reached = seen.back_off(points, _RATIO), points
        self._view.place(server)
        server.on_client_connect(self._make_room)
        viser_scene.add_floor(scene, shapes)
        self._nodes = viser_scene.ModelNodes(scene, shapes, "/arm")
        self._data = mujoco.MjData(model)
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
        # Seen through what the target may be in.
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
        # The arm takes three quarters of the width, and stands three tenths of the height above the middle.
        view = self._view.back_off(self._reached, 0.75 * camera.aspect)
        height = 2.0 * np.linalg.norm(view.position - view.look_at) * np.tan(0.5 * camera.fov)
        lower = 0.3 * float(height) * view.axes[1]
        with client.atomic():
            camera.position, camera.look_at = view.position - lower, view.look_at - lower

    def show(self, snapshot: Snapshot, path: Floats | None) -> None:
        """Move everything to an instant, with the path ahead ``(P, 3)``, or None if it is not known."""
        tick, aimed = snapshot.tick, snapshot.aimed
        self._data.mocap_pos[self._marker], self._data.mocap_quat[self._marker] = aimed.position, aimed.quaternion
        self._data.qpos[:] = self._arm.qpos(tick.q)
        mujoco.mj_kinematics(self._nodes.model, self._data)
        self._nodes.show(self._data)
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
        pushed = bool(tick.force.any())
        if pushed != self._arrow.visible:
            self._arrow.visible = pushed
        if pushed:
            # 3 mm for a newton, and 0.8 m at most.
            length = min(3e-3, 0.8 / float(np.linalg.norm(tick.force))) * self._scale
            self._arrow.points = np.array([[tick.pushed, tick.pushed + length * tick.force]], dtype=np.float32)
