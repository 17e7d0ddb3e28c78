"""The nearest posture of hinge and slide: against a search over all angles, near zero and half a turn too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim.arm.kinematics import CompoundJoint, CompoundJoints, Factor
from lieednn_sim.arm.projection import Retraction, Retractor
from lieednn_sim.lie import exp, log

LENGTH = 0.7
ANGLES = np.linspace(-np.pi, np.pi, 361)
AXIS, SLANTED, ACROSS = np.array([0.0, 0.6, 0.8]), np.array([0.48, -0.64, 0.6]), np.array([1.0, 0.0, 0.0])


def retractor(order: str, direction: np.ndarray) -> tuple[Retractor, CompoundJoints]:
    """One joint; its slide is a coupled pair that moves 0.8 times its coordinate."""
    hinge = Factor("hinge", AXIS[:, None], np.zeros(3), np.array([0]))
    slides = [Factor("slide", direction[:, None], np.zeros(3), np.array([1]), ratio) for ratio in (0.5, 0.3)]
    factors = (hinge, *slides) if order == "turn first" else (*slides, hinge)
    joints = CompoundJoints((CompoundJoint(factors),), np.array([0.1, -0.2]))
    return Retractor(joints, LENGTH), joints


def squared_distance(joints: CompoundJoints, q: np.ndarray, xi: np.ndarray) -> np.ndarray:
    """4 sin^2(angle / 2) + ||shift||^2 / LENGTH^2, by SciPy's poses."""
    found, wanted = joints.poses(q), exp(xi)
    angle = np.asarray((found.inv() * wanted).rotation.magnitude())
    shift = np.asarray(found.translation) - np.asarray(wanted.translation)
    return (4.0 * np.sin(0.5 * angle) ** 2 + (shift**2).sum(axis=-1) / LENGTH**2)[..., 0]


def least_distance(joints: CompoundJoints, order: str, direction: np.ndarray, xi: np.ndarray) -> float:
    """The least over a grid of angles; the best slide is the foot of the perpendicular."""
    p = np.asarray(exp(xi).translation)[0]
    local = Rotation.from_rotvec(-ANGLES[:, None] * AXIS).apply(p) if order == "turn first" else np.tile(p, (361, 1))
    q = joints.reference + np.stack([ANGLES, local @ direction / 0.8], axis=-1)
    return float(squared_distance(joints, q, np.broadcast_to(xi, (361, 1, 6))).min())


def drawn(joints: CompoundJoints, seed: int, spread: float, turn: float) -> np.ndarray:
    """A posture at an angle near ``turn``, its pose disturbed by ``spread``."""
    rng = np.random.default_rng(seed)
    q = joints.reference + np.array([turn + min(spread, 0.1) * rng.normal(), rng.uniform(-0.5, 0.5)])
    disturbance = exp(np.clip(spread * rng.normal(size=(1, 6)), -3.0, 3.0))
    return np.asarray(log(disturbance * joints.poses(q)))


@pytest.mark.parametrize("order", ["turn first", "slide first"])
@pytest.mark.parametrize("direction", [AXIS, ACROSS, SLANTED], ids=["along", "across", "slanted"])
@settings(max_examples=8)
@given(
    seed=st.integers(0, 2**32 - 1),
    spread=st.sampled_from([0.0, 1e-9, 1e-3, 0.1, 0.8, 3.0]),
    turn=st.sampled_from([0.0, 1e-6, 1.2, -2.0, np.pi - 1e-6, -np.pi]),
)
def test_nothing_is_nearer_than_the_retraction(order, direction, seed, spread, turn):
    retract, joints = retractor(order, direction)
    xi = drawn(joints, seed, spread, turn)
    found = retract(xi)
    distance = float(squared_distance(joints, found.q, xi))
    # Rounding of the angle in the grid's own distances is 1e-8.
    assert distance <= least_distance(joints, order, direction, xi) + 1e-14
    assert abs(found.q[0] - joints.reference[0]) <= np.pi + 1e-12
    neighbours = found.q + 1e-4 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    assert distance <= squared_distance(joints, neighbours, np.broadcast_to(xi, (4, 1, 6))).min() + 1e-14
    gap = exp(xi).inv() * joints.poses(found.q)
    np.testing.assert_allclose(found.gap_translation, np.linalg.norm(gap.translation, axis=-1), atol=1e-12)
    np.testing.assert_allclose(found.gap_rotation, gap.rotation.magnitude(), atol=1e-7)


