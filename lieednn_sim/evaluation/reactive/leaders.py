"""Planners that react, in one protocol: from the target and the measured joints to the reference of the next period.

All of them keep the limits of velocity and, when speeding up, of acceleration; all but the tracker yield to pushes with
the arm and wait for it, see `simulation.feedback`. Among obstacles, networks, primitives and the linear attractor use
the safety filter; the fabric and the path integral (`mppi`) avoid obstacles themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from lieednn_sim.arm.collision import Collisions
from lieednn_sim.evaluation.reactive.mppi import PathIntegral
from lieednn_sim.evaluation.reactive.protocol import PACE, Assignment, JointLeader, Leader, Setpoints
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import plan
from lieednn_sim.planning.network_planners import without_weights
from lieednn_sim.planning.shaped import ShapedOptions
from lieednn_sim.simulation import Simulation
from lieednn_sim.simulation.feedback import FeedbackFollower
from lieednn_sim.synthesis import synthesize
from lieednn_sim.values import Floats

# Size of the certified network's bias [gamma/mu]: the middle one of its planner's.
_BIAS_MAGNITUDE = 0.25
# The movement primitive: spring, decay of the phase over the motion (a third of the spring, as usual, so that its
# forces vanish when the motion ends), number of basis functions, ridge of their regression.
_SPRING, _DECAY, _BASES, _RIDGE = 25.0, 25.0 / 3.0, 20, 1e-8
# The fabric: stiffness and damping [1/s^2, 1/s], distances at which geoms repel and that are kept [m], strength.
_STIFFNESS, _DAMPING, _NEAR, _MARGIN, _STRENGTH = 16.0, 8.0, 0.15, 0.01, 0.3


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


class _Primitive(JointLeader):
    """A dynamic movement primitive in joint space that imitates the teacher's motion.

    T z' = a (a / 4 (g - y) - z) + f(x), T y' = z, T x' = -b x (Ijspeert et al., Neural Computation 25(2), 2013), with f
    of normalised radial functions times x and weights for each joint, learned by ridge regression. When the target
    moves, so does the attractor, but not the forces. During a push the phase waits too.
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
        # Implicit in z, so that a stiff spring stays stable at a low control rate.
        pull = self._z + h * (_SPRING * 0.25 * _SPRING * (target - self.y) + force)
        self._z = pull / (1.0 + h * _SPRING)
        return np.asarray(self._z / self._time)

    def went(self, time: float) -> None:
        self._x *= float(np.exp(-_DECAY * time / self._time))


class _Fabric(JointLeader):
    """An attractor and repelling geoms, weighted by their metrics as in Riemannian motion policies.

    With joints in units of their range, M a = k (g - y) - c v + sum_i w_i n_i (r / d_i - c n_i . v) and
    M = I + sum_i w_i n_i n_i', with n_i the gradient of the distance of a pair, d_i this distance above its margin, and
    w_i = (d_0 / d_i - 1)^2 within d_0 (Ratliff et al., arXiv 1801.02854). A pair repels only within d_0, and within 0.9
    of its distance at the start and at the target.
    """

    def __init__(self, task: Assignment) -> None:
        super().__init__(task, replace(task.feedback, safety=None))
        self._collisions, self._v = Collisions(task.arm), np.zeros_like(task.start)
        # Pairs that are close by design, or at the target, repel only when closer still: else it would not arrive.
        self._design, self._goal = self._near(task.start), np.full_like(task.start, np.nan)
        self._there: dict[tuple[int, int], float] = {}

    def _near(self, q: Floats) -> dict[tuple[int, int], float]:
        """Distances of pairs that are near [m]."""
        near = self._collisions.distances(q, _NEAR)
        return {(a, b): float(d) for (a, b), d in zip(near.pairs.tolist(), near.distance, strict=True)}

    def velocity(self, target: Floats, waiting: float) -> Floats:
        if (target != self._goal).any():
            self._goal, self._there = target.copy(), self._near(target)
        near = self._collisions.distances(self.y, _NEAR)
        known = [min(self._design.get((a, b), np.inf), self._there.get((a, b), np.inf)) for a, b in near.pairs.tolist()]
        onset = np.minimum(_NEAR, 0.9 * np.array(known))
        kept = np.minimum(_MARGIN, 0.5 * onset)
        gap = np.maximum(near.distance - kept, 1e-3)
        weight = np.maximum((onset - kept) / gap - 1.0, 0.0) ** 2
        slopes, v = near.jacobian * self.range, self._v
        force = _STIFFNESS * (target - self.y) / self.range - _DAMPING * v
        force = force + (weight * (_STRENGTH / gap - _DAMPING * (slopes @ v))) @ slopes
        metric = np.eye(len(v)) + (slopes.T * weight) @ slopes
        self._v = v + waiting * self.period * np.linalg.solve(metric, force)
        fastest = np.abs(self._v * self.range / self.arm.velocity_limits).max()
        self._v = self._v / max(1.0, float(fastest))
        return np.asarray(self._v * self.range)


class _Tracker:
    """Plays the motion sample by sample, ignoring the arm and the target."""

    def __init__(self, task: Assignment) -> None:
        self._motion, self._row, self._steps = task.motion, 0, task.steps

    def __call__(self, target: Floats, simulation: Simulation) -> Setpoints:
        rows = self._row + np.arange(1, self._steps + 1)
        self._row += self._steps
        last = len(self._motion.t) - 1
        inside = (rows <= last)[:, None]
        return self._motion.q[np.minimum(rows, last)], np.where(inside, self._motion.qd[np.minimum(rows, last)], 0.0)


@lru_cache(maxsize=1)
def _shaped_network(task: Assignment, rate: float) -> LieEDNN:
    """The network of `lieednn-shaped`, cached for all disturbances of a case."""
    options = ShapedOptions(rate=rate)
    network = plan(task.arm, task.target, planner="lieednn-shaped", options=options, seed=task.seed).network
    assert isinstance(network, LieEDNN)
    return network


def _shaped(rate: float) -> Callable[[Assignment], Leader]:
    return lambda task: _Network(task, _shaped_network(task, rate), PACE / rate)


def _certified(task: Assignment) -> Leader:
    xi = task.arm.encode(task.target)
    network = synthesize(xi, bias="sign-matched", bias_magnitude=_BIAS_MAGNITUDE, seed=task.seed).unwrap()
    # Network time is scaled so that the slowest mode at the target decays like the linear attractor.
    slowest = -float(np.linalg.eigvals(network.jacobian(xi)).real.max())
    return _Network(task, network, PACE / slowest)


def _linear(task: Assignment) -> Leader:
    return _Network(task, without_weights(task.arm.encode(task.target)), PACE)


LEADERS: dict[str, Callable[[Assignment], Leader]] = {
    "lieednn-shaped, rho 1": _shaped(1.0),
    "lieednn-shaped, rho 0.3": _shaped(0.3),
    "lieednn-shaped, rho 0.1": _shaped(0.1),
    "lieednn-certified": _certified,
    "linear-attractor": _linear,
    "dmp": _Primitive,
    "fabric": _Fabric,
    "mppi": PathIntegral,
    "tracker": _Tracker,
}
