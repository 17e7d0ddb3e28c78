import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from lieednn_sim.arm import Arm
from lieednn_sim.environments import expert as experts
from lieednn_sim.environments import tasks
from lieednn_sim.environments.expert import Expert, planned
from lieednn_sim.environments.tasks import REST, TASKS, band_limited, make_task
from lieednn_sim.errors import InputError
from lieednn_sim.lie import exp
from lieednn_sim.registry import DEFAULT_ARMS

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module", params=DEFAULT_ARMS)
def arm(request):
    """An arm with time steps of 4 ms, which halve the cost of plans and episodes."""
    fine = Arm.load(request.param)
    spec = fine.spec.copy()
    spec.option.timestep = 0.004
    return Arm.from_spec(spec, fine.source, fine.name)


@pytest.fixture(scope="module")
def reach():
    return make_task("reach", time_limit=0.4)


@pytest.fixture(scope="module")
def track():
    return make_task("track", time_limit=0.4)


def run(task, seed, steps=5):
    rng = np.random.default_rng(seed)
    seen = [*task.begin(rng).values()]
    for _ in range(steps):
        observation, reward, *_ = task.step(rng.uniform(-1.0, 1.0, task.arm.n_joints))
        seen += [*observation.values(), np.array([reward])]
    return np.concatenate([np.ravel(value) for value in seen])


def test_expert_reaches_targets_with_every_arm_and_random_actions_do_not(arm, monkeypatch):
    # A plan is made slowly and run faster: of less samples.
    monkeypatch.setattr(experts, "_PLANNING_DURATION", 6.0)
    task = make_task("reach", arm, time_limit=3.5)
    rng = np.random.default_rng(1)
    expert = Expert(task)
    rewards = {"expert": 0.0, "random": 0.0}
    for policy in rewards:
        task.begin(np.random.default_rng(0))
        over = False
        while not over:
            action = expert.act() if policy == "expert" else rng.uniform(-1.0, 1.0, arm.n_joints)
            assert np.abs(action).max() <= 1.0
            observation, reward, terminated, over, info = task.step(action)
            rewards[policy] += reward
        assert not terminated
        if policy == "expert":
            assert info["success"]
            assert reward == 1.0
            # Independently of what the task says: forward kinematics of the observed posture.
            position = observation["position"]
            to_go = arm.link_poses(position)[-1].inv() * arm.link_poses(task.target(task.time))[-1]
            assert np.linalg.norm(to_go.translation) < 1e-3
            assert np.rad2deg(to_go.rotation.magnitude()) < 0.1
    assert rewards["expert"] > 1.5 * rewards["random"]


def test_expert_keeps_up_with_moving_targets_with_every_arm(arm):
    task = make_task("track", arm, time_limit=2.0)
    task.begin(np.random.default_rng(3))
    expert = Expert(task)
    rewards = []
    for _ in range(task.steps):
        action = expert.act()
        assert np.abs(action).max() <= 1.0
        rewards.append(task.step(action)[1])
    assert min(rewards) == 1.0
    # The target moved: standing still would not have done.
    assert np.abs(task.target(2.0) - arm.keyframe("home")).max() > 0.02


@pytest.mark.parametrize("name", TASKS)
def test_observations_keep_their_bounds_and_say_where_the_target_is(arm, name):
    task = make_task(name, arm, goal="links", time_limit=0.2)
    rng = np.random.default_rng(0)
    task.begin(rng)
    for _ in range(task.steps):
        seen, reward, terminated, truncated, _ = task.step(rng.uniform(-2.0, 2.0, arm.n_joints))
        assert list(seen) == list(task.bounds)
        for key, (low, high) in task.bounds.items():
            assert seen[key].shape == low.shape
            assert (low <= seen[key]).all()
            assert (seen[key] <= high).all()
        target = seen["position"] + seen["position_error"]
        assert_allclose(target, task.target(task.time), atol=1e-12)
        reached = arm.link_poses(seen["position"]) * exp(seen["pose_error"])
        assert_allclose(reached.as_matrix(), arm.link_poses(target).as_matrix(), atol=1e-9)
        assert 0.0 <= reward <= 1.0
        assert arm.limit_excess(seen["command"]).max() <= 1e-12
    assert truncated
    assert not terminated
    with pytest.raises(InputError, match="reset first"):
        task.step(np.zeros(arm.n_joints))


