"""Forces of a model's actuators on the coordinates of an arm, and the loads that they hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco, scratch_data
from lieednn_sim.arm.checks import SCALAR
from lieednn_sim.arm.coordinates import Coordinates
from lieednn_sim.values import Floats

# Kinds of transmission by which an actuator drives a joint.
ON_JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
DRIVABLE = (
    "<position>, <motor>, or <general> with fixed gain, affine bias and no dynamics (timeconst), on joints or fixed "
    "tendons; of a file, servos='design' (--servos design) makes others"
)


def tangent_basis(space: Coordinates) -> Floats:
    """Generalised velocities ``(nv, n)`` at unit rates of the coordinates, every ball joint at its reference.

    Its columns span the velocities that the arm's joints can have at any position. Rows of joints outside the arm are
    zero, and those of coupled stages are multiples of their leaders'. Its transpose turns generalised forces ``(nv,)``
    into forces along the coordinates; for ball joints, along the axes of the moving body.
    """
    basis = space.rates.copy(order="F")
    basis[space.ball_rate_addresses, space.balls] = 1.0
    return basis


def disabled_actuators(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which actuators ``(nu,)`` exert nothing, by ``actuatorgroupdisable`` or by the flag ``actuation``."""
    groups, last = model.actuator_group.astype(int), 30  # those beyond cannot be disabled
    named = (groups >= 0) & (groups <= last) & (model.opt.disableactuator >> np.clip(groups, 0, last) & 1 != 0)
    return np.asarray(named | bool(model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)))


def actuator_moments(model: mujoco.MjModel) -> Floats:
    """Generalised force per unit force of each actuator, ``(nu, nv)``, at the reference position; disabled ones: 0."""
    data, moments = scratch_data(model), np.zeros((model.nu, model.nv))
    # The parts of mj_forward that moments need.
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_tendon(model, data)
    mujoco.mj_transmission(model, data)
    if model.nu:
        rows = data.moment_rownnz, data.moment_rowadr, data.moment_colind
        mujoco.mju_sparse2dense(moments, data.actuator_moment.ravel(), *rows)
    moments[disabled_actuators(model)] = 0.0
    return moments


def driving(moments: Floats, rates: Floats) -> NDArray[np.bool_]:
    """Which actuators ``(nu,)`` with `actuator_moments` ``(nu, nv)`` move anything at velocities ``(nv, n)``."""
    return np.asarray(np.abs(moments @ rates).max(axis=1, initial=0.0) > 1e-9)


def constant_moments(model: mujoco.MjModel) -> Floats:
    """The `actuator_moments` of actuators on joints and fixed tendons, which are constant; zero for the others."""
    constant = np.isin(model.actuator_trntype, ON_JOINTS) | _on_fixed_tendons(model)
    return np.where(constant[:, None], actuator_moments(model), 0.0)


