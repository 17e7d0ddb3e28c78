"""STOMP against numbers computed by hand, and problems whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.errors import PlanError
from lieednn_sim.planning import PlanningProblem, StompOptions
from lieednn_sim.planning.baselines.stomp import StompSearch, motion_along, noise_weights, stomp
from lieednn_sim.planning.joint_space import ClearanceTest

from .arms import posted
from .test_rivals import blocked

ARM = Arm.load("telescopic_pr")
LOW, HIGH = ARM.position_limits.T
TURN = ARM.joint_names.index("turn")


def search(arm: Arm = ARM, turn: tuple[float, float] = (0.5, 2.6), seed: int = 0, **options: object) -> StompSearch:
    """A search for a turn of the extended arm."""
    start, target = arm.keyframe("extended").copy(), arm.keyframe("extended").copy()
    start[TURN], target[TURN] = turn
    chosen = StompOptions(**options)
    return StompSearch(
        PlanningProblem(arm, start, target, 8.0, seed), chosen, chosen.spacing, np.random.default_rng(seed)
    )


# Of four waypoints: (A' A)^-1 = (A^-1)^2 with A^-1 = -[[4, 3, 2, 1], [3, 6, 4, 2], ...] / 5, times 25.
INVERSE = np.array([[30, 40, 35, 20], [40, 65, 60, 35], [35, 60, 65, 40], [20, 35, 40, 30]])


def test_metric_and_smoother_are_those_computed_by_hand():
    made = search(waypoints=4)
    np.testing.assert_allclose(made.metric, [[5, -4, 1, 0], [-4, 6, -4, 1], [1, -4, 6, -4], [0, 1, -4, 5]])
    np.testing.assert_allclose(made.smoother, INVERSE / [160, 260, 260, 160], atol=1e-14)


def test_the_noise_has_the_inverse_metric_as_covariance():
    drawn = search(waypoints=4).noise(20_000)
    assert drawn.shape == (20_000, 4, ARM.n_joints)
    # 160 000 samples of variance 1 at most: four standard errors.
    samples = drawn.transpose(0, 2, 1).reshape(-1, 4)
    np.testing.assert_allclose(samples.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(np.cov(samples.T), INVERSE / 65, atol=0.015)
    # Joints, and one path and the next, know nothing of each other.
    np.testing.assert_allclose(np.corrcoef(drawn[:, 1].T), np.eye(ARM.n_joints), atol=0.03)


def test_noises_weigh_by_what_they_cost():
    costs = np.array([[0.3, 7.0], [0.1, 7.0], [0.2, 7.0]])
    raw = np.exp([-10.0, 0.0, -5.0])
    np.testing.assert_allclose(noise_weights(costs)[:, 0], raw / raw.sum())
    np.testing.assert_array_equal(noise_weights(costs)[:, 1], 0.0)


def test_costs_are_zero_where_the_fast_test_of_clearance_says_yes():
    test = ClearanceTest(posted(1.0, 0.06), 0.03)
    q = np.random.default_rng(0).uniform(LOW, HIGH, (100, len(LOW)))
    clear = np.array([test(position) for position in q])
    assert 0 < clear.sum() < 100
    np.testing.assert_array_equal(test.lack(q) == 0.0, clear)


def test_the_angle_of_a_ball_joint_beyond_its_limit_costs_once():
    """At the waypoint and the one before, whose edges end there; a slide beyond its limit costs as much more."""
    arm = Arm.load("telescopic_compound")
    home, options = arm.keyframe("home"), StompOptions(waypoints=4)
    problem = PlanningProblem(arm, home, home, 4.0, 0)
    made = StompSearch(problem, options, options.spacing, np.random.default_rng(0))
    made._clear.lack = lambda q: np.zeros(len(q))
    ball, slide = arm.space.balls[0], next(k for k in range(arm.n_joints) if k not in arm.space.balls)
    path = np.tile(home, (4, 1))
    path[1, ball] = (arm.position_limits[ball[0], 1] + 0.03) * np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(made.costs(path)[:2], 0.03, atol=1e-12)
    path[1, slide] = arm.position_limits[slide, 1] + 0.05
    np.testing.assert_allclose(made.costs(path)[:2], 0.08, atol=1e-12)


def test_what_is_thin_costs_between_waypoints_too():
    """Four waypoints of a turn from 0 to 2.5, at 0.5, 1, 1.5 and 2: the post stands between the second and third."""
    arm = posted(1.25, 0.01)
    made = search(arm, (0.0, 2.5), waypoints=4)
    assert made.problem.start[TURN] == 0.0
    np.testing.assert_allclose(made.straight[:, TURN], [0.5, 1.0, 1.5, 2.0])
    test = ClearanceTest(arm, made.options.margin)
    np.testing.assert_array_equal(test.lack(made.straight), 0.0)
    assert (made.cost > 0.0).tolist() == [False, True, True, False]


def test_steps_down_the_second_term_keep_what_goes_around(monkeypatch):
    """The cost wants one waypoint of one joint at least 0.2 from the straight path: the least bend that has it."""
    made = search(waypoints=21, steps=40)
    peak = 10

    def costs(path):
        return np.full(len(path), max(0.2 - (path - made.straight)[peak, TURN], 0.0))

    monkeypatch.setattr(made, "costs", costs)
    bent = made.straight + 0.05 * made.noise(1)[0]
    bent[:, TURN] += 1.0
    found = made.smoothed(bent) - made.straight
    np.testing.assert_allclose(np.delete(found, TURN, axis=1), 0.0, atol=1e-12)
    assert 0.2 <= found[peak, TURN] < 0.21
    # A beam on two supports with a load in the middle: of (A' A)^-1 the middle column.
    beam = np.linalg.inv(made.metric)[:, peak]
    np.testing.assert_allclose(found[:, TURN], 0.2 * beam / beam[peak], atol=0.03)


def test_the_motion_stays_in_the_hull_of_the_waypoints():
    made = search()
    # On a limit for a while: a curve through the waypoints would overshoot it.
    path, joint = made.straight.copy(), ARM.joint_names.index("lift")
    path[:, joint] = np.maximum(path[:, joint] - 0.6 * np.sin(np.linspace(0.0, np.pi, len(path))), LOW[joint])
    held = path[:, joint] == LOW[joint]
    assert 2 < held.sum() < len(path) - 2, "the path is to reach the limit and to leave it"
    motion = motion_along(made.problem, path)
    assert motion.q[:, joint].min() == pytest.approx(LOW[joint], abs=1e-9)


def test_a_refusal_says_what_was_tried():
    with pytest.raises(PlanError, match="no path of 1 rounds is clear; try another seed or target"):
        stomp(blocked(), StompOptions(rounds=1, rollouts=1))
