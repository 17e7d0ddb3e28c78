"""The mechanism of a foreign model: its posture at import, and which of its joints are the arm."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.compound_joints import cut
from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.arm.importer.loading import compile_spec
from lieednn_sim.arm.importer.ranges import joint_ranges
from lieednn_sim.arm.importer.serial_chain import body_frame, is_gripper, joint_groups, longest_chain, named_frames
from lieednn_sim.arm.importer.stages import find_couplings
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice, as_floats, quoted

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_SAME = 1e-3  # controls this close to a position hold it [rad, m]


def choose_posture(draft: Draft) -> None:
    """Compile the model as given, and take the posture of a keyframe or the reference, with the given joint positions.

    Raises:
        InputError: there is no such keyframe or joint (the message lists those there are), or a position is invalid.
    """
    model = draft.original = compile_spec(draft.spec)
    names = [model.key(k).name or f"key{k}" for k in range(model.nkey)]
    commanded = {k for k, key in enumerate(draft.spec.keys) if not len(key.qpos) and _holds_another(model, k)}
    draft.keyframes = [k for k in range(model.nkey) if k not in commanded]
    if commanded:
        draft.notes.append(
            f"keyframes left out: {', '.join(names[k] for k in sorted(commanded))}; they have controls for another "
            "posture, and no positions; name another keyframe, or give the positions of joints at home"
        )
    choice = {names[k]: k for k in reversed(draft.keyframes)}
    if draft.keyframe is not None and draft.keyframe not in choice:
        why = " with positions" if draft.keyframe in names else ""
        known = ", ".join(map(repr, reversed(choice))) or "none"
        raise InputError(f"no keyframe {quoted(draft.keyframe)}{why}; keyframes of the model: {known}")
    if choice:
        name = draft.keyframe or ("home" if "home" in choice else names[draft.keyframes[0]])
        draft.posture, draft.qpos = f"keyframe {name!r}", model.key_qpos[choice[name]].copy()
        if not np.isfinite(draft.qpos).all():
            raise InputError(f"{draft.posture} holds NaN or infinite positions; correct it, or choose another")
    else:
        draft.posture, draft.qpos = "the reference position", model.qpos0.copy()
    if draft.home:
        draft.posture += f", with {', '.join(map(str, draft.home))} as given"
        _set_joints(model, draft.qpos, draft.home)


def find_mechanism(draft: Draft) -> None:
    """Find the arm's frames, joint groups, couplings and ranges, from the given names, its sites, or its longest chain.

    Raises:
        InputError: there is no such arm, the choice is ambiguous, or coupled joints move different links.
    """
    model, links, base = draft.original, draft.links, draft.base
    if links is None and base is None:
        links, base = _frames_of_the_model(model)
    if links is not None:
        draft.frames = named_frames(model, links, base)
    else:
        inner, tip = longest_chain(model, base)
        draft.frames = (inner, body_frame(model, tip))
        behind = (joint for joint in range(model.njnt) if model.body_parentid[model.jnt_bodyid[joint]] == tip)
        hands = [model.joint(joint).name for joint in behind if is_gripper(model, joint)]
        if hands:
            draft.notes.append(f"taken for a gripper, and locked: {', '.join(hands)}; name the links to move it")
    draft.groups = joint_groups(model, draft.frames)
    draft.couplings = find_couplings(model, draft.joints)
    if links is None:
        data = mujoco.MjData(model)
        data.qpos[:] = draft.qpos
        mujoco.mj_kinematics(model, data)
        whole = joint_ranges(model, [[joint] for joint in draft.joints], draft.couplings, [])
        draft.groups = cut(model, data, draft.joints, whole, draft.couplings)
        draft.frames = (inner, *(body_frame(model, int(model.jnt_bodyid[group[-1]])) for group in draft.groups))
    draft.ranges = joint_ranges(model, draft.groups, draft.couplings, draft.notes)
    link = {joint: i for i, group in enumerate(draft.groups, start=1) for joint in group}
    for follower, (leader, _, _) in draft.couplings.lines.items():
        if link[follower] != link[leader]:
            raise InputError(
                f"joint {model.joint(follower).name!r} moves link {link[follower]} and follows joint "
                f"{model.joint(leader).name!r}, which moves link {link[leader]}; "
                "choose links so that coupled joints move the same link"
            )
        if model.joint(follower).name in draft.home and follower not in draft.couplings.added:
            raise InputError(
                f"joint {model.joint(follower).name!r} of the home posture follows joint {model.joint(leader).name!r}; "
                "give the position of that one"
            )
    if len(draft.groups) == 1:
        draft.notes.append("the arm is one link; networks of a single neuron are hard to certify: name more links")


def _frames_of_the_model(model: mujoco.MjModel) -> tuple[tuple[str, ...] | None, str | None]:
    """The sites of a model that has this package's conventions already."""
    sites = {model.site(i).name for i in range(model.nsite)}
    links = tuple(itertools.takewhile(sites.__contains__, (f"link{i}_frame" for i in itertools.count(1))))
    return (links, "base_frame") if links and "base_frame" in sites else (None, None)


def _holds_another(model: mujoco.MjModel, keyframe: int) -> bool:
    """Whether position servos would hold another posture at a keyframe's controls than the keyframe's own."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, keyframe)
    mujoco.mj_forward(model, data)
    offset, stiffness = model.actuator_biasprm[:, 0], -model.actuator_biasprm[:, 1]
    rest = model.actuator_gainprm[:, 0] * data.ctrl + offset - stiffness * data.actuator_length
    return bool(np.any(np.abs(rest) > _SAME * stiffness, where=stiffness > 0.0))


def _set_joints(model: mujoco.MjModel, qpos: NDArray[np.float64], home: Mapping[str, float]) -> None:
    """Set hinges and slides in ``qpos`` ``(nq,)`` by name."""
    joints = {model.joint(j).name: j for j in range(model.njnt) if model.jnt_type[j] in _SCALAR}
    for name, value in home.items():
        joint = joints[as_choice("joint of the home posture", name, joints)]
        position = float(as_floats(f"home position of joint {name!r}", value, ()))
        low, high = model.jnt_range[joint]
        if model.jnt_limited[joint] and not low <= position <= high:
            raise InputError(f"home position {position:g} of joint {name!r} is outside of [{low:.4g}, {high:.4g}]")
        qpos[model.jnt_qposadr[joint]] = position
