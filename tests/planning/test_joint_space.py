"""What planners in joint space share, by hand: margins at narrow ends, what is lacking, edges and their lengths."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.planning import PlanningProblem, RrtConnectOptions
from lieednn_sim.planning.baselines import sampling, search_space
from lieednn_sim.planning.baselines.search_space import EdgeTest
from lieednn_sim.planning.joint_space import ClearanceTest, ProblemClearance
from lieednn_sim.planning.motion import joint_scale


@pytest.mark.parametrize(
    ("at_start", "at_target", "margin"),
    # Four fifths of what is nearer than 5 cm, at either end; what motions are checked for is kept in any case.
    [(0.5, 0.5, 0.05), (0.055, 0.5, 0.044), (0.5, 0.01, 0.008), (0.0022, 0.5, 0.002)],
)
def test_the_margin_is_what_both_ends_keep_themselves(gantry, at_start, at_target, margin):
    """The ball is so far from the floor."""
    start, target, near = (np.array([0.0, 0.0, gap - 0.9, 0.0]) for gap in (at_start, at_target, 0.001))
    clear = ProblemClearance(PlanningProblem(gantry, start, target), 0.05)
    assert clear.lack(near[None]) == pytest.approx(margin - 0.001, abs=1e-6)


def test_what_pairs_lack_is_counted_once_each(gantry, monkeypatch):
    """With a margin of 5 cm; two pairs are near at two points each, of which the deeper ones lack 6 and 4 cm."""
    found = np.array([-0.01, 0.02, 0.03, 0.01, 0.06]), np.array([[0, 1], [0, 1], [1, 2], [1, 2], [2, 3]])
    monkeypatch.setattr(Arm, "contact_finder", lambda *_: SimpleNamespace(geoms=lambda _: found))
    clear = ClearanceTest(gantry, 0.05)
    np.testing.assert_allclose(clear.lack(np.zeros((2, 4))), 0.06 + 0.04)
    assert clear.tests == 2


@pytest.mark.parametrize(
    ("contact", "stop", "first", "tests"), [(5, 5, None, 5), (2, 5, 2, 3), (5, 3, 3, 4), (2, 3, 2, 3), (4, 1, 1, 2)]
)
def test_the_first_of_contact_and_a_stop_is_found(gantry, monkeypatch, contact, stop, first, tests):
    finder = SimpleNamespace(first=lambda qpos: min(contact, len(qpos)))
    monkeypatch.setattr(Arm, "contact_finder", lambda *_: finder)
    clear = ClearanceTest(gantry, 0.0)
    monkeypatch.setattr(clear, "_beyond", lambda qpos: np.where(np.arange(5) >= stop, 1.0, -1.0))
    assert (clear.first_blocked(np.zeros((5, 4))), clear.tests) == (first, tests)


def test_joints_without_a_velocity_limit_are_measured_by_their_range(gantry):
    arm = replace(gantry, velocity_limits=np.array([1.0, np.inf, 4.0, np.inf]))
    np.testing.assert_array_equal(joint_scale(arm), [1.0, 4.0, 4.0, 6.0])


def edges_of(gantry, spacing=0.1):
    """A test of edges whose coordinates are in units of 1, 2, 4 and 8, and the configurations that it tests."""
    seen = []
    clear = MagicMock(tests=0, first_blocked=seen.extend, side_effect=lambda q: seen.append(q) or True)
    return EdgeTest(gantry, clear, spacing), seen


def test_edges_are_tested_as_densely_in_space_whichever_way_they_go(gantry):
    edges, seen = edges_of(gantry)
    np.testing.assert_allclose(edges.bounds, [[-1.0, 1.0], [-1.0, 1.0], [-0.5, 0.75], [-0.375, 0.375]])
    # Slides move the link frames by as much; the wrist moves none, its frame is on its axis.
    np.testing.assert_allclose(edges.swept, [1.0, 2.0, 4.0, 0.0], atol=1e-9)
    for goal, count in (([0.5, 0, 0, 0], 5), ([-0.5, 0, 0, 0], 5), ([0.1, -0.1, 0, 0], 3), ([0, 0, 0, 0.3], 1)):
        seen.clear()
        assert edges.passable(np.zeros(4), 0.999 * np.array(goal))
        # Evenly spaced, the end first.
        joints = 0.999 * np.array(goal) * [1.0, 2.0, 4.0, 8.0]
        np.testing.assert_allclose(seen[0], joints)
        np.testing.assert_allclose(sorted(np.array(seen) @ joints / (joints @ joints)), np.arange(1, count + 1) / count)
        # Its end is known now; work is counted as if it were not.
        before, seen[:] = edges._clear.tests, []
        assert edges.passable(np.zeros(4), 0.999 * np.array(goal))
        assert (len(seen), edges._clear.tests) == (count - 1, before + 1)
    assert not edges.over(10)
    edges._clear.tests = 10
    assert edges.over(10)


def test_a_blocked_end_is_looked_at_alone(gantry):
    edges, seen = edges_of(gantry)
    edges._clear.side_effect = lambda q: seen.append(q)
    assert not edges.passable(np.zeros(4), np.array([0.5, 0, 0, 0]))
    np.testing.assert_allclose(seen, [[0.5, 0, 0, 0]])


def test_a_search_without_time_is_over_soon_and_stays_over(gantry, monkeypatch):
    edges, _ = edges_of(gantry)
    late = iter([False, True])
    monkeypatch.setattr(search_space, "out_of_time", lambda: next(late, False))
    over = [edges.over(1000) for _ in range(50)]
    assert not over[0]
    assert all(over[16:])


def test_the_angle_of_a_ball_joint_bounds_points_and_edges():
    """The corners of the box around its rotation vectors are beyond the limit, and clear."""
    arm = Arm.load("telescopic_compound")
    edges, seen = edges_of(arm)
    ball = arm.space.balls[0]
    corner, inside = np.zeros((2, arm.n_joints))
    corner[ball] = 0.99 * arm.position_limits[ball, 1]
    inside[ball] = 0.5 * arm.position_limits[ball, 1]
    assert arm.limit_excess(corner).max() > 0.1
    assert edges.free(inside / edges.scale)
    assert not edges.free(corner / edges.scale)
    assert edges.passable(np.zeros(arm.n_joints), inside / edges.scale)
    seen.clear()
    assert not edges.passable(np.zeros(arm.n_joints), corner / edges.scale)
    assert seen == []


def test_edges_of_balanced_trees_are_a_share_of_the_diagonal_in_metres(gantry, monkeypatch):
    """Ranges of 2, 4 and 5 m; what hardly moves a link counts as a tenth of what moves links most, 0.4 of 8 rad/s."""
    space = SimpleNamespace(ends=(np.zeros(4), np.array([0.6, 1.6, 0.0, 0.0])), edges=edges_of(gantry)[0])
    given = {}
    monkeypatch.setattr(sampling, "connected", lambda *ends, **world: given.update(world, ends=ends))
    assert sampling.balanced_search(space, RrtConnectOptions(longest_edge=0.3), None) is None
    np.testing.assert_allclose(given["bounds"], [[-1.0, 1.0], [-2.0, 2.0], [-2.0, 3.0], [-0.15, 0.15]])
    assert given["longest_edge"] == pytest.approx(0.3 * np.linalg.norm([2.0, 4.0, 5.0, 0.3]))
    np.testing.assert_allclose(given["ends"], [np.zeros(4), [0.6, 1.6, 0.0, 0.0]])
