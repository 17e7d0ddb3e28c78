"""Checks of an imported model: kinematics, sag, contacts, turns near pi, singular links."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import scipy

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE, ContactFinder, colliding_geoms, moving_geoms
from lieednn_sim.arm.forces import dry_friction, resting_load
from lieednn_sim.arm.importer.configurations import random_coordinates
from lieednn_sim.arm.importer.conventions import length_unit
from lieednn_sim.arm.importer.draft import Draft, stacked
from lieednn_sim.arm.importer.locking import pose
from lieednn_sim.arm.kinematics import least_singular_value
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats

_SAG = 3e-4  # worth a remark [rad, m]: over a few joints, a millimetre at an arm's length
_PATHS, _LOOKS = 256, 20  # straight paths, and configurations on each
_SHOWN = 24  # pairs of bodies in a remark
# Least singular value of a link's screws, of unit size, at which its pose still determines its joints. By the same
# measure paths begin to be straightened at the larger `singularities.NEARLY_SINGULAR`; the gap that this leaves is
# worth a remark here.
_SINGULAR = 0.1
_SLOW = 5.0  # worth a remark [Hz]
_DESIGN = "servos='design' designs a new one"


def check_kinematics(draft: Draft) -> None:
    """Compare the link frames of both models at a few configurations; `InputError` if they differ by more than 1e-9."""
    original, model, frames = draft.original, draft.model, draft.frames
    bodies, sites = [frame.body for frame in frames], _frame_sites(model, len(frames))
    fixed = pose(np.array([frame.pos for frame in frames]), np.array([frame.quat for frame in frames]))
    before, after = mujoco.MjData(original), mujoco.MjData(model)
    samples = stacked(draft.samples[:8])
    configurations = draft.place(original, samples, draft.qpos), draft.place(model, samples, model.qpos0)
    for before.qpos[:], after.qpos[:] in zip(*configurations, strict=True):
        mujoco.mj_kinematics(original, before)
        mujoco.mj_kinematics(model, after)
        expected = pose(before.xpos[bodies], before.xquat[bodies]) * fixed
        rotations = scipy.spatial.transform.Rotation.from_matrix(after.site_xmat[sites].reshape(-1, 3, 3))
        result = scipy.spatial.transform.RigidTransform.from_components(after.site_xpos[sites], rotations)
        same = np.isclose(expected.as_matrix(), result.as_matrix(), rtol=0.0, atol=1e-9).all(axis=(-2, -1))
        if not same.all():
            raise InputError(
                f"the frame {frames[int(same.argmin())].name!r} moved while other joints were locked; the model uses a "
                "feature that cannot be carried over: remove the joints that are not the arm's by hand"
            )


def look_for_half_turns(draft: Draft) -> None:
    """Note the compound joints of several hinges that come near half a turn at one of the draft's configurations."""
    model, groups = draft.model, draft.groups
    configurations = [model.qpos0, *draft.place(model, stacked(draft.samples), model.qpos0)]
    frames = _frame_matrices(model, configurations, len(groups))
    inner, outer = (scipy.spatial.transform.Rotation.from_matrix(part) for part in (frames[:, :-1], frames[:, 1:]))
    relative = inner.inv() * outer
    turns = (relative[0].inv() * relative).magnitude().max(axis=0)
    draft.notes += [
        f"link {i} may turn by {turn:.3g} rad against link {i - 1}; the logarithm is unique below pi: name more links"
        for i, (group, turn) in enumerate(zip(groups, turns, strict=True), start=1)
        if len(group) > 1 and turn > 0.95 * np.pi
    ]


def look_for_shapes(draft: Draft) -> None:
    """Note an arm that cannot be seen, or cannot touch anything."""
    model = draft.model
    moving = moving_geoms(model)
    if not moving.any():
        draft.notes.append(
            "no moving body has a geom: the arm is invisible and touches nothing; of a URDF MuJoCo reads <collision>, "
            'and <visual> only with <mujoco><compiler discardvisual="false"/></mujoco> in <robot>'
        )
    elif not colliding_geoms(model)[moving].any():
        draft.notes.append("no geom of a moving body can collide: the arm passes through obstacles and through itself")


def look_at_home(draft: Draft) -> None:
    """Note the servos that sag, stick or are too weak at the keyframe ``home``, and the bodies that touch there."""
    model, notes = draft.model, draft.notes
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    loaded = 16  # configurations at which loads are computed
    elsewhere = draft.place(model, stacked(draft.samples[:loaded]), model.qpos0)
    at_home, *others = resting_load(model, np.array([data.qpos, *elsewhere]))
    loads = np.abs(others)
    frictions = dry_friction(model, draft.rates)
    for dof, servo, friction in zip(draft.dofs, draft.servos, frictions, strict=True):
        force = float(at_home @ dof.rates)
        if servo.frequency < _SLOW:
            slow = f"its servo is slow, {servo.frequency:.2g} Hz, and follows motions badly"
            notes.append(f"{servo.name}: {slow}{f'; {_DESIGN}' if servo.kept else ''}")
        helps = "the controller inverse-dynamics compensates for it" + (f", {_DESIGN}" if servo.kept else "")
        if friction / servo.kp > _SAG:
            notes.append(
                f"{servo.name}: dry friction of {friction:.3g} leaves it up to {friction / servo.kp:.2g} rad or m off; "
                + helps
            )
        low, high = servo.force_range
        if not low <= force <= high:
            notes.append(f"{servo.name}: needs {force:.4g} at home, more than its force limits allow")
        elif (most := float((loads @ np.abs(dof.rates)).max()) / servo.kp) > _SAG:
            sag = f"sags by {abs(force) / servo.kp:.2g} rad or m at home under its load, elsewhere up to {most:.2g}"
            notes.append(f"{servo.name}: {sag}; {helps}")
    for contact in data.contact[: data.ncon]:
        if contact.dist < 0.0:
            first, second = (model.body(model.geom_bodyid[geom]).name for geom in contact.geom)
            notes.append(f"bodies {first!r} and {second!r} touch at home")


