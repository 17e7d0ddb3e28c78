"""Commanded joint positions after actions, and the controls of servos, for many environments at once."""

from __future__ import annotations

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.simulation.actuators import Actuators
from lieednn_sim.values import Floats


class Commands:
    """Commands that move at constant velocity for one control step, followed by position servos with feedforward.

    Args:
        arm: the arm, whose limits scale the actions.
        substeps: number of physics steps in a control step.

    Raises:
        InputError: the arm is not driven by position actuators on joints or fixed tendons.
    """

    def __init__(self, arm: Arm, substeps: int) -> None:
        self._arm, self._actuators = arm, Actuators(arm)
        self._actuators.require_servos()
        self._damping = arm.model.dof_damping.copy()
        self._low, self._high = arm.position_limits.T
        self._timestep = substeps * arm.timestep
        parts = np.arange(substeps + 1)[:, None] / substeps
        self._before, self._after = 1.0 - parts, parts

    def moved(self, command: Floats, action: Floats) -> Floats:
        """Commanded positions ``(..., n)`` after actions ``(..., n)``, from those before them."""
        share = np.minimum(np.maximum(action, -1.0), 1.0)
        end = command + self._timestep * share * self._arm.velocity_limits
        end = np.minimum(np.maximum(end, self._low), self._high)
        return self._arm.within_angles(end) if len(self._arm.space.balls) else end

    def controls(self, start: Floats, end: Floats) -> Floats:
        """Controls ``(..., substeps, nu)`` that lead servos between commanded positions ``(..., n)``."""
        # Not start + share * (end - start), which may exceed a limit by rounding.
        q = self._before * start[..., None, :] + self._after * end[..., None, :]
        space = self._arm.space
        # Generalised velocities depend on the posture only with ball joints.
        postures = q[..., 1:, :] if len(space.balls) else end[..., None, :]
        qvel = space.to_qvel(postures, ((end - start) / self._timestep)[..., None, :])
        return self._actuators.servo_controls(space.to_qpos(q[..., :-1, :]), qvel, self._damping * qvel)
