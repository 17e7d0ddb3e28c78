"""The simulation of a task as dm_control's physics.

dm_control decides at its import which OpenGL it renders by, so importing this module chooses one.
"""

from __future__ import annotations

from lieednn_sim._mujoco import mujoco
from lieednn_sim.environments.base import ArmTask
from lieednn_sim.rendering import opengl

opengl.configure()

from dm_control.mujoco import Physics, wrapper  # noqa: E402


class TaskPhysics(Physics):  # type: ignore[misc]  # dm_control has no types
    """Model and data of a task's simulation, shared with it: what is read, set and rendered is what is simulated.

    Its steps are the simulation's: dm_control holds the controls during a control step, and the servos follow the
    command at every physics step. A copy has no task, and is a physics of dm_control like any other.
    """

    _task: ArmTask | None = None

    def __init__(self, task: ArmTask) -> None:
        self._task = task
        super().__init__(wrapper.MjData(task.simulation.data))

    def step(self, nstep: int = 1) -> None:
        """Do physics steps; a failure of the simulation is told to the task, which ends the episode."""
        if self._task is None:
            super().step(nstep)
            return
        self._task.advance(nstep)
        if not self._task.failure:
            # As after dm_control's own steps, what follows from positions and velocities is up to date.
            mujoco.mj_step1(self.model.ptr, self.data.ptr)
