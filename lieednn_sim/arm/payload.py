"""A mass at the end effector's frame: a ball of steel, without collisions and gravity compensation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError
from lieednn_sim.lie import rotations

if TYPE_CHECKING:
    from lieednn_sim.arm.serial_arm import SerialArm


def add_payload(spec: Any, arm: SerialArm, mass: float, name: str) -> None:
    """Add a ball [kg] to a copy of the arm's spec, as a body of that name."""
    tip = arm.frames[-1:]
    spec.body(arm.model.body(int(tip.bodies[0])).name).add_body(
        name=name,
        pos=tip.positions[0],
        mass=mass,
        ipos=[0.0, 0.0, 0.0],
        inertia=[_ball_inertia(mass)] * 3,
        explicitinertial=True,
    )


def load_body(model: mujoco.MjModel, arm: SerialArm, mass: float) -> None:
    """Add a ball [kg] to the mass and inertia of the end effector's body in a compiled model, which is changed.

    Raises:
        InputError: MuJoCo compensates that body for gravity, at its centre of mass.
    """
    tip = arm.frames[-1:]
    body, turn = int(tip.bodies[0]), np.empty(9)
    if model.body_gravcomp[body]:
        raise InputError(
            f"a payload cannot be added to {model.body(body).name!r} of a compiled model, whose gravity MuJoCo "
            "compensates at its centre of mass: set its gravcomp to zero, or add the payload to the model as a body"
        )
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    rotation, before = turn.reshape(3, 3), float(model.body_mass[body])
    whole = before + mass
    centre = (before * model.body_ipos[body] + mass * tip.positions[0]) / whole
    inertia = rotation @ np.diag(model.body_inertia[body]) @ rotation.T + _ball_inertia(mass) * np.eye(3)
    for part, place in ((before, model.body_ipos[body]), (mass, tip.positions[0])):
        off = place - centre
        inertia += part * (off @ off * np.eye(3) - np.outer(off, off))
    moments, axes = np.linalg.eigh(inertia)
    axes *= np.sign(np.linalg.det(axes))
    model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = whole, centre, moments
    model.body_iquat[body] = rotations(axes).as_quat(scalar_first=True)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _ball_inertia(mass: float) -> float:
    """Moment of inertia [kg m^2] of a ball of steel, 7850 kg/m^3."""
    radius = (3.0 * mass / (4.0 * np.pi * 7850.0)) ** (1.0 / 3.0)
    return float(0.4 * mass * radius**2)