def look_at_straight_paths(draft: Draft) -> None:
    """Note the bodies between which straight paths from home to random configurations come near contact."""
    finder, home = ContactFinder(draft.model, PLANNED_CLEARANCE), draft.samples[0]
    ends, between = Counter[str](), Counter[str]()
    blocked, touching, rng = 0, 0, np.random.default_rng(1)
    fractions = np.linspace(1.0, 0.0, _LOOKS, endpoint=False)
    for path in _straight_paths(draft, home, [random_coordinates(draft, rng) for _ in range(_PATHS)], fractions):
        for fraction, qpos in zip(fractions, path, strict=True):
            result = finder.bodies(qpos)
            if result:
                touching, blocked = touching + int(fraction == 1.0), blocked + int(fraction < 1.0)
                (ends if fraction == 1.0 else between).update({"{!r} and {!r}".format(*sorted(p)) for p in result})
                break
    for count, what, pairs, then in (
        (touching, f"{_PATHS} random configurations are", ends, "these cannot be targets"),
        (
            blocked,
            f"{_PATHS - touching} straight paths from home to the others come",
            between,
            "there planners fail that do not search for a way around, as lieednn-shaped and rrt-connect do",
        ),
    ):
        if count:
            # Sets have no order: ties are broken by name.
            most = sorted(pairs.items(), key=lambda item: (-item[1], item[0]))[:_SHOWN]
            shown = ", ".join(f"{pair} ({times})" for pair, times in most)
            draft.notes.append(
                f"{count} of {what} within {1e3 * PLANNED_CLEARANCE:g} mm of contact, between {shown}: {then}"
            )


def look_for_singular_links(draft: Draft) -> None:
    """Note the links of several joints whose pose does not determine the joints somewhere on a straight path."""
    model, data, home = draft.model, mujoco.MjData(draft.model), draft.samples[0]
    paths = _straight_paths(draft, home, draft.samples[1:], np.linspace(0.0, 1.0, _LOOKS + 1))
    sites, unit = _frame_sites(model, len(draft.frames)), length_unit(draft)
    independent = {draft.original.joint(joint).name for joint in draft.independent}
    groups = [[draft.original.joint(joint).name for joint in group] for group in draft.groups]
    for i, group in enumerate(groups, start=1):
        columns = [dof.rates for dof in draft.dofs if dof.joint in independent.intersection(group)]
        if len(columns) < 2:
            continue
        singular = 0
        for path in paths:
            screws = []
            for data.qpos[:] in path:
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                linear, angular = np.zeros((2, 3, model.nv))
                mujoco.mj_jacSite(model, data, linear, angular, sites[i])
                screws.append(np.concatenate([angular, linear / unit]) @ np.array(columns).T)
            singular += int(least_singular_value(np.array(screws)).min() < _SINGULAR)
        if singular:
            draft.notes.append(
                f"link {i}: {singular} of {len(paths)} straight paths from home pass near configurations at which "
                f"its pose does not determine {', '.join(group)}; networks, which lead an arm by poses, leave a "
                "gap there, or fail: name more links to avoid that"
            )


def _straight_paths(
    draft: Draft, start: dict[int, Floats], ends: Sequence[dict[int, Floats]], fractions: Floats
) -> Floats:
    """Configurations ``(E, S, nq)`` of the model at fractions ``(S,)`` of the straight paths to each of the ends."""
    last = stacked(ends)
    q = {joint: value + fractions[:, None] * (last[joint][:, None] - value) for joint, value in start.items()}
    return draft.place(draft.model, q, draft.model.qpos0)


def _frame_sites(model: mujoco.MjModel, count: int) -> list[int]:
    return [model.site(f"link{i}_frame" if i else "base_frame").id for i in range(count)]


def _frame_matrices(model: mujoco.MjModel, configurations: Sequence[Floats], links: int) -> Floats:
    """Rotation matrices of the base's and the links' frames at each of K configurations, ``(K, links + 1, 3, 3)``."""
    data = mujoco.MjData(model)
    sites = _frame_sites(model, links + 1)
    result = np.empty((len(configurations), links + 1, 9))
    for matrices, data.qpos[:] in zip(result, configurations, strict=True):
        mujoco.mj_kinematics(model, data)
        matrices[:] = data.site_xmat[sites]
    return result.reshape(-1, links + 1, 3, 3)
