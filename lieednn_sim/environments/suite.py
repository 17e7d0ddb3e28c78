"""The tasks in the style of the dm_control suite: `load` returns a `dm_control.rl.control.Environment`."""

from __future__ import annotations

import os
from collections import OrderedDict
from typing import Any

import dm_env
import numpy as np
from dm_control.rl import control
from dm_env import specs

from lieednn_sim.arm import Arm
from lieednn_sim.environments.base import ArmTask
from lieednn_sim.environments.tasks import make_task
from lieednn_sim.simulation import Simulation
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_generator, as_seed
from lieednn_sim.values import Floats

__all__ = ["ControlEnvironment", "load"]


def load(
    arm: str | os.PathLike[str] | Arm = "telescopic_pr",
    task: str = "reach",
    *,
    random: int | np.random.Generator | None = None,
    **options: Any,
) -> ControlEnvironment:
    """Load an environment.

    Args:
        arm: name of an arm, or an arm.
        task: a name of `TASKS`.
        random: seed or generator of everything random; None for a fresh generator.
        options: options of the task, see `ArmTask`, `Reach` and `Track`.

    Raises:
        InputError: an argument is malformed.
    """
    return ControlEnvironment(make_task(task, arm, **options), random=random)


class ControlTask(control.Task):  # type: ignore[misc]  # dm_control has no types
    """A task with the interface of dm_control. Arguments ``physics`` are ignored, since the task has its simulation.

    Args:
        task: the task.
        random: generator of its episodes.
    """

    def __init__(self, task: ArmTask, random: np.random.Generator) -> None:
        self.task, self.random = task, random

    def initialize_episode(self, physics: Any) -> None:
        """Begin an episode."""
        self.task.begin(self.random)

    def before_step(self, action: Floats, physics: Any) -> None:
        """Move the command by an action ``(n,)``."""
        self.task.before_step(action)

    def after_step(self, physics: Any) -> None:
        """Update the observations; after its steps a `TaskPhysics` has up-to-date link frames."""
        self.task.after_step(current=True)

    def get_observation(self, physics: Any) -> OrderedDict[str, Floats]:
        """Observed arrays by name."""
        return OrderedDict(self.task.observe())

    def get_reward(self, physics: Any) -> float:
        """The task's reward; 0 if the simulation failed."""
        return 0.0 if self.task.failure else self.task.reward()

    def get_termination(self, physics: Any) -> float | None:
        """Discount at the end of an episode: 0 if the simulation failed, 1 at the time limit; otherwise None."""
        return None if not self.task.over else 0.0 if self.task.failure else 1.0

    def action_spec(self, physics: Any) -> specs.BoundedArray:
        """Joint velocities as shares of their limits."""
        joints = ", ".join(self.task.arm.joint_names)
        return specs.BoundedArray((self.task.arm.n_joints,), np.float64, -1.0, 1.0, name=f"joint velocities ({joints})")

    def observation_spec(self, physics: Any) -> OrderedDict[str, specs.BoundedArray]:
        """Observed arrays by name, with their bounds."""
        return OrderedDict(
            (name, specs.BoundedArray(low.shape, np.float64, low, high, name=name))
            for name, (low, high) in self.task.bounds.items()
        )


class ControlEnvironment(control.Environment):  # type: ignore[misc]  # dm_control has no types
    """A task behind the interface of dm_control: ``physics.render()`` and dm_control's wrappers work on it.

    Episodes end with discount 1 at their time limit, and with discount 0 if the simulation fails. A step raises
    `InputError` if the action is malformed or not finite, and begins a new episode if the last one is over.

    Attributes:
        task: the task.
        physics: its simulation as a `dm_control.mujoco.Physics`, see `TaskPhysics`.
    """

    def __init__(self, task: ArmTask, *, random: int | np.random.Generator | None = None) -> None:
        from lieednn_sim.environments.physics import TaskPhysics

        # dm_control renders the simulated model, which must have its visual geoms.
        task.run_in(Simulation(task.arm))
        generator = np.random.default_rng() if random is None else as_generator("random", random)
        super().__init__(TaskPhysics(task), ControlTask(task, generator), n_sub_steps=task.substeps)

    @property
    def task(self) -> ArmTask:
        """The task."""
        return self._task.task

    def reset(self, seed: int | None = None) -> dm_env.TimeStep:
        """Begin an episode.

        Args:
            seed: restarts the random numbers, as if the environment had been loaded with it; not part of dm_env's
                interface.
        """
        if seed is not None:
            self._task.random = np.random.default_rng(as_seed("seed", seed))
        return super().reset()

    def reward_spec(self) -> specs.BoundedArray:
        """Rewards are in [0, 1]."""
        return specs.BoundedArray((), np.float64, 0.0, 1.0, name="reward")


typecheck_public(globals())
