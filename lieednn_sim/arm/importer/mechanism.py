"""The mechanism of a foreign model: its configuration at import, which of its joints are the arm, and their ranges."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.checks import ancestry
from lieednn_sim.arm.frames import Frame, body_frame, find_frame
from lieednn_sim.arm.importer.compound_joints import cut
from lieednn_sim.arm.importer.coupled_joints import Couplings, find_couplings
from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.arm.importer.loading import compile_spec
from lieednn_sim.arm.importer.serial_chain import (
    is_gripper,
    joint_groups,
    longest_chain,
    named_chain,
    named_frames,
)
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice, as_floats, quoted
from lieednn_sim.values import Floats

_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_BALL, _SLIDE = int(mujoco.mjtJoint.mjJNT_BALL), int(mujoco.mjtJoint.mjJNT_SLIDE)
_WIDEST = 0.99 * np.pi  # the logarithm of a rotation is unique below pi
_TOOL = re.compile(r"tcp|tool|(^|_)ee($|_)|end.?effector|flange|grasp|pinch|attachment", re.IGNORECASE)
_DEFAULT = 0.95 * np.pi  # of a hinge or ball joint without a range


def choose_configuration(draft: Draft) -> None:
    """Compile the model; take the configuration of a keyframe or the reference, with the given joint positions.

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
            "configuration, and no positions; name another keyframe, or give the positions of joints at home"
        )
    choice = {names[k]: k for k in reversed(draft.keyframes)}
    if draft.keyframe is not None and draft.keyframe not in choice:
        why = " with positions" if draft.keyframe in names else ""
        known = ", ".join(map(repr, reversed(choice))) or "none"
        raise InputError(f"no keyframe {quoted(draft.keyframe)}{why}; keyframes of the model: {known}")
    if choice:
        name = draft.keyframe or ("home" if "home" in choice else names[draft.keyframes[0]])
        draft.configuration, draft.qpos = f"keyframe {name!r}", model.key_qpos[choice[name]].copy()
        if not np.isfinite(draft.qpos).all():
            raise InputError(f"{draft.configuration} holds NaN or infinite positions; correct it, or choose another")
    else:
        draft.configuration, draft.qpos = "the reference position", model.qpos0.copy()
    if draft.home:
        draft.configuration += f", with {', '.join(map(str, draft.home))} as given"
        _set_joints(model, draft.qpos, draft.home)


def find_mechanism(draft: Draft) -> None:
    """Find the arm's frames, joint groups, couplings and ranges, from the given names, its sites, or its longest chain.

    Raises:
        InputError: there is no such arm, the choice is ambiguous, or coupled joints move different links.
    """
    model, links, base = draft.original, draft.links, draft.base
    if links is None and base is None and draft.chosen is None and draft.tip is None:
        links, base = _frames_of_the_model(model)
    if links is not None:
        draft.frames = named_frames(model, links, base)
        draft.groups = joint_groups(model, draft.frames)
        draft.couplings = find_couplings(model, draft.joints)
    else:
        inner, chain = _chain(draft, base)
        draft.couplings = find_couplings(model, chain)
        data = kinematics_at(model, draft.qpos)
        whole = joint_ranges(model, [[joint] for joint in chain], draft.couplings, [])
        draft.groups = cut(model, data, chain, whole, draft.couplings)
        draft.frames = (inner, *(body_frame(model, int(model.jnt_bodyid[group[-1]])) for group in draft.groups))
        if draft.tip is not None:
            draft.frames = (*draft.frames[:-1], tip_frame(model, draft.tip, draft.frames[-1]))
        elif tools := _tools(model, draft.frames[-1].body):
            draft.notes.append(
                f"the end effector is {draft.frames[-1].name!r}; tip={tools[0]!r} (--tip) would choose that, of the "
                f"frames named like a tool: {', '.join(tools)}"
            )
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
                f"joint {model.joint(follower).name!r} of the home configuration follows joint "
                f"{model.joint(leader).name!r}; give the position of that one"
            )
    if len(draft.groups) == 1:
        draft.notes.append("the arm is one link; networks of a single neuron are hard to certify: name more links")


