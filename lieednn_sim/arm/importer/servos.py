"""Position servos for the independent coordinates of an arm, kept from its model or designed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.stages import tendon_joints

Floats = NDArray[np.float64]
_BALL = int(mujoco.mjtJoint.mjJNT_BALL)
_TRN = mujoco.mjtTrn
NATURAL_FREQUENCY = 20.0  # of a designed servo [Hz]


@dataclass(frozen=True, eq=False)
class Freedom:
    """One independent coordinate of the arm in a compiled model.

    Attributes:
        name: of the joint, with ``_x``, ``_y`` or ``_z`` for those of a ball joint.
        joint: name of the joint.
        axis: 0, or 0 to 2 in a ball joint.
        rates: ``(nv,)`` how fast the model's freedoms move with it, coupled stages included.
        span: ``(2,)`` its range [rad, m].
    """

    name: str
    joint: str
    axis: int
    rates: Floats
    span: Floats


@dataclass(frozen=True)
class Servo:
    """Force kp (ctrl - q) - kv dq/dt on one coordinate.

    Attributes:
        name: of the coordinate.
        kp: [N m/rad, N/m].
        kv: [N m s/rad, N s/m].
        force_range: [N m, N]; infinite where nothing limits the drive.
        frequency: natural frequency on the largest inertia of a few postures, the other coordinates held [Hz].
        kept: whether kp and kv are those of the given model.
    """

    name: str
    kp: float
    kv: float
    force_range: tuple[float, float]
    frequency: float
    kept: bool

    def __str__(self) -> str:
        """Return one line for a report."""
        low, high = self.force_range
        limits = "no force limit" if np.isinf([low, high]).all() else f"force {low:.4g} .. {high:.4g}"
        return (
            f"{self.name}: {'kept' if self.kept else 'made'}, kp {self.kp:.4g}, kv {self.kv:.4g}, "
            f"{self.frequency:.3g} Hz, {limits}"
        )


@dataclass(frozen=True)
class Drive:
    """What a given model has to move one coordinate.

    Attributes:
        force_range: sum over its actuators, referred to the coordinate [N m, N].
        gains: kp and kv referred to the coordinate, of the one plain position servo that moves nothing else.
        remark: why there are no gains, or empty.
    """

    force_range: tuple[float, float]
    gains: tuple[float, float] | None
    remark: str


def read_drive(model: mujoco.MjModel, freedoms: list[Freedom], k: int) -> Drive:
    """The drive of coordinate ``k`` in the given model; ``rates`` of the freedoms must be those of this model.

    An actuator of moment r on the coordinate, r = gear times d(transmission length)/dq, exerts r F. A position servo
    F = kp (ctrl - l) - kv dl/dt with l = r q is one on q with the gains r^2 kp and r^2 kv.
    """
    acting = []
    for a in range(model.nu):
        moments = np.array([_moment(model, a) @ freedom.rates for freedom in freedoms])
        if moments[k]:
            acting.append((a, moments))
    if not acting:
        return Drive((-np.inf, np.inf), None, "there was no drive")
    force = np.sum([np.sort(_force_range(model, a) * moments[k]) for a, moments in acting], axis=0)
    joint = model.joint(freedoms[k].joint).id
    if model.jnt_actfrclimited[joint]:
        force = np.array(
            [max(force[0], model.jnt_actfrcrange[joint, 0]), min(force[1], model.jnt_actfrcrange[joint, 1])]
        )
    limits = float(force[0]), float(force[1])
    if not limits[0] < 0.0 < limits[1]:
        limits = (-np.inf, np.inf)
    (a, moments), *others = acting
    if others:
        return Drive(limits, None, f"there were {len(acting)} drives each")
    if np.count_nonzero(moments) > 1:
        return Drive(limits, None, "the drive moves other joints, too")
    gain, (b0, b1, b2) = model.actuator_gainprm[a, 0], model.actuator_biasprm[a, :3]
    plain = (
        model.actuator_gaintype[a] == int(mujoco.mjtGain.mjGAIN_FIXED)
        and model.actuator_biastype[a] == int(mujoco.mjtBias.mjBIAS_AFFINE)
        and model.actuator_dyntype[a] == int(mujoco.mjtDyn.mjDYN_NONE)
    )
    if not (plain and gain > 0.0 and np.isclose(gain, -b1) and b0 == 0.0 and b2 <= 0.0):
        return Drive(limits, None, "the drive is no position servo with ctrl = position")
    return Drive(limits, (float(gain * moments[k] ** 2), float(abs(b2) * moments[k] ** 2)), "")


def design(
    model: mujoco.MjModel, postures: Sequence[Floats], freedoms: list[Freedom], drives: list[Drive]
) -> tuple[Servo, ...]:
    """One servo for each freedom: the drive's own gains where it has any, else kp = I w^2, kv = 2 I w, w = 2 pi f.

    I = M_ii is the inertia with the other coordinates held, M in the independent coordinates, coupled stages and
    armature included; the largest over ``postures`` counts, and f = 20 Hz. With the others free to give way the
    inertia may be next to nothing, as of two axes in line, and a servo made for that is weak when both turn.
    """
    inertia = np.max([np.diag(reduced_inertia(model, qpos, freedoms)) for qpos in postures], axis=0)
    servos = []
    for freedom, drive, held in zip(freedoms, drives, inertia, strict=True):
        omega = 2.0 * np.pi * NATURAL_FREQUENCY
        kp, kv = drive.gains or (held * omega**2, 2.0 * held * omega)
        frequency = np.sqrt(kp / held) / (2.0 * np.pi)
        servos.append(
            Servo(freedom.name, float(kp), float(kv), drive.force_range, float(frequency), drive.gains is not None)
        )
    return tuple(servos)


def add_servo(spec: Any, freedom: Freedom, servo: Servo) -> str:
    """Add a servo to a spec, its control range that of the coordinate; returns the actuator's name."""
    gear = np.zeros(6)
    gear[freedom.axis] = 1.0
    actuator = spec.add_actuator(
        name=_unused(spec, servo.name),
        target=freedom.joint,
        trntype=_TRN.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        dyntype=mujoco.mjtDyn.mjDYN_NONE,
        gear=gear,
    )
    actuator.gainprm, actuator.biasprm = gain_parameters(servo)
    actuator.inheritrange = 0.0
    actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
    actuator.ctrlrange = freedom.span
    actuator.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
    limited = np.isfinite(servo.force_range).all()
    actuator.forcelimited = getattr(mujoco.mjtLimited, f"mjLIMITED_{'TRUE' if limited else 'FALSE'}")
    if limited:
        actuator.forcerange = servo.force_range
    return str(actuator.name)


