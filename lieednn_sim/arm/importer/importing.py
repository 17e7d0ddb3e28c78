"""`import_arm`, and its steps in order."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypedDict

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.actuators import add_servos, design_servos, read_actuators, stabilise
from lieednn_sim.arm.importer.checks import (
    check_kinematics,
    look_at_home,
    look_at_straight_paths,
    look_for_half_turns,
    look_for_shapes,
    look_for_singular_links,
)
from lieednn_sim.arm.importer.configurations import add_keyframes, draw_configurations
from lieednn_sim.arm.importer.conventions import (
    add_frames,
    compensate_gravity,
    mend_inertias,
    replace_integrator,
    set_length_unit,
    set_ranges,
    tie_stages,
)
from lieednn_sim.arm.importer.draft import Draft, ImportReport
from lieednn_sim.arm.importer.floor import AUTO, add_floor, as_floor
from lieednn_sim.arm.importer.limits import (
    check_rates,
    drop_old_limits,
    limit_accelerations,
    limit_as_asked,
    limit_velocities,
)
from lieednn_sim.arm.importer.loading import load_spec
from lieednn_sim.arm.importer.locking import lock_other_joints
from lieednn_sim.arm.importer.mechanism import choose_configuration, find_mechanism
from lieednn_sim.arm.importer.overlaps import ignore_overlaps
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice

# What is done with the position servos of a model.
SERVOS = ("keep", "design")

STEPS: tuple[Callable[[Draft], None], ...] = (
    mend_inertias,
    replace_integrator,
    choose_configuration,
    find_mechanism,
    lock_other_joints,
    add_frames,
    tie_stages,
    set_ranges,
    compensate_gravity,
    drop_old_limits,
    draw_configurations,
    read_actuators,
    ignore_overlaps,
    set_length_unit,
    design_servos,
    limit_velocities,
    limit_accelerations,
    limit_as_asked,
    stabilise,
    add_servos,
    add_floor,
    add_keyframes,
    check_kinematics,
    look_for_half_turns,
    look_for_shapes,
    look_at_home,
    look_at_straight_paths,
    look_for_singular_links,
)


class ImportOptions(TypedDict, total=False):
    """The options of `import_arm`, for functions that pass them on."""

    links: Sequence[str] | None
    joints: Sequence[str] | None
    tip: str | None
    base: str | None
    keyframe: str | None
    home: Mapping[str, float] | None
    limits: Mapping[str, Mapping[str, float]] | None
    servos: str
    floor: float | str


def import_arm(
    model: str | os.PathLike[str] | mujoco.MjSpec,
    *,
    links: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    tip: str | None = None,
    base: str | None = None,
    keyframe: str | None = None,
    home: Mapping[str, float] | None = None,
    limits: Mapping[str, Mapping[str, float]] | None = None,
    servos: str = "keep",
    floor: float | str = AUTO,
) -> tuple[mujoco.MjSpec, ImportReport]:
    """Turn an MJCF or URDF model with a serial chain into an arm.

    The arm has sites at its link frames and one servo for each coordinate; all other joints are locked.

    Without ``links`` and ``joints`` the link frames are the model's own sites base_frame, link1_frame, ..., if it has
    them; otherwise the arm is the chain with the most driven joints (`serial_chain.longest_chain`). A chain is cut into
    compound joints (`compound_joints.cut`), with its link frames at the origins of the bodies behind the cuts.

    Coupled stages count as one coordinate; a fixed tendon that drives several stages becomes equalities between them,
    and soft equalities become as stiff as belts. Plain position servos keep their gains; other actuators are replaced
    by critically damped servos of 20 Hz on the largest inertia M_ii of a few configurations, slower where coupled
    stages could not follow. Force limits of actuators limit accelerations (`limits.limit_accelerations`); a URDF's
    efforts and velocities are limits too. Gravity compensation is switched on where no body of the arm has any, because
    position servos would sag. Tubes of a telescope, and other parts that overlap by design, don't collide with each
    other, and home is moved away from other self-collisions (`overlaps.ignore_overlaps`). Hinges that share a link with
    other joints are kept within 0.99 pi of their reference, where the logarithm is unique.

    Args:
        model: an MJCF or URDF file, or a `mujoco.MjSpec`, which is not changed.
        links: names of bodies or sites, from the base outwards; the frame of a body is at its origin.
        joints: names of the arm's joints, instead of its links, which are then found. Joints that equalities tie to
            them are the arm's too; all others are locked.
        tip: body or site of the end effector's frame, beyond the last joint, where no links are named. Default: the
            body that the last joint moves.
        base: body or site of the base frame. Default: the parent of the first moving body of link 1.
        keyframe: configuration of the locked joints, and of the new keyframe ``home``, which stays 5 % of each range
            away from the limits. Default: ``home``, else the first keyframe, else the reference position. Keyframes
            without positions, and with controls for another configuration, don't count.
        home: positions of joints by name [rad, m] that replace those of the keyframe; for a URDF, which has none.
        limits: ``velocity``, ``acceleration`` and ``jerk`` of coordinates by name [rad or m, s]; they take precedence
            over the model's.
        servos: ``"keep"`` the model's position servos, or ``"design"`` all of them anew.
        floor: height of the floor [m], or ``"none"``. Default, ``"auto"``: the model's own plane, else one at the
            height of the base, and none if the robot reaches below its base at home.

    Returns:
        A spec for `Arm.from_spec`, and the report.

    Raises:
        FileError: the file or one of its meshes is missing, or MuJoCo cannot compile it.
        InputError: the names or the mechanism don't make an arm; the message says why.
    """
    as_choice("choice of servos", servos, SERVOS)
    if links is not None and not links:
        raise InputError("links must name at least one body or site, from the base outwards")
    if joints is not None and not joints:
        raise InputError("joints must name at least one joint")
    if links is not None and (joints is not None or tip is not None):
        raise InputError("name either the links, of which the last one is the tip, or the joints and the tip")
    check_rates(limits)
    height = as_floor(floor)
    notes: list[str] = []
    spec = load_spec(model, notes)
    source = None if isinstance(model, mujoco.MjSpec) else Path(model)
    draft = Draft(
        spec,
        source,
        None if links is None else tuple(links),
        None if joints is None else tuple(joints),
        tip,
        base,
        keyframe,
        home or {},
        limits or {},
        servos,
        height,
        notes,
    )
    for step in STEPS:
        step(draft)
    return draft.spec, draft.report()
