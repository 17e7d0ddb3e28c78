"""Replanning: no jump at a change, the proof and the arrival, poles in the way, nowhere to go, and error messages."""

import dataclasses
from concurrent.futures import Future

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.planning import plan
from lieednn_sim.planning.transition import along, straight
from lieednn_sim.policies import Feedback, FilteredPolicy, ReplanningOptions, ReplanningPolicy, make_policy, replanning
from lieednn_sim.policies.surroundings import Surroundings
from lieednn_sim.simulation import Disturbances, MovingObstacle, Push, follow
from lieednn_sim.synthesis.shaping.encoder import CurveEncoder

ACROSS = np.array([0.0, 1.5, 0.0, 0.5])


@pytest.fixture(scope="module")
def beside(gantry):
    """The gantry, whose end effector is at x = 1 m, and a pole at x = 3 m."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="pole", pos=[3.0, 0.8, 0.0])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.05, 4.0, 0.0])
    return dataclasses.replace(gantry.with_obstacles(spec, "pole"), scene="free")


def coming(*more):
    """A pole that walks to where the end effector would pass, in half a second; and on."""
    places = [(0.3, (3.0, 0.8, 0.0)), (0.8, (1.0, 0.8, 0.0)), *more]
    return Disturbances(obstacles=(MovingObstacle("obstacle_pole", *zip(*places, strict=True)),))


def test_changes_of_target_at_any_time_jump_in_nothing(gantry):
    policy, rng = ReplanningPolicy(gantry, 50.0), np.random.default_rng(0)
    policy.reset(np.zeros(4))
    low, high = gantry.position_limits.T
    rows = [(policy.q, policy.qd)]
    for _ in range(15):
        target = np.clip(rng.uniform(0.9 * low, 0.9 * high), [-1.0, -2.0, -0.85, -3.0], high)
        rows += [policy.step(policy.q, target) for _ in range(rng.integers(1, 80))]
    rows += [policy.step(policy.q, target) for _ in range(400)]
    q, qd = np.moveaxis(np.array(rows), 1, 0)
    assert policy.changes >= 15
    assert (np.abs(qd) <= gantry.velocity_limits).all()
    acceleration = np.diff(qd, axis=0) / 0.02
    assert (np.abs(acceleration) <= 0.9 * gantry.acceleration_limits).all()
    # Positions are those that the velocities lead to.
    np.testing.assert_allclose(np.diff(q, axis=0), 0.01 * (qd[1:] + qd[:-1]), atol=2e-3)
    # Across a change, too, accelerations go on.
    assert (np.abs(np.diff(acceleration, axis=0)) / gantry.acceleration_limits).max() < 0.12
    np.testing.assert_allclose(q[-1], target, atol=1e-8)
    assert policy.network.certificate is CurveEncoder(2).network.certificate
    np.testing.assert_allclose(policy.network.visible(policy.network.equilibrium().xi), gantry.encode(target))


def test_after_the_last_change_it_is_the_network_itself(gantry):
    """Its states lie on the orbit of the network with its code, integrated for comparison."""
    policy = ReplanningPolicy(gantry, 50.0, feedback=None)
    policy.reset(np.zeros(4))
    for target in (ACROSS, -0.4 * ACROSS):
        code, states = policy.network.hidden_start, [policy.state]
        for _ in range(20):
            policy.step(None, target)
            states.append(policy.state)
        assert (policy.network.hidden_start != code).any()
    network = policy.network
    trajectory = network.trajectory(network.start(states[0]), 2.0, rtol=1e-6, atol=1e-8)
    orbit = network.visible(trajectory(np.linspace(0.0, 2.0, 4001)))
    for state in states:
        assert np.abs(orbit - state).max(axis=(1, 2)).min() < 1e-4


def test_it_goes_around_a_pole_that_walks_into_its_way(beside):
    pytest.importorskip("ompl")
    motion = plan(beside, ACROSS, planner="minimum-jerk", duration=3.0).motion
    make = {"rate": 50.0, "start": np.zeros(4)}
    touched = follow(make_policy("tracker", beside, motion, **make), ACROSS, 3.0, disturbances=coming())
    assert touched.rollout.contacts.any()
    policy = make_policy("lieednn-replanning", beside, motion, **make)
    rollout, again = (follow(policy, ACROSS, end, disturbances=coming()).rollout for end in (4.5, 2.0))
    # To the bit, though the search is in another thread.
    np.testing.assert_array_equal(rollout.q[: len(again.q)], again.q)
    assert again.channels["changes"][-1] >= 2.0
    assert not rollout.contacts.any()
    np.testing.assert_allclose(rollout.q[-1], ACROSS, atol=1e-3)
    assert rollout.channels["blocked"].max() == 1.0
    assert rollout.channels["changes"][-1] >= 2.0
    # Undisturbed, it is the given motion.
    policy.reset(np.zeros(4))
    rows = np.array([policy.step(None, ACROSS)[0] for _ in range(150)])
    np.testing.assert_allclose(rows, motion.q[2::2], atol=1e-3)
    assert policy.changes == 1


@pytest.mark.parametrize("name", ["linear-attractor", "fabric", "mppi"])
def test_others_also_see_where_the_pole_is(name, beside):
    """They stop before it; the one without a filter does not see it."""
    target = ACROSS * [1.0, 1.0, 1.0, 0.0]
    walk = Disturbances(obstacles=(MovingObstacle("obstacle_pole", (0.0, 0.1), ((3.0, 0.8, 0.0), (1.0, 0.8, 0.0))),))

    def made():
        policy = make_policy(name, beside, target, rate=50.0, feedback=None)
        policy = FilteredPolicy(policy) if name == "linear-attractor" else policy
        policy.reset(np.zeros(4))
        return policy

    policy = made()
    assert not follow(policy, target, 1.5, disturbances=walk).rollout.contacts.any()
    if name == "linear-attractor":
        assert follow(policy.inner, target, 1.5, disturbances=walk).rollout.contacts.any()
    # A reset puts the pole back.
    policy.reset(np.zeros(4))
    fresh = made()
    for each in (policy, fresh):
        for _ in range(100):
            each.step(None, target)
    np.testing.assert_array_equal(policy.q, fresh.q)
    assert abs(policy.q[1] - 1.5) < 0.2


def test_it_waits_where_there_is_no_way_and_goes_on_when_there_is(beside):
    target = np.array([0.0, 0.8, 0.0, 0.0])
    policy = ReplanningPolicy(beside, 50.0, options=ReplanningOptions(search_periods=5))
    blocked = follow(policy, target, 3.0, disturbances=coming())
    assert policy.message.startswith("waits for 'obstacle_pole'; the target is not free")
    assert not blocked.rollout.contacts.any()
    assert np.abs(blocked.rollout.qd[-1]).max() < 1e-3
    # It leaves after 2 s.
    left = follow(policy, target, 6.0, disturbances=coming((2.0, (1.0, 0.8, 0.0)), (2.5, (3.0, 0.8, 0.0))))
    assert not left.rollout.contacts.any()
    np.testing.assert_allclose(left.rollout.q[-1], target, atol=1e-3)


def test_what_is_in_the_way_by_hand(beside):
    """The arm's ball of 0.1 m is at (1, y, 0), the pole has 0.05 m; the margin is 0.03 m."""
    look = Surroundings(beside, 0.03)
    at_pole, home = np.array([2.0, 0.8, 0.0, 0.0]), np.zeros(4)
    assert look.blocked(np.stack([home, at_pole])) == (1, "obstacle_pole")

    def gap_of(gap, q=home, **how):
        look.see({"obstacle_pole": np.array([1.15 + gap, 0.0, 0.0])})
        return look.blocked(q[None], **how)

    for only_moving in (False, True):
        assert gap_of(0.028, only_moving=only_moving) == (0, "obstacle_pole")
        assert gap_of(0.032, only_moving=only_moving) is None
        # It is no longer where the scene has it.
        assert look.blocked(at_pole[None], only_moving=only_moving) is None
    labelled = dataclasses.replace(beside, scene="poles", scene_seed=3).with_moved_bodies(
        {"obstacle_pole": np.zeros(3)}
    )
    assert (labelled.scene, labelled.scene_seed) == ("poles", 3)
    # From 0.02 m the arm may get away, as long as four fifths of that are left.
    gap_of(0.02)
    look.leave(home)
    assert gap_of(0.017) is None
    assert gap_of(0.015) == (0, "obstacle_pole")


