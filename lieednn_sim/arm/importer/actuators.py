"""The actuators of an imported arm: those of its model are read, and replaced by one position servo per coordinate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.forces import constant_moments, force_ranges
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
from lieednn_sim.values import Floats

# Least decay rate of the motions of tied stages [1/s], and the factors by which their servos are slowed down for it.
_DECAY, _SLOWDOWNS = 10.0, 0.8 ** np.arange(13)


def read_actuators(draft: Draft) -> None:
    """Find what drives each coordinate in the original model, and which coordinates need new servos, and why."""
    dofs, model = draft.dofs_of(draft.original), draft.original
    rates = np.array([dof.rates for dof in dofs]).T
    moments, ranges = constant_moments(model) @ rates, force_ranges(model, rates)
    for k, dof in enumerate(dofs):
        joint = model.joint(dof.joint).id
        if model.jnt_actfrclimited[joint] and not moments[:, k].any():
            # The joint's own bound, such as the effort of a URDF, applies to any servo added later.
            ranges[k] = model.jnt_actfrcrange[joint]
    results = [_actuation(model, moments, (float(low), float(high)), k) for k, (low, high) in enumerate(ranges)]
    if draft.servo_rule == "design":
        results = [replace(item, gains=None, remark=item.remark or "as asked for") for item in results]
    for remark in dict.fromkeys(item.remark for item in results if item.remark):
        affected = [dof.name for dof, item in zip(dofs, results, strict=True) if item.remark == remark]
        draft.notes.append(f"new servos for {', '.join(affected)}: {remark}")
    draft.actuations = results


def design_servos(draft: Draft) -> None:
    """Design one servo for each coordinate: with its present gains, if any, else kp = I w^2, kv = 2 I w, w = 2 pi f.

    I = M_ii, the largest over a few configurations, is the inertia with the other coordinates held; M is in the
    independent coordinates and includes coupled stages and armature; f = 20 Hz. With the other coordinates free the
    inertia may nearly vanish, as for two axes in line, and a servo designed for that would be weak when both turn.
    """
    natural_frequency = 20.0  # of a designed servo [Hz]
    omega, servos = 2.0 * np.pi * natural_frequency, []
    inertia = largest_inertia(draft.bare, draft.configurations(draft.samples[:16]), draft.rates)
    for dof, actuation, held in zip(draft.dofs, draft.actuations, inertia, strict=True):
        kp, kv = map(float, actuation.gains or (held * omega**2, 2.0 * held * omega))
        frequency = float(np.sqrt(kp / held) / (2.0 * np.pi))
        servos.append(Servo(dof.name, kp, kv, actuation.force_range, frequency, actuation.gains is not None))
    draft.servos = tuple(servos)


def stabilise(draft: Draft) -> None:
    """If the servos are unstable at one of a few configurations, change the integrator, then shorten the timestep."""
    model, option = draft.bare, draft.spec.option
    inertias = reduced_inertia(model, draft.configurations(draft.samples[:8]), draft.rates)

    def unstable() -> bool:
        timestep = float(model.opt.timestep)
        return any(growth(model, inertia, draft.dofs, draft.servos, timestep) > 1.0 + 1e-9 for inertia in inertias)

    if unstable() and model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_EULER):
        model.opt.integrator = option.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        draft.notes.append("the servos would be unstable with the model's integrator; it is implicitfast now")
    halvings = 6  # of the timestep, at most
    for _ in range(halvings):
        if not unstable():
            break
        model.opt.timestep /= 2.0
        option.timestep = model.opt.timestep
        draft.notes.append(f"the servos would be unstable with the timestep; it is {model.opt.timestep:g} s now")


def add_servos(draft: Draft) -> None:
    """Add the servos to the spec, slowed down where the soft ties between coupled stages could not follow them."""
    names = [_add_servo(draft.spec, dof, servo) for dof, servo in zip(draft.dofs, draft.servos, strict=True)]
    draft.servos = _soften(draft.spec, draft.configurations(draft.samples[:1])[0], draft.dofs, draft.servos, names)


def _add_servo(spec: mujoco.MjSpec, dof: Dof, servo: Servo) -> str:
    """Add a servo with the coordinate's range as control range; return the actuator's name."""
    gear = np.zeros(6)
    gear[dof.axis] = 1.0
    actuator = spec.add_actuator(
        name=unused(servo.name, {actuator.name for actuator in spec.actuators}, "_servo"),
        target=dof.joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
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


def _actuation(model: mujoco.MjModel, moments: Floats, limits: tuple[float, float], k: int) -> Actuation:
    """What drives coordinate ``k``, given the actuators' ``moments`` ``(nu, n)`` on the coordinates.

    An actuator with moment r, gear times d(transmission length)/dq, exerts r F on the coordinate. A position servo
    F = kp (ctrl - l) - kv dl/dt with l = r q is one on q with the gains r^2 kp and r^2 kv.
    """
    acting = np.flatnonzero(moments[:, k])
    if not acting.size:
        return Actuation(limits, None, "there was no actuator")
    if acting.size > 1:
        return Actuation(limits, None, f"each had {acting.size} actuators")
    (a,) = acting
    if np.count_nonzero(moments[a]) > 1:
        return Actuation(limits, None, "the actuator moves other joints too")
    gain, (b0, b1, b2) = model.actuator_gainprm[a, 0], model.actuator_biasprm[a, :3]
    plain = (
        model.actuator_gaintype[a] == int(mujoco.mjtGain.mjGAIN_FIXED)
        and model.actuator_biastype[a] == int(mujoco.mjtBias.mjBIAS_AFFINE)
        and model.actuator_dyntype[a] == int(mujoco.mjtDyn.mjDYN_NONE)
    )
    if not (plain and gain > 0.0 and np.isclose(gain, -b1) and b0 == 0.0 and b2 <= 0.0):
        return Actuation(limits, None, "the actuator is not a position servo with ctrl = position")
    return Actuation(limits, (float(gain * moments[a, k] ** 2), float(abs(b2) * moments[a, k] ** 2)), "")


def _soften(
    spec: mujoco.MjSpec, qpos: Floats, dofs: list[Dof], servos: tuple[Servo, ...], names: list[str]
) -> tuple[Servo, ...]:
    """Slow down the designed servos of coupled stages, which act on one stage, until their soft ties can keep up.

    The fastest servos are taken with which the model's slowest mode decays at 10 / s, or nearly as fast as with any
    slower ones, since other parts of the model may be slow by themselves. Dry friction is left out.

    Args:
        spec: the spec with the servos, which is changed.
        qpos: ``(nq,)`` configuration of the whole model at which a step is linearised.
        dofs: the arm's coordinates, with rates in the spec's model.
        servos: the coordinates' servos.
        names: names of the servos' actuators.
    """
    tied = [
        k
        for k, (dof, servo) in enumerate(zip(dofs, servos, strict=True))
        if not servo.kept and int(np.count_nonzero(dof.rates)) > 1
    ]
    if not tied:
        return servos
    model = spec.compile()
    # Dry friction holds the stages at rest, and would hide how they swing once they move.
    model.dof_frictionloss[:] = model.tendon_frictionloss[:] = 0.0
    choices = [tuple(_slower(s, factor) if k in tied else s for k, s in enumerate(servos)) for factor in _SLOWDOWNS]
    decays: list[float] = []
    for choice in choices:
        for k in tied:
            actuator = model.actuator(names[k]).id
            gain, bias = gain_parameters(choice[k])
            model.actuator_gainprm[actuator], model.actuator_biasprm[actuator] = gain, bias
        decays.append(-np.log(_step_growth(model, qpos)) / model.opt.timestep)
        if decays[-1] >= _DECAY:
            break
    best = max(decays)
    result = choices[next(i for i, decay in enumerate(decays) if decay >= min(_DECAY, best - 0.1 * abs(best)))]
    for k in tied:
        actuator = spec.actuator(names[k])
        actuator.gainprm, actuator.biasprm = gain_parameters(result[k])
    return result


def _slower(servo: Servo, factor: float) -> Servo:
    return replace(servo, kp=servo.kp * factor**2, kv=servo.kv * factor, frequency=servo.frequency * factor)


def _step_growth(model: mujoco.MjModel, qpos: Floats) -> float:
    """Spectral radius of one step of the whole model, at rest with the servos commanded to the configuration."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    data.ctrl[:] = data.actuator_length
    size = 2 * model.nv + model.na
    transition = np.zeros((size, size))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, transition, None, None, None)
    return float(np.abs(np.linalg.eigvals(transition)).max())
