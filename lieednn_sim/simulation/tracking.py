"""A planned motion followed by the simulated arm, with a controller chosen by name."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.planning import Plan
from lieednn_sim.planning.motion import Motion, steps_of_rate
from lieednn_sim.simulation.controllers import make_controller
from lieednn_sim.simulation.controllers.base import Controller, Inputs
from lieednn_sim.simulation.disturbances import Disturbances
from lieednn_sim.simulation.log import ChannelSource, Log
from lieednn_sim.simulation.plant import make_plant
from lieednn_sim.simulation.reference import Reference
from lieednn_sim.simulation.rollout import Rollout
from lieednn_sim.simulation.simulation import Simulation
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats


def make_controlled(
    arm: Arm, controller: str, reference: Reference, disturbances: Disturbances
) -> tuple[Controller, Simulation]:
    """A controller by name, and the simulation of the plant that it drives, without visual geoms."""
    bare = arm.without_visuals
    driver = make_controller(controller, bare, reference)
    plant = make_plant(bare, disturbances, driver.add_bodies)
    driver.equip(plant)
    return driver, Simulation(arm, plant, disturbances=disturbances)


def as_hold(value: float) -> float:
    """Return the time after a motion [s] when it can be simulated, or raise `InputError`."""
    hold = float(as_floats("hold", value, ()))
    # A longer one is an error of units, and would take gigabytes.
    if not 0.0 <= hold <= 1000.0:
        raise InputError(f"hold must be between 0 and 1000 s, got {hold:g}")
    return hold


def as_motion(arm: Arm, motion: Plan | Motion) -> Motion:
    """Return a motion, or that of a plan, when the arm can follow it, or raise `InputError`."""
    motion = motion.motion if isinstance(motion, Plan) else motion
    if motion.q.shape[1] != arm.n_joints:
        raise InputError(f"the motion has {motion.q.shape[1]} coordinates, arm {arm.name!r} has {arm.n_joints}")
    step = arm.timestep
    if not np.isclose(motion.timestep, step, rtol=1e-9):
        raise InputError(f"the motion is sampled every {motion.timestep:g} s, the model steps every {step:g} s")
    return motion


def at_rest_after(motion: Motion, rows: int) -> tuple[Floats, Floats]:
    """Joint coordinates and rates ``(rows, n)`` of a motion and of the rest at its end."""
    extra = ((0, rows - len(motion.q)), (0, 0))
    return np.pad(motion.q, extra, "edge"), np.pad(motion.qd, extra)


def as_reference(arm: Arm, motion: Motion, rows: int, rate: float | None) -> Reference:
    """A motion and the rest at its end, seen at a rate [Hz] or at every step."""
    hold = 1 if rate is None else steps_of_rate("reference_rate", rate, arm.timestep)
    return Reference.of(arm, *at_rest_after(motion, rows), hold=hold)


def simulate(
    arm: Arm,
    motion: Plan | Motion,
    *,
    target: ArrayLike | None = None,
    controller: str = "position-servo",
    hold: float = 1.0,
    reference_rate: float | None = None,
    disturbances: Disturbances | None = None,
    log: Sequence[ChannelSource] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Rollout:
    """Simulate an arm whose controller tracks a motion and then holds its end.

    The simulation starts at rest at the motion's first position, and is a function of its arguments alone: two runs
    are bit-identical.

    Args:
        arm: the arm; its model is not changed.
        motion: a plan, or a motion sampled at the model's time step.
        target: ``(n,)`` joint position to reach; by default the plan's, or the motion's end.
        controller: a name of `CONTROLLERS`.
        hold: time after the end of the motion [s].
        reference_rate: rate of the samples of the motion that the controller sees, held in between [Hz]; a divisor of
            the simulation's rate. By default it sees every step.
        disturbances: disturbances unknown to the controller.
        log: further quantities to log, each a `Channel`; the rollout has them in ``channels``.
        progress: called with (done, total) steps, about every tenth of a second.

    Raises:
        InputError: the motion does not fit the model, or two channels have one name.
        SimulationError: a warning of MuJoCo or a state that is not finite; it has the run up to there.
    """
    if target is None and isinstance(motion, Plan):
        target = motion.target
    motion = as_motion(arm, motion)
    total = len(motion.t) + round(as_hold(hold) / arm.timestep)
    rate = None if reference_rate is None else as_positive("reference_rate", reference_rate)
    reference = as_reference(arm, motion, total, rate)
    changes = Disturbances() if disturbances is None else disturbances
    meta: dict[str, Any] = {"motion": motion, "controller": controller, "reference_rate": rate, "disturbances": changes}
    if target is not None:
        meta["target"] = arm.check_position(target, "target")
    driver, simulation = make_controlled(arm, controller, reference, changes)
    simulation.reset(reference.q[0])
    drive = _drive(driver, simulation, total)
    record = Log(simulation, driver, *log)
    shown, end = time.monotonic(), float(motion.t[-1])
    try:
        with QuietWarnings():
            for k in range(total):
                drive(k)
                record.step()
                if progress is not None and (time.monotonic() - shown > 0.1 or k == total - 1):
                    shown = time.monotonic()
                    progress(k + 1, total)
    except SimulationError as error:
        if len(record) > 1:
            end = len(record) * arm.timestep
            # What was logged may be out of range before the state is.
            with contextlib.suppress(InputError):
                error.rollout = record.rollout(reference.q, reference.qd, motion_end=end, **meta)
        raise
    return record.rollout(reference.q, reference.qd, motion_end=end, **meta)


def _drive(driver: Controller, simulation: Simulation, total: int) -> Callable[[int], None]:
    """A function that sets the controls of a step after a reset; they are computed beforehand if possible."""
    model, data, inputs = simulation.model, simulation.data, driver.inputs(range(total), simulation.first_noise(total))
    if inputs is None:
        return lambda k: driver.act(data, k, simulation.noise)
    kind, rows = joined(inputs)
    return lambda k: mujoco.mj_setState(model, data, rows[k], kind)


def joined(inputs: Inputs) -> tuple[int, Floats]:
    """Arguments of `mj_setState` for inputs of m steps: the parts of the state, and a row ``(m, size)`` per step."""
    kinds = sorted(inputs, key=int)
    return sum(map(int, kinds)), np.concatenate([inputs[kind].reshape(len(inputs[kind]), -1) for kind in kinds], axis=1)