@pytest.mark.parametrize("name", TASKS)
@settings(max_examples=5)
@given(seed=SEEDS, other=SEEDS)
def test_an_episode_depends_on_its_seed_alone(reach, track, name, seed, other):
    task = {"reach": reach, "track": track}[name]
    first = run(task, seed)
    run(task, other, steps=3)
    assert_array_equal(run(task, seed), first)
    assert_array_equal(run(make_task(name, task.arm, time_limit=0.4), seed), first)
    if seed != other:
        assert (run(task, other) != first).any()


def test_servos_are_told_of_the_velocity_and_of_the_damping_of_joints(reach):
    model, steps = reach.arm.model, reach.substeps
    start, velocity = reach.arm.keyframe("home"), np.linspace(-0.2, 0.2, 8)
    end = start + reach.control_timestep * velocity
    (found,) = reach.commands.controls(start[None], end[None])
    kp, kv = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
    ahead = (kv + model.dof_damping) / kp * velocity
    assert_allclose(found, np.linspace(start, end, steps, endpoint=False) + ahead, rtol=0.0, atol=1e-12)


def test_commands_stop_at_the_limits():
    task = make_task("reach", "telescopic_compound")
    task.begin(np.random.default_rng(0))
    for _ in range(40):
        task.step(np.ones(24))
    assert_allclose(task.arm.limit_excess(task.command), 0.0, atol=1e-12)


def test_success_needs_rest(reach):
    target = reach.arm.keyframe("home")
    reach.begin(np.random.default_rng(0), {"target": target})
    assert reach.state.success
    assert reach.state.reward == 1.0
    # As fast as twice what counts as rest.
    _, reward, _, _, info = reach.step(np.eye(8)[0] * np.sqrt(2.0 * REST))
    assert not info["success"]
    assert 0.5 < reward < 1.0


def test_the_approach_is_the_action_that_leads_to_the_target(reach):
    home = reach.arm.keyframe("home")
    near = 0.3 * reach.control_timestep * reach.arm.velocity_limits
    seen = reach.begin(np.random.default_rng(0), {"target": home + near * np.resize([1.0, -1.0], 8)})
    assert_allclose(np.abs(seen["approach"]), np.sqrt(0.3))
    assert_allclose(reach.step(seen["approach"])[0]["command"], reach.target(0.0), atol=1e-15)
    # Far away it leads there at the velocity limits.
    seen = reach.begin(np.random.default_rng(0), {"target": home + 0.06 * np.resize([1.0, -1.0], 8)})
    assert_array_equal(seen["approach"], np.resize([1.0, -1.0], 8))


def test_the_preview_is_where_the_target_will_be(track):
    seen = track.begin(np.random.default_rng(0))
    rows = [seen["preview"]]
    for _ in range(track.preview):
        now, *_ = track.step(np.zeros(8))
        rows.append(now["preview"])
        target = now["position"] + now["position_error"]
        assert_allclose(target, rows[len(rows) - 2][0], atol=1e-12)
    assert_allclose(rows[0][-1], target, atol=1e-12)


@settings(max_examples=5)
@given(seed=SEEDS)
def test_random_trajectories_keep_limits_and_touch_nothing(seed):
    arm = Arm.load("telescopic_compound")
    trajectory = band_limited(arm, np.random.default_rng(seed), 3.1)
    t = np.linspace(0.0, 3.0, 3001)
    q, qd = trajectory(t), trajectory(t, 1)
    assert arm.limit_excess(q).max() <= 0.0
    assert (np.abs(qd) / arm.velocity_limits).max() <= 0.51
    assert_allclose(q[0], arm.keyframe("home"))
    assert_allclose(qd[0], 0.0, atol=1e-12)
    # The velocity is that of the position: its mean over the way, against the ends.
    assert_allclose(np.trapezoid(qd, t, axis=0), q[-1] - q[0], atol=1e-4)
    assert not any(arm.contacts(posture) for posture in q[::100])


