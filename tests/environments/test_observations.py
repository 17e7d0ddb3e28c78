"""Rows of observations: each array in its place and within its bounds, of one environment as of many."""

from __future__ import annotations

import numpy as np

from lieednn_sim.environments.observations import Observations


def test_arrays_stay_within_their_bounds_and_keep_their_names():
    one = np.ones(2)
    names = ("position", "velocity", "command", "position_error")
    bounds = {name: (-k * one, k * one) for k, name in enumerate(names, 1)}
    bounds |= {"pose_error": (-np.ones((1, 6)), np.ones((1, 6))), "more": (np.zeros((2, 2)), np.full((2, 2), 9.0))}
    frames = np.zeros((3, 1, 16))
    frames[..., 3:12], frames[..., 12] = np.eye(3).ravel(), 1.0
    goals = frames.copy()
    goals[:, 0, 0] = [0.5, 3.0, -3.0]
    q, more = np.array([[0.5, -7.0], [7.0, 0.0], [0.0, 0.0]]), np.arange(12.0).reshape(3, 4)
    observations = Observations(bounds)
    rows, distance, angle = observations.rows(frames, q, q, q, [0.5 * q, goals, more])
    assert rows.shape == (3, observations.size)
    seen = observations.split(rows)
    assert {name: values.shape[1:] for name, values in seen.items()} == {k: low.shape for k, (low, _) in bounds.items()}
    for name, value in zip(names, (q, q, q, -0.5 * q), strict=True):
        np.testing.assert_array_equal(seen[name], np.clip(value, *bounds[name]))
    np.testing.assert_array_equal(seen["pose_error"][:, 0, 3:], [[0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(seen["more"].reshape(3, 4), np.minimum(more, 9.0))
    # What is within the bounds is for who observes; who judges is told all.
    np.testing.assert_array_equal(distance, [0.5, 3.0, 3.0])
    np.testing.assert_array_equal(angle, 0.0)
    alone = observations.rows(frames[1], q[1], q[1], q[1], [0.5 * q[1], goals[1], more[1]])[0]
    np.testing.assert_array_equal(alone, rows[1])
