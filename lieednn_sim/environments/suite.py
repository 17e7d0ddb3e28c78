"""The tasks in the style of the dm_control suite: `load` returns a `dm_control.rl.control.Environment`."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import dm_env
import numpy as np
from dm_control.rl import control
from dm_env import specs

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.environments.base import ArmTask
from lieednn_sim.environments.tasks import make_task
from lieednn_sim.rendering import opengl
from lieednn_sim.simulation import Simulation
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_generator, as_seed
from lieednn_sim.values import Floats, StrPath

__all__ = ["ControlEnvironment", "load"]


def load(
    arm: StrPath | Arm = "telescopic_pr",
    task: str = "reach",
    *,
    random: int | np.random.Generator | None = None,
    **options: Any,
) -> ControlEnvironment:
    """Make an environment of a task in the style of the dm_control suite.

    Args:
        task: a name of `TASKS`.
        random: seed or generator of all random draws; None for a fresh generator.
        arm, options: those of the task, see `ArmTask`, `Reach` and `Track`.
    """
    return ControlEnvironment(make_task(task, arm, **options), random=random)


class ControlEnvironment(control.Environment):  # type: ignore[misc]  # dm_control has no types
    """A task behind the interface of dm_control: ``physics.render()`` and dm_control's wrappers work on it.

    Episodes end with discount 1 at their time limit, and with discount 0 if the simulation fails. A step raises
    `InputError` if the action is malformed or not finite, and begins a new episode if the last one is over.

    Attributes:
        task: the task.
        physics: a `dm_control.mujoco.Physics` that shares model and data with the task's simulation, so that
            dm_control reads, sets and renders its state.
    """

    def __init__(self, task: ArmTask, *, random: int | np.random.Generator | None = None) -> None:
        # dm_control chooses its OpenGL backend at import.
        opengl.configure()
        from dm_control.mujoco import Physics, wrapper

        self._random = np.random.default_rng() if random is None else as_generator("random", random)
        # dm_control renders the simulated model, which must have its visual geoms.
        task.run_in(Simulation(task.arm))
        super().__init__(Physics(wrapper.MjData(task.simulation.data)), task, n_sub_steps=task.substeps)

    def reset(self, seed: int | None = None) -> dm_env.TimeStep:
        """Begin an episode; a seed, which is not part of dm_env, restarts the random numbers as `load` would."""
        if seed is not None:
            self._random = np.random.default_rng(as_seed("seed", seed))
        with self._physics.reset_context():
            observation = self._task.begin(self._random)
        return dm_env.restart(OrderedDict(observation))

    def step(self, action: Floats) -> dm_env.TimeStep:
        """Do one control step with an action ``(n,)``, or begin an episode if the last one is over."""
        if self._task.over:
            return self.reset()
        observation, reward, terminated, truncated, _ = self._task.step(action)
        if terminated:
            return dm_env.termination(reward, OrderedDict(observation))
        # As after dm_control's own steps, values derived from positions and velocities are up to date.
        mujoco.mj_step1(self._task.simulation.model, self._task.simulation.data)
        return (dm_env.truncation if truncated else dm_env.transition)(reward, OrderedDict(observation))

    def action_spec(self) -> specs.BoundedArray:
        """Signed square roots of joint velocities as fractions of their limits."""
        joints = self._task.arm.joint_names
        return specs.BoundedArray((len(joints),), np.float64, -1.0, 1.0, name=f"joint velocities ({', '.join(joints)})")

    def observation_spec(self) -> OrderedDict[str, specs.BoundedArray]:
        """Observed arrays by name, with their bounds."""
        bounds = self._task.bounds.items()
        return OrderedDict((k, specs.BoundedArray(low.shape, np.float64, low, high, k)) for k, (low, high) in bounds)

    def reward_spec(self) -> specs.BoundedArray:
        """Rewards are in [0, 1]."""
        return specs.BoundedArray((), np.float64, 0.0, 1.0, name="reward")


typecheck_public(globals())
