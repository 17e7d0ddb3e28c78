"""Edits that turn a MuJoCo spec into one with this package's conventions."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.serial_chain import Frame
from lieednn_sim.arm.importer.stages import Couplings
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.storage import is_file
from lieednn_sim.validation import as_path

Floats = NDArray[np.float64]
_LIMITED = mujoco.mjtLimited.mjLIMITED_TRUE
_SITE = mujoco.mjtObj.mjOBJ_SITE


def load_spec(model: Any) -> Any:
    """A spec of one's own from a file or another spec, ready for edits: bodies stay apart, all have names.

    Raises:
        FileError: there is no such file, or MuJoCo cannot read it.
        InputError: neither a path nor a spec.
    """
    if isinstance(model, mujoco.MjSpec):
        compile_spec(model)  # a copy leaves out, without a word, what refers to names that aren't there
        spec = model.copy()
    else:
        if not isinstance(model, str | os.PathLike):
            raise InputError(f"the model must be a file or a mujoco.MjSpec, got {type(model).__name__}")
        source = as_path("the model", model)
        if not is_file(source):
            raise FileError(f"no such file: {source}")
        try:
            spec = mujoco.MjSpec.from_file(str(source))
        except ValueError as error:
            raise FileError(f"MuJoCo cannot read {source}: {str(error).strip()}") from None
    spec.compiler.fusestatic = False  # a link that doesn't move in its parent would vanish
    spec.compiler.alignfree = False  # a frozen object would keep the pose of its principal axes instead of its own
    for kind, elements in (("body", spec.bodies), ("joint", spec.joints)):
        names = {element.name for element in elements}
        for number, element in enumerate(elements):
            if not element.name:
                element.name = _unused(f"{kind}{number}", names)
                names.add(element.name)
            if kind == "joint" and element.type == mujoco.mjtJoint.mjJNT_FREE:
                element.align = 0
    return spec


def replace_integrator(spec: Any, notes: list[str]) -> None:
    """Let a model that asks for RK4 be stepped by implicitfast: see `parsing.check_integrator`."""
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        notes.append("integrator implicitfast in place of RK4, which has no inverse dynamics in discrete time")


def compile_spec(spec: Any) -> mujoco.MjModel:
    """Compile; `FileError` says what MuJoCo says, and which files of meshes and textures are missing."""
    try:
        return spec.compile()
    except ValueError as error:
        missing = _missing_files(spec)
        if missing:
            shown = ", ".join(missing[:10]) + (f" and {len(missing) - 10} more" if len(missing) > 10 else "")
            raise FileError(f"files of the model are missing: {shown}") from None
        raise FileError(f"MuJoCo cannot compile the model: {str(error).strip()}") from None


def add_frames(spec: Any, model: mujoco.MjModel, frames: Sequence[Frame], notes: list[str]) -> None:
    """Add the sites ``base_frame``, ``link1_frame``, ... at the frames; sites of these names elsewhere are renamed."""
    names = ("base_frame", *(f"link{i}_frame" for i in range(1, len(frames))))
    # By name: a spec forgets the ids of a compiled model as soon as something is added to it.
    bodies = {body.name: body for body in spec.bodies}
    missing = {name: frame for name, frame in zip(names, frames, strict=True) if not _is_there(model, name, frame)}
    for name in (*missing, f"link{len(frames)}_frame"):
        site = spec.site(name)
        if site is not None:
            other = _unused(f"original_{name}", {site.name for site in spec.sites})
            _rename_site(spec, site, other)
            notes.append(f"the site {name!r} of the model is now called {other!r}")
    for name, frame in missing.items():
        body = bodies[model.body(frame.body).name]
        site = body.add_site(name=name, pos=frame.pos, quat=frame.quat, size=[0.008, 0.0, 0.0], group=4)
        site.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        site.fromto = np.full(6, np.nan)


def _is_there(model: mujoco.MjModel, name: str, frame: Frame) -> bool:
    site = mujoco.mj_name2id(model, _SITE, name)
    return (
        site >= 0
        and int(model.site_bodyid[site]) == frame.body
        and np.allclose(model.site_pos[site], frame.pos, rtol=0.0, atol=1e-12)
        and abs(float(model.site_quat[site] @ frame.quat)) > 1.0 - 1e-12
    )


def add_coupling(spec: Any, model: mujoco.MjModel, couplings: Couplings, follower: int) -> None:
    """Tie a stage of a telescope to its leader by an equality, stiff enough to pass for a rigid belt."""
    leader, ratio, shift = couplings.lines[follower]
    y0, x0 = (float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (follower, leader))
    equality = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_JOINT, name1=model.joint(follower).name, name2=model.joint(leader).name, active=True
    )
    equality.data = np.array([shift - y0 + ratio * x0, ratio, *np.zeros(len(equality.data) - 2)])
    equality.solref, equality.solimp = _belt(model)


def stiffen_couplings(spec: Any, model: mujoco.MjModel, couplings: Couplings, notes: list[str]) -> None:
    """Make the model's own ties between stages as stiff as those of `add_coupling`, where they are softer.

    MuJoCo's default gives a light stage a spring of a few hundred newtons a metre: friction of a few newtons leaves it
    centimetres behind the others, where no servo notices.
    """
    followers = {model.joint(follower).name for follower in couplings.lines if follower not in couplings.added}
    reference, impedance = _belt(model)
    stiffened = []
    for equality in spec.equalities:
        if equality.type != mujoco.mjtEq.mjEQ_JOINT or not equality.active or equality.name1 not in followers:
            continue
        # Negative numbers are a stiffness and a damping that somebody chose.
        if 0.0 < equality.solref[0] <= reference[0] or equality.solref[0] < 0.0:
            continue
        equality.solref, equality.solimp = reference, impedance
        stiffened.append(equality.name1)
    if stiffened:
        notes.append(f"ties of {', '.join(stiffened)} made stiff, with solref {reference[0]:g} s")


def _belt(model: mujoco.MjModel) -> tuple[Floats, Floats]:
    """Parameters solref and solimp of a tie that passes for rigid; MuJoCo's least time constant is two timesteps."""
    return np.array([max(0.004, 2.0 * model.opt.timestep), 1.0]), np.array([0.99, 0.999, 0.001, 0.5, 2.0])


