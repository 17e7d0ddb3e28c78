"""Moving targets: the lag that theory gives, the feedforward that removes it, jumps, causality, determinism."""

import dataclasses

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation import evaluate, evaluate_following
from lieednn_sim.policies import NetworkPolicy
from lieednn_sim.simulation import Disturbances, Push, follow, following
from lieednn_sim.synthesis import synthesize


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


def test_behind_a_steady_target_the_error_is_speed_over_gain_and_feedforward_takes_it_away(arm, network):
    target, speed = ramp(arm, 0.1), 12.0
    runs = {}
    for flag in (False, True):
        policy = NetworkPolicy(arm, network, speed=speed, feedforward=flag, feedback=None)
        runs[flag] = follow(policy, target, 1.0)
    goals = arm.encode(runs[False].target[-2:])
    velocity = (goals[1] - goals[0]).ravel() / 0.002
    # The follower sees the target up to a period ago, on average half a one.
    delayed = goals[1].ravel() - 0.5 * 0.01 * velocity
    predicted = np.linalg.solve(-speed * network.retarget(goals[1]).jacobian(goals[1]), velocity)
    behind = delayed - runs[False].states[-1].ravel()
    np.testing.assert_allclose(behind, predicted, atol=0.05 * np.abs(predicted).max())
    assert np.abs(goals[1] - runs[True].states[-1]).max() < 2e-3 * np.abs(predicted).max()
    late, prompt = (evaluate_following(runs[flag]) for flag in (False, True))
    assert prompt.rms_mm < 0.05 * late.rms_mm
    assert abs(prompt.lag_s) < 0.002
    assert late.lag_s > 0.02


def test_the_end_of_a_moving_target_is_no_sudden_stop(arm, network):
    following = follow(NetworkPolicy(arm, network, speed=10.0), ramp(arm, 0.1), 0.5)
    force = following.rollout.force
    # Of a cubic reference forces change from one control period to the next, and no more at the end.
    changes = np.abs(np.diff(force, axis=0)).max(axis=1)
    assert changes[-1] < 1.2 * changes[-50:-1].max()


def test_a_jump_settles_without_reset_and_joints_keep_their_velocity_limits(arm, network):
    home, extended = arm.keyframe("home"), arm.keyframe("extended")

    def target(t):
        return home if t < 0.203 else home + 0.2 * (extended - home)

    run = follow(NetworkPolicy(arm, network, speed=20.0, feedback=None), target, 1.4, controller="mocap-deadbeat")
    assert run.jumps == (0.21,), "seen at the next control period"
    # Rates of a period that is slowed down come to nearly the limit; the 141st only begins.
    shares = (np.abs(run.rollout.qd_ref[1:]) / arm.velocity_limits).max(axis=1).reshape(140, 5).max(axis=1)
    pace = run.rollout.channels["pace"][::5]
    assert ((pace < 1.0)[:140] >= (shares > 0.99)).all()
    assert pace.min() < 0.5
    ends = run.rollout.qd_ref[::5]
    assert (np.abs(ends) <= arm.velocity_limits * 1.001).all()
    assert np.abs(np.diff(run.states, axis=0)).max() < 0.1, "the state never jumps"
    errors = evaluate_following(run)
    (settling,) = errors.settling_s
    assert 0.05 < settling < 1.1
    np.testing.assert_allclose(run.rollout.q[-1], target(9.0), atol=1e-3)
    np.testing.assert_allclose(run.rollout.q[:100], np.tile(home, (100, 1)), atol=1e-9)


def test_what_comes_later_is_not_known_and_runs_are_bit_identical(arm, network):
    steady = np.array([ramp(arm, 0.1)(0.002 * k) for k in range(151)])
    other = steady.copy()
    other[101:] += 0.01
    changes = Disturbances(
        pushes=(Push("end effector", (20.0, 0.0, 0.0), 0.05, 0.1),), position_noise=1e-5, payload=1.0
    )
    one, two, three = (
        follow(NetworkPolicy(arm, network), samples, 0.3, disturbances=changes) for samples in (steady, steady, other)
    )
    np.testing.assert_array_equal(one.rollout.q, two.rollout.q)
    np.testing.assert_array_equal(one.rollout.ctrl[:105], three.rollout.ctrl[:105])
    assert np.abs(one.rollout.ctrl[105] - three.rollout.ctrl[105]).max() > 1e-6
    assert one.rollout.disturbances == changes
    assert one == two
    assert one != three


def test_ball_joints_follow_too(small_arms):
    arm = small_arms["hanging"]
    network = synthesize(np.full((1, 6), 0.3), bias="solved").unwrap()
    goal = np.array([0.1, -0.1, 0.1, 0.5, -0.4, 0.3])
    run = follow(
        NetworkPolicy(arm, network, speed=15.0, feedback=None),
        lambda t: min(t, 1.0) * goal,
        1.6,
        start=np.zeros(6),
        controller="mocap",
    )
    assert evaluate_following(run).rms_mm < 5.0
    np.testing.assert_allclose(run.rollout.q_ref[-1], goal, atol=1e-4)


def test_bad_input(arm, network):
    home, policy = arm.keyframe("home"), NetworkPolicy(arm, network)
    uncertified = dataclasses.replace(network, lyapunov_diagonal=None)
    with pytest.raises(InputError, match="only a certified network follows every target"):
        NetworkPolicy(arm, uncertified)
    with pytest.raises(InputError, match=r"the target at t = 0\.050 s is out of reach"):
        follow(policy, lambda t: home + 100.0 * (t > 0.049), 1.0)
    with pytest.raises(InputError, match="network must be a LieEDNN, got None"):
        NetworkPolicy(arm, None)  # of a planner without one
    with pytest.raises(InputError, match="the policy's rate must divide the simulation's 500 Hz"):
        follow(NetworkPolicy(arm, network, 300.0), home, 1.0)
    with pytest.raises(InputError, match=r"rate must be at least 0\.5 Hz for a duration of 2 s, got 0\.25 Hz"):
        follow(NetworkPolicy(arm, network, 0.25, speed=0.1), home, 2.0)
    with pytest.raises(InputError, match="target must be"):
        follow(policy, np.zeros((0, 8)), 1.0)
    with pytest.raises(InputError, match="policy must be a Policy"):
        follow(network, home, 1.0)
    with pytest.raises(InputError, match=r"rollout must be a Rollout, got a Following; give its \.rollout"):
        evaluate(follow(policy, home, 0.1))


@pytest.mark.parametrize("controller", ["inverse-dynamics", "mocap"])
def test_a_run_without_end_is_that_of_follow_though_it_forgets_its_reference(arm, network, controller, monkeypatch):
    monkeypatch.setattr(following, "_KEPT_PERIODS", 7)
    goal = ramp(arm, 0.1)(1.0)
    expected = follow(NetworkPolicy(arm, network), goal, 0.5, controller=controller).rollout.q[-1]
    policy = NetworkPolicy(arm, network)
    policy.reset("home")
    loop = following.ClosedLoop(policy, controller, Disturbances())
    loop.begin(policy.q)
    for _ in range(50):
        loop.advance(goal)
    assert len(loop.reference.q) == 7 * loop.period
    assert loop.simulation.q.tolist() == expected.tolist()
