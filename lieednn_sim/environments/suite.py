"""The tasks in the manner of the dm_control suite: `load` returns a `dm_env.Environment`."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import dm_env
import numpy as np
from dm_env import specs
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.environments.base import ArmTask, Observation
from lieednn_sim.environments.tasks import TASKS, make_task
from lieednn_sim.validation import as_generator, as_seed

Floats = NDArray[np.float64]


def all_tasks() -> tuple[tuple[str, str], ...]:
    """All pairs of an arm of the package and a task."""
    return tuple((arm, task) for arm in arm_names() for task in TASKS)


def load(
    arm: str | Arm = "telescopic_pr",
    task: str = "reach",
    *,
    random: int | np.random.Generator | None = None,
    **options: Any,
) -> Environment:
    """An environment.

    Args:
        arm: name of an arm, or an arm.
        task: a name of `TASKS`.
        random: seed or generator of all that is random; None for a fresh one.
        options: of the task, see `ArmTask`, `Reach` and `Track`.

    Raises:
        InputError: an argument is malformed.
    """
    return Environment(make_task(task, arm, **options), random=random)


class Environment(dm_env.Environment):  # type: ignore[misc]  # dm_env has no types
    """A task behind the interface of dm_env.

    An episode that reaches its time limit ends with discount 1, one whose simulation fails with discount 0.

    Attributes:
        task: the task.
    """

    def __init__(self, task: ArmTask, *, random: int | np.random.Generator | None = None) -> None:
        self.task = task
        self._rng = np.random.default_rng() if random is None else as_generator("random", random)
        self._reset_next = True
        joints = ", ".join(task.arm.joint_names)
        self._action_spec = specs.BoundedArray(
            (task.arm.n_joints,), np.float64, -1.0, 1.0, name=f"joint velocities ({joints})"
        )
        self._observation_spec: OrderedDict[str, specs.BoundedArray] = OrderedDict(
            (name, specs.BoundedArray(low.shape, np.float64, low, high, name=name))
            for name, (low, high) in task.bounds.items()
        )

    def reset(self, seed: int | None = None) -> dm_env.TimeStep:
        """Begin an episode.

        Args:
            seed: begins the random numbers anew, as if the environment had been loaded with it; not part of dm_env's
                interface.
        """
        if seed is not None:
            self._rng = np.random.default_rng(as_seed("seed", seed))
        self._reset_next = False
        return dm_env.restart(self.task.begin(self._rng))

    def step(self, action: ArrayLike) -> dm_env.TimeStep:
        """Do one control step; begins an episode when the last one is over.

        Raises:
            InputError: the action is malformed or not finite.
        """
        if self._reset_next:
            return self.reset()
        after = self.task.step(action)
        self._reset_next = after.terminated or after.truncated
        if after.terminated:
            return dm_env.termination(after.reward, after.observation)
        if after.truncated:
            return dm_env.truncation(after.reward, after.observation)
        return dm_env.transition(after.reward, after.observation)

    def action_spec(self) -> specs.BoundedArray:
        """Joint velocities as shares of their limits."""
        return self._action_spec

    def observation_spec(self) -> OrderedDict[str, specs.BoundedArray]:
        """Arrays by name, see `ArmTask`."""
        return self._observation_spec

    def reward_spec(self) -> specs.BoundedArray:
        """In [0, 1]."""
        return specs.BoundedArray((), np.float64, 0.0, 1.0, name="reward")

    def control_timestep(self) -> float:
        """Time between actions [s]."""
        return self.task.control_timestep

    def observation(self) -> Observation:
        """Observations of the present time."""
        return self.task.observe()
