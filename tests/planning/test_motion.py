"""From network to joint trajectory: rest at both ends, consistent derivatives, limits."""

import dataclasses
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.serial_arm import SerialArm
from lieednn_sim.budget import reporting
from lieednn_sim.errors import FileError, InputError, PlanError, TooFastError
from lieednn_sim.lie import exp
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import CertifiedOptions, certified, network_path, plan
from lieednn_sim.planning.motion import Motion, check_limits, check_motion, count_steps, interpolation
from lieednn_sim.planning.network_path import RESIDUAL, NetworkPath, _invert
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.synthesis import synthesize, synthesize_many

from .arms import coarse


def make_motion(arm, network, start, duration, timestep):
    return NetworkPath.integrate(arm, network, start).timed(duration, timestep)


@pytest.fixture(scope="module")
def arm():
    return Arm.load("telescopic_pr")


@pytest.fixture(scope="module")
def network(arm):
    return synthesize(arm.encode(arm.keyframe("extended")), bias="sign-matched", bias_magnitude=0.25).unwrap()


@pytest.fixture(scope="module")
def motion(arm, network):
    return make_motion(arm, network, arm.keyframe("home"), 4.0, 0.002)


def test_large_targets_are_reached_though_the_integrator_errs_by_a_share_of_them():
    """At this target of six hinges the error of the default tolerances is above the residual to be reached."""
    axes = ("0 0 1", "0 1 0") * 3
    bodies = "".join(f'<body pos="0 0 .3"><joint axis="{axis}" range="-175 175"/><geom size=".01"/>' for axis in axes)
    arm = Arm.from_spec(mujoco.MjSpec.from_string(f"<mujoco><worldbody>{bodies}{'</body>' * 6}</worldbody></mujoco>"))
    hinges = arm
    target = np.random.default_rng(11).uniform(*(0.95 * np.deg2rad([-175.0, 175.0])), 6)
    linear = LieEDNN(
        alpha=np.zeros((6, 6)),
        rotation=np.broadcast_to(np.eye(3), (6, 6, 3, 3)),
        translation=np.zeros((6, 6, 3)),
        bias=hinges.encode(target),
    )
    end = make_motion(hinges, linear, np.zeros(6), 4.0, 0.01)
    assert end.residual <= 2 * RESIDUAL


@pytest.mark.parametrize("hidden", [False, True])
def test_the_pace_is_a_minimum_jerk_law_of_the_length(arm, network, motion, cascade, hidden):
    """|(q'/limits, p |xi - xi_d| tau')| = L sigma'(t/T) / T, p the slowest rate at the end: one L at all times."""
    if hidden:
        network = cascade(arm.encode(arm.keyframe("extended")), 0.02)
        motion = make_motion(arm, network, arm.keyframe("home"), 4.0, 0.002)
    equilibrium = network.equilibrium(network.start(motion.xi[0]))
    pace = max(-equilibrium.spectral_abscissa, 1e-3 * network.gamma)
    tau_rate = np.gradient(motion.tau, motion.t, edge_order=2)
    to_go = pace * np.linalg.norm(motion.xi - motion.xi_target, axis=(-2, -1)) * tau_rate
    speed = np.hypot(np.linalg.norm(motion.qd / arm.velocity_limits, axis=-1), to_go)
    s = motion.t / 4.0
    length = speed[200:-200] / (30.0 * s**2 * (1.0 - s) ** 2 / 4.0)[200:-200]
    np.testing.assert_allclose(length, np.median(length), rtol=2e-3)


