"""The quaternion network: joints as quaternions, weights that are quaternions, and that it arrives."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from lieednn_sim.arm import Arm
from lieednn_sim.errors import PlanError
from lieednn_sim.learning.manifold import QuaternionWeights
from lieednn_sim.planning import PlanningProblem, QshnnOptions
from lieednn_sim.planning.baselines.qshnn import JointQuaternions, learned, path_of, qshnn

ARMS = [Arm.load(name) for name in ("telescopic_compound", "telescopic_pr", "telescopic_rrp")]
ARM = ARMS[1]
PROBLEM = PlanningProblem(ARM, ARM.keyframe("home"), ARM.keyframe("extended"), 4.0)
OPTIONS = QshnnOptions()
JOINTS = JointQuaternions(ARM, OPTIONS.modulus)
TARGET = JOINTS.quaternions(PROBLEM.target)
# p -> p i, p -> p j and p -> p k of p = (w, x, y, z): (w + x i + y j + z k) i = -x + w i + z j - y k, and so on.
RIGHT = np.array(
    [
        [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -1, 0]],
        [[0, 0, -1, 0], [0, 0, 0, -1], [1, 0, 0, 0], [0, 1, 0, 0]],
        [[0, 0, 0, -1], [0, 0, 1, 0], [0, -1, 0, 0], [1, 0, 0, 0]],
    ],
    dtype=float,
)


@pytest.fixture(scope="module")
def result():
    return learned(TARGET, OPTIONS, [0, 0])


def test_a_hinge_is_its_turn_and_a_slide_a_share_of_half_a_turn():
    joints, (low, high) = JointQuaternions(ARM, 1.0), ARM.position_limits.T
    q = 0.5 * (low + high)
    np.testing.assert_allclose(joints.quaternions(q), np.tile([1.0, 0.0, 0.0, 0.0], (8, 1)), atol=1e-15)
    turn, lift = (ARM.joint_names.index(name) for name in ("turn", "lift"))
    q[turn], q[lift] = q[turn] + math.pi / 3, high[lift]
    # Both about the vertical; half of the range is a quarter of a turn.
    np.testing.assert_allclose(joints.quaternions(q)[turn], [math.sqrt(0.75), 0.0, 0.0, 0.5], atol=1e-15)
    np.testing.assert_allclose(joints.quaternions(q)[lift], np.array([1.0, 0.0, 0.0, 1.0]) / math.sqrt(2), atol=1e-15)


@given(seed=st.integers(0, 2**32 - 1), arm=st.sampled_from(ARMS))
def test_postures_come_back_whatever_the_modulus_and_the_turns_about_other_axes(seed, arm):
    rng, joints = np.random.default_rng(seed), JointQuaternions(arm, 0.5)
    q = rng.uniform(*arm.position_limits.T, (3, arm.n_joints))
    x = joints.quaternions(q)
    np.testing.assert_allclose(np.linalg.norm(x, axis=-1), 0.5, atol=1e-12)
    np.testing.assert_allclose(joints.positions(rng.uniform(0.1, 2.0, (3, x.shape[1], 1)) * x), q, atol=1e-9)


def test_the_nearest_quaternion_is_the_mean_of_its_four_places():
    # Of the matrix with a one in the corner, (w, w) = 1: a quarter of the identity.
    weight = np.zeros((8, 8))
    weight[0, 4] = 1.0
    found = QuaternionWeights().project(weight, np.ones((2, 2)), "scaled").weight
    expected = np.zeros((8, 8))
    expected[:4, 4:] = 0.25 * np.eye(4)
    np.testing.assert_allclose(found, expected, atol=1e-15)
    drawn = np.random.default_rng(0).normal(size=(8, 8))
    once = QuaternionWeights().project(drawn, np.ones((2, 2)), "scaled").weight
    np.testing.assert_allclose(QuaternionWeights().project(once, np.ones((2, 2)), "scaled").weight, once, atol=1e-14)
    # What is taken away is orthogonal to what stays, so that nothing is nearer.
    np.testing.assert_allclose(((drawn - once) * once).sum(), 0.0, atol=1e-12)


def test_learned_weights_are_quaternions_with_the_target_as_a_stable_equilibrium(result):
    assert result.success
    network = result.network
    np.testing.assert_allclose(network.blocks @ RIGHT[:, None, None], RIGHT[:, None, None] @ network.blocks, atol=1e-14)
    assert np.abs(network.blocks).max() > 0.1
    np.testing.assert_array_equal(network.bias, OPTIONS.bias)
    np.testing.assert_allclose(network.equilibrium(TARGET).xi, TARGET, atol=1e-6)
    assert np.linalg.eigvals(network.jacobian(TARGET)).real.max() < 0.0


def test_the_network_runs_from_the_start_to_the_target_along_the_path(result):
    matrix, bias = result.network.weight, result.network.bias.ravel()
    x = JOINTS.quaternions(PROBLEM.start).ravel()
    run = solve_ivp(
        lambda _, x: -x + matrix @ np.tanh(x) + bias, (0.0, 200.0), x, rtol=1e-9, atol=1e-11, dense_output=True
    )
    np.testing.assert_allclose(run.y[:, -1], TARGET.ravel(), atol=2e-6)
    path = path_of(PROBLEM, JOINTS, result.network, 60)
    np.testing.assert_array_equal(path[[0, -1]], [PROBLEM.start, PROBLEM.target])
    states = run.sol(200.0 * np.linspace(0.0, 1.0, 4_000) ** 3).T.reshape(-1, *TARGET.shape)
    along = JOINTS.positions(states)
    far = np.linalg.norm(path[:, None] - along[None], axis=2).min(axis=1).max()
    assert far < 0.005
    straight = PROBLEM.start + np.linspace(0.0, 1.0, 60)[:, None] * (PROBLEM.target - PROBLEM.start)
    assert np.abs(path - straight).max() > 0.02, "the path is to be the network's own"


def test_the_motion_comes_close_to_the_path(result):
    path, motion = path_of(PROBLEM, JOINTS, result.network, 60), qshnn(PROBLEM, OPTIONS)
    far = np.linalg.norm(path[:, None] - motion.q[None, ::10], axis=2).min(axis=1).max()
    assert far < 0.01


def test_refusals_say_why():
    short = QshnnOptions(networks=2, training=dataclasses.replace(OPTIONS.training, max_epochs=10))
    with pytest.raises(PlanError, match=r"no quaternion network of 2 can be used: epochs spent after 10 epochs"):
        qshnn(PROBLEM, short)
