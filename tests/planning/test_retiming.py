"""The fastest run through a path: known least times, limits of three kinds, and what stays of the motion."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lieednn_sim import registry
from lieednn_sim.arm import Arm, TaskSpaceRegion
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError, LieEDNNError, PlanError, TooFastError
from lieednn_sim.planning import plan, retime
from lieednn_sim.planning.baselines.smoothing import SmoothingOptions, motion_along
from lieednn_sim.planning.motion import check_motion, least_duration, travelled
from lieednn_sim.planning.problem import PlanningProblem, in_time
from lieednn_sim.planning.time_laws import eased_law, minimum_jerk_law
from lieednn_sim.registry import DEFAULT_ARMS

toppra = pytest.importorskip("toppra")


def rates(arm, motion):
    """Largest velocity, acceleration and jerk, in units of their limits."""
    acceleration = np.diff(motion.qd, axis=0) / motion.timestep
    jerk = np.diff(acceleration, axis=0) / motion.timestep
    limits = (arm.velocity_limits, arm.acceleration_limits, arm.jerk_limits)
    return [float((np.abs(x) / limit).max()) for x, limit in zip((motion.qd, acceleration, jerk), limits, strict=True)]


def straight(gantry, **limits):
    """A motion of 1.6 m along z in 4 s, at limits of 4 m/s and 40 m/s^2, and the arm with other limits."""
    target = gantry.keyframe("home") + np.array([0.0, 0.0, 1.6, 0.0])
    motion = plan(gantry, target, planner="minimum-jerk").motion
    limits["force"] = [np.inf] * 4
    return dataclasses.replace(gantry, **{f"{name}_limits": np.array(v) for name, v in limits.items()}), motion


def test_a_straight_way_takes_the_least_time_there_is(gantry):
    arm, motion = straight(gantry)
    found = retime(arm, motion)
    # A tenth of a second up to 4 m/s and down again, and 1.2 m in between; a step of the model is 10 ms.
    assert 0.5 <= found.t[-1] <= 0.5 + 2 * arm.timestep
    assert rates(arm, found)[0] > 0.95
    # So it is when it is asked for with the plan.
    planned = plan(arm, motion.q[-1], planner="minimum-jerk", fastest=True).motion
    for name in ("t", "q", "qd", "xi"):
        np.testing.assert_array_equal(getattr(planned, name), getattr(found, name))


@pytest.mark.parametrize("moved", [[0, 3], [3, 7], [6, 7]])
def test_no_limit_of_velocity_is_needed_also_where_joints_hardly_move(moved):
    """A network's joints at rest move by rounding, for which the solver found no law without limits."""
    arm = Arm.load("telescopic_pr")
    target = arm.keyframe("home")
    target[moved] = arm.keyframe("extended")[moved]
    motion = plan(arm, target, planner="lieednn-shaped").motion
    found = retime(dataclasses.replace(arm, velocity_limits=np.full(8, np.inf)), motion)
    # Half of the straight way at full acceleration, and half of it braking.
    least = 2.0 * np.sqrt((np.ptp(motion.q, axis=0) / arm.acceleration_limits).max())
    assert least <= found.t[-1] <= 1.01 * least + arm.timestep


def test_what_belongs_to_the_way_stays_with_it(gantry):
    """Gaps that grow with the way, and rates that are the positions' derivatives."""
    arm, motion = straight(gantry)
    share = motion.q[:, [2]] / 1.6 * np.ones(2)
    found = retime(arm, dataclasses.replace(motion, gap_translation=0.01 * share, gap_rotation=0.3 * share))
    share = found.q[:, [2]] / 1.6 * np.ones(2)
    np.testing.assert_allclose(found.gap_translation, 0.01 * share, atol=1e-5)
    np.testing.assert_allclose(found.gap_rotation, 0.3 * share, atol=3e-4)
    # The rule of trapezoids is exact where the acceleration is constant.
    assert np.trapezoid(found.qd[:, 2], found.t) == pytest.approx(1.6, rel=1e-3)


@pytest.mark.parametrize(("jerk", "more"), [(2000.0, 1.02), (400.0, 1.02), (80.0, 1.1)])
def test_a_limit_of_jerk_costs_little_more_than_it_must(gantry, jerk, more):
    arm, motion = straight(gantry, jerk=[jerk] * 4)
    found = retime(arm, motion)
    least = least_duration(arm, motion.q[0], motion.q[-1])
    assert least <= found.t[-1] <= more * least + 2 * arm.timestep
    assert max(rates(arm, found)) <= 1.0 + 1e-6


