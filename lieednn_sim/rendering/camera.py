"""A camera of an arm's scene, which renders pictures of it headlessly."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, RenderingUnavailableError
from lieednn_sim.rendering import opengl, scene_setup
from lieednn_sim.rendering.viewpoint import unhidden
from lieednn_sim.simulation import Rollout
from lieednn_sim.validation import as_choice, as_count, as_floats, quoted
from lieednn_sim.values import Floats

Image = NDArray[np.uint8]
_MAX_WIDTH, _MAX_HEIGHT = 3840, 2160  # 4K [pixels]


class Preset(NamedTuple):
    """Rendering quality: the settings that take most of a software renderer's time."""

    shadows: bool
    samples: int


#: Rendering presets by name.
PRESETS = {"draft": Preset(shadows=False, samples=0), "nice": Preset(shadows=True, samples=4)}


def check_view(
    arm: Arm, *, camera: str | None = None, size: tuple[int, int] = (1280, 720), preset: str = "nice"
) -> None:
    """Raise `InputError` for an unknown camera or preset, or a size that cannot be rendered."""
    check_camera(arm, camera)
    as_choice("preset", preset, PRESETS)
    if np.shape(size) != (2,):
        raise InputError(f"size must be (width, height), got {quoted(size)}")
    width, height = (as_count("size", value) for value in size)
    if width % 2 or height % 2 or width > _MAX_WIDTH or height > _MAX_HEIGHT:
        raise InputError(f"size must be even and at most {_MAX_WIDTH}x{_MAX_HEIGHT}, got {width}x{height}")


def check_camera(arm: Arm, camera: str | None) -> None:
    """Raise `InputError` for a camera that the scene does not have."""
    if camera is not None:
        as_choice("camera", camera, scene_setup.cameras(arm))


class Camera(contextlib.AbstractContextManager["Camera"]):
    """Renders an arm from a named camera; use as a context manager, which frees the OpenGL context.

    Args:
        arm: the arm; the model of a view is rendered as it is.
        camera: name of a camera of its scene; by default ``overview`` if there is one, else a view of ``points`` from
            the side that shows most of the path of ``run``.
        size: (width, height) in pixels, both even, at most 3840x2160.
        preset: a name of `PRESETS`.
        target: joint target ``(n,)`` for the marker, the scene's own or an added one; a view has no marker.
        points: points ``(P, 3)`` that the view must contain; by default those of `scene_setup.reached`.
        run: a rollout of the arm, which replaces target and points, and whose path should be visible.

    Raises:
        InputError: the camera or preset is unknown, or the size cannot be rendered.
        RenderingUnavailableError: there is no working OpenGL.
    """

    def __init__(
        self,
        arm: Arm,
        *,
        camera: str | None = None,
        size: tuple[int, int] = (1280, 720),
        preset: str = "nice",
        target: ArrayLike | None = None,
        points: ArrayLike | None = None,
        run: Rollout | None = None,
    ) -> None:
        check_view(arm, camera=camera, size=size, preset=preset)
        opengl.require()
        self._arm, self._preset = arm, PRESETS[preset]
        if run is not None:
            target, points = run.target, scene_setup.occupied(run)
        held = scene_setup.reached(arm) if points is None else as_floats("points", points, (3,), batched=True)
        self.scale = scene_setup.scale(arm, held)
        self._model, self._marker = scene_setup.staged(arm, held)
        self._camera = scene_setup.camera(arm, camera, held, run, size[0] / size[1])
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = size
        self._model.vis.quality.offsamples = self._preset.samples
        # Shadows as fine as the picture needs: with 4096, as in the scenes, a software renderer takes a third longer.
        self._model.vis.quality.shadowsize = max(1024, int(0.8 * size[0]))
        self._data = mujoco.MjData(self._model)
        self.mark(target)
        try:
            self._renderer = mujoco.Renderer(self._model, size[1], size[0], max_geom=20_000)
        except Exception as error:  # MuJoCo passes on exceptions of several GL bindings, which have no common base
            raise RenderingUnavailableError(f"OpenGL failed to start: {error}; run 'lieednn-sim doctor'") from None

    def __exit__(self, *_: object) -> None:
        self._renderer.close()

    def picture(self, q: ArrayLike, draw: Callable[[mujoco.MjvScene], None] | None = None) -> Image:
        """Image ``(height, width, 3)`` of the arm at ``q`` ``(n,)``; ``draw`` may add to the scene."""
        return self.picture_at(self._arm.qpos(as_floats("q", q, (self._arm.n_joints,))), draw)

    def picture_at(self, qpos: ArrayLike, draw: Callable[[mujoco.MjvScene], None] | None = None) -> Image:
        """As `picture`, at positions ``(nq,)`` of everything in the model."""
        self._data.qpos[:] = as_floats("qpos", qpos, (self._model.nq,))
        mujoco.mj_forward(self._model, self._data)
        # Twice, because MuJoCo puts the headlight where the camera was at the previous update.
        for _ in range(2):
            self._renderer.update_scene(self._data, self._camera)
        flags = self._renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self._preset.shadows
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        if draw is not None:
            draw(self._renderer.scene)
        return np.asarray(self._renderer.render())

    def seen(self, points: ArrayLike) -> tuple[Floats, NDArray[np.bool_]]:
        """Pixels ``(P, 2)`` of points ``(P, 3)`` in the last picture, and which points are not hidden.

        Pixels are counted from the upper left corner; those of points behind the camera are NaN.
        """
        held, renderer = as_floats("points", points, (3,), batched=True), self._renderer
        left, right = renderer.scene.camera
        place, forward, up = 0.5 * (left.pos + right.pos).astype(float), left.forward, left.up
        away = held - place
        depth = away @ forward
        # Half the height of the picture at that depth [m].
        half = left.frustum_top * (np.ones_like(depth) if left.orthographic else depth / left.frustum_near)
        scale = np.where(depth > 0.0, 0.5 * renderer.height / np.where(depth > 0.0, half, 1.0), np.nan)
        across = np.stack([away @ np.cross(forward, up), -(away @ up)], axis=1)
        pixels = 0.5 * np.array([renderer.width, renderer.height]) + scale[:, None] * across
        marker = np.flatnonzero(self._model.body_mocapid == self._marker) if self._marker >= 0 else [-1]
        return pixels, unhidden(self._model, self._data, place, held, int(marker[0])) & (depth > 0.0)

    def mark(self, target: ArrayLike | None) -> None:
        """Put the marker at a joint target ``(n,)``; without a target, hide an added marker in the base."""
        if target is None and self._model.nbody == self._arm.model.nbody:
            return
        goal = None if target is None else as_floats("target", target, (self._arm.n_joints,))
        scene_setup.mark(self._arm, self._data, self._marker, goal)
