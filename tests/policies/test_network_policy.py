"""Networks that run with the arm: a clock that waits keeps the orbits, pushes are taken up; the filter; determinism."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.network_planners import without_weights
from lieednn_sim.policies import Feedback, NetworkPolicy, make_policy
from lieednn_sim.simulation import Disturbances, Push, follow
from lieednn_sim.synthesis import synthesize

GOAL = np.array([0.3, -0.2, 0.3, 0.2])
PUSH = Disturbances(pushes=(Push("end effector", (0.0, 80.0, 0.0), 0.3, 0.2),))


def started(arm, network, start, rate=50.0, **settings):
    """A policy that is reset at the start."""
    policy = NetworkPolicy(arm, network, rate, **settings)
    policy.reset(start)
    return policy


@pytest.fixture(scope="module")
def run(gantry, cascade):
    """Follow the cascade to `GOAL` with this feedback and disturbances."""

    def make(feedback, changes):
        policy = NetworkPolicy(gantry, cascade(gantry.encode(GOAL)), 50.0, feedback=feedback)
        return follow(policy, GOAL, 6.0, disturbances=changes)

    return make


def test_a_clock_that_waits_runs_through_the_networks_own_orbit(gantry, cascade, run):
    following = run(Feedback(rate=0.0), PUSH)
    pace = following.rollout.channels["pace"][::2]
    assert pace.min() < 0.2
    assert pace.max() > 0.95
    # A push changes when the network is where, and nothing else.
    network = cascade(gantry.encode(GOAL))
    own = network.trajectory(network.start(gantry.encode(np.zeros(4))), 20.0, rtol=1e-11, atol=1e-12)
    elapsed = np.append(0.0, np.cumsum(5.0 * 0.02 * pace))
    np.testing.assert_allclose(following.states[: len(elapsed)], own(elapsed)[: len(following.states)], atol=2e-5)


def test_a_pushed_arm_takes_its_state_along_and_comes_back(gantry, run):
    still, pushed, stiff = (run(Feedback(rate=rate), push) for rate, push in ((20.0, None), (20.0, PUSH), (0.0, PUSH)))
    aside = np.abs(pushed.states[:, 1, :].reshape(len(pushed.states), -1) - still.states[:, 1, :]).max()
    assert aside > 0.005
    # Drives at their limits swing the arm past a reference that stays where it was.
    apart = [following.rollout.t[following.rollout.channels["behind"] > 0.02].max() for following in (pushed, stiff)]
    assert apart[0] < apart[1] - 0.5
    for following in (still, pushed):
        np.testing.assert_allclose(following.rollout.q[-1], GOAL, atol=5e-3)


def test_a_target_that_stops_is_met(gantry, cascade):
    policy = started(gantry, cascade(gantry.encode(GOAL)), GOAL, speed=5.0, feedforward=True, feedback=Feedback())
    # While it moves the network aims ahead of it, by half a period: 2 mm and 2 mrad here.
    for k in range(400):
        policy.step(None, GOAL + 0.2 * policy.period * min(k, 5))
    np.testing.assert_allclose(policy.q, GOAL + policy.period, atol=1e-5)


def test_waiting_and_pulling_by_hand(gantry):
    feedback = Feedback(rate=5.0, tolerance=0.01, patience=0.002)
    # At the tolerance nothing is pulled, at twice that with half the rate; the clock stands at a hundredth at least.
    for behind, expected in ((0.0, (1.0, 0.0)), (0.002, (0.5, 0.0)), (0.004, (0.2, 0.0)), (0.02, (0.01, 2.5))):
        assert feedback.response(behind) == pytest.approx(expected)
    # 5 cm aside along x, of which the range is 2 m: 5 (1 - 0.01 / 0.025) 0.05 m/s.
    rest = without_weights(gantry.encode(GOAL))
    policy = started(gantry, rest, GOAL, speed=5.0, feedforward=True, feedback=feedback)
    _, qd = policy.step(GOAL + 0.05 * np.eye(4)[0], GOAL)
    np.testing.assert_allclose(qd, [0.15, 0.0, 0.0, 0.0], atol=1e-3)
    assert policy.behind == pytest.approx(0.025)


def test_a_target_of_which_one_joint_leaps_has_jumped(gantry, cascade):
    policy = started(gantry, without_weights(gantry.encode(GOAL)), GOAL, speed=5.0, feedforward=True)
    aside = np.eye(4)[1]
    policy.step(None, GOAL)
    # After a step it is there at once; after a leap it goes at its own speed.
    for place, ahead in ((0.01, 0.01), (0.5, 0.0)):
        before = policy.q[1]
        policy.step(None, GOAL + place * aside)
        own = (1.0 - np.exp(-0.1)) * (GOAL[1] + place - before)
        assert (policy.q[1] - before > own + 0.5 * ahead) == (ahead > 0.0)


def test_a_network_faster_than_the_control_takes_the_steps_that_it_needs(gantry, cascade):
    # Two time constants in a period: one step of Runge and Kutta would be off by a third of what is left.
    network, start = cascade(gantry.encode(GOAL), 0.0), GOAL - 1e-3
    policy = started(gantry, network, start, speed=100.0, feedforward=False, feedback=Feedback())
    exact = network.trajectory(network.start(gantry.encode(start)), 6.0, rtol=1e-11, atol=1e-12)
    for k in range(3):
        policy.step(None, GOAL)
        assert policy.pace == 1.0
        np.testing.assert_allclose(policy.xi[:2], exact(2.0 * (k + 1))[:2], atol=1e-6)


def test_the_gap_is_that_of_the_last_state(gantry, cascade):
    policy = started(gantry, cascade(gantry.encode(GOAL)), np.zeros(4), speed=5.0)
    for _ in range(20):
        policy.step(None, GOAL)
    decoded = gantry.decode(policy.state[: gantry.n_links])
    assert decoded.gap_translation.max() > 1e-3
    # The policy's retraction is the nearest one only where the gap is small.
    gap = np.stack([decoded.gap_rotation, decoded.gap_translation], axis=1)
    np.testing.assert_allclose(policy.gap, gap, rtol=0.02, atol=1e-12)


def test_a_target_that_moves_steadily_is_met_at_the_end_of_each_period(gantry):
    network = without_weights(gantry.encode(GOAL))
    policy = started(gantry, network, GOAL, speed=5.0, feedforward=True, feedback=Feedback())
    step = 0.02 * np.array([0.05, 0.05, 0.0, 0.05])
    for k in range(150):
        policy.step(None, GOAL + k * step)
    # By then the target is a sample further.
    np.testing.assert_allclose(policy.q, GOAL + 150 * step, atol=2e-5)
    # At its end the network is half a period past what it aims at, by 5 /s times 0.01 s of its velocity.
    np.testing.assert_allclose(policy.qd, 0.95 * 50.0 * step, atol=2e-4)


def test_a_network_twice_as_fast_at_half_the_speed_is_the_same(gantry, cascade):
    network = cascade(gantry.encode(GOAL))
    states = []
    for factor in (1.0, 2.0):
        scaled = replace(network, gamma=factor * network.gamma, mu=factor * network.mu)
        policy = started(gantry, scaled, np.zeros(4), speed=5.0 / factor, feedforward=True, feedback=Feedback())
        # It hears an arm that is off and runs after a target that moves.
        for k in range(50):
            policy.step(policy.q + 0.02, GOAL + 1e-3 * k)
        states.append(policy.xi)
    np.testing.assert_allclose(*states, atol=1e-9)


def test_a_network_that_is_drawn_out_of_the_limits_leaves_the_reference_there(gantry, cascade):
    high = gantry.position_limits[:, 1]
    policy = started(gantry, cascade(gantry.encode(high)), high, speed=0.1, feedforward=True, feedback=Feedback())
    for _ in range(20):
        q, qd = policy.step(high + 0.2 * np.eye(4)[0], high)
        assert (q <= high + 1e-12).all()
    assert qd[0] == 0.0
    for _ in range(20):
        q, _ = policy.step(high - 0.5 * np.eye(4)[0], GOAL)
    assert q[0] < high[0]


def test_bad_input(gantry, cascade):
    with pytest.raises(InputError, match="rate must not"):
        Feedback(rate=-1.0)
    with pytest.raises(InputError, match="tolerance must be positive"):
        Feedback(tolerance=0.0)
    with pytest.raises(InputError, match="3 visible neurons"):
        NetworkPolicy(gantry, cascade(np.zeros((3, 6))))
    # Half of 1 / (1 + |W|) in each of a hundred steps of a period, in the certificate's norm.
    network = cascade(gantry.encode(GOAL))
    root = np.sqrt(network.lyapunov_diagonal)
    weight = np.diag(root) @ network.certifiable_weight @ np.diag(1.0 / root)
    fastest = 100 * 0.5 * 50.0 / (1.0 + np.sqrt(np.linalg.eigvalsh(weight.T @ weight)[-1]))
    with pytest.raises(InputError, match=rf"at most {re.escape(f'{fastest:.3g}')} per second .* at 50 Hz, got 10000"):
        NetworkPolicy(gantry, network, 50.0, speed=1e4)


def test_a_ball_joint_turns_no_further_than_its_largest_angle():
    arm = Arm.load("telescopic_compound")
    ball, aside = arm.space.balls[1], np.zeros(arm.n_joints)
    # At an angle whose components are each within the limit.
    widest = arm.position_limits[ball[0], 1]
    start = arm.keyframe("home")
    start[ball] = widest / np.sqrt(3.0)
    aside[ball] = 0.1
    network = synthesize(arm.encode(start), seed=0).network
    policy = started(arm, network, start, speed=0.1, rate=250.0)
    for _ in range(20):
        q, _ = policy.step(start + aside, start)
        assert np.linalg.norm(q[ball]) <= widest + 1e-12


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_it_runs_the_retargeted_network_and_no_measurement_is_none(seed):
    arm, rng = Arm.load("telescopic_pr"), np.random.default_rng(seed)
    home = arm.keyframe("home")
    network = synthesize(arm.encode(home), bias="sign-matched", bias_magnitude=0.25).unwrap()
    q, goal = (home + 0.05 * rng.uniform(-1.0, 1.0, 8) for _ in range(2))
    policy = started(arm, network, q, 250.0, speed=2.0, feedforward=False)
    scales = [policy.step(None, goal) and policy.pace for _ in range(8)]
    # Limits of acceleration hold it back at first.
    elapsed = 2.0 * 0.004 * sum(scales)
    exact = network.retarget(arm.encode(goal)).trajectory(arm.encode(q), elapsed, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(policy.state, exact.xi[-1], atol=1e-8)
    assert policy.message.startswith("moves")


def test_it_is_slowed_down_to_a_limit_and_not_further():
    arm = Arm.load("telescopic_pr")
    home, extended = arm.keyframe("home"), arm.keyframe("extended")
    network = synthesize(arm.encode(home), bias="sign-matched", bias_magnitude=0.25).unwrap()
    policy = started(arm, network, home, 100.0, speed=40.0)
    for _ in range(5):
        allowed = policy.allowed()
        _, qd = policy.step(None, home + 0.5 * (extended - home))
        assert policy.pace < 0.5
        assert 0.95 < (np.abs(qd) / allowed).max() <= 1.001
    assert policy.message == f"moves at {100 * policy.pace:.2g} % of its speed, within the joints' limits"


@pytest.mark.parametrize("seed", [1, 4, 9])
def test_a_network_that_gathers_speed_within_a_period_keeps_the_limits(seed):
    arm = Arm.load("telescopic_rrp")
    low, high = arm.position_limits.T
    goal = low + (high - low) * (0.1 + 0.8 * np.random.default_rng(seed).random(arm.n_joints))
    policy = make_policy("lieednn-certified", arm, goal, rate=20.0, start="home")
    policy.reset("home")
    shares = []
    for _ in range(20):
        allowed = policy.allowed()
        _, qd = policy.step(None, goal)
        shares.append((np.abs(qd) / allowed).max())
    assert 0.95 < max(shares) <= 1.002