def test_a_network_keeps_its_path_and_every_limit():
    for name in DEFAULT_ARMS:
        arm = Arm.load(name)
        arm = dataclasses.replace(arm, jerk_limits=30.0 * arm.acceleration_limits)
        asked = plan(arm, draw_target(arm, seed=11), planner="lieednn-certified", seed=11)
        slow, fast = asked.motion, retime(arm, asked.motion)
        # On telescopic_pr it was 0.75 of the limit, at nine tenths of the way, before sharp turns were eased.
        assert name != "telescopic_pr" or (slow.t[-1] == 4.0 and rates(arm, slow)[1] < 0.6)
        check_motion(arm, fast)
        assert fast.t[-1] < 0.9 * slow.t[-1], name
        # As fast as it goes: something is at its limit.
        assert max(rates(arm, fast)) > 0.8
        # The same configurations in the same order, with the states that made them.
        assert np.all(np.diff(fast.tau) >= 0.0)
        steps = np.linalg.norm(np.diff(slow.q, axis=0), axis=1).max()
        assert cKDTree(slow.q).query(fast.q)[0].max() <= steps
        np.testing.assert_allclose(arm.decode(fast.xi, start=fast.q[0]).q, fast.q, atol=2e-5)
        for end in (0, -1):
            np.testing.assert_array_equal(fast.q[end], slow.q[end])
            np.testing.assert_array_equal(fast.xi[end], slow.xi[end])
        assert not fast.qd[[0, -1]].any()


def test_a_motion_that_takes_the_least_time_there_is_keeps_its_law(gantry):
    """Jerk of 80 m/s^3 for 0.2 s, -80 for 0.4 s, 80 for 0.2 s: 2 j t^3 = 1.28 m at no more than 3.2 m/s, 16 m/s^2."""
    arm, longer = straight(gantry, jerk=[80.0] * 4)
    t, k = 0.01 * np.arange(81), np.linspace(0, len(longer.t) - 1, 81).round().astype(int)
    parts = np.array([np.maximum(t - begin, 0.0) for begin in (0.0, 0.2, 0.6)])
    signs = 80.0 * np.array([1.0, -2.0, 2.0])
    q, qd = np.zeros((2, 81, 4))
    q[:, 2], qd[:, 2] = signs @ parts**3 / 6.0, signs @ parts**2 / 2.0
    assert q[-1, 2] == pytest.approx(1.28)
    assert qd[-1, 2] == pytest.approx(0.0, abs=1e-12)
    gaps = {name: getattr(longer, name)[k] for name in ("gap_translation", "gap_rotation")}
    best = dataclasses.replace(longer, t=t, tau=t, xi=arm.encode(q), q=q, qd=np.vstack([qd[:-1], np.zeros(4)]), **gaps)
    assert retime(arm, best).t[-1] <= 0.8 + arm.timestep + 1e-9


def test_what_has_no_fastest_motion_is_refused(gantry, monkeypatch):
    arm, motion = straight(gantry, acceleration=[10.0, 20.0, np.inf, 80.0])
    with pytest.raises(InputError, match=r"joint 'z' has no limit of acceleration, .*name one: Arm.load"):
        retime(arm, motion)
    # What does not move needs none.
    assert retime(straight(gantry, acceleration=[np.inf, 20.0, 40.0, 80.0])[0], motion).t[-1] < 0.6
    monkeypatch.setattr(
        registry.importlib, "import_module", lambda name: (_ for _ in ()).throw(ModuleNotFoundError(name))
    )
    with pytest.raises(LieEDNNError, match=r"toppra is not installed \(.*\): pip install 'lieednn_sim\[timing\]'"):
        retime(gantry, motion)