def test_a_motion_shows_the_visible_neurons_and_hidden_ones_shape_it(gantry, cascade):
    home, goal = np.zeros(4), np.array([0.4, -0.5, 0.6, 1.0])
    network = cascade(gantry.encode(goal))
    motion = make_motion(gantry, network, home, 2.0, 0.01)
    np.testing.assert_allclose(motion.xi_target, gantry.encode(goal), atol=1e-9)
    np.testing.assert_allclose(motion.q[[0, -1]], [home, goal], atol=1e-7)
    assert motion.residual <= 2 * RESIDUAL
    start = network.start(gantry.encode(home))
    states = network.trajectory(start, motion.tau[-1], method="DOP853", rtol=1e-10, atol=1e-12)(motion.tau)
    np.testing.assert_allclose(motion.xi, states[:, :2], atol=1e-6)
    decoded = gantry.decode(states[:, :2])
    np.testing.assert_allclose(motion.gap_translation, decoded.gap_translation, atol=1e-6)
    numeric = np.gradient(motion.q, motion.t, axis=0, edge_order=2)
    np.testing.assert_allclose(motion.qd[2:-2], numeric[2:-2], atol=0.01 * np.abs(motion.qd).max())
    # With the hidden neurons at rest from the beginning the way is the straight one.
    still = dataclasses.replace(network, hidden_start=network.goal(start[:2])[2:])
    straight = make_motion(gantry, still, home, 2.0, 0.01)
    share = straight.xi[:, 0, 3] / straight.xi_target[0, 3]
    np.testing.assert_allclose(straight.xi, share[:, None, None] * straight.xi_target, atol=1e-6)
    assert np.abs(motion.xi - straight.xi).max() > 0.1
    # Where only the hidden neurons are not yet at rest, the arm leaves and comes back.
    away = make_motion(gantry, network, goal, 2.0, 0.01)
    np.testing.assert_allclose(away.q[[0, -1]], [goal, goal], atol=1e-7)
    assert np.abs(away.q - goal).max() > 0.05


def test_the_law_by_hand():
    np.testing.assert_array_equal(minimum_jerk_law(np.array([0.0, 0.5, 1.0])), [[0.0, 0.5, 1.0], [0.0, 1.875, 0.0]])
    np.testing.assert_allclose(minimum_jerk_law(np.array([0.25])), [[106.0 / 1024.0], [270.0 / 256.0]], rtol=1e-15)


def test_lengths_are_inverted_to_rounding():
    """Also where the speed changes by orders of magnitude within one piece."""
    grid = np.array([0.0, 0.5, 1.5, 4.0, 9.0, 10.0])
    speed = PchipInterpolator(grid, [3.0, 1e-4, 2.0, 1e-6, 1.0, 1e-9])
    length = speed.antiderivative()
    wanted = length(grid[-1]) * np.sort(np.append(np.random.default_rng(0).uniform(size=60), [0.0, 1.0]))
    tau = _invert(length, speed, grid, wanted)
    np.testing.assert_allclose(length(tau), wanted, atol=1e-13)
    assert (tau[0], tau[-1]) == (0.0, 10.0)


def test_a_duration_is_a_whole_number_of_steps_and_two_at_least():
    assert [count_steps(duration, 0.002) for duration in (0.003, 0.004, 0.0049, 0.0051, 1.0)] == [2, 2, 2, 3, 500]
    assert count_steps(200.0, 0.002) == 100_000
    for duration in (0.0029, 200.003):
        with pytest.raises(InputError, match="duration must be 2 to 100000 time steps"):
            count_steps(duration, 0.002)


def test_gap_is_the_distance_between_decoded_and_feasible_poses(arm, motion):
    difference = arm.joint_poses(motion.q).inv() * exp(motion.xi)
    np.testing.assert_allclose(motion.gap_translation, np.linalg.norm(difference.translation, axis=-1), atol=1e-6)
    np.testing.assert_allclose(motion.gap_rotation, difference.rotation.magnitude(), atol=1e-6)
    assert motion.gap_translation.max() > 1e-3, "a mechanism with two dof cannot follow se(3) exactly on the way"
    assert motion.gap_translation[-1].max() < 10 * RESIDUAL


def test_a_motion_to_where_the_arm_is_stays_there(arm):
    home = arm.keyframe("home")
    still = make_motion(arm, synthesize(arm.encode(home), bias="sign-matched").unwrap(), home, 1.0, 0.002)
    np.testing.assert_allclose(still.q, np.broadcast_to(home, still.q.shape), atol=1e-9)
    np.testing.assert_array_equal(still.qd, 0.0)


