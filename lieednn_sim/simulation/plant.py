"""The simulated model: the arm's own, with the bodies of a controller and the changes by disturbances."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
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
    """
    changes = Disturbances() if disturbances is None else disturbances
    if add_bodies is None and changes.payload == 0.0:
        plant = copy.deepcopy(arm.model)
    else:
        spec: Any = arm.spec.copy()
        if add_bodies is not None:
            add_bodies(spec)
        if changes.payload > 0.0:
            _add_payload(spec, arm, changes.payload)
        plant = spec.compile()
        # The compiler derives servo damping from the inertia, which would include the payload.
        plant.actuator_gainprm[:], plant.actuator_biasprm[:] = arm.model.actuator_gainprm, arm.model.actuator_biasprm
    if changes.mass_scale != 1.0:
        known = np.array([plant.body(i).name != _PAYLOAD for i in range(plant.nbody)])
        plant.body_mass[known] *= changes.mass_scale
        plant.body_inertia[known] *= changes.mass_scale
        plant.body_gravcomp[known] /= changes.mass_scale
        mujoco.mj_setConst(plant, mujoco.MjData(plant))
    return plant


def _add_payload(spec: Any, arm: Arm, mass: float) -> None:
    """Add a ball at the end effector's frame, without collisions and gravity compensation."""
    tip = arm.frames[-1:]
    # The inertia is that of a ball of steel, 7850 kg/m^3.
    radius = (3.0 * mass / (4.0 * np.pi * 7850.0)) ** (1.0 / 3.0)
    spec.body(arm.model.body(int(tip.bodies[0])).name).add_body(
        name=_PAYLOAD,
        pos=tip.positions[0],
        mass=mass,
        ipos=[0.0, 0.0, 0.0],
        inertia=[0.4 * mass * radius**2] * 3,
        explicitinertial=True,
    )
