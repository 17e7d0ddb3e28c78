"""Moving targets: the lag that theory gives, the feedforward that removes it, jumps, causality, determinism."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation import evaluate_following
from lieednn_sim.simulation import Disturbances, Push, follow
from lieednn_sim.simulation.following import Follower
from lieednn_sim.synthesis import synthesize

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def arm():
    return Arm.load("telescopic_pr")


@pytest.fixture(scope="module")
def network(arm):
    return synthesize(arm.encode(arm.keyframe("home")), bias="sign-matched", bias_magnitude=0.25).unwrap()


def ramp(arm: Arm, share: float):
    """A target that moves from home towards extended at a constant velocity."""
    home, extended = arm.keyframe("home"), arm.keyframe("extended")
    return lambda t: home + share * t * (extended - home)


@settings(max_examples=5)
@given(seed=seeds)
def test_the_follower_runs_the_retargeted_network(arm, network, seed):
    rng = np.random.default_rng(seed)
    q, goal = (arm.keyframe("home") + 0.05 * rng.uniform(-1.0, 1.0, 8) for _ in range(2))
    follower = Follower(arm, network, q, steps=5, speed=2.0, feedforward=False)
    for _ in range(3):
        follower.advance(goal)
    assert follower.share == 1.0
    exact = network.retarget(arm.encode(goal)).trajectory(arm.encode(q), 2.0 * 0.03, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(follower.xi, exact.xi[-1], atol=1e-9)


def test_hidden_neurons_run_with_the_follower_and_are_never_reset(gantry, cascade):
    q, goal = np.zeros(4), np.array([0.02, -0.02, 0.03, 0.02])
    network = cascade(gantry.encode(np.full(4, 0.1)))
    follower = Follower(gantry, network, q, steps=5, speed=0.5, feedforward=True)
    periods = [follower.advance(goal)[2] for _ in range(4)]
    assert follower.share == 1.0
    exact = network.retarget(gantry.encode(goal)).trajectory(network.start(gantry.encode(q)), 0.1, rtol=1e-11)
    np.testing.assert_allclose(np.concatenate(periods), exact(0.005 * np.arange(1.0, 21.0)), atol=1e-8)


def test_a_network_that_leaves_the_limits_leaves_the_reference_there(gantry, cascade):
    high = gantry.position_limits[:, 1]
    network = cascade(gantry.encode(high), 0.05)
    follower = Follower(gantry, network, high, steps=5, speed=20.0, feedforward=True)
    q, qd, states = map(np.concatenate, zip(*(follower.advance(high) for _ in range(8)), strict=True))
    decoded = gantry.decode(network.visible(states))
    beyond = decoded.q > high
    assert beyond.any()
    np.testing.assert_array_equal(q[beyond], np.broadcast_to(high, q.shape)[beyond])
    assert (qd[beyond] == 0.0).all()
    np.testing.assert_allclose(q[~beyond], decoded.q[~beyond])
    # The largest of the whole run, not of its end.
    assert follower.limit_excess == pytest.approx((decoded.q - high).max())
    for name in ("gap_rotation", "gap_translation"):
        gap = getattr(decoded, name)
        assert getattr(follower, name) == pytest.approx(gap.max())
        assert gap.max() > 1.5 * gap[-5:].max()


def test_following_with_hidden_neurons_arrives(arm, cascade):
    goal = ramp(arm, 0.1)(1.0)
    run = follow(arm, cascade(arm.encode(goal), 0.02), goal[None], 1.0, speed=20.0, control_rate=50.0)
    assert run.xi.shape[1:] == (7, 6)
    np.testing.assert_allclose(run.rollout.q_ref[-1], goal, atol=1e-3)


def test_behind_a_steady_target_the_error_is_speed_over_gain_and_feedforward_takes_it_away(arm, network):
    target, speed = ramp(arm, 0.1), 12.0
    runs = {flag: follow(arm, network, target, 1.0, speed=speed, feedforward=flag) for flag in (False, True)}
    goals = arm.encode(runs[False].target[-2:])
    velocity = (goals[1] - goals[0]).ravel() / 0.002
    # The follower sees the target up to a period ago, on average half a one.
    delayed = goals[1].ravel() - 0.5 * 0.01 * velocity
    predicted = np.linalg.solve(-speed * network.retarget(goals[1]).jacobian(goals[1]), velocity)
    behind = delayed - runs[False].xi[-1].ravel()
    np.testing.assert_allclose(behind, predicted, atol=0.05 * np.abs(predicted).max())
    assert np.abs(goals[1] - runs[True].xi[-1]).max() < 2e-3 * np.abs(predicted).max()
    late, prompt = (evaluate_following(runs[flag]) for flag in (False, True))
    assert prompt.rms_mm < 0.05 * late.rms_mm
    assert abs(prompt.lag_s) < 0.002
    assert late.lag_s > 0.02


def test_the_end_of_a_moving_target_is_no_sudden_stop(arm, network):
    following = follow(arm, network, ramp(arm, 0.1), 0.5, speed=10.0, controller="inverse-dynamics")
    force = following.rollout.force
    assert np.abs(force[-1] - force[-2]).max() < 0.05 * np.abs(force[-2]).max()


def test_a_jump_settles_without_reset_and_joints_keep_their_velocity_limits(arm, network):
    home, extended = arm.keyframe("home"), arm.keyframe("extended")

    def target(t):
        return home if t < 0.203 else home + 0.2 * (extended - home)

    run = follow(arm, network, target, 1.4, speed=20.0, controller="mocap-deadbeat")
    assert run.jumps == (0.21,), "seen at the next control period"
    # Rates of a period that is slowed down come to nearly the limit; the 141st only begins.
    shares = (np.abs(run.rollout.qd_ref[1:]) / arm.velocity_limits).max(axis=1).reshape(140, 5).max(axis=1)
    assert run.slowed == np.sum(shares > 0.99) / 141
    assert (np.abs(run.rollout.qd_ref) <= arm.velocity_limits * (1.0 + 1e-9)).all()
    assert np.abs(np.diff(run.xi, axis=0)).max() < 0.02, "the state never jumps"
    errors = evaluate_following(run)
    (settling,) = errors.settling_s
    assert 0.05 < settling < 1.1
    np.testing.assert_allclose(run.rollout.q[-1], target(9.0), atol=1e-3)
    np.testing.assert_allclose(run.rollout.q[:100], np.tile(home, (100, 1)), atol=1e-9)


def test_a_follower_is_slowed_down_to_its_velocity_limit_and_not_further(arm, network):
    home, extended = arm.keyframe("home"), arm.keyframe("extended")
    follower = Follower(arm, network, home, steps=5, speed=40.0, feedforward=False)
    for _ in range(3):
        _, qd, _ = follower.advance(home + 0.5 * (extended - home))
        assert follower.share < 0.5
        assert 0.95 < (np.abs(qd) / arm.velocity_limits).max() <= 1.0


def test_what_comes_later_is_not_known_and_runs_are_bit_identical(arm, network):
    steady = np.array([ramp(arm, 0.1)(0.002 * k) for k in range(151)])
    other = steady.copy()
    other[101:] += 0.01
    changes = Disturbances(
        pushes=(Push("end effector", (20.0, 0.0, 0.0), 0.05, 0.1),), position_noise=1e-5, payload=1.0
    )
    one, two, three = (follow(arm, network, samples, 0.3, disturbances=changes) for samples in (steady, steady, other))
    np.testing.assert_array_equal(one.rollout.q, two.rollout.q)
    np.testing.assert_array_equal(one.rollout.ctrl[:105], three.rollout.ctrl[:105])
    assert np.abs(one.rollout.ctrl[105] - three.rollout.ctrl[105]).max() > 1e-6
    assert one.rollout.disturbances == changes


def test_ball_joints_follow_too(small_arms):
    arm = small_arms["hanging"]
    network = synthesize(np.full((1, 6), 0.3), bias="solved").unwrap()
    goal = np.array([0.1, -0.1, 0.1, 0.5, -0.4, 0.3])
    run = follow(arm, network, lambda t: min(t, 1.0) * goal, 1.6, start=np.zeros(6), controller="mocap", speed=15.0)
    assert evaluate_following(run).rms_mm < 5.0
    np.testing.assert_allclose(run.rollout.q_ref[-1], goal, atol=1e-4)


def test_bad_input(arm, network):
    home = arm.keyframe("home")
    uncertified = dataclasses.replace(network, lyapunov_diagonal=None)
    with pytest.raises(InputError, match="only a certified network follows every target"):
        follow(arm, uncertified, lambda t: home, 1.0)
    with pytest.raises(InputError, match=r"the target at t = 0\.050 s is out of reach"):
        follow(arm, network, lambda t: home + 100.0 * (t > 0.049), 1.0)
    with pytest.raises(InputError, match="network must be a LieEDNN, got None"):
        follow(arm, None, lambda t: home, 1.0)  # of a planner without one
    with pytest.raises(InputError, match="control_rate must divide the simulation's 500 Hz"):
        follow(arm, network, lambda t: home, 1.0, control_rate=300.0)
    with pytest.raises(InputError, match=r"control_rate must be at least 0\.5 Hz for a duration of 2 s, got 0\.25 Hz"):
        follow(arm, network, lambda t: home, 2.0, control_rate=0.25)
    with pytest.raises(InputError, match="speed must be at most"):
        follow(arm, network, lambda t: home, 1.0, speed=1e4)
    with pytest.raises(InputError, match="target must have shape"):
        follow(arm, network, home, 1.0)
