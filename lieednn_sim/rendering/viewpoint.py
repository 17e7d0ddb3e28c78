"""Viewpoints of pictures, the points that they contain, and the side from which a path is hidden least."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.values import Floats, frozen

# Sides [deg]; the first one is taken unless another one is better.
_AZIMUTHS, _ELEVATIONS = 125.0 + 30.0 * np.array([0, -1, 1, -2, 2, -3, 3, -4, 4, -5, 5, 6]), (-20.0, -45.0)
# Geoms of these groups are drawn.
_DRAWN = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)


@frozen
class Viewpoint:
    """A browser's view: position ``(3,)``, the point ``(3,)`` in the middle [m], and vertical field of view [rad]."""

    position: Floats
    look_at: Floats
    field_of_view: float

    def place(self, server: Any) -> None:
        """Let the pages of a `viser.ViserServer` begin from here."""
        server.initial_camera.position = self.position
        server.initial_camera.look_at = self.look_at
        server.initial_camera.fov = self.field_of_view

    @property
    def axes(self) -> Floats:
        """``(3, 3)`` unit vectors to the right, up and forward, in rows; z is up in the world."""
        forward = self.look_at - self.position
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right = right / np.linalg.norm(right)
        return np.array([right, np.cross(right, forward), forward])

    def back_off(self, points: Floats, ratio: float) -> Viewpoint:
        """The viewpoint from the same side where points ``(P, 3)`` fill a picture of width / height ``ratio``."""
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        x, y, z = self.axes @ (points - centre).T
        slope = np.tan(0.5 * self.field_of_view)
        # The pictured offset x / (distance + z) must stay below the slope of the picture's edge.
        distance = max((abs(x) / (ratio * slope) - z).max(), (abs(y) / slope - z).max())
        return Viewpoint(centre - distance * self.axes[2], centre, self.field_of_view)

    def ratio(self, points: Floats) -> float:
        """The least width / height of a picture from here that contains points ``(P, 3)`` from left to right."""
        x, _, z = self.axes @ (points - self.position).T
        return float((abs(x) / z).max() / np.tan(0.5 * self.field_of_view))


def viewpoint(model: mujoco.MjModel, data: mujoco.MjData, camera: mujoco.MjvCamera, points: Floats) -> Viewpoint:
    """The viewpoint of a camera of MuJoCo; its middle is as far away as the mean of the points ``(P, 3)``."""
    scene = mujoco.MjvScene(model, maxgeom=1)  # no geoms are asked for, only the camera's pose and frustum
    mujoco.mj_camlight(model, data)
    mujoco.mjv_updateCamera(model, data, camera, scene)
    left, right = scene.camera
    position, forward = 0.5 * (left.pos + right.pos).astype(float), left.forward.astype(float)
    distance = max(float((points.mean(axis=0) - position) @ forward), 0.1)
    angle = 2.0 * np.arctan(left.frustum_top / left.frustum_near)
    return Viewpoint(position, position + distance * forward, float(angle))


def around(points: Floats, azimuth: float, elevation: float, angle: float, ratio: float) -> Viewpoint:
    """The viewpoint from a side (MuJoCo's angles [deg]) whose picture of width / height ``ratio`` the points fill.

    A margin of a tenth is left around the points ``(P, 3)``; ``angle`` is the vertical field of view [rad].
    """
    turn, rise = np.deg2rad([azimuth, elevation])
    forward = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return Viewpoint(centre - forward, centre, angle).back_off(centre + 1.1 * (points - centre), ratio)


def free_side(
    model: mujoco.MjModel, instants: Floats, path: Floats, points: Floats, angle: float, ratio: float
) -> tuple[float, float]:
    """Azimuth and elevation [deg] from which most of a path ``(K, 3)`` is seen, at positions ``(I, nq)`` of the model.

    The measure is the length of the visible path in the picture, averaged over the instants. The first side from which
    it is at least 95 % of the largest one is taken. The other arguments are as for `around`.
    """
    data, steps = [kinematics_at(model, qpos) for qpos in instants], np.diff(path, axis=0)
    sides, seen = list(product(_AZIMUTHS, _ELEVATIONS)), []
    some = points[:: max(len(points) // 2000, 1)]  # a rough position of the eye suffices
    for side in sides:
        view = around(some, *side, angle, ratio)
        length = np.linalg.norm(np.cross(steps, view.axes[2]), axis=1)
        seen.append(np.mean([length @ unhidden(model, now, view.position, path)[1:] for now in data]))
    azimuth, elevation = sides[int(np.argmax(np.array(seen) >= 0.95 * max(seen)))]
    return float(azimuth), elevation


def unhidden(
    model: mujoco.MjModel, data: mujoco.MjData, eye: Floats, points: Floats, without: int = -1
) -> NDArray[np.bool_]:
    """Which of points ``(P, 3)`` no drawn geom hides from ``eye`` ``(3,)``; one body may be left out."""
    rays = points - eye
    length = np.linalg.norm(rays, axis=1)
    distance, count = np.empty(len(rays)), len(rays)
    given = np.array(eye, float), (rays / length[:, None]).ravel(), _DRAWN, True, without
    mujoco.mj_multiRay(model, data, *given, np.empty(count, np.int32), distance, None, count, mujoco.mjMAXVAL)
    return np.asarray((distance < 0.0) | (distance > length - 1e-3))