def _chain(draft: Draft, base: str | None) -> tuple[Frame, tuple[int, ...]]:
    """Base frame and joints of an arm without named links: the joints that are named, or the longest chain."""
    model = draft.original
    if draft.chosen is not None:
        return named_chain(model, draft.chosen, base)
    inner, tip = longest_chain(model, base)
    behind = (joint for joint in range(model.njnt) if model.body_parentid[model.jnt_bodyid[joint]] == tip)
    if hands := [model.joint(joint).name for joint in behind if is_gripper(model, joint)]:
        draft.notes.append(f"taken for a gripper, and locked: {', '.join(hands)}; name the links to move it")
    (chain,) = joint_groups(model, (inner, body_frame(model, tip)))
    return inner, chain


def tip_frame(model: mujoco.MjModel, name: str, last: Frame) -> Frame:
    """The frame of the end effector by its name, on the last link or beyond it."""
    tip = find_frame(model, name)
    if last.body not in ancestry(model, tip.body):
        raise InputError(f"the tip {name!r} is not carried by the last link, {last.name!r}")
    return tip


def _tools(model: mujoco.MjModel, last: int) -> list[str]:
    """Names of the bodies and sites that are fixed to the last link and named like a tool."""
    fixed = np.flatnonzero(model.body_weldid == model.body_weldid[last])
    names = [model.body(body).name for body in fixed if body != last]
    names += [model.site(site).name for site in np.flatnonzero(np.isin(model.site_bodyid, fixed))]
    return [name for name in names if _TOOL.search(name)]


def _frames_of_the_model(model: mujoco.MjModel) -> tuple[tuple[str, ...] | None, str | None]:
    """The sites of a model that has this package's conventions already."""
    sites = {model.site(i).name for i in range(model.nsite)}
    links = tuple(itertools.takewhile(sites.__contains__, (f"link{i}_frame" for i in itertools.count(1))))
    return (links, "base_frame") if links and "base_frame" in sites else (None, None)


