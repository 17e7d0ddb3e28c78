"""The twist from a frame to its goal: that of SciPy, from nothing to half a turn, and each as it is alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim._mujoco import mujoco
from lieednn_sim.environments.frames import pose_error_twists
from lieednn_sim.environments.tasks import tail


def rows(poses: RigidTransform) -> np.ndarray:
    found = np.empty((len(poses), 16))
    matrices = poses.as_matrix()
    found[:, :3], found[:, 3:12] = matrices[:, :3, 3], matrices[:, :3, :3].reshape(-1, 9)
    for row in found:
        mujoco.mju_mat2Quat(row[12:], row[3:12])
    return found


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 1.9e-4, 2.1e-4, 1e-2, 1.0, 3.1])
def test_twists_lead_from_frames_to_goals(angle):
    rng = np.random.default_rng(0)
    axis, place = rng.normal(size=(2, 50, 3))
    twist = np.hstack([angle * axis / np.linalg.norm(axis, axis=1, keepdims=True), place])
    begin = RigidTransform.from_components(rng.normal(size=(50, 3)), Rotation.random(50, rng=rng))
    way = RigidTransform.from_exp_coords(twist)
    frames, goals = rows(begin)[:, None], rows(begin * way)[:, None]
    found, distance, turned = pose_error_twists(frames, goals)
    np.testing.assert_allclose(found[:, 0], twist, atol=1e-13)
    np.testing.assert_allclose(distance, np.linalg.norm(way.translation, axis=1), atol=1e-13)
    np.testing.assert_allclose(turned, angle, atol=1e-13)
    alone = [pose_error_twists(frame, goal)[0] for frame, goal in zip(frames, goals, strict=True)]
    np.testing.assert_array_equal(found, alone)


def test_frames_at_their_goals_and_far_from_them_are_each_as_alone():
    rng = np.random.default_rng(1)
    begin = RigidTransform.from_components(rng.normal(size=(40, 3)), Rotation.random(40, rng=rng))
    scale = np.resize([0.0, 1e-7, 1e-4, 1e-2, 1.0], (40, 1))
    twist = scale * rng.normal(size=(40, 6))
    frames, goals = rows(begin)[:, None], rows(begin * RigidTransform.from_exp_coords(twist))[:, None]
    np.testing.assert_allclose(pose_error_twists(frames, goals)[0][:, 0], twist, atol=1e-13)
    alone = [pose_error_twists(frame, goal) for frame, goal in zip(frames, goals, strict=True)]
    for together, each in zip(pose_error_twists(frames, goals), zip(*alone, strict=True), strict=True):
        np.testing.assert_array_equal(together, each)


def test_of_several_frames_the_worst_counts_and_tails_fall_to_a_tenth():
    frames = rows(RigidTransform.from_translation(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])))
    goals = rows(RigidTransform.from_translation(np.array([[0.0, 0.1, 0.0], [1.0, 0.0, 0.3]])))
    assert pose_error_twists(frames, goals)[1] == pytest.approx(0.3)
    np.testing.assert_allclose(tail(np.array([0.0, 1.0])), [1.0, 0.1])
