"""QSHNN, the quaternion-valued Hopfield-structured network with supervised learning that preceded LieEDNN.

Wang, Ma and Pang, NeurIPS 2025 (arXiv 2510.16607): q_i' = -gamma q_i + mu sum_j omega_ij phi(q_j) + mu b_i, with tanh
on each component, and weights that multiply quaternions from the left, 4 x 4 blocks of W. Gradient steps on
E = |q* - d|^2 / 2 move the equilibrium q* towards the target d, and every ten steps each block is projected onto the
nearest such block (their Algorithm 1, here `learning.train` with `QuaternionWeights`; the equilibrium, which they reach
by running the network, is found by Newton's method).

As in their arm, whose joints are ball joints, a neuron represents the position of a joint by a multiple of the unit
quaternion of its rotation from the middle of its range. They have no slide joints; here a slide's displacement counts
as a rotation about its axis, with half a turn for its range. Along the trajectory, states also have other moduli and
rotate about other axes; the motion takes the nearest position of each joint, 2 atan2(v . a, w) for a hinge about a.

The stability proof for their networks needs weights with an infinity norm below 1, which learned weights exceed. So the
planner checks that the equilibrium is locally stable and that the network arrives when it is run; nothing more is
guaranteed. The method takes no account of limits and obstacles.
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
from lieednn_sim.network.componentwise import HopfieldNetwork
from lieednn_sim.planning.baselines.smoothing import smoothed
from lieednn_sim.planning.joint_space import joint_motion
from lieednn_sim.planning.motion import Motion, joint_scale, travelled
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem, in_time
from lieednn_sim.values import Floats

# Distance to the target at which the path ends, a few times the error of learning; and the longest duration in the
# network's own time, since its slowest mode may be far slower than its decay.
_ARRIVAL_DISTANCE, _LONGEST_RUN = 1e-5, 1000.0
# Their Algorithm 1: rates, period, tolerance. A thousand epochs usually suffice; they allow 30 000.
_ALGORITHM = TrainingOptions(
    projection="scaled", period=10, min_rate=0.001, max_rate=0.2, tolerance=1e-6, max_epochs=10_000
)


@dataclass(frozen=True)
class QshnnOptions(PlannerOptions):
    """Options of the planner ``qshnn``.

    Attributes:
        modulus: modulus of the states at start and target; only their directions encode joint positions. With
            1, most networks become unstable: a component w near 1 needs a weight above 1, which also acts on components
            near 0, where tanh is steepest.
        bias: bias of every component, 0.125 to 0.2 in the paper.
        networks: largest number of networks to learn, each from other initial weights, until the arm can follow one.
        waypoints: number of evenly spaced waypoints of the network's path, the control points of the curve followed.
        bend: curvature above which the curve is followed more slowly, as in `SmoothingOptions`.
        training: options of the training.
    """

    modulus: float = 0.25
    bias: float = 0.125
    networks: int = 3
    waypoints: int = 60
    bend: float = 8.0
    training: TrainingOptions = _ALGORITHM


def qshnn(problem: PlanningProblem, options: QshnnOptions) -> Motion:
    """The motion along the path of the first learned network that the arm can follow; `PlanError` if there is none."""
    joints = JointQuaternions(problem.arm, options.modulus)
    target = joints.quaternions(problem.target)
    refusal = ""
    for attempt in range(options.networks):
        result = learned(target, options, [problem.seed, attempt])
        if not isinstance(result.network, HopfieldNetwork) or not result.success:
            # The reason why a motion was refused takes precedence over that of a failed training.
            refusal = refusal or result.message
            continue
        try:
            path = path_of(problem, joints, result.network, options.waypoints)
            return in_time(_along, problem, path, options.bend)
        except PlanError as error:
            refusal = str(error)
    raise PlanError(f"no quaternion network of {options.networks} can be used: {refusal}")


class JointQuaternions:
    """Joint positions as quaternions (w, x, y, z), one for each hinge, slide or ball joint.

    Coupled joints, which share a coordinate, share a quaternion. All have the same modulus.
    """

    def __init__(self, arm: Arm, modulus: float) -> None:
        self._modulus = modulus
        # For the indices of a joint's coordinates, the rotation vectors ``(3, c)`` of a unit of each.
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
        """Joint positions ``(..., n)`` with the quaternions nearest in direction to ``x`` ``(..., N, 4)``."""
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
    """Learn a network with the equilibrium ``(N, 4)``, starting from U(-1, 1) weights over their infinity norm."""
    drawn = np.random.default_rng(seed).uniform(-1.0, 1.0, (target.size, target.size))
    weight = drawn / np.abs(drawn).sum(axis=1).max()
    return train(target, options.training, bias=options.bias, group=QuaternionWeights(), initial_weight=weight)


def path_of(problem: PlanningProblem, joints: JointQuaternions, network: HopfieldNetwork, count: int) -> Floats:
    """Evenly spaced joint positions ``(count, n)`` on the network's path to the target; `PlanError` if it fails."""
    start, target = joints.quaternions(problem.start), joints.quaternions(problem.target)
    trajectory = network.trajectory(start, _LONGEST_RUN, until=target, distance=_ARRIVAL_DISTANCE)
    left = float(np.abs(trajectory.xi[-1] - target).max())
    if left > 2.0 * _ARRIVAL_DISTANCE:
        raise PlanError(f"the learned network is {left:.2g} from the target after {_LONGEST_RUN:g} of its time")
    # Waypoints are interpolated between so many samples.
    fraction = np.linspace(0.0, 1.0, 2000)
    times = np.interp(fraction, np.linspace(0.0, 1.0, len(trajectory.t)), trajectory.t)
    q = joints.positions(trajectory(times))
    q[0], q[-1] = problem.start, problem.target
    length = travelled(q / joint_scale(problem.arm))
    even = np.linspace(0.0, length[-1], count)
    return np.stack([np.interp(even, length, joint) for joint in q.T], axis=1)


def _along(problem: PlanningProblem, path: Floats, bend: float) -> Motion:
    """The motion along waypoints ``(W, n)``, smoothed."""
    return joint_motion(problem, *smoothed(problem, path, 1, bend))
