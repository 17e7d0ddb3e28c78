"""Kinds, owners and names of the joints of a compiled model, and a check of its numbers."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError

FREE, BALL, SLIDE, HINGE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{kind}")) for kind in ("FREE", "BALL", "SLIDE", "HINGE")
)
JOINT_KINDS = {HINGE: "hinge", SLIDE: "slide", BALL: "ball"}
SCALAR = (HINGE, SLIDE)  # kinds of joints with one dof
_NUMBERS = (
    *(f"body_{what}" for what in ("pos", "quat", "ipos", "iquat", "mass", "inertia", "gravcomp")),
    *(f"jnt_{what}" for what in ("pos", "axis", "range", "stiffness")),
    *(f"geom_{what}" for what in ("pos", "quat", "size", "friction", "margin")),
    *(f"site_{what}" for what in ("pos", "quat")),
    *(f"actuator_{what}" for what in ("gainprm", "biasprm", "gear", "ctrlrange", "forcerange")),
)


def joint_kind(model: mujoco.MjModel, joint: int) -> str:
    """``"hinge"``, ``"slide"`` or ``"ball"``; `KeyError` of a free joint."""
    return JOINT_KINDS[int(model.jnt_type[joint])]


def joint_label(model: mujoco.MjModel, arm: str, joint: int) -> str:
    """The name of a joint in messages."""
    return f"joint {model.joint(joint).name!r} of arm {arm!r}"


def ancestry(model: mujoco.MjModel, body: int) -> list[int]:
    """The bodies from the world outwards to a body, itself included."""
    path = [body]
    while path[-1]:
        path.append(int(model.body_parentid[path[-1]]))
    return path[::-1]


def joints_of(model: mujoco.MjModel, body: int) -> list[int]:
    """The joints of a body against its parent."""
    start = int(model.body_jntadr[body])
    return list(range(start, start + int(model.body_jntnum[body])))


def check_numbers(model: mujoco.MjModel) -> None:
    """Raise `InputError` where a model holds NaN, which MuJoCo silently reads, or an actuator with several controls."""
    for k in np.flatnonzero(model.actuator_ctrlnum != 1).tolist():
        name, controls = model.actuator(k).name or f"number {k}", int(model.actuator_ctrlnum[k])
        rule = "only those with one are known: put a <position> or <motor> in its place"
        raise InputError(f"actuator {name!r} has {controls} controls; {rule}")
    for field in _NUMBERS:
        values = np.asarray(getattr(model, field))
        bad = np.flatnonzero(np.isnan(values).any(axis=tuple(range(1, values.ndim))))
        if bad.size:
            kind, _, what = field.partition("_")
            kind = "joint" if kind == "jnt" else kind
            name = getattr(model, kind)(int(bad[0])).name or f"number {bad[0]}"
            raise InputError(f"the {what} of {kind} {name!r} of the model is {values[bad[0]]}; write numbers")
