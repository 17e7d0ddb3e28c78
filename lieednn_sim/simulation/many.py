"""Many motions at once: states of rollouts with known controls, by `mujoco.rollout` in threads."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import field
from typing import Any

import numpy as np
from mujoco import rollout

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.planning import Plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.registry import CONTROLLERS
from lieednn_sim.simulation.controllers import make_controller
from lieednn_sim.simulation.controllers.base import Controller
from lieednn_sim.simulation.disturbances import Disturbances
from lieednn_sim.simulation.plant import make_plant
from lieednn_sim.simulation.rollout import Rollout
from lieednn_sim.simulation.simulation import Simulation
from lieednn_sim.simulation.tracking import as_hold, as_motion, as_reference, joined, simulate
from lieednn_sim.validation import as_count, as_positive, as_workers
from lieednn_sim.values import Floats, frozen

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_PUSHES = mujoco.mjtState.mjSTATE_XFRC_APPLIED


@frozen
class Rollouts:
    """States of B simulations at the same K times; all last as long as the longest one.

    Each is equal to that of `simulate` to the last bit.

    Attributes:
        arm: the simulated arm.
        motions: the motions that were followed.
        t: ``(K,)`` times [s].
        q: ``(B, K, n)`` joint coordinates [rad, m]; NaN where a simulation failed.
        qd: ``(B, K, n)`` their rates [rad/s, m/s].
        ctrl: ``(B, K, nu)`` actuator controls.
        failures: reasons of failed simulations, by index.
        settings: arguments of `simulate` other than arm, motion and hold.
    """

    arm: Arm
    motions: tuple[Plan | Motion, ...]
    t: Floats
    q: Floats
    qd: Floats
    ctrl: Floats
    failures: Mapping[int, str]
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return B."""
        return len(self.motions)

    def __repr__(self) -> str:
        return f"<Rollouts of {self.arm.name}: {len(self)} of {self.t[-1]:g} s, {len(self.failures)} failed>"

    def rollout(self, index: int) -> Rollout:
        """One rollout with its whole log, simulated again; raises `SimulationError` if it failed."""
        if as_count("index", index, -len(self)) >= len(self):
            raise InputError(f"index must be below {len(self)}, the number of rollouts, got {index}")
        motion = self.motions[index]
        return simulate(self.arm, motion, hold=self.t[-1] - as_motion(self.arm, motion).t[-1], **self.settings)


def simulate_many(
    arm: Arm,
    motions: Sequence[Plan | Motion],
    *,
    controller: str = "position-servo",
    hold: float = 1.0,
    reference_rate: float | None = None,
    disturbances: Disturbances | None = None,
    threads: int | None = None,
) -> Rollouts:
    """Simulate many motions in threads, as `simulate` does one, and keep their states; all end at the same time.

    Args:
        arm: the arm; its model is not changed.
        motions: plans, or motions sampled at the model's time step.
        controller: name of a controller whose controls follow from the reference alone.
        hold: time simulated after the end of the longest motion [s]; the others are held longer.
        reference_rate: as for `simulate`.
        disturbances: disturbances of each rollout.
        threads: number of threads; by default, the number of processors.

    Raises:
        InputError: there are no motions, one does not fit the model, the controller needs the state, or obstacles move.
    """
    if disturbances is not None and disturbances.obstacles:
        raise InputError("obstacles move in single rollouts alone, those of simulate and follow")
    if not (chosen := [as_motion(arm, motion) for motion in motions]):
        raise InputError("motions must hold at least one motion or plan")
    total = max(len(motion.t) for motion in chosen) + round(as_hold(hold) / arm.timestep)
    rate = None if reference_rate is None else as_positive("reference_rate", reference_rate)
    bare, changes = arm.without_visuals, Disturbances() if disturbances is None else disturbances
    CONTROLLERS.find(controller)  # before the work
    settings = {"controller": controller, "reference_rate": rate, "disturbances": changes}
    q = np.full((len(chosen), total, arm.n_joints), np.nan)
    qd, ctrl = q.copy(), np.full((len(chosen), total, arm.model.nu), np.nan)
    failures: dict[int, str] = {}
    own = threading.local()

    def run(index: int) -> None:
        reference = as_reference(arm, chosen[index], total - len(chosen[index].t), rate)
        if hasattr(own, "simulation"):
            own.reference.become(reference)
        else:
            # Once per thread: setting up a controller takes long and is the same for every motion.
            own.reference, own.driver = reference, make_controller(controller, bare, reference)
            plant = make_plant(bare, changes, own.driver.add_bodies if own.driver.adds_bodies else None)
            own.driver.equip(plant)
            own.simulation = Simulation(bare, plant, disturbances=changes)
        driver: Controller = own.driver
        simulation: Simulation = own.simulation
        model, data = simulation.model, simulation.data
        simulation.reset(reference.q[0])
        inputs = driver.inputs(range(total), simulation.first_noise(total))
        if inputs is None:
            raise InputError(
                f"the controller {controller} needs the state at every step, so its rollouts are made one by one, by "
                "simulate; many at once take one whose controls are known beforehand: "
                "position-servo, inverse-dynamics, mocap or mocap-deadbeat"
            )
        if changes.pushes:
            inputs[_PUSHES] = simulation.pushes.forces(range(total))
        kind, rows = joined(inputs)
        states = np.empty((1, total + 1, mujoco.mj_stateSize(model, _STATE)))
        mujoco.mj_getState(model, data, states[0, 0], _STATE)
        states[:, 1:] = rollout.rollout(model, data, states[:, 0], rows[None], control_spec=kind)[0]
        if data.warning.number.any() or not np.isfinite(states).all():
            failures[index] = _failure(arm, chosen[index], total, settings)
            return
        qpos, qvel = np.split(states[0, :-1, 1 : 1 + model.nq + model.nv], [model.nq], axis=1)
        q[index] = arm.coordinates(qpos)
        qd[index] = arm.rates(q[index], qvel)
        ctrl[index] = inputs.get(mujoco.mjtState.mjSTATE_CTRL, 0.0)

    workers = as_workers("threads", os.cpu_count() or 1 if threads is None else threads)
    with QuietWarnings(), ThreadPoolExecutor(workers) as pool:
        for _ in pool.map(run, range(len(chosen))):
            pass
    t = arm.timestep * np.arange(total, dtype=float)
    return Rollouts(arm, tuple(motions), t, q, qd, ctrl, dict(sorted(failures.items())), settings)


def _failure(arm: Arm, motion: Motion, total: int, settings: dict[str, Any]) -> str:
    """The error message of `simulate` for a rollout that fails."""
    try:
        simulate(arm, motion, hold=arm.timestep * (total - len(motion.t)), **settings)
    except SimulationError as error:
        return str(error)
    raise AssertionError("a rollout fails among others, but not by itself")
