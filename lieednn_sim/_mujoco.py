"""MuJoCo, imported even if ``MUJOCO_GL`` names an OpenGL backend that is not installed, since physics needs none.

MuJoCo imports the OpenGL bindings that the variable names, and fails if these do. The backend for rendering is chosen
on the first rendering, in `rendering.opengl`.
"""

import os
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np

try:
    import mujoco as mujoco  # for others to import from here
except Exception:  # of several OpenGL bindings, with no common base
    asked = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "disable"
    try:
        import mujoco as mujoco
    finally:
        if asked is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = asked

_SCRATCH = threading.local()


class QuietWarnings:
    """Keeps MuJoCo from printing warnings and from writing a log file; users must check ``data.warning`` themselves."""

    def __enter__(self) -> None:
        self._before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda _: None)

    def __exit__(self, *_: object) -> None:
        mujoco.set_mju_user_warning(self._before)


def kinematics_at(model: Any, qpos: Any, data: Any = None) -> Any:
    """`mujoco.MjData`, new by default, with positions ``qpos`` ``(nq,)`` and the frames of all bodies there."""
    data = mujoco.MjData(model) if data is None else data
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_flex(model, data)
    return data


def kinematics_each(model: Any, rows: Any, data: Any = None) -> Iterator[Any]:
    """The same `mujoco.MjData` with the kinematics at one row of positions ``(K, nq)`` after another."""
    data = mujoco.MjData(model) if data is None else data
    for data.qpos[:] in rows:
        mujoco.mj_kinematics(model, data)
        yield data


def kinematics_along(model: Any, rows: Any, *arrays: str, data: Any = None) -> list[Any]:
    """Whole arrays of `mujoco.MjData`, such as ``xpos``, at each row of positions ``(K, nq)``: each ``(K, ...)``."""
    data = mujoco.MjData(model) if data is None else data
    # Views are kept, since getting one from MuJoCo takes as long as reading it.
    views = [getattr(data, name) for name in arrays]
    results = [np.empty((len(rows), *view.shape)) for view in views]
    for k, _ in enumerate(kinematics_each(model, rows, data)):
        for result, view in zip(results, views, strict=True):
            result[k] = view
    return results


def scratch_data(model: Any) -> Any:
    """`mujoco.MjData` in its initial state, valid until this thread's next call for the model, which returns it again.

    Making new data takes a hundred times as long as a computation, so those of the thread's last model are kept.
    """
    if getattr(_SCRATCH, "model", None) is not model:
        _SCRATCH.model, _SCRATCH.data = model, mujoco.MjData(model)
    mujoco.mj_resetData(model, _SCRATCH.data)
    return _SCRATCH.data


def geom_colours(model: Any) -> Any:
    """Colours ``(G, 4)`` of all geoms, from 0 to 1: their own, else those of their materials, as MuJoCo draws them."""
    colours = model.geom_rgba.copy()
    # This grey is the default colour of geoms.
    of_material = (model.geom_matid >= 0) & (colours == (0.5, 0.5, 0.5, 1.0)).all(axis=1)
    colours[of_material] = model.mat_rgba[model.geom_matid[of_material]]
    return colours
