"""The actuators of an arm: what its model has is read, one position servo for each coordinate is made of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.arm.importer.loading import unused
from lieednn_sim.arm.importer.servos import (
    Actuation,
    Dof,
    Servo,
    gain_parameters,
    growth,
    largest_inertia,
    reduced_inertia,
)
from lieednn_sim.arm.importer.softening import soften
from lieednn_sim.arm.importer.stages import tendon_joints

Floats = NDArray[np.float64]
_BALL = int(mujoco.mjtJoint.mjJNT_BALL)
_TRN = mujoco.mjtTrn
_EXPLICIT = (int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_RK4))
_NATURAL_FREQUENCY = 20.0  # of a designed servo [Hz]
_HALVINGS = 6  # of the timestep at most


def read_actuators(draft: Draft) -> None:
    """What moves each coordinate in the model as it came, and which coordinates need new servos for what reason."""
    dofs = draft.dofs_of(draft.original)
    found = [_actuation(draft.original, dofs, k) for k in range(len(dofs))]
    if draft.servo_rule == "design":
        found = [replace(one, gains=None, remark=one.remark or "as asked for") for one in found]
    for remark in dict.fromkeys(one.remark for one in found if one.remark):
        affected = [dof.name for dof, one in zip(dofs, found, strict=True) if one.remark == remark]
        draft.notes.append(f"new servos for {', '.join(affected)}: {remark}")
    draft.actuations = found


def design_servos(draft: Draft) -> None:
    """One servo for each coordinate: with the gains it has, if any, else kp = I w^2, kv = 2 I w, w = 2 pi f.

    I = M_ii is the inertia with the other coordinates held, M in the independent coordinates, coupled stages and
    armature included; the largest of a few postures counts, and f = 20 Hz. With the others free to give way the
    inertia may be next to nothing, as of two axes in line, and a servo made for that is weak when both turn.
    """
    omega, servos = 2.0 * np.pi * _NATURAL_FREQUENCY, []
    inertia = largest_inertia(draft.bare, draft.postures(draft.samples[:16]), draft.dofs)
    for dof, actuation, held in zip(draft.dofs, draft.actuations, inertia, strict=True):
        kp, kv = map(float, actuation.gains or (held * omega**2, 2.0 * held * omega))
        frequency = float(np.sqrt(kp / held) / (2.0 * np.pi))
        servos.append(Servo(dof.name, kp, kv, actuation.force_range, frequency, actuation.gains is not None))
    draft.servos = tuple(servos)


def stabilise(draft: Draft) -> None:
    """Where the servos would be unstable at one of a few postures take a better integrator, then shorter timesteps."""
    model, option = draft.bare, draft.spec.option
    inertias = [reduced_inertia(model, qpos, draft.dofs) for qpos in draft.postures(draft.samples[:8])]

    def unstable() -> bool:
        timestep = float(model.opt.timestep)
        return any(growth(model, inertia, draft.dofs, draft.servos, timestep) > 1.0 + 1e-9 for inertia in inertias)

    if unstable() and model.opt.integrator in _EXPLICIT:
        model.opt.integrator = option.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        draft.notes.append("the servos would be unstable with the model's integrator; it is implicitfast now")
    for _ in range(_HALVINGS):
        if not unstable():
            break
        model.opt.timestep /= 2.0
        option.timestep = model.opt.timestep
        draft.notes.append(f"the servos would be unstable with the timestep; it is {model.opt.timestep:g} s now")


def add_servos(draft: Draft) -> None:
    """Add the servos to the spec, slowed down where soft ties between stages could not keep up with them."""
    names = [_add_servo(draft.spec, dof, servo) for dof, servo in zip(draft.dofs, draft.servos, strict=True)]
    draft.servos = soften(draft.spec, draft.postures(draft.samples[:1])[0], draft.dofs, draft.servos, names)


def _add_servo(spec: mujoco.MjSpec, dof: Dof, servo: Servo) -> str:
    """Add a servo to a spec, its control range that of the coordinate; returns the actuator's name."""
    gear = np.zeros(6)
    gear[dof.axis] = 1.0
    actuator = spec.add_actuator(
        name=unused(servo.name, {actuator.name for actuator in spec.actuators}, "_servo"),
        target=dof.joint,
        trntype=_TRN.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        dyntype=mujoco.mjtDyn.mjDYN_NONE,
        gear=gear,
    )
    actuator.gainprm, actuator.biasprm = gain_parameters(servo)
    actuator.inheritrange = 0.0
    actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
    actuator.ctrlrange = dof.span
    actuator.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
    limited = np.isfinite(servo.force_range).all()
    actuator.forcelimited = getattr(mujoco.mjtLimited, f"mjLIMITED_{'TRUE' if limited else 'FALSE'}")
    if limited:
        actuator.forcerange = servo.force_range
    return str(actuator.name)


