"""Many motions at once: states of rollouts with known controls, by `mujoco.rollout` in threads."""

from __future__ import annotations

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
from lieednn_sim.simulation.controllers.base import Controller
from lieednn_sim.simulation.disturbances import Disturbances, before
from lieednn_sim.simulation.reference import Reference
from lieednn_sim.simulation.rollout import Rollout
from lieednn_sim.simulation.simulation import Simulation
from lieednn_sim.simulation.tracking import (
    as_hold,
    as_loaded,
    as_motion,
    at_rest_after,
    joined,
    make_controlled,
    simulate,
)
from lieednn_sim.validation import as_count, as_workers
from lieednn_sim.values import Floats, frozen


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
        motion = self.motions[as_count("index", index, -len(self), len(self) - 1)]
        return simulate(self.arm, motion, hold=self.t[-1] - as_motion(self.arm, motion).t[-1], **self.settings)


def simulate_many(
    arm: Arm,
    motions: Sequence[Plan | Motion],
    *,
    controller: str = "position-servo",
    hold: float = 1.0,
    disturbances: Disturbances | None = None,
    threads: int | None = None,
) -> Rollouts:
    """Simulate many motions in threads, as `simulate` does one, and keep their states; all end at the same time.

    Args:
        arm: the arm; its model is not changed.
        motions: plans, or motions sampled at the model's time step.
        controller: name of a controller whose controls follow from the reference alone.
        hold: time simulated after the end of the longest motion [s]; the others are held longer.
        disturbances: disturbances of each rollout.
        threads: number of threads; by default, the number of processors.

    Raises:
        InputError: there are no motions, one does not fit the model, the controller needs the state, or obstacles move.
    """
    if disturbances is not None and disturbances.obstacles:
        raise InputError("obstacles move in single rollouts alone, those of simulate and follow")
    arm = as_loaded(arm, *motions)
    if not (chosen := [as_motion(arm, motion) for motion in motions]):
        raise InputError("motions must hold at least one motion or plan")
    total = max(len(motion.t) for motion in chosen) + round(as_hold(hold) / arm.timestep)
    changes = before((total - 1) * arm.timestep, arm.timestep, disturbances)
    settings = {"controller": controller, "disturbances": changes}
    q, qd, ctrl = (np.full((len(chosen), total, n), np.nan) for n in (arm.n_joints, arm.n_joints, arm.model.nu))
    failures: dict[int, str] = {}
    workers = min(as_workers("threads", threads), len(chosen))

    def work(first: int) -> None:
        """Simulate every ``workers``-th motion from ``first`` on with one controller and plant: making them is slow."""
        reference = Reference(arm, total)
        driver, simulation = make_controlled(arm, controller, reference, changes)
        for index in range(first, len(chosen), workers):
            reference.forget(reference.known)
            reference.extend(*at_rest_after(chosen[index], total))
            states, controls = _states(driver, simulation, reference, controller)
            if simulation.data.warning.number.any() or not np.isfinite(states).all():
                failures[index] = _failure(arm, chosen[index], total, settings)
                continue
            qpos, qvel = np.split(states[:-1, 1 : 1 + arm.model.nq + arm.model.nv], [arm.model.nq], axis=1)
            q[index] = arm.coordinates(qpos)
            qd[index] = arm.rates(q[index], qvel)
            ctrl[index] = controls

    with QuietWarnings(), ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(workers)))
    t = arm.timestep * np.arange(total, dtype=float)
    return Rollouts(arm, tuple(motions), t, q, qd, ctrl, dict(sorted(failures.items())), settings)


def _states(
    driver: Controller, simulation: Simulation, reference: Reference, controller: str
) -> tuple[Floats, Floats | float]:
    """The states ``(K + 1, size)`` along a reference, in MuJoCo's order, and the controls ``(K, nu)`` of its steps."""
    model, data, total, kind = simulation.model, simulation.data, len(reference.q), mujoco.mjtState.mjSTATE_FULLPHYSICS
    simulation.reset(reference.q[0])
    inputs = driver.inputs(range(total), simulation.sensors.first(total))
    if inputs is None:
        raise InputError(
            f"the controller {controller} needs the state at every step, so its rollouts are made one by one, by "
            "simulate; many at once take one whose controls are known beforehand: "
            "position-servo, inverse-dynamics, mocap or mocap-deadbeat"
        )
    if simulation.disturbances.pushes:
        inputs[mujoco.mjtState.mjSTATE_XFRC_APPLIED] = simulation.pushes.forces(range(total))
    parts, rows = joined(inputs)
    start = np.empty((1, mujoco.mj_stateSize(model, kind)))
    mujoco.mj_getState(model, data, start[0], kind)
    after = rollout.rollout(model, data, start, rows[None], control_spec=parts)[0]
    return np.concatenate([start, after[0]]), inputs.get(mujoco.mjtState.mjSTATE_CTRL, 0.0)


def _failure(arm: Arm, motion: Motion, total: int, settings: dict[str, Any]) -> str:
    """The error message of `simulate` for a rollout that fails."""
    try:
        simulate(arm, motion, hold=arm.timestep * (total - len(motion.t)), **settings)
    except SimulationError as error:
        return str(error)
    raise AssertionError("a rollout fails among others, but not by itself")
