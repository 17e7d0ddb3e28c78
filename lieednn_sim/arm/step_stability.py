"""Whether the time steps of a model let motions near rest grow, by their linearisation."""

from __future__ import annotations

import copy

import numpy as np

from lieednn_sim._mujoco import mujoco, scratch_data
from lieednn_sim.values import Floats

_GROWING = 1.01  # growth in one step, far more than that by rounding or of a falling link


def without_stops(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model, changed: without sleep, contacts, limits, and dry friction, which hides how things swing."""
    model.dof_frictionloss[:] = model.tendon_frictionloss[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT)
    model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    return model


def step_growth(model: mujoco.MjModel, qpos: Floats) -> float:
    """Spectral radius of one step of the whole model, at rest with the servos commanded to the configuration."""
    data = scratch_data(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    data.ctrl[:] = data.actuator_length
    size = 2 * model.nv + model.na
    transition = np.zeros((size, size))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, transition, None, None, None)
    finite = np.isfinite(transition).all()
    return float(np.abs(np.linalg.eigvals(transition)).max(initial=0.0)) if finite else np.inf


def step_remedy(model: mujoco.MjModel, qpos: Floats) -> str:
    """What makes the steps of a model unstable at rest at ``(nq,)``, and a remedy; empty if nothing is found."""
    model = without_stops(copy.deepcopy(model))
    option = model.opt
    if model.nhistory or step_growth(model, qpos) < _GROWING:  # MuJoCo does not linearise delays
        return ""
    euler, step = option.integrator == int(mujoco.mjtIntegrator.mjINT_EULER), option.timestep
    before = "Euler" if euler else mujoco.mjtIntegrator(option.integrator).name.removeprefix("mjINT_").lower()
    told = f"steps near rest are unstable with integrator {before} and timestep {step:g}, and stable with"
    if euler:
        option.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        if step_growth(model, qpos) < _GROWING:
            return f'{told} <option integrator="implicitfast"/>'
    for option.timestep in step / 2.0 ** np.arange(1, 5):
        if step_growth(model, qpos) < _GROWING:
            return f'{told} <option integrator="implicitfast" timestep="{option.timestep:g}"/>'
    return ""
