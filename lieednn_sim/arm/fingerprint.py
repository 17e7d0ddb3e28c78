"""What affects the motion of a model: fingerprints, which are hashes of it, and a model without what is only drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim import io
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.contacts import colliding_geoms
from lieednn_sim.arm.serial_arm import SerialArm

# Prefixes of MuJoCo's arrays that count, and suffixes of those among them that concern appearance alone.
_COUNT = (
    *("body_", "jnt_", "dof_", "geom_", "site_", "actuator_", "eq_", "tendon_", "wrap_", "pair_", "exclude_"),
    *("mesh_", "hfield_", "key_", "qpos"),
)
# Arrays that affect motion, besides those of geoms; for `dof_length` see `discard_visuals`.
_BEGINNINGS = (
    *("body_", "jnt_", "dof_", "site_pos", "site_quat", "actuator_", "eq_", "tendon_", "wrap_", "pair_", "exclude_"),
    *("sensor_", "plugin", "flex_", "hfield_", "qpos", "tree_"),
)
_OTHERS = ("body_geomadr", "body_geomnum", "dof_length", "tendon_matid", "tendon_rgba", "flex_matid", "flex_rgba")
_ARRAYS = [name for name in dir(mujoco.MjModel) if name.startswith(_BEGINNINGS) and name not in _OTHERS]
_OPTIONS = [name for name in dir(mujoco.MjOption) if not name.startswith("_")]
# Arrays of geoms that concern appearance alone, or follow from the geoms' sizes.
_OF_GEOMS = {f"geom_{what}" for what in ("rgba", "matid", "group", "user", "dataid", "aabb", "rbound", "plugin")}
_GEOMS = [name for name in dir(mujoco.MjModel) if name.startswith("geom_") and name not in _OF_GEOMS]


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


def discard_visuals(arm: SerialArm) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """Spec and model of an arm without textures, materials and non-colliding geoms; its own where that fails."""
    spec: Any = arm.spec.copy()
    spec.compiler.discardvisual = True
    try:
        model = spec.compile()
    except ValueError:
        return arm.spec, arm.model
    # The extent of the bodies that a dof moves, by which MuJoCo decides whether it sleeps.
    model.dof_length[:] = arm.model.dof_length
    return spec, model


def moves_alike(bare: mujoco.MjModel, model: mujoco.MjModel) -> bool:
    """Whether a model of `discard_visuals` still moves like the whole one, which may have been changed since."""
    touching = np.flatnonzero(colliding_geoms(model))
    sees = (model.sensor_type == int(mujoco.mjtSensor.mjSENS_RANGEFINDER)).any()
    return bool(
        not sees
        and bare.ngeom == len(touching)
        and all(getattr(bare, name).tobytes() == getattr(model, name)[touching].tobytes() for name in _GEOMS)
        and all(_bytes(bare.opt, name) == _bytes(model.opt, name) for name in _OPTIONS)
        and all(_bytes(bare, name) == _bytes(model, name) for name in _ARRAYS)
    )


def _bytes(holder: Any, name: str) -> bytes:
    return np.asarray(getattr(holder, name)).tobytes()
