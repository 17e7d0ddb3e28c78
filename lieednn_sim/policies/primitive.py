"""A dynamic movement primitive in joint space, as a policy.

Its basis functions are those of `learning.demonstrations.primitives` and of the planner ``dmp``. The planner makes a
whole motion; the policy advances step by step, its phase waits for the arm, and its target may move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.learning.demonstrations.primitives import forcing
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.policies.feedback import FEEDBACK, Feedback
from lieednn_sim.policies.joint_policy import JointPolicy
from lieednn_sim.policies.task import PolicyTask
from lieednn_sim.values import Floats


@dataclass(frozen=True)
class PrimitiveOptions(PlannerOptions):
    """Options of the policy ``dmp``.

    Attributes:
        spring: a of the equations in `MovementPrimitive`.
        decay: b; at a third of the spring, the forces vanish when the motion ends.
        basis_functions: number of radial functions.
        ridge: weight of the squared weights in their regression.

    Raises:
        InputError: a value is out of range.
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
        arm: the arm.
        motion: motion to imitate.
        rate: control rate [Hz].
        options: options of the policy.
        feedback: settings of the feedback from the measured joints; None for no feedback.
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
        features = self._features(np.exp(-options.decay * t))
        normal = features.T @ features + options.ridge * len(t) * np.eye(options.basis_functions)
        self._weights = np.linalg.solve(normal, features.T @ force)

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        super().begin(q)
        self._x, self._z = 1.0, np.zeros_like(q)

    def velocity(self, target: Floats, waiting: float) -> Floats:
        """See `JointPolicy`; unchecked."""
        h, spring = waiting * self.period / self._time, self._options.spring
        force = self._features(np.array([self._x]))[0] @ self._weights
        # Implicit in z, so that a stiff spring stays stable at a low control rate.
        pull = self._z + h * (spring * 0.25 * spring * (target - self.y) + force)
        self._z = pull / (1.0 + h * spring)
        return np.asarray(self._z / self._time)

    def elapse(self, time: float) -> None:
        """See `JointPolicy`; unchecked."""
        self._x *= float(np.exp(-self._options.decay * time / self._time))

    def _features(self, x: Floats) -> Floats:
        return forcing(self._options.basis_functions, x, self._options.decay)


def primitive(task: PolicyTask, options: PrimitiveOptions) -> MovementPrimitive:
    """The primitive that imitates the task's motion."""
    return MovementPrimitive(task.arm, task.motion, task.rate, options=options, feedback=task.feedback)
