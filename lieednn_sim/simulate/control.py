"""Controllers: what to send to the actuators so that the arm follows a reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError

Floats = NDArray[np.float64]


class PositionServo:
    """Position actuators with velocity feedforward: ctrl = q_ref + (kv / kp) qd_ref.

    A position actuator pulls with kp (ctrl - q) - kv qd, so without the second term it lags a moving reference by
    kv / kp seconds. The velocity is taken one step ahead of the position, because implicitfast damps with the velocity
    at the end of the step.

    Raises:
        InputError: an actuator is not a position actuator on one joint.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        joints = model.actuator_trnid[:, 0]
        stiffness, damping = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
        if (
            (model.actuator_trntype != mujoco.mjtTrn.mjTRN_JOINT).any()
            or (model.actuator_biasprm[:, 1] != -stiffness).any()
            or (stiffness <= 0.0).any()
        ):
            raise InputError("the position servo needs position actuators on joints, one for each coordinate")
        self._coordinates = model.jnt_qposadr[joints]
        self._lead = (damping / stiffness)[None, :]

    def commands(self, q_ref: Floats, qd_ref: Floats) -> Floats:
        """Controls ``(K, nu)`` for a reference ``(K, 2N)`` sampled at the simulation's time steps."""
        ahead = np.vstack([qd_ref[1:], qd_ref[-1:]])
        return q_ref[:, self._coordinates] + self._lead * ahead[:, self._coordinates]
