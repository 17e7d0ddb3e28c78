"""Rows of the benchmark that compare rollouts and environments with MuJoCo's bare steps."""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from benchmark_timing import Row, seconds, time_ratios
from gymnasium.vector import AsyncVectorEnv
from mujoco import rollout

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.environments.gymnasium import Environment, VectorEnvironment
from lieednn_sim.planning import plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.simulation import Disturbances, Rollout, Simulation, simulate, simulate_many
from lieednn_sim.simulation.controllers import make_controller
from lieednn_sim.simulation.plant import make_plant
from lieednn_sim.simulation.reference import Reference

_NSTEP, _LOOP = "a bare call of mj_step with nstep", "a bare Python loop of mj_step"
_NOISE = Disturbances(position_noise=1e-4, velocity_noise=1e-3)
# The package simulates no visual geoms, which do not change the motion, so there are two floors; aims are of the first.
_WHOLE, _BARE = " on the whole model", " without visual geoms"
_FLOORS = {_WHOLE: False, _BARE: True}


def floor(arm: Arm, controller: str, followed: Rollout, bare: bool) -> Simulation:
    """A plant at the start of a rollout, with the controls of its first step, with or without visual geoms."""
    arm = arm.without_visuals if bare else arm
    driver = make_controller(controller, arm, Reference.of(arm, followed.q_ref, followed.qd_ref))
    plant = make_plant(arm, None, driver.add_bodies if driver.adds_bodies else None)
    driver.equip(plant)
    simulation = Simulation(arm, plant)
    simulation.reset(followed.q[0])
    driver.act(simulation.data, 0, simulation.noise)
    return simulation


def _step_by_step(model: mujoco.MjModel, data: mujoco.MjData, steps: int) -> None:
    for _ in range(steps):
        mujoco.mj_step(model, data)


def rollout_rows(arm: Arm, motion: Motion, repeats: int) -> list[Row]:
    """Steps/s of rollouts with their log, in those of bare ones of the same arm."""
    rows = []
    cases = [(name, Disturbances(), _NSTEP) for name in ("position-servo", "inverse-dynamics", "mocap")]
    cases += [("computed-torque", Disturbances(), _LOOP), ("computed-torque", _NOISE, _LOOP)]
    cases += [("position-servo", _NOISE, _LOOP)]
    for controller, changes, rival in cases:
        ours = partial(simulate, arm, motion, controller=controller, disturbances=changes)
        followed = ours()
        for label, bare in _FLOORS.items():
            simulation = floor(arm, controller, followed, bare)
            run = partial(mujoco.mj_step if rival == _NSTEP else _step_by_step, simulation.model, simulation.data)
            name = f"{controller}{' with noise' if changes == _NOISE else ''}, in those of {rival}{label}"
            samples = time_ratios(partial(run, len(followed.t)), ours, repeats)
            aim = "" if bare else ">= 0.8" if rival == _NSTEP else ">= 0.6"
            rows.append(Row(f"steps/s of a rollout by {name}", samples, aim))
    return rows


def many_rows(arm: Arm, count: int, repeats: int) -> list[Row]:
    """Steps/s of many rollouts at once, in those of `mujoco.rollout` with as many threads."""
    motions = [plan(arm, draw_target(arm, k), planner="minimum-jerk").motion for k in range(count)]
    threads, kind, rows = os.cpu_count() or 1, mujoco.mjtState.mjSTATE_FULLPHYSICS, []
    ours = partial(simulate_many, arm, motions, hold=0.0, threads=threads)
    found = ours()
    for label, bare in _FLOORS.items():
        simulation = floor(arm, "position-servo", found.rollout(0), bare)
        model, data = simulation.model, [mujoco.MjData(simulation.model) for _ in range(threads)]
        states = np.zeros((count, mujoco.mj_stateSize(model, kind)))
        for state in states:
            mujoco.mj_getState(model, simulation.data, state, kind)
        rival = partial(rollout.rollout, model, data, states, np.ascontiguousarray(found.ctrl))
        name = f"steps/s of {count} rollouts by simulate_many, in those of mujoco.rollout{label}"
        rows.append(Row(name, time_ratios(rival, ours, repeats), "" if bare else ">= 0.9"))
    return rows


