"""Many rotation matrices as quaternions, against MuJoCo's own function bit by bit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim._mujoco import mujoco
from lieednn_sim.simulation.quaternions import quaternions


@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([1e-12, 1e-8, 1e-4, 1.0, np.pi]))
def test_quaternions_are_mujoco_s(seed, size):
    """Of random and tiny rotations, and of those around 180 degrees, where each component is the largest in turn."""
    vectors = np.random.default_rng(seed).normal(size=(4, 5, 3))
    vectors *= size / np.linalg.norm(vectors, axis=-1, keepdims=True)
    matrices = Rotation.from_rotvec(np.concatenate([vectors, [np.pi * np.eye(3)[[0, 1, 2, 0, 1]]]])).as_matrix()
    expected = np.empty((5, 5, 4))
    for index in np.ndindex(5, 5):
        mujoco.mju_mat2Quat(expected[index], matrices[index].ravel())
    np.testing.assert_array_equal(quaternions(matrices), expected)
