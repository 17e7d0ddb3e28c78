"""Ranges of the joints of a chain, within what the joints that follow them and the logarithm allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lieednn_sim._mujoco import mujoco, scratch_data
from lieednn_sim.arm.checks import BALL, SLIDE, joint_kind
from lieednn_sim.arm.compound_joints import Couplings
from lieednn_sim.arm.coordinates import Coordinates
from lieednn_sim.arm.equalities import joint_range
from lieednn_sim.arm.forces import affine_actuators, constant_moments, control_ranges, tangent_basis
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats

_WIDEST = 0.99 * np.pi  # the logarithm of a rotation is unique below pi
_DEFAULT = 0.95 * np.pi  # largest angle from the reference of a hinge or ball joint without a range
_ENDLESS = 1e3  # half a range from which on it counts as none [rad, m]


def drop_endless_ranges(model: mujoco.MjModel, notes: list[str]) -> None:
    """Make hinges and slides unlimited whose ranges have no ends, as some tools write continuous joints."""
    low, high = model.jnt_range.T
    for joint in np.flatnonzero((model.jnt_limited != 0) & (low <= -_ENDLESS) & (high >= _ENDLESS)).tolist():
        model.jnt_limited[joint] = 0
        notes.append(f"{model.joint(joint).name}: range [{low[joint]:g}, {high[joint]:g}] taken for none")


def joint_ranges(
    model: mujoco.MjModel,
    groups: Sequence[Sequence[int]],
    couplings: Couplings,
    notes: list[str],
    around: Floats,
    within: Mapping[int, Floats],
) -> dict[int, Floats]:
    """The range ``(2,)`` [rad, m] of each joint of links' ``groups``; new and narrowed ones are added to ``notes``.

    A coordinate may move as far as all joints that it moves allow. A hinge alone in its link keeps its range, whatever
    it is; without one it may make a turn in each direction from the positions ``around`` ``(nq,)``. Other hinges, and
    ball joints, are narrowed to 0.99 pi, where the logarithm is still unique; without a range they get 0.95 pi to
    either side of their reference. ``within`` are further bounds ``(2,)`` of some joints, from joints elsewhere that
    follow them. `InputError` if a slide has no range, or nothing is left of a range.
    """
    joints = [joint for group in groups for joint in group]
    spans = {joint: _span(model, joint, notes, around, alone=len(group) == 1) for group in groups for joint in group}
    for joint, (low, high) in within.items():
        spans[joint] = np.array([max(spans[joint][0], low), min(spans[joint][1], high)])
    for lead in dict.fromkeys(couplings.line(joint)[0] for joint in joints):
        members = [joint for joint in joints if couplings.line(joint)[0] == lead]
        low, high = -np.inf, np.inf
        for joint in members:
            _, ratio, shift = couplings.line(joint)
            bounds = np.sort((spans[joint] - shift) / ratio)
            low, high = max(low, bounds[0]), min(high, bounds[1])
        name = model.joint(lead).name
        if not np.isfinite([low, high]).all():
            raise InputError(
                f'{joint_kind(model, lead)} {name!r} has no range; give it one, in MJCF by range="0 0.5", in a URDF by '
                '<limit lower="0" upper="0.5"/>, or leave it out of the arm\'s joints (joints=[...], --joints ...)'
            )
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


def narrow_to_servos(
    model: mujoco.MjModel, qpos: Floats, space: Coordinates, limits: Floats, notes: list[str]
) -> Floats:
    """The limits ``(n, 2)`` of the coordinates within which position servos can hold them.

    Without a load a servo rests at the length l at which g ctrl + b0 + b1 l = 0, with the control in its range. Only
    servos count that act on a single coordinate, on which nothing else acts, evaluated at ``qpos`` ``(nq,)``.
    `InputError` if nothing is left of a range.
    """
    rates, q, held = constant_moments(model) @ tangent_basis(space), space.from_qpos(qpos), limits.copy()
    data = scratch_data(model)
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    gain, (constant, stiffness) = model.actuator_gainprm[:, 0], model.actuator_biasprm[:, :2].T
    servos = affine_actuators(model) & (stiffness * gain < 0.0)
    servos &= model.actuator_dyntype != int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
    acts = np.abs(rates) > 1e-9
    for a in np.flatnonzero(servos & (acts.sum(axis=1) == 1)).tolist():
        k = int(acts[a].argmax())
        if k in space.scalars and acts[:, k].sum() == 1:
            lengths = -(gain[a] * control_ranges(model)[a] + constant[a]) / stiffness[a]
            low, high = np.sort(q[k] + (lengths - data.actuator_length[a]) / rates[a, k])
            held[k] = max(low, held[k, 0]), min(high, held[k, 1])
    narrower = ~np.isclose(held, limits, rtol=0.0, atol=1e-3)  # beyond the rounding in a file, such as 6.2831 for 2 pi
    for k in np.flatnonzero(narrower.any(axis=1)).tolist():
        name, before, after = space.names[k], *("[{:.4g}, {:.4g}]".format(*span[k]) for span in (limits, held))
        if held[k, 0] >= held[k, 1]:
            raise InputError(f"by its ctrlrange the servo of {name!r} holds it nowhere in {before}; correct one")
        notes.append(f"{name}: range {before} narrowed to {after}, where its servo can hold it by its ctrlrange")
    return np.where(narrower, held, limits)


def _span(model: mujoco.MjModel, joint: int, notes: list[str], around: Floats, *, alone: bool) -> Floats:
    name, kind = model.joint(joint).name, int(model.jnt_type[joint])
    given = joint_range(model, joint) if model.jnt_limited[joint] else np.array([-np.inf, np.inf])
    if kind == SLIDE:
        return given
    if kind == BALL:
        widest = given[1] if model.jnt_limited[joint] else _DEFAULT
        span = np.array([0.0, min(widest, _WIDEST)])
    elif alone:
        turns = around[model.jnt_qposadr[joint]] + 2.0 * np.pi * np.array([-1.0, 1.0])
        span = given if model.jnt_limited[joint] else turns
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
