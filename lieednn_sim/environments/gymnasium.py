"""The tasks as Gymnasium environments ``LieEDNN/TelescopicReach-v0`` and ``LieEDNN/TelescopicTrack-v0``.

Gymnasium finds environments of other packages when their module was imported, or is named, as in
``gymnasium.make("lieednn_sim.environments.gymnasium:LieEDNN/TelescopicReach-v0")``. With
``gymnasium.make_vec(..., num_envs=64, vectorization_mode="vector_entry_point")`` many are stepped at once by
`mujoco.rollout`, in threads.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from lieednn_sim._mujoco import QuietWarnings, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.environments.observations import Bounds, LinkFrames, Observation, State, Target
from lieednn_sim.environments.tasks import make_task
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.rendering.camera import Camera, check_view
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_choice, as_count, as_floats, as_seed, as_workers, quoted
from lieednn_sim.values import Floats, StrPath

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.utils import seeding
    from gymnasium.vector import AutoresetMode
    from gymnasium.vector.utils import batch_space
except ImportError:
    raise LieEDNNError("this module needs gymnasium: pip install 'lieednn_sim[gymnasium]'") from None

__all__ = ["ENVIRONMENTS", "Environment", "VectorEnvironment"]

#: Name of the task of each registered Gymnasium environment, by the environment's id.
ENVIRONMENTS = {"LieEDNN/TelescopicReach-v0": "reach", "LieEDNN/TelescopicTrack-v0": "track"}

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


def observations(bounds: Bounds, flat: bool) -> tuple[spaces.Space[Any], Callable[[Observation], Any]]:
    """Space of a task's observations, and the function that returns one or many as they are, or each as a vector."""
    space = spaces.Dict({name: spaces.Box(low, high, dtype=np.float64) for name, (low, high) in bounds.items()})
    if not flat:
        return space, lambda seen: seen
    return spaces.flatten_space(space), lambda seen: np.concatenate(
        [seen[name].reshape(*seen["position"].shape[:-1], -1) for name in space], axis=-1
    )


