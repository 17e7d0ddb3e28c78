"""Servos where nothing drives a joint: those of the arm, and those that hold what carries it or else would fall."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import ancestry
from lieednn_sim.arm.dependents import tied_joints
from lieednn_sim.arm.equalities import dof_addresses
from lieednn_sim.arm.forces import actuator_moments, force_ranges, servo_gains
from lieednn_sim.arm.frames import chain_joints
from lieednn_sim.arm.importer.loading import compile_spec, unused
from lieednn_sim.arm.importer.report import Servo
from lieednn_sim.arm.limits import largest_inertia
from lieednn_sim.arm.model_arm import ModelArm
from lieednn_sim.arm.step_stability import step_growth, without_stops
from lieednn_sim.values import Floats

SERVOS = ("keep", "design", "none")
_STABLE = -1e-6  # least decay rate at which the steps count as stable [1/s]
# Least decay rate of the motions of tied stages [1/s], and the factors by which servos are slowed down for it.
_DECAY, _SLOWDOWNS = 10.0, 0.8 ** np.arange(13)


@dataclass(frozen=True, eq=False)
class _Servo:
    """A critically damped position servo of one dof, kp = I w^2 and kv = 2 I w."""

    name: str  # of the dof: its joint's, with ``_x``, ``_y`` or ``_z`` for those of a ball joint
    joint: str  # where it acts
    axis: int
    inertia: float  # I [kg m^2, kg]
    force: Floats | None = None  # ``(2,)`` the range of its force, if it has one [N m, N]
    tied: bool = False  # whether other joints follow this one

    def parameters(self, slower: float) -> tuple[Floats, Floats]:
        """MuJoCo's gain and bias parameters, ten each, of one slower by a factor."""
        omega = 2.0 * np.pi * 20.0 * slower  # 20 Hz
        kp, kv = self.inertia * omega**2, 2.0 * self.inertia * omega
        return np.array([kp, *np.zeros(9)]), np.array([0.0, -kp, -kv, *np.zeros(7)])


def add_servos(spec: mujoco.MjSpec, arm: ModelArm, configurations: Floats, rule: str, notes: list[str]) -> set[str]:
    """Add servos to a spec, by ``rule``, one of `SERVOS`; the names of their actuators.

    Coordinates that nothing drives, or with ``design`` all of them, get a servo of 20 Hz, critically damped on the
    largest inertia M_ii with the other coordinates held; with these free the inertia may nearly vanish, as for two axes
    in line, and a servo for it would be weak when both turn. Other undriven joints get a servo that holds them in place
    if they carry the arm or the file drives nothing at all; else they stay passive. Servos are slower where the time
    step or the soft ties between coupled stages could not follow them, at configurations ``(S, nq)``, home first.
    """
    if rule == "none":
        return set()
    model, basis = arm.model, arm.unit_rates()
    moments: Floats = np.abs(actuator_moments(model))
    ranges, moving = force_ranges(model, basis), (moments @ np.abs(basis)).max(axis=1, initial=0.0) > 1e-9
    holders = [*_holders(arm, np.asarray(moments.any(axis=0)), configurations[0])]
    if rule == "design":
        for actuator in [actuator for actuator in spec.actuators if moving[actuator.id]]:
            spec.delete(actuator)
        moments[moving] = 0.0
    bare = np.flatnonzero((moments @ np.abs(basis)).max(axis=0, initial=0.0) <= 1e-9)
    servos = [*_drivers(arm, bare, ranges, configurations[:16], basis)]
    for made, why in ((servos, "as asked for" if rule == "design" else "there was no actuator"), (holders, "to hold")):
        if made:
            notes.append(f"new servos for {', '.join(servo.name for servo in made)}: {why}")
    names = {actuator.name for actuator in spec.actuators}
    actuators: dict[str, _Servo] = {}
    for servo in (*servos, *holders):
        name = unused(servo.name, names, "_servo")
        names.add(name)
        actuators[name] = servo
        _add(spec, name, servo)
    if actuators:
        if spec.option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION):
            # The file's own actuators stay disabled, by their groups.
            spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
            spec.option.disableactuator = 2**31 - 1
        _slow_down(spec, actuators, configurations[:8], notes)
    return set(actuators)


def describe_servos(arm: ModelArm, configurations: Floats, added: set[str]) -> Iterator[Servo]:
    """What drives each coordinate of an arm in its completed model; ``added`` are names of actuators."""
    model, basis = arm.model, arm.unit_rates()
    (kp, kv), ranges = servo_gains(model, basis), force_ranges(model, basis)
    inertia = largest_inertia(model, configurations[:16], basis)
    driving = np.abs(actuator_moments(model) @ basis) > 1e-9
    for k, name in enumerate(arm.joint_names):
        frequency = float(np.sqrt(kp[k] / inertia[k]) / (2.0 * np.pi))
        kept = not added.intersection(model.actuator(int(a)).name for a in np.flatnonzero(driving[:, k]))
        low, high = map(float, ranges[k])
        yield Servo(name, float(kp[k]), float(kv[k]), (low, high), frequency, kept)


