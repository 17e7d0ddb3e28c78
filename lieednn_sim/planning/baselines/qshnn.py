"""QSHNN, the quaternion-valued Hopfield-structured network with supervised learning that LieEDNN goes back to.

Wang, Ma and Pang, NeurIPS 2025 (arXiv 2510.16607): q_i' = -gamma q_i + mu sum_j omega_ij phi(q_j) + mu b_i, with tanh
on each component and quaternion weights from the left, 4 x 4 blocks of W. Gradient steps of E = |q* - d|^2 / 2 move the
equilibrium q* towards the target d, and every ten steps each block returns to the nearest quaternion's (their
Algorithm 1, here `learning.train` with `QuaternionWeights`: Newton's method finds the equilibrium that they run to).

One neuron stands for one joint's posture, as in their robotic arm, whose joints are balls: a multiple of the unit
quaternion of the turn from the middle of its range. Their paper knows no sliding joints; here a slide's displacement is
a turn about its axis, its range half a turn. On the way the states have other moduli and turn about other axes, too:
the nearest posture of each joint is followed, 2 atan2(v . a, w) of a hinge about a.

What is proved of their networks needs weights below 1 in the infinity norm, and those that are learned exceed it: that
the equilibrium attracts is checked, that the network arrives is seen when it runs, and no more is promised. Limits and
obstacles have no part in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.errors import PlanError
from lieednn_sim.learning import TrainingOptions, TrainingResult, train
from lieednn_sim.learning.manifold import QuaternionWeights
from lieednn_sim.network.hopfield import HopfieldNetwork
from lieednn_sim.planning.baselines.joint_space import joint_motion, joint_scale
from lieednn_sim.planning.baselines.smoothing import rounded
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem, in_time
from lieednn_sim.values import Floats

# Distance to the target at which the path ends, a few times what learning leaves, and the longest that it may take in
# the network's own time, whose slowest part may be far slower than its decay.
_ARRIVED, _LONGEST = 1e-5, 1000.0
# Samples of the path, from which the waypoints are taken.
_SAMPLES = 2000
# Their Algorithm 1: rates, period, tolerance. A thousand epochs do mostly; of their 30 000 no more than these.
_ALGORITHM = TrainingOptions(
    projection="scaled", period=10, min_rate=0.001, max_rate=0.2, tolerance=1e-6, max_epochs=10_000
)


@dataclass(frozen=True)
class QshnnOptions(PlannerOptions):
    """Options of the planner ``qshnn``.

    Attributes:
        modulus: of start and target, whose directions alone are postures. With 1 most networks turn unstable: a state
            w near 1 takes a weight beyond 1, and the same weight is that of components near 0, where tanh is steepest.
        bias: of every component, 0.125 to 0.2 in the paper.
        networks: to learn, each from other weights, until one's motion can be made.
        waypoints: of the network's path, evenly laid; control points of the curve that is followed.
        bend: curvature from which on it is run through more slowly, as of `SmoothingOptions`.
        training: how each is learned.
    """

    modulus: float = 0.25
    bias: float = 0.125
    networks: int = 3
    waypoints: int = 60
    bend: float = 8.0
    training: TrainingOptions = _ALGORITHM


def qshnn(problem: PlanningProblem, options: QshnnOptions) -> Motion:
    """The motion along the path of the first learned network that the arm can follow.

    Raises:
        PlanError: no network was learned, or none arrives, or every motion breaks a limit of the arm.
    """
    postures = JointPostures(problem.arm, options.modulus)
    target = postures.quaternions(problem.target)
    refusal = ""
    for attempt in range(options.networks):
        result = learned(target, options, [problem.seed, attempt])
        if not isinstance(result.network, HopfieldNetwork) or not result.success:
            # A refused motion tells more than a failed training.
            refusal = refusal or result.message
            continue
        try:
            path = path_of(problem, postures, result.network, options.waypoints)
            return in_time(_motion, problem, path, options.bend)
        except PlanError as error:
            refusal = str(error)
    raise PlanError(f"no quaternion network of {options.networks} can be used: {refusal}")


class JointPostures:
    """Each joint's posture as a quaternion (w, x, y, z): one for a hinge, a slide or a ball.

    Coupled joints, which share a coordinate, have one together.

    Args:
        arm: whose joints they are.
        modulus: of the quaternions.
    """

    def __init__(self, arm: Arm, modulus: float) -> None:
        self._modulus = modulus
        # By their coordinates; axes ``(3, c)`` in turns by a unit of each coordinate.
        axes: dict[tuple[int, ...], Floats] = {}
        for joint in arm.joints.joints:
            for factor in joint.factors:
                indices = tuple(map(int, factor.indices))
                turn = math.pi / arm.ranges[factor.indices] if factor.kind == "slide" else 1.0
                axes.setdefault(indices, factor.axes * turn)
        self._axes, self._middle = sorted(axes.items()), arm.position_limits.mean(axis=1)

    def quaternions(self, q: Floats) -> Floats:
        """Quaternions ``(..., N, 4)`` of joint positions ``(..., n)``."""
        vectors = [(q - self._middle)[..., list(indices)] @ axes.T for indices, axes in self._axes]
        vector = np.stack(vectors, axis=-2)
        half = 0.5 * np.linalg.norm(vector, axis=-1, keepdims=True)
        return self._modulus * np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * vector], axis=-1)

    def positions(self, x: Floats) -> Floats:
        """Joint positions ``(..., n)`` whose quaternions are nearest in direction to ``x`` ``(..., N, 4)``."""
        q = np.broadcast_to(self._middle, (*x.shape[:-2], len(self._middle))).copy()
        for neuron, (indices, axes) in enumerate(self._axes):
            w, vector = x[..., neuron, 0], x[..., neuron, 1:]
            if len(indices) == 1:
                per_unit = float(np.linalg.norm(axes))
                q[..., indices[0]] += 2.0 * np.arctan2(vector @ axes[:, 0] / per_unit, w) / per_unit
            else:
                length = np.linalg.norm(vector, axis=-1)
                turn = 2.0 * np.arctan2(length, w) / np.maximum(length, np.finfo(float).tiny)
                q[..., list(indices)] += (turn[..., None] * vector) @ axes
        return q


def learned(target: Floats, options: QshnnOptions, seed: Sequence[int]) -> TrainingResult:
    """A network with the target ``(N, 4)`` as its equilibrium, from weights in U(-1, 1) over their infinity norm."""
    drawn = np.random.default_rng(seed).uniform(-1.0, 1.0, (target.size, target.size))
    weight = drawn / np.abs(drawn).sum(axis=1).max()
    return train(target, options.training, bias=options.bias, group=QuaternionWeights(), initial_weight=weight)


def path_of(problem: PlanningProblem, postures: JointPostures, network: HopfieldNetwork, count: int) -> Floats:
    """Joint positions ``(count, n)`` along the network's path from the problem's start to its target, evenly laid.

    Raises:
        PlanError: the network does not arrive.
    """
    start, target = postures.quaternions(problem.start), postures.quaternions(problem.target)
    way = network.trajectory(start, _LONGEST, until=target, distance=_ARRIVED)
    left = float(np.abs(way.xi[-1] - target).max())
    if left > 2.0 * _ARRIVED:
        raise PlanError(
            f"the learned network does not arrive: {left:.2g} from the target after {_LONGEST:g} of its time"
        )
    share = np.linspace(0.0, 1.0, _SAMPLES)
    times = np.interp(share, np.linspace(0.0, 1.0, len(way.t)), way.t)
    q = postures.positions(way(times))
    q[0], q[-1] = problem.start, problem.target
    scale = joint_scale(problem.arm)
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q / scale, axis=0), axis=1)))
    even = np.linspace(0.0, length[-1], count)
    return np.stack([np.interp(even, length, joint) for joint in q.T], axis=1)


def _motion(problem: PlanningProblem, path: Floats, bend: float) -> Motion:
    return joint_motion(problem, *rounded(problem, path, 1, bend))
