"""What touches what at a posture, by MuJoCo's collision detection."""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco

Floats = NDArray[np.float64]


class ContactChecker:
    """Finds bodies closer to each other than a margin; some ten times faster than distances, and without them.

    Args:
        model: is not changed.
        margin: distance [m] below which bodies count as touching.
    """

    def __init__(self, model: mujoco.MjModel, margin: float = 0.0) -> None:
        self._margin = margin
        self._model = copy.deepcopy(model)
        # Overridden rather than written into the geoms, whose bounding volumes were made for the old margins.
        self._model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
        self._model.opt.o_margin = margin
        self._data = mujoco.MjData(self._model)

    def __call__(self, qpos: Floats) -> list[tuple[str, str]]:
        """Names of the bodies closer than the margin at MuJoCo's positions ``(nq,)``."""
        model, data = self._model, self._data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        near = data.contact.dist < self._margin if data.ncon else []
        bodies = model.geom_bodyid[data.contact.geom[near]] if data.ncon else []
        return list(dict.fromkeys((model.body(a).name, model.body(b).name) for a, b in bodies))