def test_bad_input(arm, network):
    home = arm.keyframe("home")
    for duration in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="duration"):
            make_motion(arm, network, home, duration, 0.002)
    with pytest.raises(InputError, match=r"start must have shape \(8,\)"):
        make_motion(arm, network, home[:3], 1.0, 0.002)
    small = synthesize(np.full((2, 6), 0.3), bias="sign-matched").unwrap()
    with pytest.raises(InputError, match=r"2 visible neurons.*4 links"):
        make_motion(arm, small, home, 1.0, 0.002)


def test_a_motion_has_one_time_step(motion):
    t = np.append(motion.t[:-1], motion.t[-1] + 0.1)
    with pytest.raises(InputError, match=r"t must rise by one time step, but rises by 0\.002 to 0\.102 s"):
        dataclasses.replace(motion, t=t)


def test_a_network_that_does_not_arrive_is_refused(arm, network, monkeypatch):
    n = arm.n_links
    rotation = np.broadcast_to(np.eye(3), (n, n, 3, 3))
    rising = LieEDNN(alpha=4.0 * np.eye(n), rotation=rotation, translation=np.zeros((n, n, 3)), bias=np.zeros((n, 6)))
    with pytest.raises(PlanError, match=r"does not arrive|cannot be used"):
        make_motion(arm, rising, arm.keyframe("home"), 1.0, 0.002)
    # Nothing comes as close as this in the time there is.
    monkeypatch.setattr(network_path, "RESIDUAL", 1e-30)
    with pytest.raises(PlanError, match=r"does not arrive at its equilibrium from this start, or too slowly"):
        make_motion(arm, network, arm.keyframe("home"), 1.0, 0.002)


def test_save_and_load(motion, tmp_path):
    motion.save(tmp_path / "motion.npz")
    loaded = Motion.load(tmp_path / "motion.npz")
    for name, value in vars(motion).items():
        np.testing.assert_array_equal(getattr(loaded, name), value)
    (tmp_path / "motion.npz").write_bytes(b"PK not a zip")
    with pytest.raises(FileError, match="not a readable motion file"):
        Motion.load(tmp_path / "motion.npz")


def test_where_no_candidate_is_certified_the_last_one_is_looked_for_with_patience(arm, monkeypatch):
    asked = []

    def none_found(*args, **options):
        return [dataclasses.replace(one, network=None) for one in synthesize_many(*args, **options)]

    def patient(*args, **options):
        asked.append(options)
        return synthesize(*args, **options)

    monkeypatch.setattr(certified, "synthesize_many", none_found)
    monkeypatch.setattr(certified, "synthesize", patient)
    made = plan(arm, arm.keyframe("extended"), options=CertifiedOptions(n_networks=3, n_first=3, last_attempts=7))
    assert made.details.n_networks == 3
    assert [(options["bias_magnitude"], options["max_attempts"]) for options in asked] == [(0.25, 7)]


def test_candidates_are_made_a_few_at_a_time_so_that_progress_is_told(arm, monkeypatch):
    parts, told = [], []
    made = certified.synthesize_many
    monkeypatch.setattr(certified, "_BATCH_SIZE", 2)
    monkeypatch.setattr(certified, "synthesize_many", lambda xi, **more: parts.append(len(xi)) or made(xi, **more))
    goal, options = arm.keyframe("extended"), CertifiedOptions(n_networks=4, n_first=4)
    with reporting(lambda done, total: told.append((done, total, len(parts)))):
        split = plan(arm, goal, options=options)
    assert parts == [2, 2]
    assert told == [(1, 4, 1), (2, 4, 1), (3, 4, 2), (4, 4, 2)]
    monkeypatch.undo()
    np.testing.assert_array_equal(plan(arm, goal, options=options).motion.q, split.motion.q)