@pytest.mark.parametrize("planner", ["lieednn-certified", "lieednn-shaped", "minimum-jerk"])
@pytest.mark.parametrize("beside", [0.0, 1e-9])
def test_a_goal_that_is_reached_already_is_a_rest_as_without_retiming(gantry, planner, beside):
    home = gantry.keyframe("home")
    box = TaskSpaceRegion.box(*(gantry.tip(home) + side for side in (-0.05, 0.05)))
    for goal in (home + beside, gantry.link_poses(home)[-1], box, [home + beside, home + 0.5]):
        found, plain = (plan(gantry, goal, duration=1.0, planner=planner, fastest=how).motion for how in (True, False))
        np.testing.assert_array_equal(found.q, plain.q)
        assert found.t[-1] == 1.0
        assert np.ptp(found.q, axis=0).max() < 1e-8


def turning(gantry, radius):
    """A motion along x, then y, around a corner of a radius [m], by minimum jerk of its length."""
    edge = 0.8 - radius
    length = 2 * edge + 0.5 * np.pi * radius
    motion = plan(gantry, gantry.keyframe("home") + np.array([0.5, 0.5, 0.0, 0.0]), planner="minimum-jerk").motion
    share, slope = minimum_jerk_law(motion.t / motion.t[-1])
    s = length * share
    angle = np.clip((s - edge) / radius, 0.0, 0.5 * np.pi)
    x = np.minimum(s, edge) + radius * np.sin(angle)
    y = radius * (1.0 - np.cos(angle)) + np.maximum(s - length + edge, 0.0)
    q, qd = np.zeros_like(motion.q), np.zeros_like(motion.qd)
    q[:, 0], q[:, 1] = x, y
    qd[:, 0], qd[:, 1] = np.cos(angle) * length * slope / motion.t[-1], np.sin(angle) * length * slope / motion.t[-1]
    return dataclasses.replace(motion, q=q, qd=qd), length


def test_sharp_turns_are_taken_slowly(gantry):
    """In the middle minimum jerk is at 1.875 L / T: across a turn of radius R that is 3.5 L^2 / (R T^2)."""
    sharp, length = turning(gantry, 0.05)
    law = eased_law(sharp, np.ones(4))
    s = np.linspace(0.0, 1.0, 401)
    share, slope = law(s)
    assert (share[0], share[-1]) == pytest.approx((0.0, 1.0))
    assert np.all(np.diff(share) >= 0.0)
    np.testing.assert_allclose(np.gradient(share, s)[5:-5], slope[5:-5], atol=0.05)
    # The bound is 10 L / T^2; the time that it costs makes the rest, and the turn, a little faster.
    before, after = 1.875**2 * length / 0.05, np.interp(0.5, share, slope) ** 2 * length / 0.05
    assert before > 100.0
    assert after < 25.0
    assert slope.max() < 1.5 * 1.875


def test_a_turn_is_sharp_from_ten_lengths_over_the_squared_duration_on(gantry):
    """R = 0.535 m makes 9.0 L / T^2, and R = 0.45 m makes 11.0, also in units of 2 m along x and 0.5 m along y."""
    for radius, bound in ((0.535, 9.0), (0.45, 11.0)):
        motion, length = turning(gantry, radius)
        assert 1.875**2 * length / radius == pytest.approx(bound, rel=2e-3)
        for units in (np.ones(4), np.array([2.0, 0.5, 1.0, 1.0])):
            stretched = dataclasses.replace(motion, q=motion.q * units, qd=motion.qd * units)
            law = eased_law(stretched, units)
            assert (law is None) == (bound < 10.0)
    with_units, without = (eased_law(one, u) for one, u in ((stretched, units), (motion, np.ones(4))))
    np.testing.assert_allclose(with_units(motion.t / 4.0), without(motion.t / 4.0), atol=1e-12)


@pytest.mark.parametrize("radius", [0.004, 0.02, 0.4])
def test_a_turn_of_any_radius_is_taken_in_the_least_time(gantry, radius):
    """As by TOPP-RA on two thousand pieces of equal length, of which some eight are in the sharpest turn."""
    motion, _ = turning(gantry, radius)
    gantry = dataclasses.replace(gantry, force_limits=np.full(4, np.inf))
    path = toppra.SplineInterpolator(travelled(motion.q), motion.q)
    velocity, acceleration = (x[:, None] * [-1.0, 1.0] for x in (gantry.velocity_limits, gantry.acceleration_limits))
    constraints = [
        toppra.constraint.JointVelocityConstraint(velocity),
        toppra.constraint.JointAccelerationConstraint(acceleration),
    ]
    grid = np.linspace(0.0, path.duration, 2001)
    _, rate, _ = toppra.algorithm.TOPPRA(constraints, path, grid, "seidel").compute_parameterization(0.0, 0.0)
    least = float(np.sum(2.0 * np.diff(grid) / (rate[1:] + rate[:-1])))
    found = retime(gantry, motion)
    assert least <= found.t[-1] + gantry.timestep <= 1.03 * least + 2.0 * gantry.timestep