def _actuation(model: mujoco.MjModel, dofs: Sequence[Dof], k: int) -> Actuation:
    """What moves coordinate ``k`` in the given model; ``rates`` of the dofs must be those of this model.

    An actuator of moment r on the coordinate, r = gear times d(transmission length)/dq, exerts r F. A position servo
    F = kp (ctrl - l) - kv dl/dt with l = r q is one on q with the gains r^2 kp and r^2 kv.
    """
    acting = []
    for a in range(model.nu):
        moments = np.array([_moment(model, a) @ dof.rates for dof in dofs])
        if moments[k]:
            acting.append((a, moments))
    if not acting:
        return Actuation((-np.inf, np.inf), None, "there was no actuator")
    force = np.sum([np.sort(_force_range(model, a) * moments[k]) for a, moments in acting], axis=0)
    joint = model.joint(dofs[k].joint).id
    if model.jnt_actfrclimited[joint]:
        force = np.array(
            [max(force[0], model.jnt_actfrcrange[joint, 0]), min(force[1], model.jnt_actfrcrange[joint, 1])]
        )
    limits = float(force[0]), float(force[1])
    if not limits[0] < 0.0 < limits[1]:
        limits = (-np.inf, np.inf)
    (a, moments), *others = acting
    if others:
        return Actuation(limits, None, f"there were {len(acting)} actuators each")
    if np.count_nonzero(moments) > 1:
        return Actuation(limits, None, "the actuator moves other joints, too")
    gain, (b0, b1, b2) = model.actuator_gainprm[a, 0], model.actuator_biasprm[a, :3]
    plain = (
        model.actuator_gaintype[a] == int(mujoco.mjtGain.mjGAIN_FIXED)
        and model.actuator_biastype[a] == int(mujoco.mjtBias.mjBIAS_AFFINE)
        and model.actuator_dyntype[a] == int(mujoco.mjtDyn.mjDYN_NONE)
    )
    if not (plain and gain > 0.0 and np.isclose(gain, -b1) and b0 == 0.0 and b2 <= 0.0):
        return Actuation(limits, None, "the actuator is no position servo with ctrl = position")
    return Actuation(limits, (float(gain * moments[k] ** 2), float(abs(b2) * moments[k] ** 2)), "")


def _moment(model: mujoco.MjModel, actuator: int) -> Floats:
    """Generalised force per unit force ``(nv,)`` of an actuator on a joint or fixed tendon; zero for other kinds."""
    moment, gear = np.zeros(model.nv), model.actuator_gear[actuator]
    kind, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
    if kind in (int(_TRN.mjTRN_JOINT), int(_TRN.mjTRN_JOINTINPARENT)):
        width = {0: 6, _BALL: 3}.get(int(model.jnt_type[target]), 1)
        moment[model.jnt_dofadr[target] : model.jnt_dofadr[target] + width] = gear[:width]
    elif kind == int(_TRN.mjTRN_TENDON):
        for joint, coefficient in tendon_joints(model, target).items():
            moment[model.jnt_dofadr[joint]] = gear[0] * coefficient
    return moment


def _force_range(model: mujoco.MjModel, actuator: int) -> Floats:
    if model.actuator_forcelimited[actuator]:
        return model.actuator_forcerange[actuator].copy()
    motor = (
        model.actuator_gaintype[actuator] == int(mujoco.mjtGain.mjGAIN_FIXED)
        and model.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_NONE)
        and model.actuator_ctrllimited[actuator]
    )
    if motor:
        return np.sort(model.actuator_gainprm[actuator, 0] * model.actuator_ctrlrange[actuator])
    return np.array([-np.inf, np.inf])
