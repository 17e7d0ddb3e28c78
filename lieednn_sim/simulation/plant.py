"""The simulated model: the arm's own, with the bodies of a controller and the changes by disturbances."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.grasp import load_body
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.simulation.disturbances import Disturbances


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
    loaded = arm if view else arm.with_payload(changes.payload)
    if add_bodies is None:
        plant = copy.deepcopy(loaded.model)
    else:
        spec = loaded.copied_spec()
        add_bodies(spec)
        plant = spec.compile()
        plant.actuator_gainprm[:], plant.actuator_biasprm[:] = arm.model.actuator_gainprm, arm.model.actuator_biasprm
    if changes.mass_scale != 1.0:
        own = np.flatnonzero(moved_together(arm.model, arm.dofs))
        if plant.nbody > arm.model.nbody:
            own = np.array([plant.body(arm.model.body(k).name).id for k in own.tolist()])
        plant.body_mass[own] *= changes.mass_scale
        plant.body_inertia[own] *= changes.mass_scale
        plant.body_gravcomp[own] /= changes.mass_scale
    if view and changes.payload > 0.0:
        load_body(plant, arm, changes.payload)
    elif changes.mass_scale != 1.0:
        mujoco.mj_setConst(plant, mujoco.MjData(plant))
    return plant