def test_a_straight_way_has_no_turns_however_sharply_it_accelerates(gantry):
    _, motion = straight(gantry)
    s = np.clip((motion.t / motion.t[-1] - 0.45) / 0.1, 0.0, 1.0)
    share, slope = minimum_jerk_law(s)
    q, qd = 1.6 * share[:, None] * np.array([0.6, 0.0, 0.8, 0.0]), np.zeros_like(motion.qd)
    qd[:] = 1.6 * slope[:, None] / (0.1 * motion.t[-1]) * np.array([0.6, 0.0, 0.8, 0.0])
    # Along the way, 580 times its length over the squared duration.
    assert eased_law(dataclasses.replace(motion, q=q, qd=qd), np.ones(4)) is None


def test_a_sharp_corner_does_not_slow_down_the_whole_motion(gantry):
    gantry = dataclasses.replace(gantry, force_limits=np.full(4, np.inf))
    start = gantry.keyframe("home")
    corner = start + np.array([0.0, 0.0, 0.8, 0.0])
    problem = PlanningProblem(gantry, start, corner + np.array([0.0, 0.3, 0.0, 0.0]), duration=0.1, longest=10.0)
    corners = np.array([start, corner, problem.target])
    slow, fast = (
        in_time(motion_along, problem, corners, SmoothingOptions(control_points=(224,), fastest=fastest), {})
        for fastest in (False, True)
    )
    assert fast.t[-1] < 0.8 * slow.t[-1]
    check_motion(gantry, fast)
    # On one leg or on the other, but at the corner, by as much as two control points are apart.
    assert np.abs(fast.q - corner)[:, 1:3].min(axis=1).max() < 1e-2
    np.testing.assert_array_equal(fast.q[[0, -1]], corners[[0, -1]])
    # Where curves touch something, the polyline is followed as fast as it goes, with a stop at the corner.
    slow, fast = (
        in_time(motion_along, problem, corners, SmoothingOptions((224,), fastest=fastest), {224: PlanError("touches")})
        for fastest in (False, True)
    )
    least = least_duration(gantry, *corners[:2]) + least_duration(gantry, *corners[1:])
    assert least <= fast.t[-1] <= 1.03 * least < 0.85 * slow.t[-1]
    still = dataclasses.replace(problem, target=start)
    assert not motion_along(still, np.array([start] * 2), SmoothingOptions(fastest=True), {}).qd.any()


def test_a_duration_that_was_stretched_leaves_so_much_less_to_stretch():
    """The longest duration that planners may take is that of the problem, however often it is stretched."""
    arm = Arm.load("telescopic_pr")
    problem = PlanningProblem(arm, arm.keyframe("extended"), arm.keyframe("home"), duration=2.0, longest=6.0)
    tried = []

    def make(problem):
        tried.append((problem.duration, problem.longest))
        raise TooFastError("too fast", 1.3 * problem.duration)

    with pytest.raises(TooFastError):
        in_time(make, problem)
    assert len(tried) > 2
    np.testing.assert_allclose([latest for _, latest in tried], 6.0)
    assert max(duration for duration, _ in tried) <= 6.0


@pytest.mark.parametrize("planner", ["minimum-jerk", "lieednn-shaped"])
def test_steps_of_any_length_are_timed_at_the_limits(planner):
    """In a straight line, where acceleration decides: 2 sqrt(d / a) is the least time of all."""
    arm = Arm.load("telescopic_pr")
    home, signs = arm.keyframe("home"), np.array([1.0, -1.0] * 4)
    for length in (1e-7, 1e-5, 1e-4, 1e-2, 0.1):
        target = np.clip(home + length * signs, *arm.position_limits.T)
        least = 2.0 * np.sqrt(np.abs(target - home) / arm.acceleration_limits).max()
        duration = plan(arm, target, planner=planner, fastest=True).motion.t[-1]
        assert least <= duration <= max(1.5 * least, 2.5 * arm.timestep)