@pytest.mark.parametrize(("step", "blocked"), [(-0.1, True), (0.0, False), (0.1, False)])
def test_an_obstacle_is_expected_to_go_on(beside, step, blocked, monkeypatch):
    """Five periods of 0.02 s at 1 m/s towards the path, 0.3 s before it is there, or away from it."""
    searched = []
    policy = ReplanningPolicy(beside, 50.0, feedback=None)
    policy.reset(np.zeros(4))
    monkeypatch.setattr(replanning, "aside", lambda _, __, places, *___: searched.append(places) or Future())
    for k in range(6):
        policy.see({"obstacle_pole": np.array([1.4 - step * (1.0 - k / 5.0), 0.8, 0.0])})
        policy.step(None, ACROSS)
    assert policy.channels()[3] == blocked
    # The path that is searched for avoids it where it is.
    assert [places["obstacle_pole"][0] for places in searched] == [1.4] * blocked


def test_searches_have_seeds_of_their_own_and_their_paths_are_looked_at_again(beside, monkeypatch):
    """No path, and then one into which the pole has moved meanwhile; it rests before the pole all the same."""
    seeds, path = [], plan(beside, ACROSS, planner="minimum-jerk", duration=2.0).motion

    def aside(arm, search, *arguments):
        seeds.append(arguments[-1])
        future = Future()
        if len(seeds) < 3:
            future.set_exception(PlanError("no path"))
        else:
            future.set_result(along(beside, path))
        return future

    policy = ReplanningPolicy(beside, 50.0, seed=7, feedback=None, options=ReplanningOptions(search_periods=5))
    policy.reset(np.zeros(4))
    monkeypatch.setattr(replanning, "aside", aside)
    policy.see({"obstacle_pole": np.array([1.0, 0.8, 0.0])})
    for _ in range(100):
        policy.step(None, ACROSS)
    assert seeds[:4] == [7, 8, 9, 10]
    assert policy.q[1] < 0.65


