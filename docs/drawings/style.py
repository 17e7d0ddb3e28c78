"""What the drawings of the concepts share: paper, ink, sizes, and pictures of an arm with frames drawn on it."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls
from lieednn_sim.rendering.video import Camera

BLUE, ORANGE, GREEN, RED, GREY = "#1f6fb4", "#d9730d", "#2a8f5b", "#c0392b", "#6b7280"
# Made for a phone: on a page 390 pixels wide, letters of 9 points are 9 pixels high.
WIDTH = 4.8


def figure(height: float, *arguments: Any, **options: Any) -> Any:
    """As `plt.subplots`, on a white panel, which is readable on light and on dark pages."""
    plt.rcParams.update(
        {
            "font.size": 9,
            "axes.titlesize": 9,
            "axes.labelsize": 9,
            "xtick.labelsize": 8.5,
            "ytick.labelsize": 8.5,
            "legend.fontsize": 8.5,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "savefig.facecolor": "white",
            "svg.hashsalt": "lieednn_sim",
        }
    )
    made, axes = plt.subplots(*arguments, figsize=(WIDTH, height), layout="constrained", **options)
    made.get_layout_engine().set(w_pad=0.1, h_pad=0.1)
    return made, axes


def show_arm(
    axis: Any,
    arm: ls.Arm,
    q: Any,
    *,
    target: Any = None,
    camera: str | None = None,
    points: Any = None,
    size: tuple[int, int] = (640, 480),
    crop: tuple[float, float, float, float] = (0.0, 1.0, 1.0, 0.0),
) -> Any:
    """Show an arm at q ``(n,)``; returns a function that turns points ``(..., 3)`` of the world into the axis's.

    Args:
        axis: where to.
        arm: the arm.
        q: its joints.
        target: joint target of the marker.
        camera: as in `Camera`.
        points: as in `Camera`.
        size: of the whole picture.
        crop: left, right, bottom and top of the part that is shown, as fractions of the whole from the upper left.
    """
    seen: list[Any] = []
    with Camera(arm, camera=camera, size=size, preset="draft", target=target, points=points) as view:
        axis.imshow(view.picture(q, lambda scene: seen.append(scene.camera[0])))
        eye = seen[0]
        position, forward, up = (np.array(part, float) for part in (eye.pos, eye.forward, eye.up))
        slope = eye.frustum_top / eye.frustum_near
    width, height = size
    axis.set(xlim=(crop[0] * width, crop[1] * width), ylim=(crop[2] * height, crop[3] * height))
    axis.set_axis_off()

    def seen_at(places: Any) -> Any:
        away = np.asarray(places) - position
        depth = slope * away @ forward
        across = np.stack([away @ np.cross(forward, up) / depth, -(away @ up) / depth], axis=-1)
        return 0.5 * np.array(size) + 0.5 * height * across

    return seen_at


def draw_frames(axis: Any, seen_at: Any, frames: Any, length: float, alpha: float = 1.0) -> Any:
    """Draw frames ``(F, 4, 4)`` as three arrows each, x red, y green, z blue; returns where their origins are seen."""
    for frame in frames:
        for direction, colour in zip(np.eye(3), (RED, GREEN, BLUE), strict=True):
            ends = seen_at([frame[:3, 3], frame[:3, 3] + length * frame[:3, :3] @ direction])
            arrow = {"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0, "alpha": alpha}
            axis.annotate("", ends[1], ends[0], arrowprops=arrow)
    return seen_at(np.asarray(frames)[:, :3, 3])
