"""Many environments of one task at once, as a vector environment of Gymnasium, stepped by `mujoco.rollout` in threads.

import gymnasium

name = "lieednn_sim.environments.gymnasium:LieEDNN/TelescopicReach-v0"
environments = gymnasium.make_vec(name, num_envs=64, vectorization_mode="vector_entry_point")
"""

from __future__ import annotations

import copy
import os
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from mujoco import rollout
from numpy.typing import NDArray

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.environments.bounds import Bounds
from lieednn_sim.environments.frames import frames_at
from lieednn_sim.environments.tasks import make_task
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice, as_count, as_floats, as_seed, as_workers
from lieednn_sim.values import Floats

Stepped = tuple[dict[str, Floats], Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_MOST_ENVIRONMENTS = 2**16


def observation_space(bounds: Bounds) -> spaces.Dict:
    """Space of a task's observations."""
    return spaces.Dict({name: spaces.Box(low, high, dtype=np.float64) for name, (low, high) in bounds.items()})


class VectorEnvironment(gymnasium.vector.VectorEnv[dict[str, Floats], Floats, Any]):
    """B environments, each equal to an `Environment` with its seed; with NumPy 2.4 to the last bit.

    Args:
        num_envs: B.
        task: a name of `tasks.TASKS`.
        arm: name of an arm of the package, or an arm.
        scene: as for `Environment`.
        autoreset_mode: when the next episode begins, see Gymnasium.
        threads: number of threads; by default, the number of processors.
        options: further options of the task, see `ArmTask`, `Reach` and `Track`.

    Attributes:
        tasks: tasks of the environments; they share an arm and a simulation.

    Raises:
        InputError: an argument is malformed.
    """

    def __init__(
        self,
        num_envs: int = 1,
        task: str = "reach",
        *,
        arm: str | os.PathLike[str] | Arm = "telescopic_pr",
        scene: str | os.PathLike[str] = "free",
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        **options: Any,
    ) -> None:
        first = make_task(task, arm, scene=scene, **options)
        self.num_envs = as_count("num_envs", num_envs, most=_MOST_ENVIRONMENTS)
        self.tasks = [copy.copy(first) for _ in range(num_envs)]
        if not isinstance(autoreset_mode, AutoresetMode):
            modes = [mode.value for mode in AutoresetMode]
            autoreset_mode = AutoresetMode(as_choice("autoreset_mode", autoreset_mode, modes))
        self.autoreset_mode = autoreset_mode
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_fps": round(1.0 / first.control_timestep)}
        self.single_observation_space = observation_space(first.bounds)
        self.single_action_space = spaces.Box(-1.0, 1.0, (first.arm.n_joints,), np.float64)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        workers = as_workers("threads", os.cpu_count() or 1 if threads is None else threads)
        self._rollouts, self._model = rollout.Rollout(nthread=workers), first.simulation.model
        self._data = [mujoco.MjData(self._model) for _ in range(workers)]
        self._states = np.zeros((num_envs, mujoco.mj_stateSize(self._model, _STATE)))
        self._seen = np.zeros((num_envs, first.observations.size))
        self._judged = {"success": np.zeros(num_envs, dtype=bool), "distance": np.zeros(num_envs)}
        self._judged["angle"] = np.zeros(num_envs)
        self._commands = np.zeros((num_envs, first.arm.n_joints))
        self._over = np.ones(num_envs, dtype=bool)
        self._generators: list[np.random.Generator | None] = [None] * num_envs

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Floats], dict[str, Any]]:
        """Begin episodes, with seed + i in environment i; ``options`` may hold Gymnasium's ``reset_mask``."""
        if seed is None or isinstance(seed, int | np.integer):
            seed = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise InputError(f"seed must be a number or a list of {self.num_envs}, got one of {len(seed)}")
        seeds = list(seed)
        chosen = dict(options or {})
        try:
            mask = np.asarray(chosen.pop("reset_mask", np.ones(self.num_envs, dtype=bool)))
        except ValueError:
            mask = np.empty(0)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise InputError(f"reset_mask must be an array of {self.num_envs} truth values, one of them true")
        infos: dict[str, Any] = {}
        for i in np.flatnonzero(mask):
            if (own := seeds[i]) is not None:
                self._generators[i] = seeding.np_random(as_seed("seed", own))[0]
            infos = self._begin(int(i), infos, chosen)
        return self._observed(), infos

    def step(self, actions: Floats) -> Stepped:
        """Do one control step with actions ``(B, n)``; environments that begin an episode ignore theirs.

        Raises:
            InputError: actions are malformed or not finite, or an episode is over and autoreset is disabled.
        """
        share = as_floats("actions", actions, (self.num_envs, self.tasks[0].arm.n_joints))
        rewards, terminated = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=bool)
        waiting = self._over.copy()
        infos: dict[str, Any] = {}
        if waiting.any() and self.autoreset_mode == AutoresetMode.DISABLED:
            raise InputError(f"the episodes of environments {np.flatnonzero(waiting)} are over: reset them first")
        going = np.flatnonzero(~waiting)
        if len(going):
            rewards[going], terminated[going], infos = self._advance(going, share[going])
        truncated = np.array([task.over for task in self.tasks]) & ~terminated & ~waiting
        for i in np.flatnonzero(waiting):
            infos = self._begin(int(i), infos, {})
        self._over = terminated | truncated
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            for i in np.flatnonzero(self._over):
                last = self.tasks[0].observations.split(self._seen[i].copy())
                infos = self._add_info(infos, {"final_obs": last, "final_info": self._info(int(i))}, int(i))
                infos = self._begin(int(i), infos, {})
            self._over = np.zeros(self.num_envs, dtype=bool)
        return self._observed(), rewards, terminated, truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        self._rollouts.close()

    def _observed(self) -> dict[str, Floats]:
        # Contiguous copies.
        return {name: values.copy() for name, values in self.tasks[0].observations.split(self._seen).items()}

    def _begin(self, i: int, infos: dict[str, Any], options: dict[str, Any]) -> dict[str, Any]:
        task, generator = self.tasks[i], self._generators[i]
        if generator is None:
            generator = self._generators[i] = seeding.np_random()[0]
        task.begin(generator, options)
        self._seen[i] = task.row
        mujoco.mj_getState(self._model, task.simulation.data, self._states[i], _STATE)
        self._commands[i] = task.command
        for name, value in task.info().items():
            self._judged[name][i] = value
        self._over[i] = False
        return self._add_info(infos, self._info(i), i)

    def _info(self, i: int) -> dict[str, Any]:
        info = {name: values[i].item() for name, values in self._judged.items()}
        return info | ({"failure": self.tasks[i].failure} if self.tasks[i].failure else {})

    def _advance(self, going: NDArray[np.int_], actions: Floats) -> tuple[Floats, NDArray[np.bool_], dict[str, Any]]:
        """Step some environments; returns their rewards, whether they failed, and infos."""
        first, model = self.tasks[0], self._model
        before, start = self._states[going], self._commands[going]
        end = first.commands.moved(start, actions)
        controls = first.commands.controls(start, end)
        with QuietWarnings():
            after = self._rollouts.rollout(model, self._data, before, controls)[0][:, -1]
        # After a warning, MuJoCo's time stands still, or restarts.
        late = np.abs(after[:, 0] - before[:, 0] - first.control_timestep) > 0.5 * first.simulation.timestep
        failed = late | ~np.isfinite(after).all(axis=1)
        self._commands[going] = end
        failures = {int(going[k]): self._failure(int(going[k]), before[k], controls[k]) for k in np.flatnonzero(failed)}
        for i, command in zip(going.tolist(), end, strict=True):
            self.tasks[i].took(command, failures.get(i, ""))
        rewards = np.zeros(len(going))
        good = np.flatnonzero(~failed)
        if len(good):
            self._states[going[good]] = after[good]
            rewards[good] = self._look(going[good])
        infos: dict[str, Any] = {}
        self._judged["success"][going[failed]] = False
        for name, values in self._judged.items():
            infos[name], infos[f"_{name}"] = np.zeros_like(values), np.zeros(self.num_envs, dtype=bool)
            infos[name][going], infos[f"_{name}"][going] = values[going], True
        for i, why in failures.items():
            infos = self._add_info(infos, {"failure": why}, i)
        return rewards, failed, infos

    def _look(self, which: NDArray[np.int_]) -> Floats:
        """Update the observations of some environments, and return their rewards."""
        first, data, model = self.tasks[0], self._data[0], self._model
        qpos, qvel = np.split(self._states[which, 1 : 1 + model.nq + model.nv], [model.nq], axis=1)
        frames = frames_at(first.arm, model, data, qpos, first.frames)
        q = first.arm.space.from_qpos(qpos)
        qd = first.arm.space.from_qvel(q, qvel)
        target = [np.array(values) for values in zip(*(self.tasks[i].here() for i in which), strict=True)]
        self._seen[which], distance, angle = first.observations.rows(frames, q, qd, self._commands[which], target)
        rewards, success = first.judge(distance, angle, qd)
        for values, judged in zip(self._judged.values(), (success, distance, angle), strict=True):
            values[which] = judged
        return rewards

    def _failure(self, i: int, state: Floats, controls: Floats) -> str:
        """The reason why a control step failed, found by repeating it step by step."""
        task = self.tasks[i]
        mujoco.mj_setState(self._model, task.simulation.data, state, _STATE)
        return task.failure_of(controls)