def _drivers(
    arm: ModelArm, bare: NDArray[np.int_], ranges: Floats, configurations: Floats, basis: Floats
) -> Iterator[_Servo]:
    """Servos for the coordinates ``bare``."""
    if not len(bare):
        return
    inertia = largest_inertia(arm.model, configurations, basis)
    model, dofs = arm.model, arm.space.own_rate_addresses
    for k in bare.tolist():
        joint = int(model.dof_jntid[dofs[k]])
        axis = int(dofs[k] - model.jnt_dofadr[joint])
        # A joint's force range bounds the sum of all its actuators, so it is not the range of the servo.
        limited = np.isfinite(ranges[k]).all() and not model.jnt_actfrclimited[joint]
        force = ranges[k] if limited else None
        tied = bool(np.count_nonzero(basis[:, k]) > 1)
        name = arm.joint_names[k], model.joint(joint).name
        yield _Servo(*name, axis, float(inertia[k]), force, tied=tied)


def _holders(arm: ModelArm, driven: NDArray[np.bool_], qpos: Floats) -> Iterator[_Servo]:
    """Servos that hold joints where they are in ``qpos``; ``driven`` are the dofs that actuators move."""
    model = arm.model
    followers = {follower for follower, _ in tied_joints(model)}
    carrying = {joint for body in ancestry(model, int(arm.frames.bodies[0])) for joint in chain_joints(model, body)}
    moved = {int(model.dof_jntid[dof]) for dof in arm.dofs}
    inertia = largest_inertia(model, qpos[None], np.eye(model.nv))
    for joint in (joint for body in range(model.nbody) for joint in chain_joints(model, body)):
        dofs = dof_addresses(model, [joint])
        if joint in moved or joint in followers or driven[dofs].any() or not (joint in carrying or not model.nu):
            continue
        for axis, dof in enumerate(dofs.tolist()):
            name = model.joint(joint).name
            named = f"{name}_{'xyz'[axis]}" if len(dofs) > 1 else name
            yield _Servo(named, name, axis, float(inertia[dof]))


def _add(spec: mujoco.MjSpec, name: str, servo: _Servo) -> None:
    gear = np.zeros(6)
    gear[servo.axis] = 1.0
    actuator = spec.add_actuator(
        name=name,
        target=servo.joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        group=31,  # which nothing can disable
        dyntype=mujoco.mjtDyn.mjDYN_NONE,
        gear=gear,
        inheritrange=0.0,
        actlimited=mujoco.mjtLimited.mjLIMITED_FALSE,
        ctrllimited=mujoco.mjtLimited.mjLIMITED_FALSE,
        forcelimited=mujoco.mjtLimited.mjLIMITED_FALSE,
    )
    actuator.gainprm, actuator.biasprm = servo.parameters(1.0)
    if servo.force is not None:
        actuator.forcelimited, actuator.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, servo.force


def _slow_down(spec: mujoco.MjSpec, actuators: Mapping[str, _Servo], configurations: Floats, notes: list[str]) -> None:
    """Take the integrator implicitfast where Euler's would be unstable, and slow servos down.

    The servos of coupled stages, each of which acts on one stage, are slowed first, until the soft ties can keep up: to
    the fastest with which the model's slowest mode decays at 10 / s at home, or nearly as fast as with any slower ones,
    since other parts may be slow by themselves. Then all are, until the steps are stable at all configurations.
    """
    model = compile_spec(spec)
    if model.nhistory:  # MuJoCo does not linearise delays
        undelayed = spec.copy()
        for element in (*undelayed.actuators, *undelayed.sensors):
            element.delay, element.nsample = 0.0, 0
        model = compile_spec(undelayed)
    without_stops(model)
    slower = dict.fromkeys(actuators, 1.0)

    def decay(rows: Floats) -> float:
        for name, servo in actuators.items():
            actuator = model.actuator(name).id
            model.actuator_gainprm[actuator], model.actuator_biasprm[actuator] = servo.parameters(slower[name])
        return min(-float(np.log(step_growth(model, qpos))) / model.opt.timestep for qpos in rows)

    euler = int(mujoco.mjtIntegrator.mjINT_EULER)
    if decay(configurations) < _STABLE and model.opt.integrator == euler:
        model.opt.integrator = spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        notes.append("the servos would be unstable with the model's integrator; it is implicitfast now")
    if tied := [name for name, servo in actuators.items() if servo.tied]:
        decays: list[float] = []
        for factor in _SLOWDOWNS:
            slower.update(dict.fromkeys(tied, factor))
            decays.append(decay(configurations[:1]))
            if decays[-1] >= _DECAY:
                break
        enough = min(_DECAY, max(decays) - 0.1 * abs(max(decays)))
        slower.update(dict.fromkeys(tied, next(f for f, d in zip(_SLOWDOWNS, decays, strict=False) if d >= enough)))
    start = dict(slower)
    for factor in _SLOWDOWNS:
        slower.update({name: factor * first for name, first in start.items()})
        if decay(configurations) > _STABLE:
            break
    else:
        slower = start  # something else is unstable, such as a link that nothing holds
    for name, servo in actuators.items():
        actuator = spec.actuator(name)
        actuator.gainprm, actuator.biasprm = servo.parameters(slower[name])
