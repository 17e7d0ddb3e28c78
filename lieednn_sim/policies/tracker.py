"""A policy that plays a planned motion, independent of the measured joints and the target."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.motion import Motion
from lieednn_sim.policies.base import Policy
from lieednn_sim.policies.making import PolicyTask
from lieednn_sim.values import Floats


class MotionTracker(Policy):
    """A policy that plays a motion from its beginning, and then holds its end.

    Args:
        arm: the arm.
        motion: motion that begins where the policy is reset, or a spline of joint coordinates ``(n,)`` over time [s].
        rate: control rate [Hz].

    Attributes:
        end: ``(n,)`` where the motion ends.

    Raises:
        InputError: the motion is of another arm; `reset` raises it if the motion begins elsewhere.
    """

    def __init__(self, arm: Arm, motion: Motion | CubicHermiteSpline, rate: float = 100.0) -> None:
        super().__init__(arm, rate)
        spline = CubicHermiteSpline(motion.t, motion.q, motion.qd) if isinstance(motion, Motion) else motion
        end, joints = float(spline.x[-1]), spline.c.shape[2:]
        if joints != (arm.n_joints,):
            raise InputError(f"the motion has {joints} joint coordinates, arm {arm.name!r} has {arm.n_joints}")
        times = np.minimum(self.period * np.arange(np.ceil(end / self.period) + 1.0), end)
        # At the beginning of each period.
        self.end = spline(end)
        self._rows = spline(times), np.where((times < end)[:, None], spline(times, 1), 0.0)

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        away = np.abs(self._rows[0][0] - q)
        joint = int((away / self.arm.ranges).argmax())
        # Largest distance of a motion's beginning from where the arm is, as a fraction of a joint's range.
        max_start_distance = 0.02
        if away[joint] > max_start_distance * self.arm.ranges[joint]:
            raise InputError(
                f"the motion begins {away[joint]:.3g} {self.arm.unit(joint)} from where joint "
                f"{self.arm.joint_names[joint]!r} is; plan it from there"
            )
        self._row = 0

    def act(self, measured: Floats | None, target: Floats) -> tuple[Floats, Floats]:
        """See `Policy`; unchecked."""
        self._row = min(self._row + 1, len(self._rows[0]) - 1)
        return self._rows[0][self._row], self._rows[1][self._row]

    @property
    def message(self) -> str:
        """See `Policy`."""
        return "has ended" if self._row == len(self._rows[0]) - 1 else "moves"


def tracker(task: PolicyTask) -> MotionTracker:
    """The policy that plays the task's motion."""
    return MotionTracker(task.arm, task.motion, task.rate)