def test_hand_computed_compromise():
    """R = I, p = (3, 4, 0) / 5, a slide along x that turns about z, length 1: more turn is less shift.

    g = 2 cos(theta) [tr(Rot(theta)^T I) = 1 + 2 cos, so x = 2, y = 0] + (0.6 cos + 0.8 sin)^2, and g' = 0 where
    2 sin(theta) = 2 (0.6 cos + 0.8 sin) (0.8 cos - 0.6 sin).
    """
    z, x = np.eye(3)[:, [2]], np.eye(3)[:, [0]]
    indices = np.arange(2)
    factors = (Factor("hinge", z, np.zeros(3), indices[:1]), Factor("slide", x, np.zeros(3), indices[1:]))
    retract = Retractor(CompoundJoints((CompoundJoint(factors),), np.zeros(2)), 1.0)
    angle, slide = retract(np.array([[0.0, 0.0, 0.0, 0.6, 0.8, 0.0]])).q
    cos, sin = np.cos(angle), np.sin(angle)
    assert sin == pytest.approx((0.6 * cos + 0.8 * sin) * (0.8 * cos - 0.6 * sin), abs=1e-14)
    assert 0.2 < angle < np.arctan2(4.0, 3.0)
    assert slide == pytest.approx(0.6 * cos + 0.8 * sin)
    # Where the translation counts for next to nothing, rotation alone decides: here at zero.
    far = Retractor(CompoundJoints((CompoundJoint(factors),), np.zeros(2)), 1e6)
    np.testing.assert_allclose(far(np.array([[0.0, 0.0, 0.0, 0.6, 0.8, 0.0]])).q, [0.0, 0.6], atol=1e-11)


@pytest.mark.parametrize("order", ["turn first", "slide first"])
@settings(max_examples=12)
@given(
    seed=st.integers(0, 2**32 - 1),
    spread=st.sampled_from([0.0, 1e-9, 1e-3, 0.1, 0.5]),
    turn=st.sampled_from([0.0, 1e-6, 1.2, -2.0, np.pi - 0.2]),
)
def test_rates_are_the_derivative(order, seed, spread, turn):
    retract, joints = retractor(order, SLANTED)
    rng = np.random.default_rng(seed)
    xi, rate, h = drawn(joints, seed, spread, turn), rng.normal(size=(1, 6)), 1e-5
    ahead, behind = retract(xi + h * rate).q, retract(xi - h * rate).q
    numeric = (ahead - behind) / (2.0 * h)
    # Half a turn away from the joint's own rotation the nearest posture jumps.
    if np.abs(numeric).max() < 30.0:
        np.testing.assert_allclose(retract(xi, rate).qd, numeric, atol=1e-6 * (1.0 + np.abs(numeric).max() ** 3))


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
@example(seed=0)
def test_poses_with_two_nearest_postures_give_one_of_them_and_finite_rates(seed):
    """The rotation is half a turn about a line across the axis, so that it says nothing of the angle."""
    retract, joints = retractor("turn first", ACROSS)
    rng = np.random.default_rng(seed)
    xi = np.concatenate([np.pi * ACROSS, [0.0, 0.0, 0.0] if seed % 2 else rng.normal(size=3)])[None]
    found: Retraction = retract(xi, rng.normal(size=(1, 6)))
    assert np.isfinite(found.q).all()
    assert np.isfinite(found.qd).all()
    distance = float(squared_distance(joints, found.q, xi))
    assert distance <= least_distance(joints, "turn first", ACROSS, xi) + 1e-14
