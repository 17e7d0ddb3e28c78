"""The simulation of a task as dm_control's physics.

dm_control chooses its OpenGL backend at import, so importing this module configures one first.
"""

from __future__ import annotations

from lieednn_sim._mujoco import mujoco
from lieednn_sim.environments.base import ArmTask
from lieednn_sim.rendering import opengl

opengl.configure()

from dm_control.mujoco import Physics, wrapper  # noqa: E402


class TaskPhysics(Physics):  # type: ignore[misc]  # dm_control has no types
    """Model and data of a task's simulation, shared with it, so that dm_control reads, sets and renders its state.

    Its steps are those of the simulation, in which the servos follow the command at every physics step, whereas
    dm_control would hold the controls during a control step. A copy has no task, and is an ordinary dm_control physics.
    """

    _task: ArmTask | None = None

    def __init__(self, task: ArmTask) -> None:
        self._task = task
        super().__init__(wrapper.MjData(task.simulation.data))

    def step(self, nstep: int = 1) -> None:
        """Do physics steps; if the simulation fails, the task ends the episode."""
        if self._task is None:
            super().step(nstep)
            return
        self._task.advance(nstep)
        if not self._task.failure:
            # As after dm_control's own steps, values derived from positions and velocities are up to date.
            mujoco.mj_step1(self.model.ptr, self.data.ptr)