def _holds_another(model: mujoco.MjModel, keyframe: int) -> bool:
    """Whether position servos would hold another configuration at a keyframe's controls than the keyframe's own."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, keyframe)
    mujoco.mj_forward(model, data)
    offset, stiffness = model.actuator_biasprm[:, 0], -model.actuator_biasprm[:, 1]
    rest = model.actuator_gainprm[:, 0] * data.ctrl + offset - stiffness * data.actuator_length
    same = 1e-3  # controls this close to a position hold it [rad, m]
    return bool(np.any(np.abs(rest) > same * stiffness, where=stiffness > 0.0))


def _set_joints(model: mujoco.MjModel, qpos: NDArray[np.float64], home: Mapping[str, float]) -> None:
    """Set hinges and slides in ``qpos`` ``(nq,)`` by name."""
    joints = {model.joint(j).name: j for j in range(model.njnt) if model.jnt_type[j] in _SCALAR}
    for name, value in home.items():
        joint = joints[as_choice("joint of the home configuration", name, joints)]
        position = float(as_floats(f"home position of joint {name!r}", value, ()))
        low, high = model.jnt_range[joint]
        if model.jnt_limited[joint] and not low <= position <= high:
            raise InputError(f"home position {position:g} of joint {name!r} is outside of [{low:.4g}, {high:.4g}]")
        qpos[model.jnt_qposadr[joint]] = position


def joint_ranges(
    model: mujoco.MjModel,
    groups: Sequence[Sequence[int]],
    couplings: Couplings,
    notes: list[str],
    around: Floats | None = None,
    within: Mapping[int, Floats] | None = None,
) -> dict[int, Floats]:
    """The range ``(2,)`` [rad, m] of each joint; new and narrowed ranges are added to ``notes``.

    A coordinate may move as far as all the joints that it moves. A hinge or ball joint without a range gets 0.95 pi
    either side of its reference. A hinge alone in its link keeps its range, whatever it is; other hinges, and ball
    joints, are narrowed to 0.99 pi, where the logarithm is still unique.

    Args:
        model: the model as given.
        groups: for each link, the joints that move it.
        couplings: joints that follow others.
        notes: remarks for the report.
        around: positions ``(nq,)`` about which hinges without a range may make a turn in each direction.
        within: ranges ``(2,)`` that bound some joints besides, of joints elsewhere that follow them.

    Raises:
        InputError: a slide has no range, or nothing is left of a range.
    """
    joints = [joint for group in groups for joint in group]
    spans = {joint: _span(model, joint, notes, around, alone=len(group) == 1) for group in groups for joint in group}
    for joint, (low, high) in (within or {}).items():
        spans[joint] = np.array([max(spans[joint][0], low), min(spans[joint][1], high)])
    for lead in dict.fromkeys(couplings.leader(joint) for joint in joints):
        members = [joint for joint in joints if couplings.leader(joint) == lead]
        if members == [lead] and (within is None or lead not in within) and np.isfinite(spans[lead]).all():
            continue
        low, high = -np.inf, np.inf
        for joint in members:
            _, ratio, shift = couplings.lines.get(joint, (lead, 1.0, 0.0))
            bounds = np.sort((spans[joint] - shift) / ratio)
            low, high = max(low, bounds[0]), min(high, bounds[1])
        name = model.joint(lead).name
        if not np.isfinite([low, high]).all():
            raise InputError(f'slide {name!r} has no range; give it one, such as range="0 0.5" [m]')
        if low >= high:
            raise InputError(f"nothing is left of the range of {name!r} and the joints that follow it; correct them")
        own = spans[lead]
        if np.isfinite(own).all() and (low > own[0] + 1e-9 or high < own[1] - 1e-9):
            notes.append(f"{name}: range narrowed to [{low:.4g}, {high:.4g}] by the joints that follow it")
        spans[lead] = np.array([low, high])
        for joint in members:
            if not np.isfinite(spans[joint]).all():
                _, ratio, shift = couplings.lines[joint]
                spans[joint] = np.sort(ratio * spans[lead] + shift)
    return spans


def _span(model: mujoco.MjModel, joint: int, notes: list[str], around: Floats | None, *, alone: bool) -> Floats:
    name, kind = model.joint(joint).name, int(model.jnt_type[joint])
    given = model.jnt_range[joint].copy() if model.jnt_limited[joint] else np.array([-np.inf, np.inf])
    if kind == _SLIDE:
        return given
    if kind == _BALL:
        widest = given[1] if model.jnt_limited[joint] else _DEFAULT
        span = np.array([0.0, min(widest, _WIDEST)])
    elif alone and model.jnt_limited[joint]:
        return given
    elif alone and around is not None:
        return around[model.jnt_qposadr[joint]] + 2.0 * np.pi * np.array([-1.0, 1.0])
    else:
        reference = float(model.qpos0[model.jnt_qposadr[joint]])
        most = _WIDEST if model.jnt_limited[joint] else _DEFAULT
        span = np.clip(given, reference - most, reference + most)
        if span[0] >= span[1]:
            raise InputError(
                f"hinge {name!r} with range [{given[0]:.4g}, {given[1]:.4g}] rad never comes within pi of its "
                f"reference {reference:.4g}; give it a ref inside its range"
            )
    if not model.jnt_limited[joint]:
        notes.append(f"{name}: had no range and got [{span[0]:.4g}, {span[1]:.4g}] rad")
    elif not np.array_equal(span, given):
        notes.append(f"{name}: range [{given[0]:.4g}, {given[1]:.4g}] narrowed to [{span[0]:.4g}, {span[1]:.4g}] rad")
    return span