def affine_actuators(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which actuators ``(nu,)`` exert g ctrl + b0 + b1 l + b2 v, g not zero, whatever their dynamics are."""
    affine = (model.actuator_plugin < 0) & (model.actuator_biastype <= int(mujoco.mjtBias.mjBIAS_AFFINE))
    affine &= model.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_FIXED)
    return np.asarray(affine & (model.actuator_gainprm[:, 0] != 0.0))


def drivable(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which actuators ``(nu,)`` controllers know: see `DRIVABLE`; in a parent's frame, those of hinges and slides."""
    kinds, (joint, in_parent) = model.actuator_trntype, ON_JOINTS
    scalar = np.isin(model.jnt_type[np.where(kinds == in_parent, model.actuator_trnid[:, 0], 0)], SCALAR)
    constant = (kinds == joint) | ((kinds == in_parent) & scalar) | _on_fixed_tendons(model)
    static = model.actuator_dyntype == int(mujoco.mjtDyn.mjDYN_NONE)
    return np.asarray(affine_actuators(model) & static & constant)


def compensating_dofs(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which dofs ``(nv,)`` have ``actgravcomp``: MuJoCo adds gravity compensation to the forces of their actuators."""
    acting = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    return np.asarray((model.jnt_actgravcomp[model.dof_jntid] != 0) & acting)


def actuator_ranges(model: mujoco.MjModel, *, controls: bool = True) -> Floats:
    """Least and largest force ``(nu, 2)`` of each actuator, infinite where nothing limits it.

    The control range of a motor or velocity servo limits its force at rest as well as its force range does, and so does
    the ``actuatorfrcrange`` of the tendon at which an actuator pulls. Control ranges count only with ``controls``.
    """
    ranges = np.where(model.actuator_forcelimited[:, None] != 0, model.actuator_forcerange, [-np.inf, np.inf])
    for pulls, span in zip(*limited_tendons(model), strict=True):
        ranges[pulls] = np.clip(ranges[pulls], *span)
    return np.clip(control_forces(model), ranges[:, :1], ranges[:, 1:]) if controls else ranges


def limited_tendons(model: mujoco.MjModel) -> tuple[NDArray[np.bool_], Floats]:
    """Which actuators ``(T, nu)`` pull at each tendon with an ``actuatorfrcrange``, and these ranges ``(T, 2)``."""
    tendons = np.flatnonzero(model.tendon_actfrclimited)
    pulls = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON)) & (
        model.actuator_trnid[:, 0] == tendons[:, None]
    )
    return pulls, model.tendon_actfrcrange[tendons]


def control_forces(model: mujoco.MjModel) -> Floats:
    """Least and largest force ``(nu, 2)`` at rest by control ranges of motors and velocity servos; else infinite."""
    motors, biases = _motors(model)
    by_control = np.sort(model.actuator_gainprm[:, :1] * control_ranges(model)) + biases[:, :1]
    return np.where(motors[:, None], by_control, [-np.inf, np.inf])


def lost_forces(model: mujoco.MjModel) -> Floats:
    """How much less force ``(nu,)`` limited controls of motors and velocity servos can exert, per unit velocity."""
    motors, biases = _motors(model)
    return np.where(motors & np.isfinite(control_ranges(model)).any(axis=1), -biases[:, 2], 0.0)


def _motors(model: mujoco.MjModel) -> tuple[NDArray[np.bool_], Floats]:
    """Which actuators ``(nu,)`` exert g ctrl + b0 + b2 v, whatever their lengths are, and b0, b1 and b2 of all."""
    biases = np.where(model.actuator_biastype[:, None] == int(mujoco.mjtBias.mjBIAS_NONE), 0, model.actuator_biasprm)
    static = model.actuator_dyntype != int(mujoco.mjtDyn.mjDYN_INTEGRATOR)  # its control is the rate of what acts
    return affine_actuators(model) & static & (biases[:, 1] == 0.0), biases[:, :3]


def control_ranges(model: mujoco.MjModel) -> Floats:
    """The range ``(nu, 2)`` to which MuJoCo clips each control, infinite where it does not."""
    clipped = model.actuator_ctrllimited * (not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL))
    return np.where(clipped[:, None] != 0, model.actuator_ctrlrange, [-np.inf, np.inf])


def force_ranges(model: mujoco.MjModel, rates: Floats) -> Floats:
    """Least and largest force ``(n, 2)`` [N m, N] of the actuators on joints or fixed tendons on each coordinate.

    The ranges of all actuators on a coordinate add up, each times its moment; the ``actuatorfrcrange`` of a joint or
    tendon bounds their sum. Where a range leaves no force in one direction, the limits of the coordinate count as
    unknown: they are infinite, as without an actuator. ``rates`` ``(nv, n)`` are the velocities of the model's dofs per
    unit rate of each coordinate, coupled stages included.
    """
    moments = constant_moments(model)
    single = actuator_ranges(model)
    for pulls, span in zip(*limited_tendons(model), strict=True):
        # MuJoCo makes the forces of all actuators at a tendon smaller by one factor.
        total = single[pulls].sum(axis=0)
        single[pulls] *= np.divide(np.clip(total, *span), total, where=total != 0.0, out=np.ones(2))
    on_dofs, together = _sum_of_ranges(moments, single), _sum_of_ranges(moments @ rates, single)
    limited = np.flatnonzero(model.jnt_actfrclimited)
    dofs, bounds = model.jnt_dofadr[limited], model.jnt_actfrcrange[limited]
    on_dofs[dofs] = np.clip(on_dofs[dofs], bounds[:, :1], bounds[:, 1:])
    through_dofs = _sum_of_ranges(rates, on_dofs)
    low = np.maximum(together[:, 0], through_dofs[:, 0])
    high = np.minimum(together[:, 1], through_dofs[:, 1])
    known = (low < 0.0) & (high > 0.0)
    return np.where(known[:, None], np.stack([low, high], axis=1), [-np.inf, np.inf])


def required_forces(
    model: mujoco.MjModel, qpos: Floats, qvel: Floats | float = 0, qacc: Floats | float = 0, *, limited: bool = False
) -> Floats:
    """Generalised forces ``(S, nv)`` that actuators need for a motion, after gravity compensation and springs.

    They are those of inverse dynamics, M qacc + bias - passive, without contacts and dry friction.

    Args:
        qpos: MuJoCo's positions ``(S, nq)``.
        qvel, qacc: its velocities and accelerations ``(S, nv)``; by default at rest.
        limited: whether the forces are those that ``actuatorfrcrange`` limits, which include compensation by actuators.
    """
    data, compensated = scratch_data(model), bool(model.jnt_actgravcomp.any())
    if compensated:
        by_actuator = compensating_dofs(model)
        if limited:
            by_actuator &= model.jnt_actfrclimited[model.dof_jntid] == 0
    forces = np.zeros((len(qpos), model.nv))
    qvel, qacc = forces + qvel, forces + qacc
    inertial = np.zeros(model.nv)
    bias, passive, compensation = data.qfrc_bias, data.qfrc_passive, data.qfrc_gravcomp
    for force, data.qpos[:], data.qvel[:], acceleration in zip(forces, qpos, qvel, qacc, strict=True):
        # The parts of mj_inverse before the constraints, for which it would look for contacts.
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_mulM(model, data, inertial, acceleration)
        np.subtract(bias, passive, force)
        force += inertial
        if compensated:
            force -= by_actuator * compensation
    return forces


def servo_gains(model: mujoco.MjModel, rates: Floats) -> tuple[Floats, Floats]:
    """The gains kp [N m/rad, N/m] and kv [N m s/rad, N s/m], both ``(n,)``, of the position servos on each coordinate.

    Rates, and the servos that count, are as in `force_ranges`.
    """
    kp, kv = -model.actuator_biasprm[:, 1:3].T @ (constant_moments(model) @ rates) ** 2
    return kp, kv


def dry_friction(model: mujoco.MjModel, rates: Floats) -> Floats:
    """Largest force ``(n,)`` of the joints' dry friction against each coordinate [N m, N]."""
    return np.asarray(model.dof_frictionloss @ np.abs(rates))


def _on_fixed_tendons(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which actuators ``(nu,)`` pull at a tendon whose length is a sum of joint positions."""
    on = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON)
    on[on] = model.wrap_type[model.tendon_adr[model.actuator_trnid[on, 0]]] == int(mujoco.mjtWrap.mjWRAP_JOINT)
    return np.asarray(on)


def _sum_of_ranges(weights: Floats, ranges: Floats) -> Floats:
    """Ranges ``(n, 2)`` of weighted sums, with weights ``(m, n)``, of independent numbers in the ranges ``(m, 2)``."""
    factors = np.repeat(weights[..., None], 2, axis=-1)
    scaled = np.multiply(factors, ranges[:, None], where=factors != 0.0, out=np.zeros_like(factors))
    return np.sort(scaled, axis=-1).sum(axis=0)
