"""Bring your own arm: any MJCF with a serial chain of hinge, slide and ball joints, made into one that `Arm` reads."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.accelerations import set_acceleration_limits
from lieednn_sim.arm.importer.checks import (
    check_kinematics,
    random_samples,
    remarks_at_home,
    remarks_on_turns,
    stabilise,
)
from lieednn_sim.arm.importer.freezing import freeze
from lieednn_sim.arm.importer.nesting import ignore_nested
from lieednn_sim.arm.importer.ranges import coordinates_inside, extremes, joint_ranges, place
from lieednn_sim.arm.importer.serial_chain import Frame, body_frame, cut, joint_groups, longest_chain, named_frames
from lieednn_sim.arm.importer.servos import Freedom, Servo, add_servo, design, read_drive
from lieednn_sim.arm.importer.softening import soften
from lieednn_sim.arm.importer.spec import (
    add_coupling,
    add_frames,
    add_keyframe,
    compensate_gravity,
    compile_spec,
    drop_old_limits,
    load_spec,
    replace_integrator,
    set_range,
    stiffen_couplings,
)
from lieednn_sim.arm.importer.stages import Coupling, Couplings, find_couplings
from lieednn_sim.arm.importer.units import set_length_unit
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice

Floats = NDArray[np.float64]

# What becomes of the position servos that a model has.
SERVOS = ("keep", "design")


@dataclass(frozen=True)
class Adoption:
    """What `adopt` made of a model.

    Attributes:
        posture: the keyframe that the frozen joints and the new keyframe ``home`` were taken from.
        base: name of the body or site of the base frame.
        links: names of those of the link frames.
        groups: of each link the joints of its compound joint, from the base outwards.
        couplings: joints that follow others.
        frozen: joints that were removed, their bodies left where the posture has them.
        servos: the position servo of each independent coordinate.
        notes: everything else that was decided, and what to look at.
    """

    posture: str
    base: str
    links: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    couplings: tuple[Coupling, ...]
    frozen: tuple[str, ...]
    servos: tuple[Servo, ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """Return the report as lines of text."""
        lines = [f"posture: {self.posture}", f"base: {self.base}"]
        for i, (link, group) in enumerate(zip(self.links, self.groups, strict=True), start=1):
            lines.append(f"link {i}: {link}, moved by {', '.join(group)}")
        for title, entries in (("coupled", self.couplings), ("servo", self.servos), ("note", self.notes)):
            lines += [f"{title}: {entry}" for entry in entries]
        lines.append(f"frozen: {', '.join(self.frozen) or 'none'}")
        return "\n".join(lines)


def adopt(
    model: str | os.PathLike[str] | Any,
    *,
    links: Sequence[str] | None = None,
    base: str | None = None,
    keyframe: str | None = None,
    servos: str = "keep",
) -> tuple[Any, Adoption]:
    """Make a model into an arm: sites at the link frames, one servo per coordinate, all else frozen.

    Without ``links`` the link frames are the model's own sites base_frame, link1_frame, ..., if it has them, else
    the arm is the chain with the most driven joints (`serial_chain.longest_chain`), cut by the rule
    of `serial_chain.cut`, its link frames the origins of the bodies behind the cuts. Every joint off the arm is frozen.
    Coupled stages count as one coordinate; a fixed tendon that drives several stages becomes equalities between them,
    and soft equalities become stiff, as belts are.
    Plain position servos keep their gains; other drives are replaced by servos of 20 Hz, critically damped, on the
    largest inertia M_ii of a few postures, slower where coupled stages could not keep up. Where drives have force
    limits, accelerations get limits (`accelerations.set_acceleration_limits`). Gravity compensation is switched on
    where no body of the arm has any, because a position servo would sag. Tubes of a telescope, and what else overlaps
    in the robot at home, don't collide with each other (`nesting.ignore_nested`). Hinges are held within 0.99 pi of
    their reference, where the logarithm is unique.

    Args:
        model: an MJCF or URDF file, or a `mujoco.MjSpec`, which is not changed.
        links: bodies or sites, in order from the base outwards; the frame of a body is its origin.
        base: body or site of the base frame. Default: the body that carries the first moving body of link 1.
        keyframe: posture of the frozen joints, and of the new keyframe ``home``, which keeps 5 % of each range off
            the limits. Default: ``home``, else the first keyframe, else the reference position.
        servos: ``"keep"`` the position servos of the model, or ``"design"`` all anew.

    Returns:
        A `mujoco.MjSpec` for `Arm.from_spec`, and the report.

    Raises:
        FileError: the file or one of its meshes is missing, or MuJoCo cannot compile it.
        InputError: the names or the mechanism don't make an arm; the message says why.
    """
    as_choice("choice of servos", servos, SERVOS)
    spec = load_spec(model)
    notes: list[str] = []
    replace_integrator(spec, notes)
    original = compile_spec(spec)
    posture, qpos = _posture(original, keyframe)
    frames, groups, couplings, ranges = _mechanism(original, qpos, *_checked(links, base), notes)
    joints = [joint for group in groups for joint in group]
    independent = [joint for joint in joints if joint not in couplings.lines]
    if len(groups) == 1:
        notes.append("the arm is one link; networks of a single neuron are hard to certify: name more links")

    frozen, remarks = freeze(spec, original, qpos, set(joints))
    notes += remarks
    add_frames(spec, original, frames, notes)
    for joint in couplings.added:
        add_coupling(spec, original, couplings, joint)
    stiffen_couplings(spec, original, couplings, notes)
    for joint in joints:
        set_range(spec.joint(original.joint(joint).name), ranges[joint])
    compensate_gravity(spec, original, joints, notes)
    bare = compile_spec(spec)
    given, here = (_freedoms(original, m, independent, couplings, ranges) for m in (original, bare))
    drop_old_limits(spec, len(here), notes)

    def posture_of(q: dict[int, Floats]) -> Floats:
        return place(bare, original, q, couplings, bare.qpos0)

    home, moved = coordinates_inside(original, joints, couplings, ranges, qpos)
    notes += [f"{name}: moved off its limits in the keyframe 'home'" for name in moved]
    drives = [read_drive(original, given, k) for k in range(len(given))]
    if servos == "design":
        drives = [replace(drive, gains=None, remark=drive.remark or "as asked for") for drive in drives]
    for remark in dict.fromkeys(drive.remark for drive in drives if drive.remark):
        affected = [freedom.name for freedom, drive in zip(here, drives, strict=True) if drive.remark == remark]
        notes.append(f"new servos for {', '.join(affected)}: {remark}")
    samples = [home, *random_samples(original, joints, couplings, ranges, 64)]
    everywhere = [posture_of(q) for q in (*samples, *extremes(original, home, ranges))]
    notes += ignore_nested(spec, original, bare, posture_of(home), everywhere)
    notes += set_length_unit(spec, bare, everywhere)
    designed = design(bare, [posture_of(q) for q in samples[:16]], here, drives)
    notes += set_acceleration_limits(spec, bare, [posture_of(q) for q in samples[:16]], here, designed)
    stabilise(spec, bare, [posture_of(q) for q in samples[:8]], here, designed, notes)
    names = [add_servo(spec, freedom, servo) for freedom, servo in zip(here, designed, strict=True)]
    designed = soften(spec, posture_of(home), here, designed, names)
    keyframes = {"home": home}
    for k in range(original.nkey):
        if not np.isfinite(original.key_qpos[k]).all():
            continue
        inside, _ = coordinates_inside(original, joints, couplings, ranges, original.key_qpos[k])
        keyframes.setdefault(original.key(k).name or f"key{k}", inside)
    for name, q in keyframes.items():
        add_keyframe(spec, name, posture_of(q), np.concatenate([q[joint] for joint in independent]))
    adopted = compile_spec(spec)

    check_kinematics(original, adopted, qpos, frames, samples[:8], couplings)
    notes += remarks_on_turns(adopted, original, groups, samples, couplings)
    notes += remarks_at_home(adopted, here, designed)
    return spec, Adoption(
        posture=posture,
        base=frames[0].name,
        links=tuple(frame.name for frame in frames[1:]),
        groups=tuple(tuple(original.joint(joint).name for joint in group) for group in groups),
        couplings=couplings.named(original),
        frozen=tuple(frozen),
        servos=designed,
        notes=tuple(dict.fromkeys(notes)),
    )


def _checked(links: Sequence[str] | None, base: str | None) -> tuple[tuple[str, ...] | None, str | None]:
    if base is not None and not isinstance(base, str):
        raise InputError(f"base must be the name of a body or site, got {base!r}")
    if links is None:
        return None, base
    if isinstance(links, str) or not links or not all(isinstance(link, str) for link in links):
        raise InputError(f"links must be a list of names of bodies or sites, from the base outwards; got {links!r}")
    return tuple(links), base


def _posture(model: mujoco.MjModel, keyframe: str | None) -> tuple[str, Floats]:
    names = [model.key(k).name for k in range(model.nkey)]
    if keyframe is None:
        if not names:
            return "the reference position", model.qpos0.copy()
        k = names.index("home") if "home" in names else 0
    elif keyframe in names:
        k = names.index(keyframe)
    else:
        known = ", ".join(repr(name) for name in names if name) or "none"
        raise InputError(f"no keyframe {keyframe!r}; keyframes of the model: {known}")
    if not np.isfinite(model.key_qpos[k]).all():
        raise InputError(f"keyframe {names[k] or k!r} holds NaN or infinite positions; correct it, or choose another")
    return f"keyframe {names[k] or k!r}", model.key_qpos[k].copy()


def _mechanism(
    model: mujoco.MjModel, qpos: Floats, links: tuple[str, ...] | None, base: str | None, notes: list[str]
) -> tuple[tuple[Frame, ...], tuple[tuple[int, ...], ...], Couplings, dict[int, Floats]]:
    """Frames, joint groups, couplings and ranges of the arm, as named, as its sites say, or found."""
    if links is None and base is None:
        links, base = _frames_of_the_model(model)
    if links is not None:
        frames = named_frames(model, links, base)
        groups = joint_groups(model, frames)
    else:
        inner, tip = longest_chain(model, base)
        frames = (inner, body_frame(model, tip))
        groups = joint_groups(model, frames)
    joints = [joint for group in groups for joint in group]
    couplings = find_couplings(model, joints)
    ranges = joint_ranges(model, joints, couplings, notes)
    if links is None:
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        groups = cut(model, data, joints, ranges, couplings)
        frames = (inner, *(body_frame(model, int(model.jnt_bodyid[group[-1]])) for group in groups))
    home = {joint: i for i, group in enumerate(groups, start=1) for joint in group}
    for follower, (leader, _, _) in couplings.lines.items():
        if home[follower] != home[leader]:
            raise InputError(
                f"joint {model.joint(follower).name!r} moves link {home[follower]} and follows joint "
                f"{model.joint(leader).name!r}, which moves link {home[leader]}; "
                "choose links so that coupled joints move the same link"
            )
    return frames, groups, couplings, ranges


def _frames_of_the_model(model: mujoco.MjModel) -> tuple[tuple[str, ...] | None, str | None]:
    """The sites of a model that has this package's conventions already."""
    sites = {model.site(i).name for i in range(model.nsite)}
    links = tuple(itertools.takewhile(sites.__contains__, (f"link{i}_frame" for i in itertools.count(1))))
    return (links, "base_frame") if links and "base_frame" in sites else (None, None)


def _freedoms(
    source: mujoco.MjModel,
    model: mujoco.MjModel,
    independent: Sequence[int],
    couplings: Couplings,
    ranges: dict[int, Floats],
) -> list[Freedom]:
    """The coordinates of ``independent`` joints of ``source``, with their rates in ``model``."""
    freedoms = []
    for joint in independent:
        name, ball = source.joint(joint).name, source.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_BALL)
        followers = {f: ratio for f, (leader, ratio, _) in couplings.lines.items() if leader == joint}
        span = np.array([-1.0, 1.0]) * ranges[joint][1] if ball else ranges[joint]
        for axis in range(3 if ball else 1):
            rates = np.zeros(model.nv)
            for moved, ratio in {joint: 1.0, **followers}.items():
                rates[model.jnt_dofadr[model.joint(source.joint(moved).name).id] + axis] = ratio
            freedoms.append(Freedom(f"{name}_{'xyz'[axis]}" if ball else name, name, axis, rates, span))
    return freedoms
