"""Fingerprints that identify an arm: a hash of everything that affects its motion, obstacles included."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim import io
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.serial_arm import SerialArm

# Prefixes of MuJoCo's arrays that count, and suffixes of those among them that concern appearance alone.
_COUNT = (
    *("body_", "jnt_", "dof_", "geom_", "site_", "actuator_", "eq_", "tendon_", "wrap_", "pair_", "exclude_"),
    *("mesh_", "hfield_", "key_", "qpos"),
)


def arm_fingerprint(arm: SerialArm) -> str:
    """Fingerprint of an arm: its compiled model with the obstacles, its frames, coordinates and limits.

    Neither colours nor file locations count. Another version of MuJoCo may give another fingerprint.
    """
    arrays = _arrays(arm.model)
    for name in ("position_limits", "velocity_limits", "acceleration_limits", "force_limits"):
        arrays[name] = _rounded(np.asarray(getattr(arm, name)))
    frames = arm.frames
    arrays["frames"] = _rounded(np.column_stack([frames.bodies, frames.positions, frames.rotations.reshape(-1, 9)]))
    # Few arms have them: the others keep the fingerprint that they had before jerk limits existed.
    if np.isfinite(arm.jerk_limits).any():
        arrays["jerk_limits"] = _rounded(arm.jerk_limits)
    arrays |= {"base": _rounded(arm.base.as_matrix()), "length_scale": _rounded(np.asarray(arm.length_scale))}
    return io.fingerprint(arrays, {"joints": arm.joint_names})


def model_fingerprint(model: mujoco.MjModel) -> str:
    """Fingerprint of a compiled model without an arm."""
    return io.fingerprint(_arrays(model), {})


def _arrays(model: mujoco.MjModel) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    look = ("_rgba", "_matid", "_group", "_user", "_pathadr", "texcoord", "texcoordadr", "texcoordnum")
    for prefix, holder in (("", model), ("opt_", model.opt)):
        for name in dir(holder):
            if prefix or (name.startswith(_COUNT) and not name.endswith(look)):
                value = getattr(holder, name)
                if isinstance(value, int | float | np.ndarray):
                    arrays[prefix + name] = _rounded(np.asarray(value))
    return arrays


def _rounded(values: NDArray[Any]) -> NDArray[Any]:
    # Rounding on another processor does not change the fingerprint; adding zero turns -0.0 into 0.0.
    return np.round(values, 9) + 0.0 if values.dtype.kind == "f" else values
