"""Policies of a planned motion: one plays it, the other, a dynamic movement primitive, imitates it.

The primitive's basis functions are those of `learning.demonstrations.primitives` and of the planner ``dmp``. The
planner makes a whole motion; the policy advances step by step, its phase waits for the arm, and its target may move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations.primitives import forcing
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.policies.base import Policy
from lieednn_sim.policies.feedback import FEEDBACK, Feedback, JointPolicy
from lieednn_sim.policies.making import PolicyTask
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats


class MotionTracker(Policy):
    """A policy that plays a motion from its beginning, whatever is measured or wanted, and then holds its end.

    Args:
        motion: motion that begins where the policy is reset, or a spline of joint coordinates ``(n,)`` over time [s].
        rate: control rate [Hz].

    Attributes:
        end: ``(n,)`` where the motion ends.
        motion: the motion; None if a spline was given.

    Raises:
        InputError: the motion is of another arm; `reset` raises it if the motion begins elsewhere.
    """

    def __init__(self, arm: Arm, motion: Motion | CubicHermiteSpline, rate: float = 100.0) -> None:
        super().__init__(arm, rate)
        self.motion = motion if isinstance(motion, Motion) else None
        spline = CubicHermiteSpline(motion.t, motion.q, motion.qd) if isinstance(motion, Motion) else motion
        end, joints = float(spline.x[-1]), spline.c.shape[2:]
        if joints != (arm.n_joints,):
            raise InputError(f"the motion has {joints} joint coordinates, arm {arm.name!r} has {arm.n_joints}")
        times = np.minimum(self.period * np.arange(np.ceil(end / self.period) + 1.0), end)
        # Joints and rates at the beginning of each period.
        self.end = spline(end)
        self._rows = spline(times), np.where((times < end)[:, None], spline(times, 1), 0.0)

    @classmethod
    def stopping(cls, arm: Arm, q: Floats, qd: Floats, rate: float) -> MotionTracker:
        """A policy that brakes a reference with rates ``(n,)`` straight to rest, at the acceleration limits."""
        q, qd = (as_floats(name, given, (arm.n_joints,)) for name, given in (("q", q), ("qd", qd)))
        needed = max(float((np.abs(qd) / arm.acceleration_limits).max()), 2.0 / rate)
        if not needed * rate < 1e6:
            raise InputError(f"braking would take {needed:g} s, more than a million periods at {rate:g} Hz")
        low, high = arm.position_limits.T
        end = np.clip(arm.within_angles(q + 0.5 * needed * qd), low, high)
        policy = cls(arm, CubicHermiteSpline([0.0, needed], [q, end], [qd, np.zeros_like(qd)]), rate)
        # Set directly, since `reset` may refuse to start there.
        policy.q, policy.qd, policy._row = q, qd, 0
        return policy

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        away = np.abs(self._rows[0][0] - q)
        joint = int((away / self.arm.ranges).argmax())
        # A motion may begin within 2 % of a joint's range from where the arm is.
        if away[joint] > 0.02 * self.arm.ranges[joint]:
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


@dataclass(frozen=True)
class PrimitiveOptions(PlannerOptions):
    """Options of the policy ``dmp``.

    Attributes:
        spring: a of the equations in `MovementPrimitive`.
        decay: b; at a third of the spring, the forces vanish when the motion ends.
        basis_functions: number of radial functions.
        ridge: weight of the squared weights in their regression.
    """

    spring: float = 25.0
    decay: float = 25.0 / 3.0
    basis_functions: int = 20
    ridge: float = 1e-8


class MovementPrimitive(JointPolicy):
    """A dynamic movement primitive in joint space that imitates a motion.

    T z' = a (a / 4 (g - y) - z) + f(x), T y' = z, T x' = -b x (Ijspeert et al., Neural Computation 25(2), 2013), with f
    of normalised radial functions times x and weights for each joint, learned by ridge regression. When the target
    moves, so does the attractor, but not the forces. During a push the phase waits too.

    Args:
        arm, rate, feedback: as for `JointPolicy`.
        motion: motion to imitate.
    """

    def __init__(
        self,
        arm: Arm,
        motion: Motion,
        rate: float = 100.0,
        *,
        options: PrimitiveOptions | None = None,
        feedback: Feedback | None = FEEDBACK,
    ) -> None:
        super().__init__(arm, rate, feedback=feedback)
        self._options = options = options or PrimitiveOptions()
        spring = options.spring
        self._time, t = float(motion.t[-1]), motion.t / motion.t[-1]
        speed = self._time * motion.qd
        bend = np.gradient(speed, t, axis=0, edge_order=2)
        force = bend - spring * (0.25 * spring * (motion.q[-1] - motion.q) - speed)
        features = forcing(options.basis_functions, np.exp(-options.decay * t), options.decay)
        normal = features.T @ features + options.ridge * len(t) * np.eye(options.basis_functions)
        self._weights = np.linalg.solve(normal, features.T @ force)

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        super().begin(q)
        self._x, self._z = 1.0, np.zeros_like(q)

    def velocity(self, target: Floats, waiting: float) -> Floats:
        """See `JointPolicy`; unchecked."""
        options, h = self._options, waiting * self.period / self._time
        force = forcing(options.basis_functions, np.array([self._x]), options.decay)[0] @ self._weights
        # Implicit in z, so that a stiff spring stays stable at a low control rate.
        pull = self._z + h * (options.spring * 0.25 * options.spring * (target - self.y) + force)
        self._z = pull / (1.0 + h * options.spring)
        return np.asarray(self._z / self._time)

    def elapse(self, time: float) -> None:
        """See `JointPolicy`; unchecked."""
        self._x *= float(np.exp(-self._options.decay * time / self._time))


def primitive(task: PolicyTask, options: PrimitiveOptions) -> MovementPrimitive:
    """The primitive that imitates the task's motion."""
    return MovementPrimitive(task.arm, task.motion, task.rate, options=options, feedback=task.feedback)
