"""The mechanism of a foreign model: in which posture it is taken, and which of its joints are the arm."""

from __future__ import annotations

import itertools

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.arm.importer.loading import compile_spec
from lieednn_sim.arm.importer.ranges import joint_ranges
from lieednn_sim.arm.importer.serial_chain import body_frame, cut, joint_groups, longest_chain, named_frames
from lieednn_sim.arm.importer.stages import find_couplings
from lieednn_sim.errors import InputError


def choose_posture(draft: Draft) -> None:
    """Compile the model as it came, and take the posture of a keyframe; `InputError` lists those there are."""
    model = draft.original = compile_spec(draft.spec)
    names = [model.key(k).name for k in range(model.nkey)]
    if draft.keyframe is None:
        if not names:
            draft.posture, draft.qpos = "the reference position", model.qpos0.copy()
            return
        k = names.index("home") if "home" in names else 0
    elif draft.keyframe in names:
        k = names.index(draft.keyframe)
    else:
        known = ", ".join(repr(name) for name in names if name) or "none"
        raise InputError(f"no keyframe {draft.keyframe!r}; keyframes of the model: {known}")
    draft.posture, draft.qpos = f"keyframe {names[k] or k!r}", model.key_qpos[k].copy()
    if not np.isfinite(draft.qpos).all():
        raise InputError(f"{draft.posture} holds NaN or infinite positions; correct it, or choose another")


def find_mechanism(draft: Draft) -> None:
    """Frames, joint groups, couplings and ranges of the arm, as named, as its sites say, or found.

    Raises:
        InputError: there is no such arm, several are as good, or coupled joints move different links.
    """
    model, links, base = draft.original, draft.links, draft.base
    if links is None and base is None:
        links, base = _frames_of_the_model(model)
    if links is not None:
        draft.frames = named_frames(model, links, base)
    else:
        inner, tip = longest_chain(model, base)
        draft.frames = (inner, body_frame(model, tip))
    draft.groups = joint_groups(model, draft.frames)
    draft.couplings = find_couplings(model, draft.joints)
    draft.ranges = joint_ranges(model, draft.joints, draft.couplings, draft.notes)
    if links is None:
        data = mujoco.MjData(model)
        data.qpos[:] = draft.qpos
        mujoco.mj_kinematics(model, data)
        draft.groups = cut(model, data, draft.joints, draft.ranges, draft.couplings)
        draft.frames = (inner, *(body_frame(model, int(model.jnt_bodyid[group[-1]])) for group in draft.groups))
    link = {joint: i for i, group in enumerate(draft.groups, start=1) for joint in group}
    for follower, (leader, _, _) in draft.couplings.lines.items():
        if link[follower] != link[leader]:
            raise InputError(
                f"joint {model.joint(follower).name!r} moves link {link[follower]} and follows joint "
                f"{model.joint(leader).name!r}, which moves link {link[leader]}; "
                "choose links so that coupled joints move the same link"
            )
    if len(draft.groups) == 1:
        draft.notes.append("the arm is one link; networks of a single neuron are hard to certify: name more links")


def _frames_of_the_model(model: mujoco.MjModel) -> tuple[tuple[str, ...] | None, str | None]:
    """The sites of a model that has this package's conventions already."""
    sites = {model.site(i).name for i in range(model.nsite)}
    links = tuple(itertools.takewhile(sites.__contains__, (f"link{i}_frame" for i in itertools.count(1))))
    return (links, "base_frame") if links and "base_frame" in sites else (None, None)
