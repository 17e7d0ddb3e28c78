"""Demonstrations seen from their goals, and at equal phases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations import Demonstration, align
from lieednn_sim.learning.demonstrations.alignment import displacement, in_world


def recorded(position, vectors=None, t=None):
    """Positions, with rotations by rotation vectors where there are some."""
    samples = np.asarray(position, dtype=float)
    if vectors is not None:
        samples = np.concatenate([samples, Rotation.from_rotvec(vectors).as_quat(scalar_first=True)], axis=1)
    return Demonstration.from_samples(samples, t)


@pytest.mark.parametrize(("length", "extent"), [(0.3, 0.4), (0.5, 0.5)])
def test_the_extent_is_the_larger_of_the_way_and_the_turn_by_its_lever(length, extent):
    """A turn of 2 rad counts for 0.4 m."""
    share = np.linspace(1.0, 0.0, 20)[:, None]
    shown = align([recorded(length * share * [1.0, 0.0, 0.0], 2.0 * share * [0.0, 1.0, 0.0])], lever=0.2)
    assert shown.extent == pytest.approx(extent)


def test_a_turn_beyond_pi_goes_on():
    angle = np.linspace(1.5 * np.pi, 0.0, 40)
    # About an axis of its own, from a goal that is turned itself: turns from it are seen along the world's axes.
    axis, goal = np.array([0.6, 0.0, 0.8]), Rotation.from_rotvec([0.3, -0.2, 0.5])
    vectors = (Rotation.from_rotvec(angle[:, None] * axis) * goal).as_rotvec()
    position = np.column_stack([np.cos(angle), np.sin(angle), angle])
    one = recorded(position, vectors)
    np.testing.assert_allclose(one.twists[:, :3], angle[:, None] * axis, atol=1e-12)
    np.testing.assert_allclose(displacement(one.twists)[:, 3:], position - position[-1], atol=1e-12)


def test_a_full_turn_has_no_chart():
    angle = np.linspace(2.0 * np.pi, 0.0, 40)
    vectors = angle[:, None] * [0.0, 0.0, 1.0]
    with pytest.raises(InputError, match="a full turn or more"):
        _ = recorded(np.zeros((40, 3)), vectors).twists


@given(st.integers(0, 2**32 - 1))
def test_the_world_and_back(seed):
    rng = np.random.default_rng(seed)
    position, vectors = np.cumsum(rng.normal(size=(2, 5, 3)), axis=1)
    one = recorded(position, 0.5 * vectors)
    poses = in_world(one.twists, align([one], samples=2).goal)
    np.testing.assert_allclose(poses.translation, position, atol=1e-9)
    np.testing.assert_allclose(poses.rotation.as_matrix(), one.rotation, atol=1e-9)


def test_length_does_not_depend_on_pace_and_time_does():
    corner = np.array([[1.0, 3.0], [1.0, 0.0], [0.0, 0.0]])
    # The same way with a pause at its corner, elsewhere in the world and in another time.
    paused = np.add([[1.0, 3.0], [1.0, 0.0], [1.0, 0.0], [0.0, 0.0]], [5.0, 7.0])
    both = align([recorded(corner, t=[0, 3, 4]), recorded(paused, t=[0, 2, 5, 8])], samples=5)
    expected = [[1.0, 3.0], [1.0, 2.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]
    np.testing.assert_allclose(both.mean[:, 3:5], expected, atol=1e-12)
    np.testing.assert_allclose(both.spread, 0.0, atol=1e-12)
    # Mean of 0, 1, 2, 3, 4 and of 0, 2/3, 4/3, 2, 8: the pause belongs to what follows it.
    np.testing.assert_allclose(both.t, [0.0, 5 / 6, 5 / 3, 2.5, 6.0])
    np.testing.assert_allclose(both.goal.translation, [2.5, 3.5, 0.0])
    by_time = align([recorded(corner, t=[0, 3, 4]), recorded(paused, t=[0, 2, 5, 8])], samples=5, phase="time")
    np.testing.assert_allclose(by_time.twists[0, :, 4], [3.0, 2.0, 1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(by_time.twists[1, :, 4], [3.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(by_time.t, [0.0, 1.5, 3.0, 4.5, 6.0])


@pytest.mark.parametrize("pause", [0.0, 1.0, 1.4, 2.0])
@pytest.mark.parametrize(("noise", "rate"), [(0.0, 100), (5e-4, 100), (1e-4, 1000)])
def test_noise_makes_no_way_of_a_pause(pause, noise, rate):
    """Bends of 0.1 m in 2 s, one with a pause of 3 s; noise of each sample [m]."""
    rng, s = np.random.default_rng(0), np.linspace(0.0, 1.0, 2 * rate + 1)
    law = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    bend = np.column_stack([0.3 * (1.0 - law), 0.1 * np.sin(np.pi * law), 0.0 * s])
    paused = np.insert(bend, [round(pause * rate)] * 3 * rate, bend[round(pause * rate)], axis=0)
    shown = [one + noise * rng.normal(size=one.shape) for one in (bend, bend, paused)]
    found = align([Demonstration.from_samples(one, rate=rate) for one in shown])
    assert found.mean[:, 4].max() == pytest.approx(0.1, abs=1e-3)
    at = np.pi * (0.3 - found.mean[:, 3]) / 0.3
    np.testing.assert_allclose(found.mean[:, 4], 0.1 * np.sin(at), atol=2e-3)
    # A pause takes its third of the mean time, but at the end.
    assert found.duration == pytest.approx(2.0 if pause == 2.0 else 3.0, abs=0.15)


def test_mean_spread_and_those_left():
    lines = [recorded([[0.0, 2.0, 0.0], [0.0, 0.0, 0.0]]), recorded([[4.0, 0.0, 0.0], [0.0, 0.0, 0.0]])]
    both = align(lines, samples=3)
    np.testing.assert_allclose(both.mean[:, 3:], [[2.0, 1.0, 0.0], [1.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(both.spread[0, 3:], [2.0, 1.0, 0.0])
    assert both.extent == 4.0
    np.testing.assert_allclose(both.without(0).mean, both.twists[1])
    with pytest.raises(InputError, match="only demonstration cannot be left out"):
        both.without(0).without(0)
    with pytest.raises(InputError, match="all must record the same"):
        align([lines[0], recorded([[1.0, 0.0], [0.0, 0.0]])])


def test_a_turn_has_length_by_the_lever():
    # A turn by one radian, then a metre: with a lever of 3 m the turn is three quarters of the way.
    one = recorded([[0.0] * 3, [0.0] * 3, [1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3])
    turns = align([one], samples=5, lever=3.0).displaced[0]
    np.testing.assert_allclose(turns[:, 2], [1.0, 2 / 3, 1 / 3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(turns[[0, 3, 4], 3], [-1.0, -1.0, 0.0], atol=1e-12)