def test_a_change_leaves_state_velocity_and_acceleration_as_they_are(gantry):
    """The visible state to the bit, also what it lacks of a configuration."""
    policy = ReplanningPolicy(gantry, 50.0, feedback=None)
    policy.reset(np.zeros(4))
    for _ in range(30):
        policy.step(None, ACROSS)
    state = policy.state.copy()
    assert np.abs(gantry.encode(policy.drawn) - state).max() > 0.0
    before = policy.course.transition(np.array([policy.time]))
    policy.take(straight(gantry, policy.drawn, np.zeros(4), 1.0), lambda _: None)
    np.testing.assert_array_equal(policy.state, state)
    for old, new in zip(before[1:], policy.course.transition(np.zeros(1))[1:], strict=True):
        assert np.abs(old).max() > 0.1
        np.testing.assert_allclose(new, old, atol=0.02 * np.abs(old).max())


def test_a_change_while_the_pace_falls_for_an_arm_that_lags_takes_over_the_acceleration(gantry):
    """x'' = p' v + p^2 a of a motion with velocity v and acceleration a, by hand; it begins at the pace s > p."""
    options = ReplanningOptions(least_duration=2.0)
    policy = ReplanningPolicy(gantry, 50.0, feedback=Feedback(rate=0.0), options=options)
    policy.reset(np.zeros(4))
    lag = np.zeros(4)
    for k in range(40):
        lag[1] = 0.001 * gantry.ranges[1] * max(k - 30, 0)
        policy.step(policy.q - lag, 0.2 * ACROSS)
    v, a = policy._velocity, policy.course.transition(np.array([policy.time]))[2][0]
    pace, falls, waits = policy.pace, policy._pace_rate, policy._waiting
    assert pace < 0.6
    assert falls < -0.5
    policy.take(straight(gantry, policy.drawn, np.zeros(4), 1.0), lambda _: None)
    _, qd, qdd = policy.course.transition(np.zeros(1))
    begins = max(pace, waits)
    limit = 0.5 * gantry.acceleration_limits
    np.testing.assert_allclose(begins * qd[0], pace * v, atol=1e-9)
    np.testing.assert_allclose(qdd[0], np.clip((falls * v + pace**2 * a) / begins**2, -limit, limit), atol=1e-9)
    assert 0.1 < np.abs(qdd[0, 3]) / limit[3] < 0.9


@pytest.mark.parametrize("gap", [0.3, 0.5, 0.8])
def test_a_search_begins_where_the_arm_can_rest_before_what_blocks_it(gap, beside, monkeypatch):
    """A pole appears so far ahead of the moving ball; the search takes 20 periods, in which it would go 0.3 m."""
    starts = []

    def aside(arm, search, *arguments):
        starts.extend([arguments[1][0]] if len(arguments) == 5 else [])
        return no_path()

    monkeypatch.setattr(replanning, "aside", aside)
    policy = ReplanningPolicy(beside, 50.0, feedback=None, options=ReplanningOptions(least_duration=3.0, evade=False))
    policy.reset(np.zeros(4))
    for k in range(250):
        if k == 60:
            place = np.array([1.0, policy.q[1] + gap, 0.0])
        if k >= 60:
            policy.see({"obstacle_pole": place})
        policy.step(None, np.array([0.0, 1.8, 0.0, 0.0]))
    look = Surroundings(beside, 0.03)
    look.see({"obstacle_pole": place})
    assert look.blocked(starts[0][None]) is None


def no_path(*_):
    """What a search returns that has found none."""
    future = Future()
    future.set_exception(PlanError("no path"))
    return future


