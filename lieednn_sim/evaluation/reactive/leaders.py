"""Planners that react, in one protocol: from the target and the measured joints to the reference of the next period.

All of them keep the limits of velocity and, gathering speed, of acceleration; all but the tracker are pushed with the
arm and wait for it as `simulation.feedback` says, and among obstacles all but the tracker and the fabric go through the
safety filter.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.network_planners import without_weights
from lieednn_sim.planning.shaped import ShapedOptions
from lieednn_sim.simulation import Feedback, Simulation
from lieednn_sim.simulation.feedback import FeedbackFollower
from lieednn_sim.simulation.reference import PeriodReference
from lieednn_sim.synthesis import synthesize
from lieednn_sim.values import Floats, frozen

# Joint positions and their rates ``(m, n)`` after each of a period's m steps.
Setpoints = tuple[Floats, Floats]
Leader = Callable[[Floats, Simulation], Setpoints]

# Rate at which those without a law of time approach their target [1/s].
_PACE = 2.0
_BIAS_MAGNITUDE = 0.25
# Of the movement primitive: spring, decay of the phase over the motion, basis functions, ridge of their regression.
_SPRING, _DECAY, _BASES, _RIDGE = 25.0, 4.6, 20, 1e-8
# Of the fabric: stiffness and damping [1/s^2, 1/s], distance from which geoms repel and that they keep [m], strength.
_STIFFNESS, _DAMPING, _NEAR, _MARGIN, _STRENGTH = 16.0, 8.0, 0.15, 0.01, 0.3


@frozen
class Assignment:
    """What a leader is made for.

    Attributes:
        arm: among its obstacles.
        start: ``(n,)``.
        target: ``(n,)``.
        motion: from start to target, of the teacher: what trackers track and primitives imitate.
        steps: simulation steps in a control period.
        feedback: settings that all share.
        seed: of what is drawn.
    """

    arm: Arm
    start: Floats
    target: Floats
    motion: Motion
    steps: int
    feedback: Feedback
    seed: int


class _Network:
    """A network that follows with feedback."""

    def __init__(self, task: Assignment, network: LieEDNN, speed: float) -> None:
        self._follower = FeedbackFollower(
            task.arm,
            network,
            task.start,
            steps=task.steps,
            speed=speed,
            feedforward=False,
            feedback=task.feedback,
        )

    def __call__(self, target: Floats, simulation: Simulation) -> Setpoints:
        q, qd, _ = self._follower.advance(target, simulation.measured()[0])
        return q, qd


class _Joints(ABC):
    """What moves in joint space: y' = l (s v(y) + k d (q - y)), with the same s, k d and l as networks."""

    def __init__(self, task: Assignment, feedback: Feedback | None = None) -> None:
        self.arm, self._feedback = task.arm, feedback or task.feedback
        self._reference = PeriodReference(task.arm, task.start, task.steps, self._feedback.safety)
        self.period, self.y = self._reference.period, task.start
        self.low, self.high = task.arm.position_limits.T
        self.range = task.arm.ranges

    def __call__(self, target: Floats, simulation: Simulation) -> Setpoints:
        off = simulation.measured()[0] - self.y
        waiting, strength = self._feedback.response(float((np.abs(off) / self.range).max()))
        wanted = waiting * self.velocity(target, waiting) + strength * off
        share = 1.0 / max(1.0, float((np.abs(wanted) / self._reference.allowed()).max()))
        self.went(share * waiting * self.period)
        y = np.clip(self.arm.within_angles(self.y + self.period * share * wanted), self.low, self.high)
        qd, self.y = np.where((y == self.low) | (y == self.high), 0.0, share * wanted), y
        return self._reference(y, qd)

    @abstractmethod
    def velocity(self, target: Floats, waiting: float) -> Floats:
        """The velocity v ``(n,)`` at the end of the period."""

    def went(self, time: float) -> None:  # noqa: B027 (most have no time of their own)
        """Own time that the period took [s]."""


