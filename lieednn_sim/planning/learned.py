"""Motions of an end effector that were learned from recordings, planned for an arm.

The end effector follows the learned poses up to 0.5 mm and 0.1 degrees. Joint positions are found from one pose to the
next by Newton's method, starting from several solutions of the inverse kinematics at the first pose. The joint motion,
with the recordings' time law, is the guide of a network of the arm (`planning.shaped`), with its own certificate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform

from lieednn_sim.arm import Arm, TaskSpaceRegion, ik_candidates
from lieednn_sim.budget import check_time, cpu_time, default_limit, one_blas_thread
from lieednn_sim.errors import LieEDNNError, NoSolutionError, OutOfTimeError, PlanError
from lieednn_sim.learning.demonstrations import LearnedMotion
from lieednn_sim.lie.se3 import transforms
from lieednn_sim.planning.joint_space import joint_motion
from lieednn_sim.planning.motion import Motion, joint_scale, travelled
from lieednn_sim.planning.path_constraints import KEPT_ANGLE, KEPT_DISTANCE, projected
from lieednn_sim.planning.problem import Duration, Plan, PlanningProblem, durations, in_time
from lieednn_sim.planning.shaped import ShapedOptions, followed_guide
from lieednn_sim.planning.statics import check_held
from lieednn_sim.planning.time_laws import recorded_law, retime
from lieednn_sim.validation import Seed, as_floats, as_seed
from lieednn_sim.values import Floats, distances

#: The planner's name in `Plan.guide` for a learned motion.
LEARNED = "learned motion"
_REMEDY = (
    "give another goal or start (goal, start; --position, --pose, --start), or leave the orientation free where it was "
    "recorded (turning=False, --no-turning), as for an arm with fewer than six joints"
)


def plan_learned(
    arm: Arm,
    learned: LearnedMotion,
    *,
    start: ArrayLike | str | None = None,
    goal: RigidTransform | ArrayLike | None = None,
    turning: bool = True,
    duration: Duration | None = None,
    fastest: bool = False,
    seed: Seed = 0,
) -> Plan:
    """Plan a motion in which the arm's end effector moves as it was learned.

    Args:
        arm: the arm, in its scene.
        learned: the motion, from `ShapedMotion.fit` or `LearnedMotion.load`.
        start: joint position ``(n,)`` at rest [rad, m], or a keyframe's name; by default where the recordings began.
        goal: final pose of the end effector in the world, or its position ``(3,)`` [m] with the rotation at the
            recordings' end; by default the pose at their end.
        turning: whether the end effector turns as recorded, if orientations were recorded; otherwise they are free.
        duration: as for `plan`; by default that of the recordings, and at most three times as long.
        fastest: as for `plan`.
        seed: seed of the inverse kinematics.

    Raises:
        InputError: a value is malformed, or the arm cannot be at the start.
        NoSolutionError: the end effector cannot reach the first pose.
        PlanError: it cannot follow the others, or the motion breaks a limit of the arm.
    """
    if not (goal is None or isinstance(goal, RigidTransform)):
        goal = transforms(learned.goal.rotation.as_matrix(), as_floats("the position of goal", goal, (3,)))
    usual = float(as_floats("learned.t", learned.t, ("K",))[-1])
    begin, shortest, longest = cpu_time(), *durations(usual if duration is None else duration)
    q = None if start is None else arm.check_start(start)
    poses = learned.poses(None if q is None else arm.link_poses(q)[-1], goal)
    turning = turning and learned.dof == 6
    if turning:
        regions = [TaskSpaceRegion(pose, np.zeros(6), np.zeros(6)) for pose in poses]
    else:  # all poses at their places
        regions = [TaskSpaceRegion.box(place, place) for place in poses.translation]
    refusal = ""
    with default_limit(), one_blas_thread():
        for first in _starts(arm, regions[0], seed) if q is None else [q]:
            free, leaves = arm.leaving(first)
            try:
                path = _followed(arm, first, regions)
                problem = PlanningProblem(free, path[0], path[-1], shortest, as_seed("seed", seed), longest)
                check_held(arm, path[[0, -1]], ["the start", "the target"])
                guide = Plan(_timed(problem, path, learned.t), target=path[-1], planner=LEARNED)
                result = followed_guide(problem, ShapedOptions(), guide)
                motion = retime(free, result.motion) if fastest else result.motion
            except OutOfTimeError:
                raise
            except LieEDNNError as error:
                refusal = refusal or str(error)
                continue
            spent = cpu_time() - begin
            result = replace(result, motion=motion, target=path[-1], planner="lieednn-shaped", cpu_time=spent)
            return replace(result, arm=arm, leaves=leaves)
    raise PlanError(f"the arm cannot do the learned motion: {refusal}; {_REMEDY}")


def _starts(arm: Arm, region: TaskSpaceRegion, seed: Seed) -> list[Floats]:
    try:
        return ik_candidates(arm, region, seed=seed)
    except NoSolutionError as error:
        place = ", ".join(f"{x:.3g}" for x in region.project(arm.link_poses(arm.keyframe("home"))[-1]).translation)
        raise NoSolutionError(f"at the start of the learned motion, ({place}) m, {error}; {_REMEDY}") from None


def _followed(arm: Arm, start: Floats, regions: list[TaskSpaceRegion]) -> Floats:
    """Joint positions ``(K, n)`` in regions in turn, each near the one before; the first one is ``start``."""
    # Keep a little inside the limits, since the network's path could exceed them where this path bends at them.
    (low, high), inset = arm.position_limits.T, 0.005 * arm.ranges
    bounds = np.stack([np.minimum(low + inset, start), np.maximum(high - inset, start)], axis=1)
    arm, path = replace(arm, position_limits=bounds), [start]
    for k, region in enumerate(regions[1:], start=1):
        check_time()
        q = projected(arm, path[-1][None], region)[0]
        distance, angle = region.distance(arm.link_poses(q)[-1])
        if distance > KEPT_DISTANCE or angle > KEPT_ANGLE:
            near = np.minimum(q - bounds[:, 0], bounds[:, 1] - q) < 1e-3 * arm.ranges
            limits = ", ".join(repr(name) for name, at in zip(arm.joint_names, near, strict=True) if at)
            raise PlanError(
                f"at {100 * k / (len(regions) - 1):.0f} % of the way the end effector cannot come nearer than "
                f"{distances(float(distance), float(angle))} to it"
                + (f", with {limits} at the limit" if limits else "")
            )
        path.append(q)
    return np.array(path)


def _timed(problem: PlanningProblem, path: Floats, t: Floats) -> Motion:
    """The checked motion along joint positions ``(K, n)`` by the time law of their times ``(K,)``."""
    length = travelled(path / joint_scale(problem.arm))
    if length[-1] <= 0.0:
        raise PlanError("no joint moves")
    fraction = length / length[-1]
    kept = np.flatnonzero(np.append(True, np.diff(fraction) > 1e-9))
    curve = CubicSpline(fraction[kept], path[kept])
    law = recorded_law(t, fraction)

    def motion(asked: PlanningProblem) -> Motion:
        times = asked.times()
        progress, rate = law(times / times[-1])
        # Between joint positions at a limit the curve may pass it a little.
        q = np.clip(curve(progress), *problem.arm.position_limits.T)
        return joint_motion(asked, q, curve(progress, 1) * (rate / times[-1])[:, None], progress)

    return in_time(motion, problem)
