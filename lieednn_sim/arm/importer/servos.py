"""Coordinates of an imported arm, their servos, and the dynamics by which these are designed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.values import Floats


@dataclass(frozen=True, eq=False)
class Dof:
    """One independent coordinate of the arm in a compiled model.

    Attributes:
        name: name of the joint, with ``_x``, ``_y`` or ``_z`` for those of a ball joint.
        joint: name of the joint.
        axis: 0, or 0 to 2 in a ball joint.
        rates: ``(nv,)`` velocities of the model's dofs per unit rate, coupled stages included.
        span: ``(2,)`` its range [rad, m].
    """

    name: str
    joint: str
    axis: int
    rates: Floats
    span: Floats


@dataclass(frozen=True)
class Servo:
    """A servo with force kp (ctrl - q) - kv dq/dt on one coordinate.

    Attributes:
        name: name of the coordinate.
        kp: [N m/rad, N/m].
        kv: [N m s/rad, N s/m].
        force_range: [N m, N]; infinite where nothing limits the actuators.
        frequency: natural frequency on the largest inertia of a few configurations, the other coordinates held [Hz].
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
class Actuation:
    """What drives one coordinate in the original model.

    Attributes:
        force_range: sum over its actuators, referred to the coordinate [N m, N].
        gains: kp and kv referred to the coordinate, of the one plain position servo that moves nothing else.
        remark: why there are no gains, or empty.
    """

    force_range: tuple[float, float]
    gains: tuple[float, float] | None
    remark: str


def gain_parameters(servo: Servo) -> tuple[Floats, Floats]:
    """MuJoCo's gain and bias parameters, ten each."""
    return np.array([servo.kp, *np.zeros(9)]), np.array([0.0, -servo.kp, -servo.kv, *np.zeros(7)])


def reduced_inertia(model: mujoco.MjModel, configurations: Floats, rates: Floats) -> Floats:
    """Inertia ``(S, n, n)``, armature included, at configurations ``(S, nq)``.

    ``rates`` are as in `force_ranges`, ``(nv, n)`` or, where they differ, ``(S, nv, n)``.
    """
    data = mujoco.MjData(model)
    rates = np.broadcast_to(rates, (len(configurations), *rates.shape[-2:]))
    columns = np.zeros((len(configurations), rates.shape[-1], model.nv))
    for at, basis, data.qpos[:] in zip(columns, rates, configurations, strict=True):
        mujoco.mj_fwdPosition(model, data)
        for column, rate in zip(at, basis.T, strict=True):
            mujoco.mj_mulM(model, data, column, rate)
    return columns @ rates


def largest_inertia(model: mujoco.MjModel, configurations: Floats, rates: Floats) -> Floats:
    """Largest inertia ``(n,)`` of each coordinate over the configurations ``(S, nq)``, the other coordinates held."""
    return np.asarray(np.diagonal(reduced_inertia(model, configurations, rates), axis1=1, axis2=2).max(axis=0))


def growth(
    model: mujoco.MjModel, inertia: Floats, dofs: Sequence[Dof], servos: tuple[Servo, ...], timestep: float
) -> float:
    """Largest factor by which one step of MuJoCo's integrator multiplies a small error of the servo loops.

    Linearised, without springs and Coriolis forces: M dv/dt = -K q - (D + Kv) v, one step of the semi-implicit Euler
    method (D implicit; with the implicit methods, Kv too).
    """
    rates = np.array([dof.rates for dof in dofs])
    stiffness, gains = (np.diag([getattr(servo, gain) for servo in servos]) for gain in ("kp", "kv"))
    damping = rates @ np.diag(model.dof_damping) @ rates.T
    h, identity = timestep, np.eye(len(servos))
    implicit = damping.copy()
    if model.opt.integrator != int(mujoco.mjtIntegrator.mjINT_EULER):
        implicit += gains
    mass = inertia + h * implicit
    from_q, from_v = (-h * np.linalg.solve(mass, m) for m in (stiffness, damping + gains))
    step = np.block([[identity + h * from_q, h * (identity + from_v)], [from_q, identity + from_v]])
    return float(np.abs(np.linalg.eigvals(step)).max())