def gain_parameters(servo: Servo) -> tuple[Floats, Floats]:
    """MuJoCo's gain and bias parameters, ten each."""
    return np.array([servo.kp, *np.zeros(9)]), np.array([0.0, -servo.kp, -servo.kv, *np.zeros(7)])


def reduced_inertia(model: mujoco.MjModel, qpos: Floats, freedoms: list[Freedom]) -> Floats:
    """Inertia ``(n, n)`` in the independent coordinates, armature included."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    columns = np.zeros((len(freedoms), model.nv))
    for column, freedom in zip(columns, freedoms, strict=True):
        mujoco.mj_mulM(model, data, column, freedom.rates)
    return columns @ np.array([freedom.rates for freedom in freedoms]).T


def resting_load(model: mujoco.MjModel, qpos: Floats) -> Floats:
    """Generalised force ``(nv,)`` by which drives hold the model at rest, gravity compensation and springs apart."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    # Compensation by a drive counts as its force in MuJoCo, in addition to that of the servo.
    by_drive = model.jnt_actgravcomp[model.dof_jntid] != 0
    return np.asarray(data.qfrc_bias - data.qfrc_passive - np.where(by_drive, data.qfrc_gravcomp, 0.0))


def growth(
    model: mujoco.MjModel, inertia: Floats, freedoms: list[Freedom], servos: tuple[Servo, ...], timestep: float
) -> float:
    """Largest factor by which one step of MuJoCo's integrator multiplies a small error of the servo loops.

    Linearised, without springs and Coriolis forces: M dv/dt = -K q - (D + Kv) v, one step of the semi-implicit Euler
    method (D implicit; with the implicit methods Kv, too) or of Runge-Kutta 4.
    """
    rates = np.array([freedom.rates for freedom in freedoms])
    stiffness, gains = (np.diag([getattr(servo, gain) for servo in servos]) for gain in ("kp", "kv"))
    damping = rates @ np.diag(model.dof_damping) @ rates.T
    n, h = len(servos), timestep
    identity = np.eye(n)
    if model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_RK4):
        flow = np.block(
            [[np.zeros((n, n)), identity], [-np.linalg.solve(inertia, m) for m in (stiffness, damping + gains)]]
        )
        z = h * np.linalg.eigvals(flow)
        return float(np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24).max())
    implicit = damping.copy()
    if model.opt.integrator != int(mujoco.mjtIntegrator.mjINT_EULER):
        implicit += gains
    mass = inertia + h * implicit
    from_q, from_v = (-h * np.linalg.solve(mass, m) for m in (stiffness, damping + gains))
    step = np.block([[identity + h * from_q, h * (identity + from_v)], [from_q, identity + from_v]])
    return float(np.abs(np.linalg.eigvals(step)).max())


def _moment(model: mujoco.MjModel, actuator: int) -> Floats:
    """Generalised force per unit force ``(nv,)`` of a drive on a joint or fixed tendon; zero for other kinds."""
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


def _unused(spec: Any, name: str) -> str:
    names = {actuator.name for actuator in spec.actuators}
    while name in names:
        name += "_servo"
    return name
