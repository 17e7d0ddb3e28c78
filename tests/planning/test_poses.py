"""Poses of the end effector as targets."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import lieednn_sim as ls
from lieednn_sim.arm import ik_candidates
from lieednn_sim.errors import NoSolutionError, PlanError


@pytest.fixture(scope="module")
def arm():
    return ls.Arm.load("telescopic_pr", scene="poles", seed=1)


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


def test_a_pose_out_of_reach_is_refused_with_the_distance(arm, monkeypatch):
    monkeypatch.setattr("lieednn_sim.arm.inverse_kinematics._ATTEMPTS", 2)
    with pytest.raises(NoSolutionError, match=r"cannot reach \(9, 0, 1\) m with this orientation"):
        ls.plan(arm, RigidTransform.from_translation([9.0, 0.0, 1.0]))
