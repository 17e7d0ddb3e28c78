"""The floor of an imported arm: part of its model, so that targets and planners know what a film shows."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE, colliding_geoms
from lieednn_sim.arm.importer.loading import unused
from lieednn_sim.arm.model_arm import ModelArm
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats

AUTO, NONE = "auto", "none"  # the importer chooses the floor, or there is none
FLOOR = "floor"  # the body of a floor that the importer or a scene has added
GREY = (0.62, 0.62, 0.60, 1.0)  # its colour, for which films show squares
_ROOM = PLANNED_CLEARANCE + 0.01  # how far below the moving parts at home a floor lies at least [m]


def as_floor(value: float | str) -> float | str:
    """Return a height [m], `AUTO` or `NONE`; `InputError` for anything else."""
    if isinstance(value, str) and value not in (AUTO, NONE):
        raise InputError(f"floor must be a height in metres, {AUTO} or {NONE}, got {value!r}")
    return value if isinstance(value, str) else float(as_floats("floor", value, ()))


def add_floor(spec: mujoco.MjSpec, arm: ModelArm, floor: float | str, notes: list[str]) -> None:
    """Add a floor at the height that was asked for, or else below a base that stands on the ground.

    A base does not stand on the ground if the robot reaches below it at home: it may hang, or be on a table. A plane of
    the model is its floor; it is made to collide where it was only drawn.
    """
    bits = collision_bits(arm.model)
    planes = [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]
    for plane in planes:
        if not (plane.contype or plane.conaffinity):
            plane.contype = plane.conaffinity = bits
            notes.append(f"the plane {plane.name or 'without a name'!r} was only drawn; now it is part of the scene")
    if floor == NONE or (planes and floor == AUTO):
        return
    moving, fixed = lowest_points(arm)
    below = 0.05  # tolerance for boxes around geoms, and for a base frame inside of the base [m]
    if floor == AUTO and moving < fixed - below:
        notes.append("no floor, since the robot reaches below its base at home; floor=HEIGHT adds one")
        return
    height = min(fixed, moving - _ROOM) if floor == AUTO else float(floor)
    add_plane(spec, unused(FLOOR, {body.name for body in spec.bodies}), height, bits)
    why = "" if floor == AUTO else ", as asked for"
    notes.append(f"a floor at a height of {height:.3g} m{why}; the model has none, and floor: none leaves it so")


def add_plane(spec: mujoco.MjSpec, name: str, height: float, bits: int) -> None:
    """Add a horizontal plane, in a body of its own so that messages name it."""
    body = spec.worldbody.add_body(name=name, pos=[0.0, 0.0, height])
    look = {"name": name, "size": [0.0, 0.0, 0.05], "rgba": GREY, "group": 2}
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, contype=bits, conaffinity=bits, **look)


def collision_bits(model: mujoco.MjModel) -> int:
    """Bits with which a geom collides with every colliding geom of a model."""
    return int(np.bitwise_or.reduce(model.geom_contype | model.geom_conaffinity, initial=1))


def lowest_points(arm: ModelArm) -> tuple[float, float]:
    """Heights at home of the lowest points of the arm's colliding geoms, and of all others and the base frame [m].

    They are those of the geoms' bounding boxes, which may be a little lower.
    """
    model = arm.model
    data = kinematics_at(model, arm.qpos(arm.keyframe("home")))
    upright = data.geom_xmat.reshape(-1, 3, 3)[:, 2]
    middle = data.geom_xpos[:, 2] + (upright * model.geom_aabb[:, :3]).sum(axis=1)
    low = middle - (np.abs(upright) * model.geom_aabb[:, 3:]).sum(axis=1)
    moving = moved_together(model, arm.dofs)[model.geom_bodyid] > 0
    base = float(arm.base.translation[2])
    return float(low[moving & colliding_geoms(model)].min(initial=np.inf)), float(low[~moving].min(initial=base))
