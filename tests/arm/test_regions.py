"""Regions of poses of the end effector."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lieednn_sim as ls
from lieednn_sim.arm import TaskSpaceRegion, ik_candidates
from lieednn_sim.errors import InputError, NoSolutionError


def poses(rng, count):
    return RigidTransform.from_components(rng.normal(size=(count, 3)), Rotation.random(count, rng=rng))


def random_region(rng):
    """Each coordinate bounded, fixed, or, if it is an angle, free."""
    lower = rng.normal(size=6)
    upper = lower + np.abs(rng.normal(size=6)) * rng.integers(0, 2, 6)
    free = np.append(np.zeros(3, bool), rng.random(3) < 0.3)
    frames = poses(rng, 2)
    return TaskSpaceRegion(frames[0], np.where(free, -np.inf, lower), np.where(free, np.inf, upper), frames[1])


def turned(pose, twist):
    """A pose displaced by a small twist (omega, v) along the world's axes."""
    return RigidTransform.from_components(pose.translation + twist[3:], Rotation.from_rotvec(twist[:3]) * pose.rotation)


@pytest.mark.parametrize("seed", range(20))
def test_samples_are_inside_and_projection_is_inside_idempotent_and_has_the_slopes_of_its_excess(seed):
    rng = np.random.default_rng(seed)
    region, away = random_region(rng), poses(rng, 30)
    sample = region.sample(rng)
    assert max(region.distance(sample)) < 1e-7
    np.testing.assert_allclose(region.project(sample).as_matrix(), sample.as_matrix(), atol=1e-7)
    nearest = region.project(away)
    assert np.max(region.distance(nearest)) < 1e-7
    np.testing.assert_allclose(region.project(nearest).as_matrix(), nearest.as_matrix(), atol=1e-7)
    assert np.max(region.distance(away)) > 0.1
    numeric = [
        (region.excess(turned(away, step)) - region.excess(turned(away, -step))) / 2e-6 for step in 1e-6 * np.eye(6)
    ]
    off = np.abs(np.moveaxis(numeric, 0, -1) - region.excess_slopes(away)).max(axis=(1, 2))
    assert np.mean(off < 1e-5) > 0.9  # but where another bound or triple of angles becomes the nearest


def test_a_tilt_is_measured_however_the_end_effector_turns_about_the_free_axis():
    """Against the angle between the axes themselves."""
    held = Rotation.from_euler("xyz", [0.3, -0.5, 1.0])
    region = TaskSpaceRegion.orientation(held, axis=[0.0, 1.0, 0.0])
    rng = np.random.default_rng(0)
    for spin, angle in zip(rng.uniform(-9.0, 9.0, 20), np.geomspace(1e-4, 1.4, 20), strict=True):
        across = np.array([np.cos(spin), 0.0, np.sin(spin)])
        moved = Rotation.from_rotvec(angle * across) * Rotation.from_rotvec([0.0, spin, 0.0]) * held
        metres, radians = region.distance(RigidTransform.from_components(rng.normal(size=3), moved))
        assert metres == 0.0
        # The nearest rotation of the region may leave more than the tilt, by the coordinates' measure.
        assert angle - 1e-9 <= radians <= 1.2 * angle


def test_a_line_and_a_box_by_hand():
    line = TaskSpaceRegion.line([1.0, 0.0, 0.0], [1.0, 2.0, 0.0], Rotation.identity(), tolerance=0.1)
    # Half a metre beyond its end, 0.3 m beside it, turned by 0.2 rad.
    pose = RigidTransform.from_components([1.3, 2.5, 0.0], Rotation.from_rotvec([0.0, 0.0, 0.2]))
    metres, radians = line.distance(pose)
    assert metres == pytest.approx(np.hypot(0.5, 0.2))
    assert radians == pytest.approx(0.2)
    np.testing.assert_allclose(line.project(pose).translation, [1.1, 2.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(line.project(pose).rotation.as_matrix(), np.eye(3), atol=1e-12)
    box = TaskSpaceRegion.box([-np.inf, 0.0, 0.0], [np.inf, 1.0, 1.0])
    np.testing.assert_allclose(box.excess(pose), [0.0, 1.5, 0.0, 0.0, 0.0, 0.0], atol=1e-12)
    with pytest.raises(InputError, match="x, y and z have finite bounds"):
        box.sample(0)


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ([0] * 6, [1, 1, -1, 1, 1, 1], "lower bound of z must not be above the upper one, got 0 and -1"),
        ([0, 0, 0, -np.inf, 0, 0], [1] * 6, "rotation about x must have two bounds within a turn"),
        (
            [0, 0, 0, 0, -90, 0],
            [0, 0, 0, 0, 90, 0],
            "rotation about y must .* a turn .* got -90 and 90",
        ),
        ([np.inf] + [0] * 5, [np.inf] + [0] * 5, "lower bound of x must not be above"),
        ([[0], 0, 0, 0, 0, 0], [0] * 6, "lower must be an array of numbers"),
    ],
)
def test_malformed_bounds_are_refused(lower, upper, message):
    with pytest.raises(InputError, match=message):
        TaskSpaceRegion(RigidTransform.identity(), lower, upper)


def test_joint_positions_of_a_region_are_in_it(monkeypatch):
    monkeypatch.setattr("lieednn_sim.arm.inverse_kinematics._ATTEMPTS", 2)
    arm = ls.Arm.load("telescopic_pr")
    start = ls.draw_target(arm, seed=3)
    there = arm.link_poses(ls.draw_target(arm, seed=4))[-1]
    # A line of half a metre through the pose, with the hand kept upright.
    region = TaskSpaceRegion.line(there.translation, there.translation + np.array([0.0, 0.0, 0.5]))
    upright = TaskSpaceRegion.orientation(there.rotation, axis=[0.0, 0.0, 1.0])
    found = ik_candidates(arm, region, start=start, path_constraint=upright)
    assert len(found) == 4
    for q in found:
        for one in (region, upright):
            assert max(one.distance(arm.link_poses(q)[-1])) < 1e-5
        arm.check_reachable(q)
    with pytest.raises(NoSolutionError, match=r"cannot reach the region: the closest configuration found is .* m and"):
        ik_candidates(arm, TaskSpaceRegion.box([9.0, 0.0, 0.0], [9.0, 1.0, 1.0]))
