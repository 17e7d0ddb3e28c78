"""The simulated model: the arm's own, with the bodies of a controller and the changes by disturbances."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.errors import InputError
from lieednn_sim.lie import rotations
from lieednn_sim.simulation.disturbances import Disturbances

_PAYLOAD = "unknown_payload"


def make_plant(
    arm: Arm, disturbances: Disturbances | None = None, add_bodies: Callable[[Any], None] | None = None
) -> mujoco.MjModel:
    """A model to simulate.

    Args:
        arm: the arm; neither its model nor its spec is changed.
        disturbances: what changes the arm itself is used; gravity compensation stays that of the arm without them.
        add_bodies: called with a copy of the arm's spec, to add bodies after the arm's.

    Raises:
        InputError: bodies are to be added to a view of a compiled model, or a payload to a body of one that MuJoCo
            compensates for gravity, at its centre of mass.
    """
    changes = Disturbances() if disturbances is None else disturbances
    view = arm.spec is None
    if add_bodies is None and (view or changes.payload == 0.0):
        plant = copy.deepcopy(arm.model)
    else:
        spec: Any = arm.copied_spec()
        if add_bodies is not None:
            add_bodies(spec)
        if changes.payload > 0.0:
            _add_payload(spec, arm, changes.payload)
        plant = spec.compile()
        # The compiler derives servo damping from the inertia, which would include the payload.
        plant.actuator_gainprm[:], plant.actuator_biasprm[:] = arm.model.actuator_gainprm, arm.model.actuator_biasprm
    if changes.mass_scale != 1.0:
        own = np.flatnonzero(moved_together(arm.model, arm.dofs))
        if plant.nbody > arm.model.nbody:
            own = np.array([plant.body(arm.model.body(k).name).id for k in own.tolist()])
        plant.body_mass[own] *= changes.mass_scale
        plant.body_inertia[own] *= changes.mass_scale
        plant.body_gravcomp[own] /= changes.mass_scale
    if view and changes.payload > 0.0:
        _load(plant, arm, changes.payload)
    if changes.mass_scale != 1.0 or (view and changes.payload > 0.0):
        mujoco.mj_setConst(plant, mujoco.MjData(plant))
    return plant


def _load(plant: mujoco.MjModel, arm: Arm, mass: float) -> None:
    """Add a ball at the end effector's frame to the mass and inertia of its body."""
    tip = arm.frames[-1:]
    body, turn = int(tip.bodies[0]), np.empty(9)
    if plant.body_gravcomp[body]:
        raise InputError(
            f"a payload cannot be added to {plant.body(body).name!r} of a compiled model, whose gravity MuJoCo "
            "compensates at its centre of mass: set its gravcomp to zero, or add the payload to the model as a body"
        )
    mujoco.mju_quat2Mat(turn, plant.body_iquat[body])
    rotation, before = turn.reshape(3, 3), float(plant.body_mass[body])
    whole = before + mass
    centre = (before * plant.body_ipos[body] + mass * tip.positions[0]) / whole
    inertia = rotation @ np.diag(plant.body_inertia[body]) @ rotation.T + _ball_inertia(mass) * np.eye(3)
    for part, place in ((before, plant.body_ipos[body]), (mass, tip.positions[0])):
        off = place - centre
        inertia += part * (off @ off * np.eye(3) - np.outer(off, off))
    moments, axes = np.linalg.eigh(inertia)
    axes *= np.sign(np.linalg.det(axes))
    plant.body_mass[body], plant.body_ipos[body], plant.body_inertia[body] = whole, centre, moments
    plant.body_iquat[body] = rotations(axes).as_quat(scalar_first=True)


def _ball_inertia(mass: float) -> float:
    """Moment of inertia [kg m^2] of a ball of steel, 7850 kg/m^3."""
    radius = (3.0 * mass / (4.0 * np.pi * 7850.0)) ** (1.0 / 3.0)
    return float(0.4 * mass * radius**2)


def _add_payload(spec: Any, arm: Arm, mass: float) -> None:
    """Add a ball at the end effector's frame, without collisions and gravity compensation."""
    tip = arm.frames[-1:]
    spec.body(arm.model.body(int(tip.bodies[0])).name).add_body(
        name=_PAYLOAD,
        pos=tip.positions[0],
        mass=mass,
        ipos=[0.0, 0.0, 0.0],
        inertia=[_ball_inertia(mass)] * 3,
        explicitinertial=True,
    )
