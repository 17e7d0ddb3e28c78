"""Overlays of a video: planned frames and paths around the arm, and the caption in a corner."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from lieednn_sim._mujoco import mujoco
from lieednn_sim.rendering import scene_setup
from lieednn_sim.simulation import Rollout
from lieednn_sim.values import Floats, frozen

# Red, green and blue for x, y and z.
_AXIS_COLOURS = np.array(
    [(0.90, 0.22, 0.21, 0.75), (0.26, 0.71, 0.32, 0.75), (0.20, 0.42, 0.92, 0.75)], dtype=np.float32
)
PLANNED_COLOUR = (0.08, 0.75, 0.70, 0.55)
TRACED_COLOUR = (0.98, 0.80, 0.10, 1.0)
# Radii of the paths [m]; the travelled one is thicker, since it usually covers the planned one.
PLANNED_RADIUS, TRACED_RADIUS = 0.008, 0.011
_font = functools.cache(ImageFont.load_default)
# Position and orientation of a geom before its ends are known.
_NOWHERE, _UPRIGHT = np.zeros(3), np.eye(3).ravel()


@frozen
class Overlay:
    """Geometry to add to each frame."""

    planned_frames: Floats  # (K, N, 4, 4) planned link frames, the last one being the end effector
    traced_tip: Floats  # (K, 3) simulated end effector positions
    scale: float = 1.0  # of lengths and widths, 1 for an arm of two metres

    @classmethod
    def of(cls, rollout: Rollout, scale: float) -> Overlay:
        """The overlay of a rollout: its reference's link frames, and the simulated end effector."""
        return cls(scene_setup.planned_frames(rollout), rollout.link_position[:, -1], scale)

    def draw(self, scene: mujoco.MjvScene, k: int) -> None:
        """Add the geometry of sample ``k`` to a scene."""
        self.draw_paths(scene, k)
        axis_length = 0.22  # at full size [m]
        for frame in self.planned_frames[k]:
            for axis, rgba in enumerate(_AXIS_COLOURS):
                tip = frame[:3, 3] + self.scale * axis_length * frame[:3, axis]
                _connect(scene, mujoco.mjtGeom.mjGEOM_ARROW, 0.007 * self.scale, frame[:3, 3], tip, rgba)

    def draw_paths(self, scene: mujoco.MjvScene, k: int) -> None:
        """Add the planned path, and the one travelled up to sample ``k``, without the frames."""
        _polyline(scene, self.planned_frames[:, -1, :3, 3], PLANNED_RADIUS * self.scale, PLANNED_COLOUR)
        _polyline(scene, self.traced_tip[: k + 1], TRACED_RADIUS * self.scale, TRACED_COLOUR)


def _polyline(scene: mujoco.MjvScene, points: Floats, radius: float, colour: tuple[float, ...]) -> None:
    if len(points) < 2:
        return
    max_segments = 40  # a software renderer takes long for more, which look the same
    way = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
    chosen = points[np.searchsorted(way, np.linspace(0.0, way[-1], max_segments + 1))]
    rgba = np.array(colour, dtype=np.float32)
    for i in np.flatnonzero(np.linalg.norm(np.diff(chosen, axis=0), axis=1) > 1e-5):
        _connect(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, chosen[i], chosen[i + 1], rgba)


def _connect(
    scene: mujoco.MjvScene, kind: mujoco.mjtGeom, width: float, a: Floats, b: Floats, rgba: NDArray[np.float32]
) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, _NOWHERE, _NOWHERE, _UPRIGHT, rgba)
    mujoco.mjv_connector(geom, kind, width, a, b)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # no shadows
    geom.emission = 0.3
    scene.ngeom += 1


# White on a dark, semi-transparent panel, which is readable on any background.
_INK, _PANEL = (255, 255, 255, 255), (20, 26, 33, 150)
# The legend of `Overlay`'s colours.
KEY = ((PLANNED_COLOUR, "planned"), (TRACED_COLOUR, "travelled"))


def write_caption(image: NDArray[np.uint8], lines: Sequence[str]) -> NDArray[np.uint8]:
    """A copy of a frame ``(height, width, 3)`` with lines of text and the colour legend in its upper left corner.

    Frames below 160 pixels, which have no room for it, are returned unchanged.
    """
    height = image.shape[0]
    if height < 160:
        return image
    size = max(9, round(height / 34.0))  # smaller letters cannot be read
    font, step, margin = _font(size), round(1.35 * size), round(0.7 * size)
    widths = [font.getlength(line) for line in lines]
    widths.append(sum(font.getlength(text) + 3.0 * size for _, text in KEY))
    picture = Image.fromarray(image)
    draw = ImageDraw.Draw(picture, "RGBA")
    corner = (margin + max(widths) + 2 * margin, margin + step * (len(lines) + 1) + margin)
    draw.rounded_rectangle([margin, margin, *corner], radius=margin // 2, fill=_PANEL)
    x, y = 2.0 * margin, 1.5 * margin
    for line in lines:
        draw.text((x, y), line, font=font, fill=_INK)
        y += step
    for colour, text in KEY:
        middle, bright = y + 0.6 * size, (*(round(255 * part) for part in colour[:3]), 255)
        draw.line([x, middle, x + 1.2 * size, middle], fill=bright, width=max(2, size // 4))
        draw.text((x + 1.6 * size, y), text, font=font, fill=_INK)
        x += font.getlength(text) + 3.0 * size
    return np.asarray(picture)
