"""Rows of observations: each array in its place and within its bounds, of one environment as of many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lieednn_sim.environments.base import Commands
from lieednn_sim.environments.observations import Observations, common_bounds
from lieednn_sim.environments.tasks import make_task


def test_arrays_stay_within_their_bounds_and_keep_their_names():
    one = np.ones(2)
    names = ("position", "velocity", "command", "position_error")
    bounds = {name: (-k * one, k * one) for k, name in enumerate(names, 1)}
    bounds |= {"pose_error": (-np.ones((1, 6)), np.ones((1, 6))), "more": (np.zeros((2, 2)), np.full((2, 2), 9.0))}
    q, more = np.array([[0.5, -7.0], [7.0, 0.0], [0.0, 0.0]]), np.arange(12.0).reshape(3, 4)
    twist = np.linspace(-2.0, 2.0, 18).reshape(3, 6)
    observations, values = Observations(bounds), (q, q, q, -0.5 * q, twist, more)
    rows = observations.rows(*values)
    assert rows.shape == (3, observations.size)
    seen = observations.split(rows)
    assert {name: found.shape[1:] for name, found in seen.items()} == {k: low.shape for k, (low, _) in bounds.items()}
    for name, value in zip(bounds, values, strict=True):
        np.testing.assert_array_equal(seen[name], np.clip(value.reshape(seen[name].shape), *bounds[name]))
    np.testing.assert_array_equal(observations.rows(*(value[1] for value in values)), rows[1])


def test_what_is_within_the_bounds_is_for_who_observes_and_who_judges_is_told_all():
    task = make_task("reach", time_limit=0.1)
    task.begin(np.random.default_rng(0), {"target": task.arm.keyframe("home")})
    frames = np.broadcast_to(np.concatenate([np.zeros(3), np.eye(3).ravel(), np.eye(4)[0]]), (3, 1, 16))
    goals = frames.copy()
    goals[:, 0, 0] = [0.5, 300.0, -300.0]
    data, q = task.simulation.data, np.tile(task.command, (3, 1))
    qpos, qvel = (np.tile(values, (3, 1)) for values in (data.qpos, data.qvel))
    state = task.look(np.arange(3), q, qpos, qvel, frames, q + 100.0, goals)
    np.testing.assert_array_equal(state.distance, [0.5, 300.0, 300.0])
    np.testing.assert_array_equal(state.angle, 0.0)
    most = task.bounds["pose_error"][1][0, 3]
    seen = task.observations.split(state.row)
    np.testing.assert_array_equal(seen["pose_error"][:, 0, 3], [0.5, most, -most])
    np.testing.assert_array_equal(seen["position_error"][0], task.bounds["position_error"][1])


def test_bounds_by_hand(gantry):
    """Ranges of 2, 4, 5 and 6 with a tenth beyond either end; slides of 1, 2 and 3 m and a beam of 1 m reach 7 m."""
    low, high = np.array([-1.0, -2.0, -2.0, -3.0]), np.array([1.0, 2.0, 3.0, 3.0])
    slack, found = np.array([0.2, 0.4, 0.5, 0.6]), common_bounds(gantry, 2)
    expected = {
        "position": (low - slack, high + slack),
        "velocity": (-5.0 * gantry.velocity_limits, 5.0 * gantry.velocity_limits),
        "command": (low, high),
        # From beyond one end to beyond the other.
        "position_error": (low - high - 2.0 * slack, high - low + 2.0 * slack),
        "approach": (-np.ones(4), np.ones(4)),
        "pose_error": (-np.pi * np.repeat([[1.0, 7.0]] * 2, 3, axis=1), np.pi * np.repeat([[1.0, 7.0]] * 2, 3, axis=1)),
    }
    assert found.keys() == expected.keys()
    for name, ends in expected.items():
        np.testing.assert_allclose(found[name], ends, err_msg=name)
    limits = gantry.position_limits.copy()
    limits[2] = [-4.0, -3.0]
    assert replace(gantry, position_limits=limits).reach == pytest.approx(8.0)


def test_commands_move_by_the_velocity_limit_at_most_either_way(gantry):
    """In two steps of 10 ms: half the action is a quarter of the velocity."""
    commands, zero = Commands(gantry, 2), np.zeros(4)
    for action, fraction in ((-5.0, -1.0), (5.0, 1.0), (-0.5, -0.25), (0.0, 0.0)):
        moved = commands.moved(zero, np.full(4, action))
        np.testing.assert_allclose(moved, 0.02 * fraction * gantry.velocity_limits)
        np.testing.assert_allclose(commands.towards(zero, moved), np.clip(action, -1.0, 1.0))
    np.testing.assert_array_equal(commands.towards(zero, gantry.velocity_limits), 1.0)


def test_tracking_knows_the_velocity_of_now_and_is_within_half_a_degree():
    task = make_task("track", time_limit=0.4)
    assert (task.position_tolerance, np.rad2deg(task.rotation_tolerance)) == (0.005, pytest.approx(0.5))
    task.begin(np.random.default_rng(0))
    for _ in range(5):
        seen, *_ = task.step(np.zeros(task.arm.n_joints))
    numeric = (task.target(task.time + 1e-5) - task.target(task.time - 1e-5)) / 2e-5
    np.testing.assert_allclose(seen["target_velocity"], numeric, atol=1e-6)


def test_at_rest_is_a_hundredth_of_the_velocity_limit():
    task = make_task("reach", time_limit=0.4)
    task.begin(np.random.default_rng(0))
    rest = 0.01 * task.arm.velocity_limits
    assert [bool(task.judge(0.0, 0.0, factor * rest)[1]) for factor in (0.99, 1.01)] == [True, False]