class _Primitive(_Joints):
    """A dynamic movement primitive in joint space that imitates the teacher's motion.

    T z' = a (a / 4 (g - y) - z) + f(x), T y' = z, T x' = -b x (Ijspeert et al., Neural Computation 25(2), 2013), with f
    of normalised radial functions times x and the joint's own weights, learned by ridge regression. What the target has
    moved since then moves the attractor, not the forces. In a push the phase waits with the rest.
    """

    def __init__(self, task: Assignment) -> None:
        super().__init__(task)
        motion = task.motion
        self._time, self._goal, self._z = float(motion.t[-1]), task.target, np.zeros_like(task.start)
        self._x, t = 1.0, motion.t / motion.t[-1]
        speed = self._time * motion.qd
        bend = np.gradient(speed, t, axis=0, edge_order=2)
        force = bend - _SPRING * (0.25 * _SPRING * (self._goal - motion.q) - speed)
        self._centres = np.exp(-_DECAY * np.linspace(0.0, 1.0, _BASES))
        self._widths = 1.0 / np.diff(self._centres, append=0.5 * self._centres[-1]) ** 2
        features = np.array([self._features(x) for x in np.exp(-_DECAY * t)])
        normal = features.T @ features + _RIDGE * len(t) * np.eye(_BASES)
        self._weights = np.linalg.solve(normal, features.T @ force)

    def _features(self, x: float) -> Floats:
        bumps = np.exp(-0.5 * self._widths * (x - self._centres) ** 2)
        return np.asarray(x * bumps / (bumps.sum() + 1e-300))

    def velocity(self, target: Floats, waiting: float) -> Floats:
        h = waiting * self.period / self._time
        force = self._features(self._x) @ self._weights
        # Implicit in z, so that a stiff spring does no harm at a low control rate.
        pull = self._z + h * (_SPRING * 0.25 * _SPRING * (target - self.y) + force)
        self._z = pull / (1.0 + h * _SPRING)
        return np.asarray(self._z / self._time)

    def went(self, time: float) -> None:
        self._x *= float(np.exp(-_DECAY * time / self._time))


class _Fabric(_Joints):
    """An attractor and repelling geoms, weighted by their metrics as in Riemannian motion policies.

    With joints in units of their range, M a = k (g - y) - c v + sum_i w_i n_i (r / d_i - c n_i . v) and
    M = I + sum_i w_i n_i n_i', n_i the gradient of the distance of a pair, d_i what it is above its margin, and
    w_i = (d_0 / d_i - 1)^2 within d_0 (Ratliff et al., arXiv 1801.02854). It sees no further than d_0.
    """

    def __init__(self, task: Assignment) -> None:
        super().__init__(task, replace(task.feedback, safety=None))
        self._collisions, self._v = Collisions(task.arm), np.zeros_like(task.start)
        # Parts of the arm that are close together by design repel each other where they come closer.
        near = self._collisions.distances(task.start, _NEAR)
        self._design = {tuple(pair): float(d) for pair, d in zip(near.pairs.tolist(), near.distance, strict=True)}

    def velocity(self, target: Floats, waiting: float) -> Floats:
        near = self._collisions.distances(self.y, _NEAR)
        reach = np.array([min(_NEAR, 0.9 * self._design.get(tuple(pair), np.inf)) for pair in near.pairs.tolist()])
        gap = np.maximum(near.distance - np.minimum(_MARGIN, 0.5 * reach), 1e-3)
        weight = np.maximum(reach / gap - 1.0, 0.0) ** 2 if len(gap) else gap
        slopes, v = near.jacobian * self.range, self._v
        force = _STIFFNESS * (target - self.y) / self.range - _DAMPING * v
        force = force + (weight * (_STRENGTH / gap - _DAMPING * (slopes @ v))) @ slopes
        metric = np.eye(len(v)) + (slopes.T * weight) @ slopes
        self._v = v + waiting * self.period * np.linalg.solve(metric, force)
        fastest = np.abs(self._v * self.range / self.arm.velocity_limits).max()
        self._v = self._v / max(1.0, float(fastest))
        return np.asarray(self._v * self.range)


class _Tracker:
    """The motion, sample by sample, whatever happens; it hears neither the arm nor the target."""

    def __init__(self, task: Assignment) -> None:
        self._motion, self._row, self._steps = task.motion, 0, task.steps

    def __call__(self, target: Floats, simulation: Simulation) -> Setpoints:
        rows = self._row + np.arange(1, self._steps + 1)
        self._row += self._steps
        last = len(self._motion.t) - 1
        inside = (rows <= last)[:, None]
        return self._motion.q[np.minimum(rows, last)], np.where(inside, self._motion.qd[np.minimum(rows, last)], 0.0)


def _shaped(rate: float) -> Callable[[Assignment], Leader]:
    def made(task: Assignment) -> Leader:
        options = ShapedOptions(rate=rate)
        network = plan(task.arm, task.target, planner="lieednn-shaped", options=options, seed=task.seed).network
        assert isinstance(network, LieEDNN)
        return _Network(task, network, _PACE / rate)

    return made


def _certified(task: Assignment) -> Leader:
    xi = task.arm.encode(task.target)
    network = synthesize(xi, bias="sign-matched", bias_magnitude=_BIAS_MAGNITUDE, seed=task.seed).unwrap()
    return _Network(task, network, _PACE)


def _linear(task: Assignment) -> Leader:
    return _Network(task, without_weights(task.arm.encode(task.target)), _PACE)


LEADERS: dict[str, Callable[[Assignment], Leader]] = {
    "lieednn-shaped, rho 1": _shaped(1.0),
    "lieednn-shaped, rho 0.3": _shaped(0.3),
    "lieednn-shaped, rho 0.1": _shaped(0.1),
    "lieednn-certified": _certified,
    "linear-attractor": _linear,
    "dmp": _Primitive,
    "fabric": _Fabric,
    "tracker": _Tracker,
}
