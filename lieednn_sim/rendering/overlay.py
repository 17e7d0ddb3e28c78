"""Overlays of a picture: planned frames and paths, and the caption in a corner."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import field
from itertools import product
from typing import Any

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
# Colours of the paths and in legends.
PLANNED_COLOUR, TRACED_COLOUR, LOAD_COLOUR = (20, 191, 179), (250, 204, 26), (237, 84, 158)
# Radii of the paths in pages [m]; their widths in pictures, as fractions of the height, and the factor of hidden parts.
# Travelled paths are thicker, since they usually cover the planned one.
PLANNED_RADIUS, TRACED_RADIUS = 0.008, 0.011
_PLANNED_WIDTH, _TRACED_WIDTH, _HIDDEN = 0.006, 0.008, 0.4
_font = functools.cache(ImageFont.load_default)
# Position and orientation of a geom before its ends are known.
_NOWHERE, _UPRIGHT = np.zeros(3), np.eye(3).ravel()


# A path in a picture: its pixels ``(K, 2)``, which of them are unhidden, its width [pixels] and colour.
Line = tuple[Floats, NDArray[np.bool_], float, tuple[int, ...]]


@frozen
class Overlay:
    """What is added to each frame."""

    planned_frames: Floats  # (K, N, 4, 4) planned link frames, the last one being the end effector
    traced_tip: Floats  # (K, 3) simulated end effector positions
    scale: float = 1.0  # scale of lengths and widths, 1 for an arm of two metres
    traced_load: Floats = field(default_factory=lambda: np.empty((0, 3)))  # (K, 3) centre of the hanging load, if any

    @classmethod
    def of(cls, rollout: Rollout, scale: float) -> Overlay:
        """The overlay of a rollout: its reference's link frames, the simulated end effector, and its load."""
        load = scene_setup.load_path(rollout)
        return cls(scene_setup.planned_frames(rollout), rollout.link_position[:, -1], scale, load)

    def draw(self, scene: mujoco.MjvScene, k: int) -> None:
        """Add the planned frames of sample ``k`` to a scene."""
        arrow, length, width = mujoco.mjtGeom.mjGEOM_ARROW, 0.22 * self.scale, 0.007 * self.scale
        for frame, (axis, rgba) in product(self.planned_frames[k], enumerate(_AXIS_COLOURS)):
            if scene.ngeom < scene.maxgeom:
                geom = scene.geoms[scene.ngeom]
                mujoco.mjv_initGeom(geom, arrow, _NOWHERE, _NOWHERE, _UPRIGHT, rgba)
                mujoco.mjv_connector(geom, arrow, width, frame[:3, 3], frame[:3, 3] + length * frame[:3, axis])
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # no shadows
                geom.emission = 0.3
                scene.ngeom += 1

    def paths(self, seen: Callable[[Floats], tuple[Floats, NDArray[np.bool_]]], k: int, height: int) -> list[Line]:
        """The planned path, and the paths travelled up to sample ``k``, as lines of a picture.

        ``seen`` maps points ``(P, 3)`` to their pixels, and whether they are unhidden, as `Camera.seen` does.
        """
        ways = [(self.planned_frames[:, -1, :3, 3], _PLANNED_WIDTH)]
        ways += [(way[: k + 1], _TRACED_WIDTH) for way in (self.traced_tip, self.traced_load) if len(way)]
        lines: list[Line] = []
        for (way, width), (colour, _) in zip(ways, KEY, strict=False):
            some = np.unique(np.linspace(0, len(way) - 1, 151, dtype=int))
            lines.append((*seen(way[some]), max(width * height, 1.5), colour))
        return lines


# White on a dark, semi-transparent panel, which is readable on any background.
_INK, _PANEL = (255, 255, 255, 255), (20, 26, 33, 150)
# The legend of `Overlay`'s colours; the last one is for loads.
KEY = ((PLANNED_COLOUR, "planned"), (TRACED_COLOUR, "travelled"), (LOAD_COLOUR, "load"))


def draw_lines(image: NDArray[np.uint8], lines: Sequence[Line]) -> NDArray[np.uint8]:
    """A copy of a frame ``(height, width, 3)`` with lines drawn over it, thinner where they are hidden."""
    picture, fine = Image.fromarray(image), 3  # drawn in finer pixels, so that edges are smooth
    ends = np.vstack([pixels[np.isfinite(pixels[:, 0])] for pixels, *_ in lines] or [np.empty((0, 2))])
    if not len(ends):
        return image
    # Only the part of the picture that holds the lines is drawn.
    low = np.clip(ends.min(axis=0) - 16.0, 0.0, picture.size).astype(int)
    size = np.maximum(np.clip(ends.max(axis=0) + 16.0, 0.0, picture.size).astype(int) - low, 1)
    sheet = Image.new("RGBA", tuple((fine * size).tolist()))
    draw: Any = ImageDraw.Draw(sheet)
    for pixels, free, width, colour in lines:
        for kept, share in ((np.isfinite(pixels[:, 0]), _HIDDEN), (free, 1.0)):
            for part in np.split(np.arange(len(kept)), np.flatnonzero(np.diff(kept)) + 1):
                if kept[part[0]] and len(part) > 1:
                    places = (fine * (pixels[part] - low)).ravel().tolist()
                    draw.line(places, fill=colour, width=max(round(fine * share * width), 1), joint="curve")
    drawn = sheet.resize(tuple(size.tolist()), Image.Resampling.BOX)
    picture.paste(drawn, tuple(low.tolist()), mask=drawn)
    return np.asarray(picture)


def write_caption(image: NDArray[np.uint8], lines: Sequence[str], load: bool = False) -> NDArray[np.uint8]:
    """A copy of a frame ``(height, width, 3)`` with lines of text and the colour legend in its upper left corner.

    The legend has the load's colour if there is one. Frames below 160 pixels, which have no room, are left as they are.
    """
    key = KEY[: 2 + load]
    height = image.shape[0]
    if height < 160:
        return image
    size = max(9, round(height / 34.0))  # smaller letters cannot be read
    font, step, margin = _font(size), round(1.35 * size), round(0.7 * size)
    widths = [font.getlength(line) for line in lines]
    widths.append(sum(font.getlength(text) + 3.0 * size for _, text in key))
    picture = Image.fromarray(image)
    draw = ImageDraw.Draw(picture, "RGBA")
    corner = (margin + max(widths) + 2 * margin, margin + step * (len(lines) + 1) + margin)
    draw.rounded_rectangle([margin, margin, *corner], radius=margin // 2, fill=_PANEL)
    x, y = 2.0 * margin, 1.5 * margin
    for line in lines:
        draw.text((x, y), line, font=font, fill=_INK)
        y += step
    for colour, text in key:
        middle = y + 0.6 * size
        draw.line([x, middle, x + 1.2 * size, middle], fill=colour, width=max(2, size // 4))
        draw.text((x + 1.6 * size, y), text, font=font, fill=_INK)
        x += font.getlength(text) + 3.0 * size
    return np.asarray(picture)
