"""The tasks as Gymnasium environments ``LieEDNN/TelescopicReach-v0`` and ``LieEDNN/TelescopicTrack-v0``.

Gymnasium finds environments of other packages when their module is named or imported::

    import gymnasium

    environment = gymnasium.make("lieednn_sim.environments.gymnasium:LieEDNN/TelescopicReach-v0")

or, after ``import lieednn_sim.environments.gymnasium``, by the name alone.
"""

from __future__ import annotations

import contextlib
import os
from typing import Any

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.environments.observations import Observation
from lieednn_sim.environments.tasks import make_task
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.rendering.video import Camera, check_view
from lieednn_sim.values import Floats

try:
    import gymnasium
    from gymnasium import spaces
except ImportError:
    raise LieEDNNError("this module needs gymnasium: pip install 'lieednn_sim[gymnasium]'") from None

from lieednn_sim.environments.vector import VectorEnvironment, observation_space
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_seed, quoted

__all__ = ["ENVIRONMENTS", "Environment", "VectorEnvironment"]

#: Name of the task of each registered Gymnasium environment, by the environment's id.
ENVIRONMENTS = {"LieEDNN/TelescopicReach-v0": "reach", "LieEDNN/TelescopicTrack-v0": "track"}


class Environment(gymnasium.Env[Any, Floats]):
    """A task as a Gymnasium environment, which is truncated at the task's own time limit.

    ``reset(options={"target": q})`` chooses the target of a `Reach` episode.

    Args:
        task: a name of `tasks.TASKS`.
        arm: name of an arm of the package, or an arm.
        scene: obstacles around it, a name of `arm.scenes.SCENES` or a file, see `Arm.with_scene`.
        render_mode: ``"rgb_array"`` or None.
        size: (width, height) of rendered frames, both even, at most 3840x2160.
        preset: rendering quality, a name of `rendering.video.PRESETS`.
        flat: whether observations are one vector, `gymnasium.spaces.flatten` of the dictionary.
        options: further options of the task, see `ArmTask`, `Reach` and `Track`.

    Attributes:
        task: the task.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012 (Gymnasium's own)

    def __init__(
        self,
        task: str = "reach",
        *,
        arm: str | os.PathLike[str] | Arm = "telescopic_pr",
        scene: str | os.PathLike[str] = "free",
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
        self._space = observation_space(self.task.bounds)
        self.observation_space = spaces.flatten_space(self._space) if flat else self._space
        self.action_space = spaces.Box(-1.0, 1.0, (self.task.arm.n_joints,), np.float64)
        self._flat = flat

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
            self._camera = Camera(self.task.arm, size=self._size, preset=self._preset)
            self._resources.push(self._camera)
        self._camera.mark(self.task.target(self.task.time))
        return self._camera.picture(self.task.simulation.q)

    def close(self) -> None:
        """Free the OpenGL context; closing again is harmless, and rendering makes a new one."""
        self._resources.close()
        self._camera = None

    def _shown(self, observation: Observation) -> Any:
        return spaces.flatten(self._space, observation) if self._flat else observation


for _id, _task in ENVIRONMENTS.items():
    if _id not in gymnasium.registry:
        _places = f"{__name__}:Environment", f"{__name__}:VectorEnvironment"
        gymnasium.register(_id, _places[0], vector_entry_point=_places[1], kwargs={"task": _task})


typecheck_public(globals())
