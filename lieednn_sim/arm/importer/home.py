"""Home of a file's robot: a keyframe or the reference position, with some joints moved as asked for."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import SCALAR
from lieednn_sim.arm.dependents import tied_joints
from lieednn_sim.arm.equalities import joint_range
from lieednn_sim.arm.forces import actuator_moments, affine_actuators, disabled_actuators, required_forces
from lieednn_sim.arm.model_arm import ModelArm
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice, as_floats, quoted
from lieednn_sim.values import Floats

_Controls = dict[str, dict[str, float]]  # by keyframe and actuator

MARGIN = 0.05  # fraction of its range that home keeps away from each limit


def choose_home(
    spec: mujoco.MjSpec, model: mujoco.MjModel, keyframe: str | None, home: Mapping[str, float], notes: list[str]
) -> tuple[str, int | None, Floats]:
    """Home in words, the number of its keyframe if it is one, and its positions ``(nq,)``.

    `InputError` if there is no such keyframe or joint (the message lists those there are), or a position is invalid.
    """
    names = [model.key(k).name or f"key{k}" for k in range(model.nkey)]
    commanded = {k for k, key in enumerate(spec.keys) if not len(key.qpos) and _holds_another(model, k)}
    if commanded:
        notes.append(
            f"keyframes left out: {', '.join(names[k] for k in sorted(commanded))}; they have controls for another "
            "configuration, and no positions; name another keyframe, or give the positions of joints at home"
        )
    usable = [k for k in range(model.nkey) if k not in commanded]
    choice = {names[k]: k for k in reversed(usable)}
    if keyframe is not None and keyframe not in choice:
        why = " with positions" if keyframe in names else ""
        known = ", ".join(map(repr, reversed(choice))) or "none"
        raise InputError(f"no keyframe {quoted(keyframe)}{why}; keyframes of the model: {known}")
    number, label, qpos = None, "the reference position", model.qpos0.copy()
    if choice:
        name = keyframe or ("home" if "home" in choice else names[usable[0]])
        number, label = choice[name], f"keyframe {name!r}"
        qpos = model.key_qpos[number].copy()
        if not np.isfinite(qpos).all():
            raise InputError(f"{label} holds NaN or infinite positions; correct it, or choose another")
    if home:
        label += f", with {', '.join(map(str, home))} as given"
        _set_joints(model, qpos, home)
    return label, number, qpos


def move_inside(arm: ModelArm, notes: list[str]) -> Floats:
    """Home ``(n,)``, kept 5 % of each range off the limits."""
    given, (low, high) = arm.keyframe("home"), arm.position_limits.T
    spare = MARGIN * (high - low)
    inside = np.clip(given, low + spare, high - spare)
    for ball in arm.space.balls:
        angle = max(float(np.linalg.norm(given[ball])), 1e-300)
        inside[ball] = given[ball] * min(1.0, (1.0 - MARGIN) * high[ball[0]] / angle)
    moved = [name for name, a, b in zip(arm.joint_names, inside, given, strict=True) if abs(a - b) > 1e-9]
    notes += [f"{name}: moved off its limits in the keyframe 'home'" for name in moved]
    return np.where(np.abs(inside - given) > 1e-9, inside, given)


def take_controls(spec: mujoco.MjSpec) -> _Controls:
    """Take controls, by keyframe and actuator, and activations out of a spec's keyframes: its actuators may change.

    Keyframes and actuators without a name get one.
    """
    names = [actuator.name for actuator in spec.actuators]
    commands = {}
    for number, key in enumerate(spec.keys):
        key.name, key.act = key.name or f"key{number}", []
        if len(key.ctrl):
            commands[key.name] = dict(zip(names, key.ctrl, strict=True))
            key.ctrl = []
    return commands


def give_controls(
    spec: mujoco.MjSpec, model: mujoco.MjModel, keyframe: int | None, qpos: Floats, commands: _Controls
) -> None:
    """Give the keyframes controls for the actuators that the spec has now, and make the keyframe ``home``.

    At home these are the controls of the keyframe that it was taken from, if it has some, otherwise those that hold the
    robot there against its load; other keyframes take the controls that they lack from home.
    """
    (load,) = required_forces(model, qpos[None])
    moments = actuator_moments(model)
    driven = np.abs(moments).max(axis=0, initial=0.0) > 0.0
    forces = np.linalg.lstsq(moments[:, driven].T, load[driven], rcond=None)[0] if driven.any() else 0.0
    names = [model.actuator(k).name for k in range(model.nu)]
    holding = dict(zip(names, _controls(model, qpos, forces), strict=True))
    chosen = {} if keyframe is None else commands.get(spec.keys[keyframe].name, {})
    home = spec.key("home") or spec.add_key(name="home")
    home.qpos, home.qvel, home.act = qpos, [], []
    for key in spec.keys:
        given = chosen if key.name == "home" else commands.get(key.name, {})
        if given or key.name == "home":
            key.ctrl = [given.get(name, holding[name]) for name in names]


def _controls(model: mujoco.MjModel, qpos: Floats, forces: Floats | float) -> Floats:
    """Controls ``(nu,)`` with which affine actuators exert forces ``(nu,)`` at rest; zero for others."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    gain, (constant, stiffness) = model.actuator_gainprm[:, 0], model.actuator_biasprm[:, :2].T
    affine = affine_actuators(model)
    return np.where(affine, (forces - constant - stiffness * data.actuator_length) / np.where(affine, gain, 1.0), 0.0)


def _holds_another(model: mujoco.MjModel, keyframe: int) -> bool:
    """Whether position servos would hold another configuration at a keyframe's controls than the keyframe's own."""
    servos = (model.actuator_biasprm[:, 1] < 0.0) & ~disabled_actuators(model)
    off = model.key_ctrl[keyframe] - _controls(model, model.key_qpos[keyframe], 0.0)
    # Controls that are closer to a position hold it [rad, m].
    return bool((np.abs(off[servos]) > 1e-3).any())


def _set_joints(model: mujoco.MjModel, qpos: NDArray[np.float64], home: Mapping[str, float]) -> None:
    """Set hinges and slides in ``qpos`` ``(nq,)`` by name."""
    joints = {model.joint(j).name: j for j in range(model.njnt) if model.jnt_type[j] in SCALAR}
    leaders = dict(tied_joints(model))
    for name, value in home.items():
        joint = joints[as_choice("joint of the home configuration", name, joints)]
        if joint in leaders:
            leader = model.joint(leaders[joint]).name
            raise InputError(f"joint {name!r} of the home configuration follows joint {leader!r}; give its position")
        position = float(as_floats(f"home position of joint {name!r}", value, ()))
        low, high = joint_range(model, joint)
        if model.jnt_limited[joint] and not low <= position <= high:
            raise InputError(f"home position {position:g} of joint {name!r} is outside of [{low:.4g}, {high:.4g}]")
        qpos[model.jnt_qposadr[joint]] = position