@pytest.mark.parametrize("target", [(0.0, -0.8, 0.0, 0.0), (0.5, -0.3, 0.3, 1.0)])
def test_references_go_on_at_a_change_at_half_the_pace(target, beside, monkeypatch):
    """By differences of what is sent, while the arm brakes for a pole: a jump of a few thousandths of the limits."""
    monkeypatch.setattr(replanning, "aside", no_path)
    policy = ReplanningPolicy(beside, 200.0, feedback=None, options=ReplanningOptions(least_duration=2.0))
    policy.reset(np.zeros(4))
    rates, goal, changed = [policy.qd], np.array([0.0, 0.8, 0.0, 0.0]), 0
    for k in range(300):
        policy.see({"obstacle_pole": np.array([1.0 if k > 60 else 3.0, 0.8, 0.0])})
        if not changed and policy.pace < 0.5:
            changed, goal = k, np.array(target)
        rates.append(policy.step(None, goal)[1])
    assert policy.changes == 2
    acceleration = np.diff(rates, axis=0) * 200.0 / beside.acceleration_limits
    assert acceleration[changed, 1] < -0.1
    assert np.abs(np.diff(acceleration, axis=0))[changed - 3 : changed + 2].max() < 0.004


@pytest.mark.parametrize("changed", [120, 200, 260])
def test_it_stops_as_gently_as_it_can_where_a_new_target_is_refused(changed, beside, monkeypatch):
    """It turns where it rests, for which 0.35 of the limits are enough."""
    monkeypatch.setattr(replanning, "aside", no_path)
    options = ReplanningOptions(least_duration=2.0, search_periods=1)
    policy = ReplanningPolicy(beside, 200.0, feedback=None, options=options)
    policy.reset(np.zeros(4))
    policy.see({"obstacle_pole": np.array([1.0, -0.6, 0.0])})
    rates = [policy.step(None, np.array([0.0, 1.5 if k < changed else -1.5, 0.0, 0.0]))[1] for k in range(600)]
    assert policy.message == "waits for 'obstacle_pole'; no path"
    assert policy.pace < 1e-3
    assert np.abs(np.diff(rates, axis=0)).max() * 200.0 < 0.36 * beside.acceleration_limits[1]


@pytest.mark.parametrize(("appears", "share"), [(80, 0.3), (250, 0.86)])
def test_it_brakes_once_as_gently_as_it_can(appears, share, beside):
    """Where it must rest does not change from look to look, so that a small part of the limits is enough.

    Late, it takes the 0.85 that it may.
    """
    policy = ReplanningPolicy(beside, 200.0, feedback=None, options=ReplanningOptions(least_duration=2.0))
    policy.reset(np.zeros(4))
    rates = []
    for k in range(400):
        policy.see({"obstacle_pole": np.array([1.0 if k > appears else 3.0, 0.8, 0.0])})
        rates.append(policy.step(None, np.array([0.0, 0.8, 0.0, 0.0]))[1])
    assert policy.pace < 1e-3
    assert 0.3 < policy.time <= policy.rest_at + (1e-3 if appears < 100 else 0.1)
    braking = np.abs(np.diff(rates, axis=0)) * 200.0 / beside.acceleration_limits
    assert share - 0.1 < braking.max() < share


def test_it_yields_to_a_push_and_arrives_all_the_same(gantry):
    push = Disturbances(pushes=(Push("end effector", (0.0, 60.0, 0.0), 0.3, 0.2),))
    policy = ReplanningPolicy(gantry, 50.0, feedback=Feedback())
    pushed, free = (follow(policy, ACROSS, 4.0, disturbances=each).rollout for each in (push, None))
    assert pushed.channels["pace"].min() < 0.5 < free.channels["pace"].min()
    assert np.abs(pushed.q_ref - free.q_ref).max() > 0.02
    np.testing.assert_allclose(pushed.q[-1], ACROSS, atol=1e-3)


def test_what_it_is_not_for_is_said(gantry, beside):
    motion, other = plan(gantry, ACROSS, planner="minimum-jerk").motion, Arm.load("telescopic_pr")
    with pytest.raises(InputError, match="the motion has 4 joint coordinates, arm 'telescopic_pr' has 8"):
        ReplanningPolicy(other, motion=motion)
    policy = ReplanningPolicy(beside)
    with pytest.raises(InputError, match=r"a reset puts obstacles back: call reset\(q\) before see"):
        policy.see({"obstacle_pole": np.zeros(3)})
    policy.reset(np.zeros(4))
    with pytest.raises(InputError, match="no obstacle 'wrist' can move; bodies that neither move nor carry an arm are"):
        policy.see({"wrist": np.zeros(3)})
    with pytest.raises(InputError, match="the place of 'obstacle_pole' must"):
        policy.see({"obstacle_pole": np.zeros(2)})
