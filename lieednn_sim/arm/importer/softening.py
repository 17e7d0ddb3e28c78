"""Servos that are slow enough for the soft ties between the stages of a telescope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.servos import Dof, Servo, gain_parameters
from lieednn_sim.values import Floats

# Least decay rate of the motions of tied stages [1/s], and the factors by which their servos are slowed down for it.
_DECAY, _SOFTER = 10.0, 0.8 ** np.arange(13)


def soften(
    spec: mujoco.MjSpec, qpos: Floats, dofs: list[Dof], servos: tuple[Servo, ...], names: list[str]
) -> tuple[Servo, ...]:
    """Slow down the designed servos of coupled stages, which act on one stage, until their soft ties can keep up.

    The fastest servos are taken with which the model's slowest mode decays at 10 / s, or nearly as fast as with any
    slower ones, since other parts of the model may be slow by themselves. Dry friction is left out.

    Args:
        spec: the spec with the servos, which is changed.
        qpos: ``(nq,)`` posture of the whole model at which a step is linearised.
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
    choices = [tuple(_slower(s, factor) if k in tied else s for k, s in enumerate(servos)) for factor in _SOFTER]
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
    found = choices[next(i for i, decay in enumerate(decays) if decay >= min(_DECAY, best - 0.1 * abs(best)))]
    for k in tied:
        actuator = spec.actuator(names[k])
        actuator.gainprm, actuator.biasprm = gain_parameters(found[k])
    return found


def _slower(servo: Servo, factor: float) -> Servo:
    return replace(servo, kp=servo.kp * factor**2, kv=servo.kv * factor, frequency=servo.frequency * factor)


def _step_growth(model: mujoco.MjModel, qpos: Floats) -> float:
    """Spectral radius of one step of the whole model, at rest with the servos commanded to the posture."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    data.ctrl[:] = data.actuator_length
    size = 2 * model.nv + model.na
    transition = np.zeros((size, size))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, transition, None, None, None)
    return float(np.abs(np.linalg.eigvals(transition)).max())