class Environment(gymnasium.Env[Any, Floats]):
    """A task as a Gymnasium environment, whose episodes are truncated at the task's time limit.

    ``reset(options={"target": q})`` chooses the target of a `Reach` episode.

    Args:
        task: a name of `tasks.TASKS`.
        render_mode: ``"rgb_array"`` or None.
        size: (width, height) of rendered frames, both even, at most 3840x2160.
        preset: rendering quality, a name of `rendering.video.PRESETS`.
        flat: whether observations are one vector, `gymnasium.spaces.flatten` of the dictionary.
        arm, scene, options: see `ArmTask`, `Reach` and `Track`.

    Attributes:
        task: the task.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012 (Gymnasium's own)

    def __init__(
        self,
        task: str = "reach",
        *,
        arm: StrPath | Arm = "telescopic_pr",
        scene: StrPath = "free",
        render_mode: str | None = None,
        size: tuple[int, int] = (640, 480),
        preset: str = "draft",
        flat: bool = False,
        **options: Any,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise InputError(f"render_mode must be 'rgb_array' or None, got {quoted(render_mode)}")
        self.task = make_task(task, arm, scene=scene, **options)
        check_view(self.task.arm, camera=None, size=size, preset=preset)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.task.control_timestep)}
        self._size, self._preset = size, preset
        self._camera: Camera | None = None
        self._resources = contextlib.ExitStack()
        self.observation_space, self._shown = observations(self.task.bounds, flat)
        self.action_space = spaces.Box(-1.0, 1.0, (self.task.arm.n_joints,), np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; see Gymnasium, and `Reach` for the option ``target``."""
        super().reset(seed=None if seed is None else as_seed("seed", seed))
        observation = self.task.begin(self.np_random, options)
        return self._shown(observation), self.task.state.info()

    def step(self, action: Floats) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Do one control step; terminated when the simulation failed, truncated at the time limit; see `ArmTask`."""
        observation, *others = self.task.step(action)
        return self._shown(observation), *others

    def render(self) -> Any:
        """Frame ``(height, width, 3)`` now with a marker at the target, or None without a mode; raises as `Camera`."""
        if self.render_mode is None:
            return None
        if self._camera is None:
            self._camera = self._resources.enter_context(Camera(self.task.arm, size=self._size, preset=self._preset))
        self._camera.mark(self.task.target(self.task.time))
        return self._camera.picture(self.task.simulation.q)

    def close(self) -> None:
        """Free the OpenGL context; closing again is harmless, and rendering makes a new one."""
        self._resources.close()
        self._camera = None


class VectorEnvironment(gymnasium.vector.VectorEnv[Any, Floats, Any]):
    """Many environments that are stepped together, as a Gymnasium vector environment.

    Each is equal to an `Environment` with its seed, up to rounding.

    Args:
        num_envs: number of environments, B.
        task, arm, scene, flat, options: as for `Environment`.
        autoreset_mode: when the next episode begins, see Gymnasium.
        threads: number of threads; by default, the number of processors.
        max_episode_steps: control steps after which episodes are truncated, if the time limit is later; -1 for none.

    Attributes:
        task: the definition of the task; its own episode is not used.
    """

    def __init__(
        self,
        num_envs: int = 1,
        task: str = "reach",
        *,
        arm: StrPath | Arm = "telescopic_pr",
        scene: StrPath = "free",
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        flat: bool = False,
        max_episode_steps: int = -1,
        **options: Any,
    ) -> None:
        self.task = make_task(task, arm, scene=scene, **options)
        longest = self.task.steps if max_episode_steps == -1 else as_count("max_episode_steps", max_episode_steps)
        self._steps = min(self.task.steps, longest)
        self.num_envs = as_count("num_envs", num_envs, most=2**16)
        if not isinstance(autoreset_mode, AutoresetMode):
            modes = [mode.value for mode in AutoresetMode]
            autoreset_mode = AutoresetMode(as_choice("autoreset_mode", autoreset_mode, modes))
        self.autoreset_mode = autoreset_mode
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_fps": round(1.0 / self.task.control_timestep)}
        self.single_observation_space, self._shown = observations(self.task.bounds, flat)
        self.single_action_space = spaces.Box(-1.0, 1.0, (self.task.arm.n_joints,), np.float64)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        workers = as_workers("threads", threads)
        self._rollouts, self._model = rollout.Rollout(nthread=workers), self.task.simulation.model
        self._data = [mujoco.MjData(self._model) for _ in range(workers)]
        self._link_frames = LinkFrames(self.task.arm, self._model, self._data[0], self.task.frames)
        self._home = self.task.arm.keyframe("home")
        self.task.simulation.reset(self._home)
        self._first = np.zeros(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self.task.simulation.data, self._first, _STATE)
        self._states = np.tile(self._first, (num_envs, 1))
        command, row = (np.zeros((num_envs, size)) for size in (len(self._home), self.task.observations.size))
        # Before the first reset, all episodes are over.
        steps, success, failure = np.full(num_envs, self._steps), np.zeros(num_envs, dtype=bool), [""] * num_envs
        reward, distance, angle = np.zeros((3, num_envs))
        self._seen = State(steps, command, row, reward, success, distance, angle, np.array(failure, dtype=object))
        self._targets: dict[int, Target] = {}
        self._generators = [seeding.np_random()[0] for _ in range(num_envs)]

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes, with seed + i in environment i; ``options`` may hold Gymnasium's ``reset_mask``."""
        if seed is None or isinstance(seed, int | np.integer):
            seed = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise InputError(f"seed must be a number or a list of {self.num_envs}, got one of {len(seed)}")
        chosen = dict(options or {})
        try:
            mask = np.asarray(chosen.pop("reset_mask", np.ones(self.num_envs, dtype=bool)))
        except ValueError:
            mask = np.empty(0)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise InputError(f"reset_mask must be an array of {self.num_envs} truth values, at least one of them true")
        which = np.flatnonzero(mask)
        for i in which:
            if (own := seed[i]) is not None:
                self._generators[i] = seeding.np_random(as_seed("seed", own))[0]
        self._begin(which, chosen)
        return self._observed(), self._infos(mask)

    def step(self, actions: Floats) -> tuple[Any, Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Do one control step with actions ``(B, n)``; an environment that begins an episode ignores its action.

        `InputError` if an episode is over and autoreset is disabled.
        """
        given = as_floats("actions", actions, (self.num_envs, self.task.arm.n_joints))
        task, seen = self.task, self._seen
        waiting = seen.over(self._steps)
        if waiting.any() and self.autoreset_mode == AutoresetMode.DISABLED:
            raise InputError(f"the episodes of environments {np.flatnonzero(waiting)} are over: reset them first")
        self._advance(np.flatnonzero(~waiting), given)
        terminated = ~waiting & (seen.failure != "")
        truncated = ~waiting & ~terminated & seen.over(self._steps)
        rewards, infos = np.where(waiting, 0.0, seen.reward), dict[str, Any]()
        for i in np.flatnonzero(terminated).tolist():
            infos = self._add_info(infos, {"failure": seen.failure[i]}, i)
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            over = terminated | truncated
            for i in np.flatnonzero(over).tolist():
                last = State._make(values[i] for values in seen)
                shown = self._shown(task.observations.split(last.row.copy()))
                infos = self._add_info(infos, {"final_obs": shown, "final_info": last.info()}, i)
            waiting |= over
        self._begin(np.flatnonzero(waiting), {})
        return self._observed(), rewards, terminated, truncated, infos | self._infos(np.ones_like(waiting))

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the threads."""
        self._rollouts.close()

    def _observed(self) -> Any:
        # Contiguous copies, since later steps change the row.
        return self._shown({name: seen.copy() for name, seen in self.task.observations.split(self._seen.row).items()})

    def _infos(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        infos = dict[str, Any]()
        for name in ("success", "distance", "angle"):
            infos[name], infos[f"_{name}"] = getattr(self._seen, name) * mask, mask.copy()
        return infos

    def _begin(self, which: NDArray[np.int_], options: dict[str, Any]) -> None:
        """Begin episodes of some environments."""
        # All targets are drawn first, since drawing may fail, and then no episode must have ended.
        drawn = {i: self.task.draw(self._generators[i], dict(options)) for i in which.tolist()}
        self._targets |= drawn
        self._states[which] = self._first
        self._look(which, np.zeros_like(which), np.tile(self._home, (len(which), 1)))

    def _advance(self, which: NDArray[np.int_], actions: Floats) -> None:
        """Step some environments with their actions among ``(B, n)``."""
        if not len(which):
            return
        task, seen, before = self.task, self._seen, self._states[which]
        start = seen.command[which]
        command = task.commands.moved(start, actions[which])
        controls = task.commands.controls(start, command)
        with QuietWarnings():
            after = self._rollouts.rollout(self._model, self._data, before, controls)[0][:, -1]
        # After a warning, MuJoCo's time stops or restarts.
        late = np.abs(after[:, 0] - before[:, 0] - task.control_timestep) > 0.5 * task.simulation.timestep
        failed = late | ~np.isfinite(after).all(axis=1)
        for i, state, own in zip(which[failed].tolist(), before[failed], controls[failed], strict=True):
            # The reason is found by repeating the control step, one physics step after the other.
            mujoco.mj_setState(self._model, task.simulation.data, state, _STATE)
            task.simulation.steps = int(seen.steps[i]) * task.substeps
            seen.failure[i] = task.simulate(own) or "the state is not finite"
            seen.reward[i], seen.success[i] = 0.0, False
        good = which[~failed]
        self._states[good] = after[~failed]
        self._look(good, seen.steps[good] + 1, command[~failed])

    def _look(self, which: NDArray[np.int_], steps: NDArray[np.int_], command: Floats) -> None:
        """Update states and observations of some environments."""
        if not len(which):
            return
        qpos, qvel = np.split(self._states[which, 1 : 1 + self._model.nq + self._model.nv], [self._model.nq], axis=1)
        rows = (self._targets[i].after(k) for i, k in zip(which.tolist(), steps.tolist(), strict=True))
        target = [np.array(values) for values in zip(*rows, strict=True)]
        result = self.task.look(steps, command, qpos, qvel, self._link_frames.at(qpos), *target)
        for known, values in zip(self._seen, result, strict=True):
            known[which] = values


for _id, _task in ENVIRONMENTS.items():
    if _id not in gymnasium.registry:
        _places = f"{__name__}:Environment", f"{__name__}:VectorEnvironment"
        gymnasium.register(_id, _places[0], vector_entry_point=_places[1], kwargs={"task": _task})


typecheck_public(globals())
