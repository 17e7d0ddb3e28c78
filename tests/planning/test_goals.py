"""Regions and sets of goals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import lieednn_sim as ls
from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.planning.goals import candidates
from lieednn_sim.planning.motion import least_duration

GRID = RigidTransform(np.tile(np.eye(4), (2, 2, 1, 1)))


@pytest.fixture(scope="module")
def arm():
    return ls.Arm.load("telescopic_pr", scene="poles", seed=1)


def test_of_all_goals_of_a_set_the_one_reached_soonest_comes_first(arm, monkeypatch):
    monkeypatch.setattr("lieednn_sim.arm.inverse_kinematics._ATTEMPTS", 4)
    joints = np.array([ls.draw_target(arm, seed=seed) for seed in (5, 6, 7)])
    pose = arm.link_poses(joints[0])[-1]
    region = ls.TaskSpaceRegion.box(pose.translation - 0.05, pose.translation + 0.05)
    home, far = arm.keyframe("home"), RigidTransform.from_translation([9.0, 0.0, 1.0])
    beyond = arm.position_limits[:, 1] + 1.0
    found = list(candidates(arm, [joints[1], pose, region, far, beyond, "extended"], home))
    times = [least_duration(arm, home, q) for q in found]
    assert times == sorted(times)
    assert times[0] < min(least_duration(arm, home, q) for q in joints)
    inside = [max(region.distance(arm.link_poses(q)[-1])) < 1e-6 for q in found]
    assert sum(inside) >= 3
    np.testing.assert_array_equal(list(candidates(arm, joints, home)), list(candidates(arm, list(joints), home)))


def test_a_region_as_a_goal_ends_in_it(arm):
    place, size = arm.tip(ls.draw_target(arm, seed=5)), np.array([0.02, 0.1, 0.02])
    region = ls.TaskSpaceRegion.box(place - size, place + size)
    made = ls.plan(arm, region)
    assert max(region.distance(arm.link_poses(made.motion.q[-1])[-1])) == 0.0
    assert made.network.certified


@pytest.mark.parametrize(
    ("goal", "error", "message"),
    [
        ([], InputError, "target must hold at least one goal, got an empty list"),
        (np.zeros((2, 3)), InputError, r"target must have shape \(m, 8\), got \(2, 3\)"),
        ([np.zeros(8), np.zeros(3)], InputError, r"target 1 must have shape \(8\), got \(3\)"),
        (["home", "nowhere"], InputError, "no keyframe 'nowhere'"),
        (GRID, InputError, r"a pose or poses of shape \(m,\), got \(2, 2\)"),
        ([RigidTransform.from_translation([9.0, 0.0, 1.0])] * 2, NoSolutionError, "none of 2 goals can be reached"),
    ],
)
def test_malformed_goals_are_refused_with_their_number(arm, goal, error, message, monkeypatch):
    monkeypatch.setattr("lieednn_sim.arm.inverse_kinematics._ATTEMPTS", 1)
    with pytest.raises(error, match=message):
        ls.plan(arm, goal)
