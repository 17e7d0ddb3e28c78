"""SE(3): every function against a second, independent way to the same number."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.lie import adjoint, exp, hat, left_jacobian_se3, left_jacobian_so3, log, spatial_twist, vee
from lieednn_sim.lie.se3 import continued, rotations, same_signs, transforms

tiny = st.floats(-12.0, -3.0).map(lambda power: 10.0**power)
# Zero, near zero, where the series hands over to the closed forms, anywhere, and near pi: random draws alone miss bugs.
angles = st.one_of(
    st.just(0.0),
    tiny,
    tiny.map(lambda gap: 1.0 - gap),
    tiny.map(lambda gap: 1.0 + gap),
    st.floats(0.0, 3.0),
    tiny.map(lambda gap: np.pi - gap),
)
large_angles = st.one_of(angles, st.floats(np.pi, 20.0))
directions = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).normal(size=9))


def make_twist(angle: float, direction: np.ndarray) -> np.ndarray:
    return np.concatenate([angle * direction[:3] / np.linalg.norm(direction[:3]), direction[3:6]])


def ad(twist: np.ndarray) -> np.ndarray:
    w, v = hat(twist[:3]), hat(twist[3:])
    return np.block([[w, np.zeros((3, 3))], [v, w]])


def integral_of_expm(matrix: np.ndarray) -> np.ndarray:
    """int_0^1 expm(s A) ds, read from one larger exponential (Van Loan): the left Jacobian when A = ad(xi)."""
    n = len(matrix)
    return expm(np.block([[matrix, np.eye(n)], [np.zeros((n, 2 * n))]]))[:n, n:]


def adjoint_of(pose: RigidTransform) -> np.ndarray:
    return adjoint(pose.rotation.as_matrix(), pose.translation)


def test_hat_is_the_cross_product_and_vee_its_inverse():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 4, 5, 3))
    np.testing.assert_allclose((hat(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-15)
    twist = rng.normal(size=(4, 5, 6))
    assert np.array_equal(vee(hat(twist)), twist)
    assert np.array_equal(vee(hat(a)), a)


@given(large_angles, directions)
def test_exp_is_the_matrix_exponential(angle, direction):
    twist = make_twist(angle, direction)
    np.testing.assert_allclose(exp(twist).as_matrix(), expm(hat(twist)), atol=1e-12)


@given(angles, directions)
def test_log_inverts_exp(angle, direction):
    twist = make_twist(angle, direction)
    # Half a turn from either side is one pose: there the pose comes back, if not the twist.
    np.testing.assert_allclose(exp(log(exp(twist))).as_matrix(), exp(twist).as_matrix(), atol=1e-12)
    if angle < 3.1:
        np.testing.assert_allclose(log(exp(twist)), twist, rtol=1e-11, atol=1e-13)


@given(large_angles, directions)
def test_adjoint_moves_twists_as_conjugation_does(angle, direction):
    pose, twist = exp(make_twist(angle, direction)), direction[3:]
    conjugated = pose.as_matrix() @ hat(twist) @ pose.inv().as_matrix()
    np.testing.assert_allclose(adjoint_of(pose) @ twist, vee(conjugated), atol=1e-12)
    np.testing.assert_array_equal(adjoint(pose), adjoint_of(pose))
    moved = pose * exp(twist) * pose.inv()
    np.testing.assert_allclose(exp(adjoint_of(pose) @ twist).as_matrix(), moved.as_matrix(), atol=1e-12)


@given(large_angles, directions)
def test_left_jacobians_are_the_integral_of_the_adjoint(angle, direction):
    twist = make_twist(angle, direction)
    np.testing.assert_allclose(left_jacobian_se3(twist), integral_of_expm(ad(twist)), atol=2e-13)
    np.testing.assert_allclose(left_jacobian_so3(twist[:3]), integral_of_expm(hat(twist[:3])), atol=1e-13)


@given(large_angles, directions, directions)
def test_the_spatial_twist_is_the_left_jacobian_times_the_rate(angle, direction, towards):
    twist, rate = make_twist(angle, direction), make_twist(2.0, towards)[::-1]
    np.testing.assert_allclose(spatial_twist(twist, rate), left_jacobian_se3(twist) @ rate, rtol=0, atol=1e-13)
    both = spatial_twist(np.array([[twist, rate]]), np.array([[rate, rate]]))
    np.testing.assert_allclose(both[0, 0], spatial_twist(twist, rate), rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    "function", [hat, left_jacobian_so3, left_jacobian_se3, lambda x: exp(x).as_matrix(), lambda x: adjoint_of(exp(x))]
)
def test_batches_equal_one_by_one(function):
    size = 3 if function is left_jacobian_so3 else 6
    twists = np.random.default_rng(1).normal(size=(2, 3, size)) * np.array([1e-9, 0.5, 3.0])[:, None]
    result = function(twists)
    assert result.shape[:2] == (2, 3)
    for index in np.ndindex(2, 3):
        np.testing.assert_allclose(result[index], function(twists[index]), rtol=0, atol=1e-15)
    assert function(np.zeros((0, size))).shape == (0, *result.shape[2:])


@pytest.mark.parametrize("shape", [(), (50,), (20, 3), (0, 4)])
def test_rotations_and_poses_are_scipys_to_the_last_bit(shape):
    rng = np.random.default_rng(3)
    matrix = np.zeros((*shape, 4, 4))
    matrix[..., :3, 3], matrix[..., 3, 3] = rng.normal(size=(*shape, 3)), 1.0
    turns = Rotation.from_rotvec(rng.normal(size=(2, *shape, 3)) * np.pi).as_matrix()
    matrix[..., :3, :3] = turns[0] @ turns[1]
    rotation, translation = matrix[..., :3, :3], matrix[..., :3, 3]
    np.testing.assert_array_equal(rotations(rotation).as_quat(), Rotation.from_matrix(rotation).as_quat())
    expected = RigidTransform.from_matrix(matrix).as_matrix()
    np.testing.assert_array_equal(transforms(rotation, translation).as_matrix(), expected)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: hat(np.zeros(4)), r"\(\.\.\., 3\) or \(\.\.\., 6\), got \(4,\)"),
        (lambda: hat([0.0, np.nan, 0.0]), "vector must be finite, got 1"),
        (lambda: vee(np.zeros((3, 4))), r"\(\.\.\., 4, 4\), got \(3, 4\)"),
        (lambda: exp(np.zeros(5)), r"twist must have shape \(\.\.\., 6\), got \(5,\)"),
        (lambda: left_jacobian_so3(np.zeros(6)), r"omega must have shape \(\.\.\., 3\)"),
        (lambda: adjoint(np.eye(3)), "adjoint needs a pose, or a rotation and a translation"),
        (lambda: adjoint(np.zeros((2, 3, 3)), np.zeros((3, 3))), r"share their leading axes, got \(2, 3, 3\)"),
    ],
)
def test_wrong_input_is_named(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_logarithms_along_a_way_go_on_beyond_half_a_turn_and_come_back():
    s = np.sin(np.linspace(0.0, np.pi, 200))
    # About a fixed screw there and back, up to 1.6 pi, beside one that stays below half a turn.
    ways = (
        s[:, None, None] * np.array([[0.6, 0.0, 0.8, 0.1, -0.2, 0.3], [0.0, 0.5, 0.0, 0.4, 0.0, 0.0]]) * [[5.0], [2.0]]
    )
    principal = log(exp(ways))
    assert np.abs(principal - ways).max() > 1.0
    np.testing.assert_allclose(continued(principal), ways, atol=1e-9)
    below = log(exp(0.5 * ways))
    assert continued(below) is below


def test_quaternions_keep_their_sign_along_turns():
    turns = Rotation.from_rotvec(np.linspace(0.0, 4.0 * np.pi, 200)[:, None] * [[0.6, 0.0, 0.8]])
    flipping = turns.as_quat(canonical=True)
    assert np.vecdot(flipping[1:], flipping[:-1]).min() < 0.0
    kept = same_signs(flipping)
    assert np.vecdot(kept[1:], kept[:-1]).min() > 0.0
    np.testing.assert_array_equal(np.abs(kept), np.abs(flipping))