@pytest.mark.parametrize("jump", [0.01, 0.03])
def test_a_network_is_refused_where_the_nearest_configuration_jumps(jump, arm, network, monkeypatch):
    decode = SerialArm.decode

    def jumping(self, xi, *more):
        found = decode(self, xi, *more)
        moved = np.zeros_like(found.q)
        moved[len(moved) // 2 :, 4] = jump
        return dataclasses.replace(found, q=found.q + moved)

    monkeypatch.setattr(SerialArm, "decode", jumping)
    with nullcontext() if jump < 0.02 else pytest.raises(PlanError, match="path jump; use another"):
        make_motion(arm, network, arm.keyframe("home"), 1.0, 0.002)


def test_position_limits_hold_to_a_micron(arm, motion):
    for index, side, sign in ((3, 1, 1.0), (4, 0, -1.0)):
        limit = arm.position_limits[index, side]
        words = rf"at t = 1\.40 s joint '{arm.joint_names[index]}' would be at .*, its range is \["
        for beyond, expected in ((9e-7, nullcontext()), (2e-6, pytest.raises(PlanError, match=words))):
            q = np.tile(motion.q[700], (len(motion.t), 1))
            q[:, index] = limit
            q[700:, index] += sign * beyond
            with expected:
                check_motion(arm, dataclasses.replace(motion, q=q, qd=0.0 * q))


def test_limits_hold_between_samples(arm, motion):
    """Over no way, a cubic goes h v / 4 beyond its ends with rates v and -v there, and h v / sqrt(108) with v twice;
    over a way d from rest to rest its rate is 1.5 d / h."""
    still = dataclasses.replace(motion, q=np.tile(motion.q[700], (len(motion.t), 1)), qd=0.0 * motion.qd)
    q, qd, fastest = still.q.copy(), still.qd.copy(), arm.velocity_limits[4]
    q[:, 4], qd[700:702, 4] = arm.position_limits[4, 1], (0.3, -0.3)
    arm = dataclasses.replace(arm, acceleration_limits=np.inf * arm.acceleration_limits)
    for beyond, expected in ((0.9e-6, nullcontext()), (1.1e-6, pytest.raises(PlanError, match=r"t = 1\.40 s joint"))):
        q[700:702, 4] = arm.position_limits[4, 1] - 0.25 * 0.3 * motion.timestep + beyond
        with expected:
            check_limits(arm, motion.t, q, qd)
    for beyond, expected in ((0.9e-6, nullcontext()), (1.1e-6, pytest.raises(PlanError, match="joint 'yaw' would be"))):
        q[:, 4], qd[:, 4] = arm.position_limits[4, 1] - 0.3 * motion.timestep / np.sqrt(108.0) + beyond, 0.3
        with expected:
            check_limits(arm, motion.t, q, qd)
    q, qd = still.q.copy(), np.zeros_like(qd)
    for share, expected in ((0.999, nullcontext()), (1.001, pytest.raises(TooFastError, match="would move at"))):
        q[701:, 4] = q[0, 4] - share * fastest * motion.timestep / 1.5
        with expected as error:
            check_limits(arm, motion.t, q, qd)
    assert error.value.duration == pytest.approx(4.004)


def test_the_angle_of_a_ball_joint_holds_between_samples():
    """It rises and falls within a step, while no coordinate of the joint turns: two of them go on, across the angle."""
    ball = '<mujoco><worldbody><body><joint name="b" type="ball" range="0 57.29577951308232"/><geom size=".1"/></body>'
    model = mujoco.MjModel.from_xml_string(ball + "</worldbody></mujoco>")
    arm = Arm.of(model, mujoco.MjData(model), ["b"], limits={f"b_{k}": {"acceleration": 1e4} for k in "xyz"})
    out, across = np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]) / np.sqrt(2.0)
    t, way = 0.002 * np.arange(3), np.array([-1.0, 0.0, 1.0])[:, None]
    refused = pytest.raises(PlanError, match=r"joint 'b' would be at 1\.000003 rad")
    for beyond, expected in ((-1e-6, nullcontext()), (3e-6, refused)):
        q = (1.0 - 0.25 * 0.3 * 0.002 + beyond) * out + 0.002 * (way + 0.5) * across
        q[2] -= 0.002 * out
        with expected:
            check_limits(arm, t, q, across + np.array([0.3, -0.3, -0.3])[:, None] * out)


