"""An expert policy for all interfaces: it follows a LieEDNN plan, or the moving target."""

from __future__ import annotations

from typing import Any

import numpy as np

from lieednn_sim.environments.base import ArmTask
from lieednn_sim.environments.tasks import Track
from lieednn_sim.environments.trajectories import JointTrajectory, planned
from lieednn_sim.errors import InputError
from lieednn_sim.planning import OBSTACLE_PLANNER, planners, require_planner
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_choice, as_count, as_seed
from lieednn_sim.values import Floats

__all__ = ["Expert"]


class Expert:
    """A policy with access to the arm and the task.

    In `Reach` it plans a certified network's motion from ``home`` to each episode's target, around obstacles if there
    are any, and commands its positions, as fast as 90 % of the limits allow. In `Track` it commands the target's next
    position. Its actions are within [-1, 1].

    Args:
        environment: an `ArmTask`, an environment of `suite.load`, or a Gymnasium one, wrapped or not.
        planner: a name of `planning.PLANNERS`; by default a certified LieEDNN, and among obstacles `OBSTACLE_PLANNER`.
        candidates: number of networks drawn for a plan at first, see `trajectories.planned`.
        seed: seed of the draws.

    Raises:
        InputError: the environment is none of these, or there is no such planner.
        LieEDNNError: a library that the planner needs is not installed.
    """

    def __init__(self, environment: Any, *, planner: str | None = None, candidates: int = 2, seed: int = 0) -> None:
        inner = getattr(environment, "unwrapped", environment)
        task = inner if isinstance(inner, ArmTask) else getattr(inner, "task", None)
        if not isinstance(task, ArmTask):
            raise InputError(
                "environment must be an ArmTask, or made by suite.load or gymnasium.make from one of this package's, "
                f"got {type(environment).__name__}"
            )
        self._task = task
        if planner is None and task.arm.scene != "free":
            planner = OBSTACLE_PLANNER
        self._planner = None if planner is None else as_choice("planner", planner, planners())
        if self._planner is not None:
            require_planner(self._planner)
        self._candidates = as_count("candidates", candidates)
        self._seed = as_seed("seed", seed)
        self._episode = 0
        self._plan: JointTrajectory

    def act(self) -> Floats:
        """Action ``(n,)`` for the present time; it uses more of the task than the observations tell.

        Raises:
            PlanError: no plan was found for the episode's target.
            NotCertifiedError: no network could be certified for it.
        """
        task = self._task
        if task.episode == 0:
            raise InputError("the environment has not been reset")
        ahead = task.time + task.control_timestep
        wanted = task.target(ahead) if isinstance(task, Track) else self._reach(task).position(ahead)
        action = (wanted - task.command) / (task.control_timestep * task.arm.velocity_limits)
        return np.clip(action, -1.0, 1.0)

    def _reach(self, task: ArmTask) -> JointTrajectory:
        if self._episode != task.episode:
            self._plan = planned(
                task.arm, task.target(0.0), planner=self._planner, candidates=self._candidates, seed=self._seed
            )
            self._episode = task.episode
        return self._plan


typecheck_public(globals())
