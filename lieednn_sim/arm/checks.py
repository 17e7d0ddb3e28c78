"""Requirements on a compiled model before it is read as an arm; errors name the joint or the number at fault."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.kinematics import CompoundJoint, least_singular_value
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats

FREE, BALL, SLIDE, HINGE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{kind}")) for kind in ("FREE", "BALL", "SLIDE", "HINGE")
)
JOINT_KINDS = {HINGE: "hinge", SLIDE: "slide", BALL: "ball"}
# Kinds of joints with one dof.
SCALAR = (HINGE, SLIDE)
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
    """What a joint is called in messages."""
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


def check_integrator(model: mujoco.MjModel, arm: str) -> None:
    """Raise `InputError` for RK4: MuJoCo can neither split its step, as controllers need, nor invert it.

    `mj_step1` and `mj_step2` would silently integrate with Euler's method; inverse dynamics would fail.
    """
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        raise InputError(
            f"arm {arm!r} asks for the integrator RK4, which can neither be stepped in halves nor inverted; set "
            'its <option integrator="..."> to implicitfast, implicit or Euler'
        )


def check_numbers(model: mujoco.MjModel) -> None:
    """Raise `InputError` where a model holds NaN, which MuJoCo silently reads and compiles."""
    for field in _NUMBERS:
        values = np.asarray(getattr(model, field))
        bad = np.flatnonzero(np.isnan(values).any(axis=tuple(range(1, values.ndim))))
        if bad.size:
            kind, _, what = field.partition("_")
            kind = "joint" if kind == "jnt" else kind
            name = getattr(model, kind)(int(bad[0])).name or f"number {bad[0]}"
            raise InputError(f"the {what} of {kind} {name!r} of the model is {values[bad[0]]}; write numbers")


def check_turn(model: mujoco.MjModel, arm: str, joint: int, span: Floats) -> None:
    """Raise `InputError` for a joint whose range ``span`` ``(2,)`` is too wide to be encoded by a logarithm."""
    label, kind = joint_label(model, arm, joint), joint_kind(model, joint)
    if kind == "slide":
        return
    reference = 0.0 if kind == "ball" else model.qpos0[model.jnt_qposadr[joint]]
    most = np.abs(span - reference).max()
    if most >= np.pi:
        raise InputError(
            f"{label} may turn by {most:.3g} rad from its reference; the logarithm needs less than pi where other "
            "joints move the same link"
        )


def check_independent(joint: CompoundJoint, size: int, link: str) -> None:
    """Raise `InputError` for a compound joint whose pose determines its coordinates at none of a few configurations."""
    # They are tested at random configurations, and dependent where the singular value is below the last number.
    count, configurations, dependent = len(joint.indices), 8, 1e-6
    if count > 6:
        raise InputError(f"{link} is moved by {count} coordinates, but a pose determines six; name more links")
    frames, _ = joint.pose_and_slopes(np.random.default_rng(0).uniform(-1.0, 1.0, (configurations, size)))
    columns = np.swapaxes(joint.selection(joint.indices) @ frames[:, 1:].reshape(configurations, -1, 12), -1, -2)
    if least_singular_value(columns, dependent).max() < dependent:
        raise InputError(
            f"{link} is moved by {count} coordinates that are not independent; name more links to separate them"
        )