def test_a_random_trajectory_has_its_rates_and_stays_within_the_angle_of_a_ball():
    """Drawn from the very corner of the cube that is within the ball: 0.8 of its angle, reached in 1.5 s."""
    arm = Arm.load("telescopic_compound")
    corner = SimpleNamespace(
        uniform=lambda low, high, size: np.broadcast_to(high, size), dirichlet=lambda _, n: np.full((n, 3), 1.0 / 3.0)
    )
    trajectory = tasks._draw(arm, corner, arm.keyframe("home"), 3.0, 0.8)
    t = trajectory.x
    q = trajectory(t)
    for ball in arm.space.balls:
        expected = arm.keyframe("home")[ball] * 0.2 + 0.8 * arm.position_limits[ball, 1] / np.sqrt(3.0)
        assert_allclose(q[-1, ball], expected)
    assert arm.limit_excess(q).max() <= 0.0
    numeric = (q[2:] - q[:-2]) / (t[2:] - t[:-2])[:, None]
    assert_allclose(trajectory(t, 1)[1:-1], numeric, atol=0.01 * np.abs(numeric).max())


def test_the_pace_is_of_the_hardest_limit_by_hand(gantry):
    """Rates go with one over the time, accelerations with one over its square."""
    # A steady gain of x, whose limits are 1 m/s and 10 m/s^2: to 1.8 m/s in a second, or at 22.5 m/s^2 to 0.225 m/s.
    for duration, gain, expected in ((1.0, 1.8, 2.0), (0.01, 22.5, np.sqrt(2.5))):
        t = np.linspace(0.0, duration, 11)
        assert tasks.slowdown(gantry, t, gain * t[:, None] * np.eye(4)[0], 0.9) == pytest.approx(expected)


@pytest.mark.parametrize("planner", [None, "minimum-jerk"])
def test_plans_are_as_fast_as_the_limits_allow(planner):
    arm = Arm.load("telescopic_pr")
    motion, _ = planned(arm, arm.keyframe("extended"), planner=planner)
    t = np.linspace(0.0, motion.x[-1], 2000)
    velocity = np.abs(motion(t, 1)) / arm.velocity_limits
    acceleration = np.abs(np.gradient(motion(t, 1), t, axis=0)) / arm.acceleration_limits
    assert max(velocity.max(), acceleration.max()) == pytest.approx(0.9, abs=0.02)
    assert_allclose(motion(t[[0, -1]]), [arm.keyframe("home"), arm.keyframe("extended")], atol=1e-6)


def test_a_policy_by_name_is_an_expert(arm):
    task = make_task("reach", arm, time_limit=4.0)
    task.begin(np.random.default_rng(0))
    expert, over = Expert(task, policy="linear-attractor"), False
    assert_array_equal(expert.act(), expert.act())  # asked twice, it has not moved
    while not over:
        _, _, _, over, info = task.step(expert.act())
    assert expert._policy.certified
    # A rate of 2/s, less for servos that lag and for which the network waits.
    assert info["distance"] < 0.02


def test_an_expert_catches_up_when_others_act(reach):
    reach.begin(np.random.default_rng(0))
    expert, other = Expert(reach), Expert(reach)
    for _ in range(3):
        reach.step(expert.act())
    assert_array_equal(other.act(), expert.act())


