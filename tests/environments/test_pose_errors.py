"""The twist from a frame to its goal: that of SciPy, from nothing to half a turn, and each as it is alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim._mujoco import mujoco
from lieednn_sim.environments.observations import pose_error_twists


def rows(poses: RigidTransform) -> np.ndarray:
    found = np.empty((len(poses), 16))
    matrices = poses.as_matrix()
    found[:, :3], found[:, 3:12] = matrices[:, :3, 3], matrices[:, :3, :3].reshape(-1, 9)
    for row in found:
        mujoco.mju_mat2Quat(row[12:], row[3:12])
    return found


def test_twists_lead_from_frames_to_goals_each_as_it_is_alone():
    rng = np.random.default_rng(0)
    angle = np.resize([0.0, 1e-9, 1e-7, 1e-5, 1e-4, 1.9e-4, 2.1e-4, 1e-2, 1.0, 3.1], 400)
    axis, place = rng.normal(size=(2, 400, 3))
    place *= rng.choice([0.0, 1e-7, 1.0], (400, 1))
    twist = np.hstack([angle[:, None] * axis / np.linalg.norm(axis, axis=1, keepdims=True), place])
    begin = RigidTransform.from_components(rng.normal(size=(400, 3)), Rotation.random(400, rng=rng))
    way = RigidTransform.from_exp_coords(twist)
    frames, goals = rows(begin)[:, None], rows(begin * way)[:, None]
    found, distance, turned = pose_error_twists(frames, goals)
    np.testing.assert_allclose(found[:, 0], twist, atol=1e-13)
    np.testing.assert_allclose(distance, np.linalg.norm(way.translation, axis=1), atol=1e-13)
    np.testing.assert_allclose(turned, angle, atol=1e-13)
    alone = [pose_error_twists(frame, goal) for frame, goal in zip(frames, goals, strict=True)]
    for together, each in zip((found, distance, turned), zip(*alone, strict=True), strict=True):
        np.testing.assert_allclose(together, each, atol=1e-14)


def test_of_several_frames_the_worst_counts():
    frames = rows(RigidTransform.from_translation(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])))
    goals = rows(RigidTransform.from_translation(np.array([[0.0, 0.1, 0.0], [1.0, 0.0, 0.3]])))
    assert pose_error_twists(frames, goals)[1] == pytest.approx(0.3)