def test_a_posture_that_jumps_between_two_samples_is_refused(arm, motion):
    """A jump is seen by its size alone: limits, clearance and the velocities at both samples know nothing of it."""
    step = 2.0 * motion.timestep * np.abs(motion.qd[999:1001, 4]).max()
    words = rf"joint '{arm.joint_names[4]}' would jump by {step + 0.021:.3g} rad at t = 2\.00 s, where the nearest"
    refused, at_any_speed = pytest.raises(PlanError, match=words), 0.0 * arm.velocity_limits + np.inf
    for jump, expected in ((step + 0.019, nullcontext()), (step + 0.021, refused)):
        q = motion.q.copy()
        q[1000:, 4] += q[999, 4] - q[1000, 4] - jump
        with expected:
            check_motion(dataclasses.replace(arm, velocity_limits=at_any_speed), dataclasses.replace(motion, q=q))
    # At most what the velocity limit of 2 rad/s explains in a step of 2 ms; less is too fast.
    for jump, expected in ((step + 0.0041, PlanError), (step + 0.0039, TooFastError)):
        q[1000:, 4] = q[999, 4] - jump + motion.q[1000:, 4] - motion.q[1000, 4]
        with pytest.raises(PlanError) as error:
            check_motion(arm, dataclasses.replace(motion, q=q))
        assert type(error.value) is expected


@pytest.mark.parametrize(("what", "power"), [("move", 1.0), ("accelerate", 0.5), ("jerk", 1 / 3)])
def test_limits_of_velocity_acceleration_and_jerk_are_those_of_the_arm(arm, motion, what, power):
    """Just below a limit is accepted; just above, the duration that is asked for scales by the law of the quantity."""
    arm = dataclasses.replace(arm, jerk_limits=7.0 * arm.acceleration_limits if what == "jerk" else arm.jerk_limits)
    still = dataclasses.replace(motion, q=np.tile(motion.q[0], (len(motion.t), 1)))
    refused = pytest.raises(TooFastError, match=f"joint '{arm.joint_names[4]}' would {what} at")
    for factor, expected in ((0.99, nullcontext()), (1.01, refused)):
        qd = np.zeros_like(motion.qd)
        if what == "move":
            # Up and down in half of the motion each, as slowly as possible.
            qd[:, 4] = np.interp(motion.t, [0.0, 2.0, 4.0], [0.0, -factor * arm.velocity_limits[4], 0.0])
        elif what == "jerk":
            # From 2 s on the acceleration rises for a tenth of a second, to 0.7 of its limit, and falls again.
            rise = motion.timestep * np.minimum(np.arange(101), np.arange(100, -1, -1))
            qd[1000:1101, 4] = motion.timestep * np.cumsum(factor * arm.jerk_limits[4] * rise)
            qd[1101:, 4] = qd[1100, 4]
        else:
            qd[1000:, 4] = factor * arm.acceleration_limits[4] * motion.timestep
        with expected as error:
            check_motion(arm, dataclasses.replace(still, qd=qd))
    assert error.value.duration == pytest.approx(4.0 * 1.01**power)


def _gap(arm, motion):
    return (motion.gap_translation.max(axis=1) + arm.length_scale * motion.gap_rotation.max(axis=1)).max()


def _length(arm, motion):
    return np.linalg.norm(np.diff(motion.q, axis=0) / arm.velocity_limits, axis=1).sum()