def test_an_expert_may_begin_in_the_middle_of_an_episode(reach):
    reach.begin(np.random.default_rng(0))
    for _ in range(20):
        reach.step(np.ones(8))
    motion, certificate = planned(reach.arm, reach.target(0.0))
    most = reach.control_timestep * reach.arm.velocity_limits
    wanted = np.clip((motion(21 * reach.control_timestep) - reach.command) / most, -1.0, 1.0)
    assert_allclose(Expert(reach).act(), wanted, atol=1e-12)
    # With a planner, the plan is that planner's: minimum jerk has no network, and no certificate.
    certificates = []
    for planner in (None, "minimum-jerk"):
        expert = Expert(reach, planner=planner)
        expert.act()
        certificates.append(expert.certificate)
    assert certificates == [certificate, ""]
    # A policy by name begins where the arm is now, so that its first step is small.
    assert np.abs(Expert(reach, policy="tracker").act()).max() < 0.1


def test_a_step_in_contact_depends_on_nothing_but_the_state(gantry):
    task, rows = make_task("reach", gantry, time_limit=4.0), []
    for guess in (0.0, 1e3):
        task.begin(np.random.default_rng(0), {"target": np.full(4, 0.1)})
        # Down to the floor, on which the ball is pressed in the end.
        for _ in range(60):
            task.simulation.data.qacc_warmstart[:] = guess
            task.step([0.0, 0.0, -1.0, 0.0])
        rows.append(task.state.row)
    assert task.simulation.data.ncon > 0
    assert_array_equal(*rows)


def test_a_failed_simulation_terminates(reach):
    seen = reach.begin(np.random.default_rng(0))
    reach.simulation.data.qvel[0] = np.nan
    observation, reward, terminated, truncated, info = reach.step(np.zeros(8))
    assert (terminated, truncated, reward) == (True, False, 0.0)
    assert "failed at t = 0.0000 s" in info["failure"]
    for name, value in observation.items():
        assert_array_equal(value, seen[name])
    assert_array_equal(run(reach, 7), run(make_task("reach", time_limit=0.4), 7))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"task": "fly"}, "no task 'fly'; allowed: reach, track"),
        ({"arm": "unknown"}, "no arm 'unknown'; allowed: telescopic_compound"),
        ({"control_timestep": 0.021}, "control_timestep must be a whole number of simulation steps of 0.002 s"),
        ({"time_limit": 0.01}, "time_limit must be between one control step of 0.02 s"),
        ({"goal": "elbow"}, "no goal 'elbow'; allowed: end-effector, links"),
        ({"task": "track", "preview": 0}, "preview must be at least 1"),
        ({"task": "track", "preview": 10**9}, "preview must be at most 10000"),
    ],
)
def test_malformed_arguments(arguments, message):
    with pytest.raises(InputError, match=message):
        make_task(**{"task": "reach", **arguments})


def test_an_arm_without_velocity_limits_is_told_how_to_get_them(gantry):
    endless = dataclasses.replace(gantry, velocity_limits=np.array([1.0, np.inf, 4.0, 8.0]))
    with pytest.raises(InputError, match=r"which scale the actions: give arm=Arm\.load"):
        make_task("reach", endless)


def test_malformed_actions_and_options(reach):
    with pytest.raises(InputError, match="has not been reset"):
        Expert(make_task("track")).act()
    reach.begin(np.random.default_rng(0))
    with pytest.raises(InputError, match=r"action must have shape \(8,\), got \(7,\)"):
        reach.step(np.zeros(7))
    with pytest.raises(InputError, match="action must be finite, got 1 NaN"):
        reach.step(np.array([np.nan, *np.zeros(7)]))
    with pytest.raises(InputError, match="unknown reset options: 'goal'; known: target"):
        reach.begin(np.random.default_rng(0), {"goal": np.zeros(8)})
    with pytest.raises(InputError, match="target is out of reach: joint 'turn'"):
        reach.begin(np.random.default_rng(0), {"target": np.array([9.0, *np.zeros(7)])})
    with pytest.raises(InputError, match="environment must be an ArmTask"):
        Expert("reach")
    with pytest.raises(InputError, match="no planner 'wishful'"):
        Expert(reach, planner="wishful")
    with pytest.raises(InputError, match="give a policy or a planner, got 'tracker' and 'rrt-connect'"):
        Expert(reach, policy="tracker", planner="rrt-connect")


