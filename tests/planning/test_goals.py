"""Poses of the end effector, regions and sets of goals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import lieednn_sim as ls
from lieednn_sim.arm import ik_candidates
from lieednn_sim.errors import InputError, NoSolutionError, PlanError
from lieednn_sim.planning.goals import candidates
from lieednn_sim.planning.motion import least_duration

from .arms import coarse

FAR = RigidTransform.from_translation([9.0, 0.0, 1.0])
GRID = RigidTransform(np.tile(np.eye(4), (2, 2, 1, 1)))


@pytest.fixture(scope="module")
def arm():
    return coarse("telescopic_pr", "poles", 1)


def test_candidates_have_the_pose_differ_and_come_by_the_time_of_their_slowest_joint(arm):
    pose = arm.link_poses(ls.draw_target(arm, seed=5))[-1]
    start = ls.draw_target(arm, seed=6)
    found = ik_candidates(arm, pose, start=start, seed=1)
    assert len(found) == 4
    for q in found:
        np.testing.assert_allclose(arm.link_poses(q)[-1].as_matrix(), pose.as_matrix(), atol=1e-5)
        arm.check_reachable(q)
    times = [max(abs(q - start) / arm.velocity_limits) for q in found]
    assert times == sorted(times)
    apart = [max(abs(a - b) / arm.ranges) for i, a in enumerate(found) for b in found[:i]]
    assert min(apart) > 1e-3
    again = ik_candidates(arm, pose, start=start, seed=1)
    np.testing.assert_array_equal(again, found)


@pytest.mark.usefixtures("own_names")
def test_the_next_candidate_is_taken_where_the_planner_finds_no_way_to_the_first(arm):
    pose = arm.link_poses(ls.draw_target(arm, seed=5))[-1]
    found = ik_candidates(arm, pose, seed=3)
    asked = []

    @ls.register_planner("stubborn")
    def stubborn(problem):
        asked.append(problem.target)
        if len(asked) < 3:
            raise PlanError(f"not to number {len(asked)}")
        return ls.plan(arm, problem.target, start=problem.start, seed=problem.seed).motion

    made = ls.plan(arm, pose, planner="stubborn", seed=3)
    np.testing.assert_array_equal(asked, found[:3])
    np.testing.assert_array_equal(made.target, found[2])
    np.testing.assert_allclose(made.motion.q[-1], found[2], atol=1e-6)
    asked.clear()
    with pytest.raises(PlanError, match="not to number 1"):
        ls.plan(arm, found[0], planner="stubborn", seed=3)


def test_of_all_goals_of_a_set_the_one_reached_soonest_comes_first(arm, monkeypatch):
    monkeypatch.setattr("lieednn_sim.arm.inverse_kinematics._ATTEMPTS", 4)
    joints = np.array([ls.draw_target(arm, seed=seed) for seed in (5, 6, 7)])
    pose = arm.link_poses(joints[0])[-1]
    region = ls.TaskSpaceRegion.box(pose.translation - 0.05, pose.translation + 0.05)
    home = arm.keyframe("home")
    beyond = arm.position_limits[:, 1] + 1.0
    found = list(candidates(arm, [joints[1], pose, region, FAR, beyond, "extended"], home))
    times = [least_duration(arm, home, q) for q in found]
    assert times == sorted(times)
    assert times[0] < min(least_duration(arm, home, q) for q in joints)
    inside = [max(region.distance(arm.link_poses(q)[-1])) < 1e-6 for q in found]
    assert sum(inside) >= 3
    np.testing.assert_array_equal(list(candidates(arm, joints, home)), list(candidates(arm, list(joints), home)))


@pytest.mark.parametrize(
    ("goal", "error", "message"),
    [
        ([], InputError, "target must hold at least one goal, got an empty list"),
        (np.zeros((2, 3)), InputError, r"target must have shape \(m, 8\), got \(2, 3\); a pose is a scipy"),
        ([np.zeros(8), np.zeros(3)], InputError, r"target 1 must have shape \(8,\), got \(3,\)"),
        (["home", "nowhere"], InputError, "no keyframe 'nowhere'"),
        (GRID, InputError, r"a pose or poses of shape \(m,\), got \(2, 2\)"),
        (FAR, NoSolutionError, r"cannot reach \(9, 0, 1\) m: the closest .* found is 6\.26 m away"),
        ([FAR] * 2, NoSolutionError, "none of 2 goals can be reached"),
    ],
)
def test_malformed_goals_are_refused_with_their_number(arm, goal, error, message, monkeypatch):
    monkeypatch.setattr("lieednn_sim.arm.inverse_kinematics._ATTEMPTS", 1)
    with pytest.raises(error, match=message):
        ls.plan(arm, goal)
