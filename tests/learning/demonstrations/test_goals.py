"""Demonstrations with several goals: each kept at its own place, and a motion whose shape depends on its goal."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations import Demonstration, ShapedMotion, align
from lieednn_sim.learning.demonstrations.alignment import displacement, goal_distance, in_world
from lieednn_sim.network import LieEDNN
from lieednn_sim.studies.demonstrations import models as paths
from lieednn_sim.studies.demonstrations.models import compare_models
from lieednn_sim.synthesis import ShapingOptions

OPTIONS = ShapingOptions(neurons=(16,))


def path(start, goal):
    """A bend and a wave whose sizes the goal decides."""
    s = np.linspace(0.0, 1.0, 150)
    law = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))[:, None]
    bump = np.column_stack(
        [(0.05 - 0.5 * goal[0]) * np.sin(2 * np.pi * law), (0.1 + 0.8 * goal[1]) * np.sin(np.pi * law)]
    )
    return Demonstration.from_samples((1.0 - law) * start + law * goal + bump, 2.0 * s)


@pytest.fixture(scope="module")
def shown():
    rng = np.random.default_rng(0)
    return [path(rng.normal([0.4, 0.0], 0.06), rng.uniform(-0.1, 0.1, 2)) for _ in range(8)]


@pytest.fixture(scope="module")
def learned(shown):
    kept = align(shown, phase="time", goals="kept")
    return kept, ShapedMotion.fit(kept, options=OPTIONS)


def test_kept_goals_are_where_they_were():
    t, ends = [0.0, 1.0, 2.0], np.array([[1.0, 2.0, 3.0], [1.2, 2.0, 3.0]])
    made = []
    for end, turn in zip(ends, (0.3, 0.5), strict=True):
        columns = np.zeros((3, 7))
        columns[:, :3] = end + np.outer([1.0, 0.5, 0.0], [0.0, 0.4, 0.0])
        columns[:, 3:] = Rotation.from_rotvec(np.outer([0.0, 0.5, 1.0], [0.0, 0.0, turn])).as_quat(scalar_first=True)
        made.append(Demonstration.from_samples(columns, t))
    aligned, kept = align(made, samples=3), align(made, samples=3, goals="kept")
    np.testing.assert_allclose(aligned.twists[:, -1], 0.0, atol=1e-12)
    np.testing.assert_allclose(kept.displaced[:, -1, 2:4], [[-0.1, -0.1], [0.1, 0.1]], atol=1e-12)
    np.testing.assert_allclose(in_world(kept.twists[:, -1], kept.goal).translation, ends, atol=1e-12)
    np.testing.assert_allclose(goal_distance(made), np.hypot(0.1, 0.2 * 0.1))
    with pytest.raises(InputError, match="no goals 'moved'"):
        align(made, goals="moved")


def test_the_shape_depends_on_the_goal(shown, learned, monkeypatch):
    monkeypatch.setattr(paths, "SAMPLES", 50)
    kept, motion = learned
    aligned = align(shown, phase="time")
    today = ShapedMotion.fit(aligned, options=OPTIONS)
    (ours, rival), _ = compare_models(kept, motion, rivals=["promp"], aligned=aligned, starts=5)
    (before,), _ = compare_models(aligned, today, rivals=[], starts=1, leave_one_out=False)
    # What it has not seen it knows far better than they know what they have.
    for error in (ours.training.dtwd_mm, ours.left_out.dtwd_mm):
        assert error < 0.1 * before.training.dtwd_mm
        assert error < 0.1 * rival.training.dtwd_mm
    assert (ours.attraction.arrived, ours.attraction.spurious) == (5, 0)


def test_another_goal_is_reached_the_way_that_was_not_shown(learned, tmp_path):
    kept, motion = learned
    start, goal = np.array([0.42, 0.03]), np.array([0.04, -0.06])
    wanted = path(start, goal).position - kept.goal.translation
    t = np.linspace(0.0, 2.0, 150)
    ends = np.zeros((2, 6))
    ends[:, 3:] = wanted[[0, -1]]
    found = displacement(motion.toward(ends[1]).reproduce(ends[0], np.append(t, 6.0)))[:, 3:]
    off = np.linalg.norm(found[:150, None] - wanted, axis=2).min(axis=1)
    assert off.max() < 4e-3
    np.testing.assert_allclose(found[-1], wanted[-1], atol=1e-4)
    # Without the code, which moves with the target, the path is another one.
    fixed = motion.network.with_start(
        motion.network.hidden_start, motion.network.start_gain, motion.network.start_reference
    )
    plain = fixed.retarget(ends[1:]).trajectory(fixed.retarget(ends[1:]).start(ends[:1]), 12.0)
    assert np.linalg.norm(plain.xi[:, None, 0, 3:] - wanted, axis=2).min(axis=1).max() > 0.01
    # A file keeps it, and the proof is the same.
    there = motion.toward(ends[1])
    motion.network.save(tmp_path / "network.npz")
    loaded = LieEDNN.load(tmp_path / "network.npz").retarget(ends[1:])
    np.testing.assert_allclose(loaded.hidden_start, there.network.hidden_start, atol=1e-9)
    assert there.network.certificate == motion.network.certificate
    # Doubt grows with the distance of the goal, and a via point is passed on the way to any.
    far = motion.toward(4.0 * ends[1])
    sizes = [one.covariance(ends[0], t)[75, 4, 4] for one in (motion, there, far)]
    assert sizes[0] < sizes[1] < 0.5 * sizes[2]
    u = np.concatenate([displacement(ends[0]) - motion.network.start_reference[0], displacement(ends[1])])
    ratio = 1.0 + 1.0 / 8.0 + u @ motion.spread.growth @ u
    along = motion.spread.along(motion._network_times(t))[75, 4, 4]
    np.testing.assert_allclose(sizes[1], ratio * along, rtol=1e-9)
    via = motion.condition([0.2, 0.1, 0.0], fraction=0.5)
    when = np.array([0.0, motion.t[100] - 0.5 * (motion.t[100] - motion.t[99])])
    for one in (via, via.toward(ends[1])):
        np.testing.assert_allclose(one.reproduce(ends[0], when)[1, 3:5], [0.2, 0.1], atol=1e-3)
    assert np.abs(there.reproduce(ends[0], when)[1, 3:5] - [0.2, 0.1]).max() > 0.02