def test_candidates_are_screened_by_hand(gantry, monkeypatch):
    """One way through y = 2.25, where y ends at 2; one that turns link 1 by 0.1 rad about x, which no joint does."""
    arm = dataclasses.replace(gantry, length_scale=2.0)
    ways = arm.encode(np.zeros((3, 2, 4)))
    ways[1, 0] = arm.encode([0.0, 2.25, 0.0, 0.0])
    ways[1, 1, 0, 0] = 0.1
    monkeypatch.setattr(certified, "_side_by_side", lambda networks, start: ways)
    one, other = certified._screened(arm, [SimpleNamespace()] * 2, np.zeros(4))
    np.testing.assert_allclose(one.q, [[0.0] * 4, [0.0, 2.25, 0.0, 0.0], [0.0] * 4], atol=1e-9)
    np.testing.assert_allclose(other.q, np.zeros((3, 4)), atol=1e-9)
    assert (one.excess, one.gap) == pytest.approx((0.25, 0.0), abs=1e-9)
    assert other.gap == pytest.approx(0.1 * 2.0)
    assert other.excess <= 0.0
    # There and back along y, of which 2 m are a second's way at most.
    assert (one.rank[2], other.rank[2]) == pytest.approx((2.25, 0.0), abs=1e-8)
    # To keep the limits counts more than to have no gap.
    assert other.rank < one.rank


def test_networks_side_by_side_go_as_each_does_alone():
    rng = np.random.default_rng(3)
    targets = rng.uniform(-0.8, 0.8, (4, 3, 6))
    networks = [synthesize(xi, bias="sign-matched").unwrap() for xi in targets]
    start = rng.uniform(-0.5, 0.5, (3, 6))
    states = certified._side_by_side(networks, start)
    np.testing.assert_array_equal(states[0], np.tile(start, (4, 1, 1)))
    for k, network in enumerate(networks):
        exact = network.trajectory(start, 20.0)(np.linspace(0.0, 20.0, 4001))
        assert np.abs(states[:, k, None] - exact).max(axis=(2, 3)).min(axis=1).max() < 5e-3
        np.testing.assert_allclose(states[-1, k], exact[-1], atol=1e-3)


def test_candidates_that_touch_something_come_last_and_the_best_first():
    made = [SimpleNamespace(rank=(rank,), touches=touches) for rank, touches in enumerate([1, 0, 1, 0, 1])]
    order = [candidate.rank[0] for candidate in certified._promising([made[k] for k in (3, 2, 4, 0, 1)])]
    assert order == [1, 3, 0, 2, 4]


@pytest.mark.parametrize(("name", "quality"), [("telescopic_pr", _gap), ("telescopic_compound", _length)])
def test_the_plan_is_the_candidate_with_the_smallest_gap_or_the_shortest_without_one(name, quality, monkeypatch):
    """Every candidate run in full: none that would do has a smaller gap, or shorter way, than the one taken."""
    drawn = []

    def record(*args, **options):
        results = synthesize_many(*args, **options)
        drawn.extend(result.network for result in results)
        return results

    monkeypatch.setattr(certified, "synthesize_many", record)
    arm = coarse(name, timestep=0.02)
    home, goal = arm.keyframe("home"), arm.keyframe("extended")
    chosen = plan(arm, goal, options=CertifiedOptions(n_networks=6, n_first=6), seed=2)
    found = {}
    for network in drawn:
        motion = make_motion(arm, network, home, 4.0, 0.02)
        try:
            check_motion(arm, motion)
        except PlanError:
            continue
        found[id(network)] = quality(arm, motion)
    assert len(drawn) == chosen.details.n_networks == 6
    assert chosen.details.within_limits >= len(found) > 2
    # Candidates are ranked on rough ways, which are good to a few percent.
    best, worst = min(found.values()), max(found.values())
    assert found[id(chosen.network)] <= 1.05 * best < (0.5 if quality is _gap else 0.95) * worst


@pytest.mark.parametrize("count", [3, 251, 2001, 1997])
def test_samples_between_known_ones_are_on_polynomials_of_degree_five(count):
    known, all_of = interpolation(count, 250)
    assert (known[0], known[-1]) == (0, count - 1)
    s = np.arange(count) / (count - 1)
    values = np.stack([s ** min(5, len(known) - 1), np.sin(9.0 * s)], axis=1)
    made = all_of @ values[known]
    np.testing.assert_array_equal(made[known], values[known])
    np.testing.assert_allclose(made[:, 0], values[:, 0], atol=1e-14)
    if count > 3:
        np.testing.assert_allclose(made[:, 1], values[:, 1], atol=2e-10)