def set_range(joint: Any, span: Floats) -> None:
    """Limit a joint of a spec to ``span`` ``(2,)`` [rad, m], whatever unit the spec is in."""
    degrees = joint.compiler.degree and joint.type != mujoco.mjtJoint.mjJNT_SLIDE
    joint.range = np.rad2deg(span) if degrees else span
    joint.limited = _LIMITED


def compensate_gravity(spec: Any, model: mujoco.MjModel, joints: Sequence[int], notes: list[str]) -> None:
    """Switch gravity compensation on for all that moves with the joints, unless the model has it somewhere there."""
    first = int(model.jnt_bodyid[joints[0]])
    moving = {first}
    for body in range(first + 1, model.nbody):
        if int(model.body_parentid[body]) in moving:
            moving.add(body)
    gravity = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY) and np.any(model.opt.gravity)
    if not gravity:
        return
    if np.any(model.body_gravcomp[list(moving)]):
        notes.append("gravity compensation is the model's own")
        return
    names = {model.body(body).name for body in moving}
    for body in spec.bodies:
        if body.name in names:
            body.gravcomp = 1.0
    notes.append(f"gravity compensation switched on for {len(moving)} moving bodies")


def drop_old_limits(spec: Any, size: int, notes: list[str]) -> None:
    """Delete custom velocity and acceleration limits that are not for ``size`` coordinates."""
    for name in ("velocity_limit", "acceleration_limit"):
        numeric = spec.numeric(name)
        if numeric is not None and max(int(numeric.size), len(numeric.data)) != size:
            spec.delete(numeric)
            notes.append(f"removed the custom numeric {name!r}, which is not for {size} coordinates")


def add_keyframe(spec: Any, name: str, qpos: Floats, ctrl: Floats) -> None:
    """Add a keyframe at rest."""
    spec.add_key(name=name, qpos=qpos, ctrl=ctrl)


def _unused(name: str, names: set[str]) -> str:
    while name in names:
        name += "_"
    return name


def _rename_site(spec: Any, site: Any, name: str) -> None:
    for sensor in spec.sensors:
        if sensor.objtype == _SITE and sensor.objname == site.name:
            sensor.objname = name
        if sensor.reftype == _SITE and sensor.refname == site.name:
            sensor.refname = name
    for equality in spec.equalities:
        if equality.objtype == _SITE:
            equality.name1 = name if equality.name1 == site.name else equality.name1
            equality.name2 = name if equality.name2 == site.name else equality.name2
    site.name = name


def _missing_files(spec: Any) -> list[str]:
    missing = []
    known = set(spec.assets)
    for folder, elements in (
        ("meshdir", [*spec.meshes, *spec.hfields, *spec.skins]),
        ("texturedir", list(spec.textures)),
    ):
        for element in elements:
            if not element.file:
                continue
            below = getattr(element.compiler, folder, "") or getattr(spec, folder, "")
            path = Path(spec.modelfiledir) / below / element.file
            if not path.is_file() and not known.intersection(
                (element.file, path.name, str(Path(below) / element.file))
            ):
                missing.append(str(path))
    return missing
