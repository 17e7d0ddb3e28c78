"""Chunks as other software has them: a step of LeRobot's pipelines, and trajectory messages of ROS 2.

Both are recognised by their attributes; neither ``lerobot`` nor ``rclpy`` is imported.
"""

from __future__ import annotations

import copy
import math
import sys
from array import array
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.chunks import MOST_TARGETS
from lieednn_sim.policies.chunks import ChunkPolicy
from lieednn_sim.validation import as_array, as_floats, as_nonnegative, as_positive
from lieednn_sim.values import Floats


class ChunkStep:
    """A step of a LeRobot pipeline between a learned policy and the robot; each call is one control period.

    A transition's action is a new chunk ``(H, n)``, maybe in a batch of one, or None. It becomes the reference ``(n,)``
    of the joints, as a tensor if chunks or states are. ``observation.state`` begins with the measured joints ``(n,)``
    of one instant, where the policy starts, also after `reset`. Further columns of a chunk, such as a gripper's, stay
    as they are, at the time of the chunk that the reference is at; before the first chunk there are none. The info
    says what became of a chunk, as ``chunk``.

    Args:
        policy: the policy, whose rate is that of the calls.
        dt: time between two targets of a chunk [s].
        delay: age of the observation that a chunk was made from when it comes [s]; a transition may have its own in
            its complementary data, as ``delay``.
        degrees: whether the pipeline has hinges in degrees, not in radians.
    """

    def __init__(self, policy: ChunkPolicy, dt: float, *, delay: float = 0.0, degrees: bool = False) -> None:
        self.policy, self._dt, self._delay = policy, as_positive("dt", dt), as_nonnegative("delay", delay)
        units = [policy.arm.unit(joint) for joint in range(policy.arm.n_joints)]
        self._scale = np.where(degrees & (np.array(units) == "rad"), np.pi / 180.0, 1.0)
        self._like: Any = np.asarray
        self._stay: Floats | None = None  # the target before chunks
        self.reset()
        # Pipelines accept only instances of their base class, which is abstract, so that others can be registered.
        if lerobot := sys.modules.get("lerobot.processor"):
            lerobot.ProcessorStep.register(type(self))

    def __call__(self, transition: dict[str, Any]) -> dict[str, Any]:
        """The transition with the reference of this period as its action; raises `InputError` as the policy does."""
        policy, n, result = self.policy, len(self._scale), dict(transition)
        state = (transition.get("observation") or {}).get("observation.state")
        measured = None
        if state is not None:
            seen = np.atleast_1d(as_array("observation.state", state))
            seen = seen.ravel() if seen.size == seen.shape[-1] else seen
            measured = as_floats("observation.state", seen[..., :n], (n,)) * self._scale
        if self._stay is None:
            if measured is not None:
                policy.reset(measured)
                self._like = getattr(state, "new_tensor", self._like)
            self._stay = policy.q if "q" in vars(policy) else np.zeros(n)
        chunk = transition.get("action")
        if chunk is not None:
            self._like, targets = getattr(chunk, "new_tensor", self._like), np.atleast_1d(as_array("action", chunk))
            targets = targets[0] if targets.ndim == 3 and len(targets) == 1 else targets
            joints = targets[..., :n] * self._scale[: targets.shape[-1]]
            joints[~np.isfinite(targets).all(axis=-1)] = np.nan  # a gripper's, too
            delay = (transition.get("complementary_data") or {}).get("delay", self._delay)
            begin = policy.now - max(float(delay), 0.0)  # clocks differ a little
            verdict = policy.accept(joints, begin, self._dt)
            if verdict.accepted:
                self._more = begin, targets[:, n:]
            result["info"] = {**(transition.get("info") or {}), "chunk": str(verdict)}
        q, _ = policy.step(measured, self._stay)
        begin, more = self._more
        row = min(max(int((policy.chunk_time - begin) / self._dt + 0.1), 0), len(more) - 1)
        result["action"] = self._like(np.append(q / self._scale, more[row]))
        return result

    def reset(self) -> None:
        """Start again from the joints that are measured next."""
        self._stay = None
        self._more = 0.0, np.empty((1, 0))  # when the last chunk began, and its further columns

    def transform_features(self, features: Any) -> Any:
        """The features of the pipeline, which stay as they are."""
        return features

    def get_config(self) -> dict[str, Any]:
        """An empty configuration: a pipeline that is loaded is given its policy anew."""
        return {}

    state_dict = get_config

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Does nothing."""


def from_joint_trajectory(arm: Arm, message: Any, now: float = 0.0) -> tuple[Floats, float, float]:
    """The arguments of `ChunkPolicy.accept` for a trajectory_msgs/JointTrajectory.

    Its points need not be evenly spaced: between them joints go straight, or by cubics if the points have velocities.

    Args:
        arm: the arm; the message has its joints, in any order, and maybe others.
        message: the message, of any library.
        now: the policy's time that ``time_from_start`` counts from [s].

    Raises:
        InputError: it is no such message, times do not increase, positions are malformed, or a joint is not named once.
    """
    try:
        names, points = list(message.joint_names), list(message.points)
        since = [point.time_from_start for point in points]
        t = np.array([duration.sec + 1e-9 * duration.nanosec for duration in since])
        rows, rates = ([list(getattr(point, name)) for point in points] for name in ("positions", "velocities"))
    except (AttributeError, TypeError) as error:
        raise InputError(f"the message must be a trajectory_msgs/JointTrajectory: {error}") from None
    if wrong := [name for name in arm.joint_names if names.count(name) != 1]:
        raise InputError(f"the trajectory lacks, or names twice, {', '.join(wrong)}; it has {', '.join(names)}")
    order, shape = [names.index(name) for name in arm.joint_names], (len(points), len(names))
    if not len(t) or (np.diff(t) <= 0.0).any():
        raise InputError(f"the times of a trajectory must increase from point to point, and it needs one; got {t}")
    q = as_floats("positions of the points", rows, shape)[:, order]
    q = np.where(arm.continuous, np.unwrap(q, axis=0), q)
    if len(t) == 1:
        return q, now + float(t[0]), 1.0
    count = min(math.ceil((t[-1] - t[0]) / np.diff(t).min() - 1e-6) + 1, MOST_TARGETS)
    times, step = np.linspace(t[0], t[-1], count, retstep=True)
    if all(rates):
        way = CubicHermiteSpline(t, q, as_floats("velocities of the points", rates, shape)[:, order])
    else:
        way = make_interp_spline(t, q, k=1)
    return np.asarray(way(times)), now + float(t[0]), float(step)


def to_joint_trajectory(arm: Arm, like: Any, q: ArrayLike, qd: ArrayLike, period: float) -> Any:
    """A trajectory_msgs/JointTrajectory of one point: the reference at the end of a period, as `Policy.step` returns.

    Args:
        arm: the arm.
        like: a message of the library wanted, with a point or more; it stays as it is.
        q, qd: ``(n,)`` joint coordinates and rates.
        period: time until then [s].

    Raises:
        InputError: it is no such message, or a value is malformed.
    """
    values = as_floats("q", q, (arm.n_joints,)), as_floats("qd", qd, (arm.n_joints,)), np.empty(0), np.empty(0)
    try:
        message = copy.deepcopy(like)
        point = message.points[0]
        as_numpy = isinstance(point.positions, np.ndarray)
    except (AttributeError, IndexError, TypeError) as error:
        raise InputError(f"the message must be a trajectory_msgs/JointTrajectory with a point: {error}") from None
    for name, content in zip(("positions", "velocities", "accelerations", "effort"), values, strict=True):
        setattr(point, name, content.copy() if as_numpy else array("d", content))
    point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(1e9 * as_positive("period", period)), 10**9)
    message.joint_names, message.points = list(arm.joint_names), [point]
    return message
