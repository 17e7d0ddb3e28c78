"""One picture of a whole motion: the arm at several instants, fainter at earlier ones, with its path and target."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image as Picture

from lieednn_sim import io
from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError
from lieednn_sim.planning.motion import travelled
from lieednn_sim.rendering.camera import Camera, Image
from lieednn_sim.rendering.overlay import Overlay, draw_lines
from lieednn_sim.simulation import Rollout
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_path
from lieednn_sim.values import Floats, StrPath

__all__ = ["render_still"]

# Opacity of the arm at each instant, from the first to the last.
OPACITIES = (0.3, 0.36, 0.44, 0.55, 1.0)


def render_still(
    rollout: Rollout,
    path: StrPath,
    *,
    camera: str | None = None,
    size: tuple[int, int] = (1280, 720),
    preset: str = "nice",
) -> None:
    """Write one picture of a rollout: the arm at five instants, its target, and the planned and travelled paths.

    The instants divide the end effector's path into equal lengths; the earlier the instant, the fainter the arm.

    Args:
        rollout: the rollout.
        path: ``.png`` file.
        camera, size, preset: as in `Camera`.

    Raises:
        InputError: the name does not end in .png, or camera, size or preset are not as allowed.
        RenderingUnavailableError: there is no working OpenGL.
    """
    if as_path("path", path).suffix != ".png":
        raise InputError(f"a picture's name must end in .png, got {Path(path).name!r}")
    image = still(rollout, camera=camera, size=size, preset=preset)
    with io.atomic_path(path) as temporary:
        Picture.fromarray(image).save(temporary, format="PNG")


def still(rollout: Rollout, *, camera: str | None, size: tuple[int, int], preset: str) -> Image:
    """The picture ``(height, width, 3)`` of `render_still`."""
    model, overlay = rollout.arm.model, Overlay.of(rollout, 1.0)
    moving = (model.body_weldid[model.geom_bodyid] != 0) & (model.body_mocapid[model.geom_bodyid] < 0)
    chosen = instants(overlay.traced_tip, len(OPACITIES))

    def draw_without_arm(scene: mujoco.MjvScene) -> None:
        # A place that no camera and no light sees [m].
        away = (0.0, 0.0, -1e4)
        for geom in scene.geoms[: scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid < len(moving) and moving[geom.objid]:
                geom.pos[:] = away

    with Camera(rollout.arm, camera=camera, size=size, preset=preset, run=rollout) as view:
        empty = view.picture_at(rollout.qpos[0], draw_without_arm)
        # In the order of time. Where a picture equals the empty one, it shows neither the arm nor its shadow.
        result = empty.astype(float)
        for k, opacity in zip(chosen, OPACITIES, strict=True):
            picture = view.picture_at(rollout.qpos[k])
            there = (picture != empty).any(axis=-1)
            result[there] += opacity * (picture[there] - result[there])
        paths = overlay.paths(view.seen, len(rollout.t) - 1, size[1])
    return draw_lines(np.rint(result).astype(np.uint8), paths)


def instants(path: Floats, count: int) -> list[int]:
    """Indices of ``count`` samples that divide a path ``(K, 3)`` into equal lengths, or times if it has no length."""
    length = travelled(path)
    if length[-1] < 1e-6:
        length = np.linspace(0.0, 1.0, len(path))
    wanted = np.linspace(0.0, 1.0, count) * length[-1] * (1.0 - 1e-9)
    return np.searchsorted(length, wanted).tolist()


typecheck_public(globals())
