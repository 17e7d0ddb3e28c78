"""What is drawn over the arm: planned link frames, the planned tip path and the path traced so far."""

from __future__ import annotations

import itertools

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.values import Floats, frozen

_AXIS_COLOURS = ((0.90, 0.22, 0.21, 0.75), (0.26, 0.71, 0.32, 0.75), (0.20, 0.42, 0.92, 0.75))
PLANNED_COLOUR = (0.08, 0.75, 0.70, 0.55)
TRACED_COLOUR = (0.98, 0.80, 0.10, 1.0)
_AXIS_LENGTH = 0.22
_MAX_SEGMENTS = 150


@frozen
class Overlay:
    """Geometry to add to each frame.

    Attributes:
        planned_frames: ``(K, N, 4, 4)`` planned link frames, the last one being the end effector.
        traced_tip: ``(K, 3)`` simulated end effector positions.
        scale: of lengths and widths, 1 for an arm of two metres.
    """

    planned_frames: Floats
    traced_tip: Floats
    scale: float = 1.0

    def draw(self, scene: mujoco.MjvScene, k: int) -> None:
        """Add the geometry of sample ``k`` to a scene."""
        _polyline(scene, self.planned_frames[:, -1, :3, 3], 0.008 * self.scale, PLANNED_COLOUR)
        _polyline(scene, self.traced_tip[: k + 1], 0.011 * self.scale, TRACED_COLOUR)
        for frame in self.planned_frames[k]:
            for axis, colour in enumerate(_AXIS_COLOURS):
                tip = frame[:3, 3] + self.scale * _AXIS_LENGTH * frame[:3, axis]
                _connect(scene, mujoco.mjtGeom.mjGEOM_ARROW, 0.007 * self.scale, frame[:3, 3], tip, colour)


def _polyline(scene: mujoco.MjvScene, points: Floats, radius: float, colour: tuple[float, ...]) -> None:
    if len(points) < 2:
        return
    chosen = points[np.unique(np.linspace(0, len(points) - 1, _MAX_SEGMENTS + 1, dtype=int))]
    for a, b in itertools.pairwise(chosen):
        if np.linalg.norm(b - a) > 1e-5:
            _connect(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, a, b, colour)


def _connect(
    scene: mujoco.MjvScene, kind: mujoco.mjtGeom, width: float, a: Floats, b: Floats, colour: tuple[float, ...]
) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(colour, dtype=np.float32))
    mujoco.mjv_connector(geom, kind, width, a, b)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # no shadows
    geom.emission = 0.3
    scene.ngeom += 1