@pytest.mark.parametrize("name", TASKS)
def test_success_needs_distance_and_angle(name):
    task = make_task(name, time_limit=0.1)
    task.position_tolerance, task.rotation_tolerance = 2e-3, 0.01
    for distance, angle, expected in (
        (2e-3, 0.01, True),
        (2.1e-3, 0.0, False),
        (0.0, 0.011, False),
        (2.1e-3, 0.011, False),
    ):
        reward, success = task.judge(distance, angle, np.zeros(8))
        assert success == expected
        assert (reward == 1.0) == expected


@pytest.mark.parametrize(
    ("joint", "change", "name"), [("extend2", 0.05, "distance"), ("extend3", 0.01, "distance"), ("turn", 0.2, "angle")]
)
def test_distances_are_in_metres_and_angles_in_radians(joint, change, name):
    """Targets that are a slide on the way, of the last link, and a turn of the whole arm away."""
    arm = Arm.load("telescopic_pr")
    task, target = make_task("reach", arm, goal="links"), arm.keyframe("home").copy()
    target[arm.joint_names.index(joint)] += change
    seen = task.begin(np.random.default_rng(0), {"target": target})
    assert task.state.info()[name] == pytest.approx(change, abs=1e-7)
    part = slice(3, 6) if name == "distance" else slice(0, 3)
    assert np.linalg.norm(seen["pose_error"][:, part], axis=1).max() == pytest.approx(change, abs=1e-7)


def test_rewards_by_hand():
    """A long tail is a tenth where the error is beyond the tolerance by the margin: 1 / (1 + 9 (error / margin)^2)."""
    task = make_task("reach", time_limit=0.1)
    reach = task.bounds["pose_error"][1][0, 3] / np.pi
    # In motion, half a limit beyond rest.
    moving = (REST + 0.5) * task.arm.velocity_limits * np.eye(8)[0]

    def tail(errors):
        return 1.0 / (1.0 + 9.0 * errors**2)

    for distance, angle, velocity, expected in (
        # Half as a straight line to the reach and pi; a quarter each with margins of 5 cm and 0.1, 5 mm and 0.01.
        (0.05, 0.0, 0.0 * moving, 0.25 * (2.0 - 0.05 / reach + 0.1 + tail(10.0))),
        (0.0, 0.1, 0.0 * moving, 0.25 * (2.0 - 0.1 / np.pi + 0.1 + tail(10.0))),
        (0.05, 0.1, 0.0 * moving, 0.25 * (2.0 - 0.05 / reach - 0.1 / np.pi + 0.01 + tail(10.0) ** 2)),
        (0.005, 0.01, 0.0 * moving, 0.25 * (2.0 - 0.005 / reach - 0.01 / np.pi + tail(0.1) ** 2 + 0.01)),
        (2.0 * reach, np.pi, 0.0 * moving, 0.0),
        (-1e-3, -1e-3, moving, 0.25 * 3.1),
    ):
        reward, _ = task.judge(1e-3 + distance, np.deg2rad(0.1) + angle, velocity)
        assert reward == pytest.approx(expected, abs=1e-6)


def test_servos_bear_the_weight_of_an_arm_that_nothing_compensates(two_hinges, tmp_path):
    """Before, such an arm, as most models of others, hung below its target, and no episode succeeded."""
    (tmp_path / "arm.xml").write_text(two_hinges)
    limits = {name: {"velocity": 2.0, "acceleration": 20.0} for name in "ab"}
    task = make_task("reach", Arm.load(tmp_path / "arm.xml", floor="none", limits=limits), time_limit=1.0)
    seen = task.begin(np.random.default_rng(0), {"target": [0.3, 0.4]})
    while not task.over:
        seen, *_ = task.step(seen["approach"])
    assert task.state.success
    assert task.state.distance < 1e-6


def test_an_arm_that_moves_closed_loops_is_refused():
    with pytest.raises(InputError, match="'telescopic_crane' moves closed loops, through which servos do not follow"):
        make_task("reach", "telescopic_crane")
