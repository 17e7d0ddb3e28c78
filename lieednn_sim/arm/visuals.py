"""A model without its visual geoms: it moves exactly as the whole one does, to the last bit, at half the cost."""

from __future__ import annotations

from typing import Any

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.contacts import colliding_geoms
from lieednn_sim.arm.serial_arm import SerialArm

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
        and all(np.array_equal(getattr(bare.opt, name), getattr(model.opt, name)) for name in _OPTIONS)
        and all(getattr(bare, name).tobytes() == getattr(model, name).tobytes() for name in _ARRAYS)
    )
