"""Policies by name, one's own, the filter around any of them, and what they refuse."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim.errors import InputError
from lieednn_sim.planning import ShapedOptions, plan
from lieednn_sim.policies import (
    POLICIES,
    FabricOptions,
    Feedback,
    FilteredPolicy,
    FilterOptions,
    MotionTracker,
    Policy,
    make_policy,
    register_policy,
)
from lieednn_sim.policies.planned import MovementPrimitive

GOAL = np.array([0.3, -0.2, 0.3, 0.2])


@pytest.mark.parametrize("name", POLICIES)
def test_every_policy_arrives_and_a_reset_begins_anew_to_the_bit(name, gantry):
    policy = make_policy(name, gantry, GOAL, rate=50.0)
    runs = []
    for steps in (20, 250):
        policy.reset(np.zeros(4))
        runs.append(np.array([policy.step(policy.q, GOAL) for _ in range(steps)]))
    np.testing.assert_array_equal(runs[1][:20], runs[0])
    np.testing.assert_allclose(runs[1][-1, 0], GOAL, atol=5e-3)
    np.testing.assert_allclose(runs[1][-1, 1], 0.0, atol=2e-2)
    assert policy.certified == (name.startswith("lieednn") or name == "linear-attractor")
    assert len(policy.channels()) == len(policy.channel_units)
    assert policy.message in ("moves", "has ended")
    assert np.isfinite(policy.state).all()


@pytest.mark.parametrize(("name", "safety"), [*((name, None) for name in POLICIES), ("fabric", FilterOptions())])
def test_a_copy_goes_on_as_the_policy_does(name, safety, gantry):
    policy = make_policy(name, gantry, GOAL, rate=50.0)
    if safety is not None:
        policy = FilteredPolicy(policy, safety)
        policy.reset(gantry.keyframe("home"))
    for _ in range(10):
        policy.step(policy.q, GOAL)
    copies = [copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))]
    steps = np.array([[one.step(one.q, GOAL) for _ in range(20)] for one in (policy, *copies)])
    np.testing.assert_array_equal(steps[1:], steps[:1].repeat(2, axis=0))
    assert copies[1].channel_units == policy.channel_units


@pytest.mark.parametrize("name", ["linear-attractor", "dmp", "fabric", "mppi"])
def test_policies_with_feedback_yield_to_an_arm_that_is_held_aside_and_others_do_not(name, gantry):
    aside = 0.2 * gantry.ranges * np.eye(4)[1]
    for feedback in (Feedback(), None):
        policy = make_policy(name, gantry, np.zeros(4), rate=50.0, feedback=feedback)
        for _ in range(100):
            policy.step(aside, np.zeros(4))
        # Pulled towards the arm by 5/s, and back by 2/s, at a hundredth of its speed.
        assert (policy.q[1] > 0.5 * aside[1]) == (feedback is not None)
        assert ("waiting for a joint" in policy.message) == (feedback is not None)


class Fixed(Policy):
    """Its reference does not move, whatever its rates say."""

    def act(self, measured, target):
        return np.array([0.001, 0.0, 0.0, 0.0]), np.array([0.05, 0.0, 0.0, 0.0])


def test_a_filtered_reference_follows_by_hand(gantry):
    inner = Fixed(gantry, 50.0)
    policy = FilteredPolicy(inner, FilterOptions(smoothing=1.0))
    policy.reset(np.zeros(4))
    # Wanted are 0.05 + 8 (0.001 - q - v T / 2), of which the change from v is halved.
    speed, place = 0.0, 0.0
    for _ in range(2):
        wanted = 0.05 + 8.0 * (0.001 - place - 0.01 * speed)
        place, speed = place + 0.01 * (speed + 0.5 * (wanted + speed)), 0.5 * (wanted + speed)
        q, qd = policy.step(None, np.zeros(4))
        np.testing.assert_allclose((q[0], qd[0]), (place, speed), atol=1e-9)
        # The inner policy is told, so that its limits count from there.
        assert (inner.q is q, inner.qd is qd) == (True, True)


def test_a_filter_allows_a_start_nearer_than_its_margin_and_refuses_contact(gantry):
    # The ball touches the floor at -0.9 m.
    near = np.array([0.0, 0.0, -0.895, 0.0])
    policy = FilteredPolicy(Fixed(gantry, 50.0), FilterOptions())
    policy.reset(near)
    policy.step(None, near)
    assert (policy.blocking, policy.braked) == ((), False)
    with pytest.raises(InputError, match="touch"):
        policy.reset([0.0, 0.0, -0.95, 0.0])


def test_a_network_by_name_follows_a_target_without_its_velocity(gantry):
    policy = make_policy("linear-attractor", gantry, GOAL, rate=50.0, convergence_rate=2.0)
    for k in range(300):
        policy.step(None, [0.002 * k, 0.0, 0.0, 0.0])
    # Each period the distance from the target, which has moved by 0.002, shrinks by e^-0.04.
    assert 0.002 * 299 - policy.q[0] == pytest.approx(0.002 / (np.exp(0.04) - 1.0), rel=1e-4)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("linear-attractor", None),
        ("lieednn-certified", None),
        ("lieednn-shaped", ShapedOptions(rate=1.0)),
        ("lieednn-shaped", ShapedOptions(rate=0.3)),
    ],
)
def test_networks_by_name_converge_at_the_rate_asked_for(name, options, gantry):
    policy = make_policy(name, gantry, GOAL, rate=50.0, convergence_rate=3.0, options=options)
    states = []
    for _ in range(200):
        policy.step(None, GOAL)
        states.append(policy.state)
    # The slowest mode shrinks by e^-3 in a second, whatever its end.
    before, after = (np.abs(states[k + 50] - states[k]).max() for k in (99, 149))
    assert after == pytest.approx(np.exp(-3.0) * before, rel=0.03)


def test_the_filter_goes_around_any_policy(gantry):
    # The ball of 0.1 m would be in the floor, which is at -1 m.
    low = np.array([0.0, 0.0, -1.2, 0.0])
    policy = FilteredPolicy(make_policy("linear-attractor", gantry, low, rate=50.0))
    policy.reset(gantry.keyframe("home"))
    for _ in range(200):
        q, _ = policy.step(policy.q, low)
        assert q[2] > -0.9
    assert q[2] < -0.85
    assert policy.inner.q is policy.q or (policy.inner.q == policy.q).all()
    assert policy.message.startswith(("is held back by", "brakes for"))
    assert policy.channel_units == policy.inner.channel_units


def test_a_tracker_plays_a_motion_at_any_rate_and_begins_where_it_does(gantry):
    motion = plan(gantry, GOAL, planner="minimum-jerk", duration=2.0).motion
    tracker = MotionTracker(gantry, motion, 30.0)
    tracker.reset(np.zeros(4))
    played = np.array([tracker.step(None, GOAL) for _ in range(61)])
    s = np.minimum(np.arange(1, 62) / 60.0, 1.0)[:, None]
    np.testing.assert_allclose(played[:, 0], GOAL * (10 * s**3 - 15 * s**4 + 6 * s**5), atol=1e-6)
    assert (played[-2:, 1] == 0.0).all()
    assert tracker.message == "has ended"
    with pytest.raises(InputError, match=r"the motion begins 1 m from where joint 'y' is; plan it from there"):
        tracker.reset(np.eye(4)[1])
    tracker.reset(0.01 * gantry.ranges)  # up to 2 % of a range beside
    with pytest.raises(InputError, match="the motion begins"):
        tracker.reset(0.03 * gantry.ranges)
    with pytest.raises(InputError, match=r"the motion has \(4,\) joint coordinates, arm \'telescopic_pr\' has 8"):
        MotionTracker(ls.Arm.load("telescopic_pr"), motion)


def test_a_primitive_behind_an_arm_at_half_the_speed_goes_the_same_way(gantry):
    motion = plan(gantry, GOAL, start=np.zeros(4), planner="minimum-jerk").motion
    ways = []
    for behind in (None, 0.002):  # at the patience, at which it runs at half its speed
        policy = MovementPrimitive(gantry, motion, feedback=Feedback(rate=0.0))
        policy.reset(motion.q[0])
        periods = int(motion.t[-1] * policy.rate) * (1 if behind is None else 2)
        ways.append([policy.step(behind and policy.q + behind * gantry.ranges, GOAL)[0] for _ in range(periods)])
    np.testing.assert_allclose(ways[1][1::2], ways[0], atol=1e-3)


def test_a_reference_brakes_at_the_limit_of_its_hardest_joint_by_hand(gantry):
    most, start = gantry.acceleration_limits, np.zeros(4)
    for qd, periods in (
        (np.array([0.3, -0.1, 0.0, 0.2]) * most, 30),  # 0.3 s, at 100 Hz
        (np.array([0.0, 0.0, 0.001, 0.0]) * most, 2),  # no less than two periods
    ):
        policy = MotionTracker.stopping(gantry, start, qd, 100.0)
        np.testing.assert_array_equal(policy.qd, qd)
        steps = [policy.step(None, start) for _ in range(periods)]
        assert steps[-2][1].any()
        assert not steps[-1][1].any()
        np.testing.assert_allclose(steps[-1][0], 0.5 * qd * periods / 100.0, atol=1e-12)
        speeds = np.vstack([qd, *[rate for _, rate in steps]])
        assert (np.abs(np.diff(speeds, axis=0)) <= 1.001 * most / 100.0).all()


class Halver(Policy):
    """Goes half of the way that is left in every period."""

    def act(self, measured, target):
        q = self.q + 0.5 * (target - self.q)
        return q, (q - self.q) / self.period


@pytest.mark.usefixtures("own_names")
def test_ones_own_policy_in_a_few_lines():
    register_policy("halver")(lambda task: Halver(task.arm, task.rate))
    arm = ls.Arm.load("telescopic_pr")
    policy = make_policy("halver", arm, arm.keyframe("extended"))
    first, _ = policy.step(arm.keyframe("home"), arm.keyframe("extended"))
    np.testing.assert_allclose(first, 0.5 * (arm.keyframe("home") + arm.keyframe("extended")))
    assert "halver" in POLICIES
    register_policy("wrong")(lambda task: 5)
    with pytest.raises(InputError, match="policy 'wrong' must be a Policy, its function returned int"):
        make_policy("wrong", arm, arm.keyframe("home"))


def test_where_it_begins_without_a_reset(gantry):
    policy = Halver(gantry, 50.0)
    with pytest.raises(InputError, match=r"call reset\(q\), or give measured joints"):
        policy.step(None, GOAL)
    q, qd = policy.step(0.5 * GOAL, GOAL)
    np.testing.assert_allclose(q, 0.75 * GOAL)
    for array in (q, qd):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_bad_input(gantry):
    policy = Halver(gantry, 50.0)
    policy.reset(np.zeros(4))
    for measured, target, words in (
        ([0.0], GOAL, "measured must have shape"),
        (np.full(4, np.nan), GOAL, "measured must be finite"),
        (None, [[1.0], [1.0, 2.0]], "target must be an array"),
        (None, 10.0 * GOAL, "target is out of reach: joint"),
        (np.rad2deg(GOAL), GOAL, r"measured is in other units\? joint 'x' would be at .*, its range is"),
    ):
        with pytest.raises(InputError, match=words):
            policy.step(measured, target)
    with pytest.raises(InputError, match="q is out of reach"):
        policy.reset(10.0 * GOAL)
    for arguments, named, words in (
        (("shaped",), {}, "no policy 'shaped'; allowed: dmp, fabric"),
        (("fabric",), {"rate": 0.0}, "rate must be positive"),
        (("fabric",), {"start": np.zeros(3)}, "start must have shape"),
        (("tracker",), {"options": FabricOptions()}, "the policy 'tracker' has no options"),
        (("mppi",), {"options": FabricOptions()}, "takes options of class PathIntegralOptions"),
    ):
        with pytest.raises(InputError, match=words):
            make_policy(*arguments, gantry, GOAL, **named)
    with pytest.raises(InputError, match="'fabric' would go to the end of this motion on a way of its own"):
        make_policy("fabric", gantry, plan(gantry, GOAL, planner="minimum-jerk"))