def empty_environment(arm: Arm, substeps: int) -> Any:
    """An environment of dm_control with the same physics, whose task has neither observations nor rewards."""
    control = importlib.import_module("dm_control.rl.control")
    engine = importlib.import_module("dm_control.mujoco")

    class Nothing(control.Task):  # type: ignore[name-defined, misc]  # dm_control has no types
        def initialize_episode(self, physics: Any) -> None:
            pass

        def action_spec(self, physics: Any) -> None:
            pass

        def before_step(self, action: Any, physics: Any) -> None:
            pass

        def get_observation(self, physics: Any) -> dict[str, Any]:
            return {}

        def get_reward(self, physics: Any) -> float:
            return 0.0

    physics = engine.Physics(engine.wrapper.MjData(mujoco.MjData(arm.model)))
    return control.Environment(physics, Nothing(), n_sub_steps=substeps)


def environment_rows(arm: Arm, repeats: int, actions: int) -> list[Row]:
    """Time that environments add to bare substeps, in both interfaces."""
    own, rows = Environment(arm=arm), list[Row]()
    substeps = own.task.substeps
    environments: dict[str, Any] = {"Gymnasium": own}
    resets: dict[str, Callable[[], object]] = {"Gymnasium": partial(own.reset, seed=0)}
    # dm_control does not support MuJoCo 4.
    if importlib.util.find_spec("dm_control") is not None:
        suite = importlib.import_module("lieednn_sim.environments.suite").load(arm, "reach", random=0)
        environments |= {"dm_control": suite, "dm_control with an empty task": empty_environment(arm, substeps)}
        resets |= {"dm_control": partial(suite.reset, seed=0)}
    given = 0.3 * np.random.default_rng(0).uniform(-1.0, 1.0, (actions, arm.n_joints))
    for name, environment in environments.items():
        # dm_control simulates the model that it renders.
        bare = {_BARE: arm.without_visuals.model} if environment is own else {}
        for label, model in {"": arm.model, **bare}.items():
            data, added, ratios = mujoco.MjData(model), [], []
            for _ in range(repeats):
                resets.get(name, environment.reset)()
                mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
                ours = seconds(lambda steps=environment.step: [steps(action) for action in given])  # type: ignore[misc]
                alone = seconds(lambda m=model, d=data: [mujoco.mj_step(m, d, substeps) for _ in given])  # type: ignore[misc]
                added.append(1e6 * (ours - alone) / actions)
                ratios.append(ours / alone)
            of = f"environment step of {name}"
            rows.append(Row(f"{of}, in its {substeps} bare substeps{label}", ratios))
            rows.append(
                Row(f"{of}, added to its {substeps} bare substeps{label} [us]", added, "" if label else "<= 10")
            )
    return rows


def vector_rows(arm: Arm, repeats: int, actions: int, count: int) -> list[Row]:
    """Steps/s of many environments at once, and of their physics alone, in those of Gymnasium's processes."""
    own, processes = VectorEnvironment(count, arm=arm), AsyncVectorEnv([partial(Environment, arm=arm.name)] * count)
    some, task = 0.3 * np.random.default_rng(0).uniform(-1.0, 1.0, (count, arm.n_joints)), own.task
    model, kind = task.simulation.model, mujoco.mjtState.mjSTATE_FULLPHYSICS
    data = [mujoco.MjData(model) for _ in range(os.cpu_count() or 1)]

    def run(environments: gymnasium.vector.VectorEnv[Any, Any, Any]) -> None:
        for _ in range(actions):
            environments.step(some)

    own.reset(seed=0)
    processes.reset(seed=0)
    states = np.zeros((count, mujoco.mj_stateSize(model, kind)))
    mujoco.mj_getState(model, task.simulation.data, states[0], kind)
    states[:] = states[0]
    home = np.tile(arm.keyframe("home"), (count, 1))
    controls = task.commands.controls(home, task.commands.moved(home, some))
    # Wall time: processes and threads run on all cores.
    name, clock = f"of {count} environments at once, in those of Gymnasium's AsyncVectorEnv", time.perf_counter
    with rollout.Rollout(nthread=len(data)) as threads:

        def physics() -> None:
            for _ in range(actions):
                threads.rollout(model, data, states, controls)

        rows = [
            Row(f"steps/s {name}", time_ratios(partial(run, processes), partial(run, own), repeats, clock), ">= 10"),
            Row(f"steps/s of the physics alone {name}", time_ratios(partial(run, processes), physics, repeats, clock)),
        ]
    own.close()
    processes.close()
    return rows


def stepping_rows(arm: Arm, motion: Motion, repeats: int, scale: int) -> list[Row]:
    """All rows of this module, with a fraction 1 / ``scale`` of rollouts, actions and environments."""
    return [
        *rollout_rows(arm, motion, repeats),
        *many_rows(arm, max(256 // scale, 2), min(repeats, 3)),
        *environment_rows(arm, repeats, max(50 // scale, 2)),
        *vector_rows(arm, min(repeats, 5), max(20 // scale, 2), max(64 // scale, 2)),
    ]
