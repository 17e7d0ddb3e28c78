"""The filter: limits kept whatever is wanted, clearance kept on the way, arrival, and what is said when it blocks."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.filtering import FilterOptions, SafetyFilter, limits_proved, run_filtered
from lieednn_sim.motion import check_motion
from lieednn_sim.planners import PlanningProblem
from lieednn_sim.planners import filtered as planner
from lieednn_sim.planners.waypoints import find_waypoints
from lieednn_sim.synthesis import synthesize

FREE = Arm.load("telescopic_pr")
POLES = Arm.load("telescopic_pr", "poles", 0)
SPATIAL = Arm.load("telescopic_compound")
SEEDS = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("arm", [POLES, SPATIAL], ids=lambda arm: arm.name)
@given(seed=SEEDS)
@settings(max_examples=4)
def test_no_wanted_velocity_breaks_a_limit_or_touches(arm, seed):
    """Adversarial: full speed in a random direction, changed every 0.3 s; what is wanted never settles."""
    rng = np.random.default_rng(seed)
    filter_ = SafetyFilter(arm, 0.01)
    q, v = arm.keyframe("home"), np.zeros(arm.n_joints)
    filter_.allow(q)
    for k in range(150):
        if k % 30 == 0:
            wanted = 3.0 * arm.velocity_limits * rng.choice([-1.0, 1.0], arm.n_joints)
        step = filter_.step(q, v, wanted)
        assert (np.abs(step.velocity) <= arm.velocity_limits + 1e-12).all()
        assert (np.abs(step.velocity - v) <= 0.01 * arm.acceleration_limits + 1e-9).all()
        q, v = q + 0.005 * (v + step.velocity), step.velocity
        assert arm.limit_excess(q).max() <= 1e-6
        assert filter_.collisions.free(q)


def test_a_free_way_is_left_alone():
    target = draw_target(FREE, 3)
    network = synthesize(FREE.encode(target), bias="sign-matched", bias_magnitude=0.5).unwrap()
    run = run_filtered(FREE, network, FREE.keyframe("home"), 6.0)
    assert run.success, run.message
    assert run.filtered_share == 0.0
    assert run.brakings == 0
    assert run.blocked_by == ()
    np.testing.assert_allclose(run.q[-1], target, atol=1e-3)
    # Exactly what the network draws, as long as the accelerations allow it.
    assert np.abs(run.q[:600] - run.reference.q[:600]).max() < 0.05


def test_a_blocked_run_names_what_blocks_it_and_penetrates_nothing():
    target = draw_target(POLES, 0)
    network = synthesize(POLES.encode(target), bias="sign-matched", bias_magnitude=0.5).unwrap()
    run = run_filtered(POLES, network, POLES.keyframe("home"), 4.0)
    assert not run.success
    assert any("obstacle_pole" in name for name in run.blocked_by)
    assert run.blocked_by[0] in run.message
    assert run.clearance.min() > 0.009
    assert 0.0 < run.filtered_share <= 1.0


def test_ends_that_touch_or_leave_the_limits_are_refused():
    beyond = FREE.keyframe("home")
    beyond[3] = 1.2
    network = synthesize(FREE.encode(beyond), bias="solved").unwrap()
    with pytest.raises(PlanError, match=r"ends out of the arm's limits: joint 'extend1' would be at 1\.2 m"):
        run_filtered(FREE, network, FREE.keyframe("home"), 4.0)
    with pytest.raises(InputError, match="margin must be positive, got 0"):
        FilterOptions(margin=0.0)
    folded = np.array([0.0, 0.0, -0.6, 0.45, 0.0, 0.4, -1.0, 0.3])
    with pytest.raises(InputError, match=r"touches '.*' at a position to reach"):
        SafetyFilter(FREE, 0.01).allow(folded)


@pytest.mark.parametrize("scene", ["window", "shelf", "poles"])
def test_the_planner_finds_a_way_around(scene):
    arm = Arm.load("telescopic_pr", scene, 2)
    problem = PlanningProblem(arm, arm.keyframe("home"), draw_target(arm, 2), 4.0, 2)
    network, motion = planner.filtered(problem)
    assert network.certified
    check_motion(arm, motion)
    collisions = Collisions(arm)
    assert all(collisions.free(q) for q in motion.q[::3])
    np.testing.assert_array_equal(motion.q[[0, -1]], [problem.start, problem.target])
    np.testing.assert_array_equal(motion.qd[[0, -1]], 0.0)
    assert motion.t[-1] <= planner.LONGEST * problem.duration + 1.0
    # Positions are the integral of the velocities, which never jump.
    middle = 0.5 * motion.timestep * (motion.qd[1:] + motion.qd[:-1])
    np.testing.assert_allclose(np.diff(motion.q, axis=0), middle, atol=1e-6)
    assert (np.abs(np.diff(motion.qd, axis=0)) <= 1.01 * motion.timestep * arm.acceleration_limits + 1e-3).all()


def test_a_hopeless_problem_says_what_blocks(monkeypatch):
    monkeypatch.setattr(planner, "find_waypoints", lambda *_, **__: None)
    problem = PlanningProblem(POLES, POLES.keyframe("home"), draw_target(POLES, 0), 4.0)
    with pytest.raises(
        PlanError, match=r"no run through the filter arrived; .*the clearance of '.*' from 'obstacle_pole"
    ):
        planner.filtered(problem)


def test_waypoints_are_free_on_the_way():
    collisions, home, target = Collisions(POLES), POLES.keyframe("home"), draw_target(POLES, 0)
    postures = find_waypoints(collisions, home, target, seed=1)
    corners = [home, *postures, target]
    for a, b in itertools.pairwise(corners):
        assert all(collisions.free(a + s * (b - a)) for s in np.linspace(0.0, 1.0, 150))
    assert find_waypoints(collisions, home, target, seed=1, looks=3) is None


def test_limits_are_proved_only_where_they_hold():
    home = SPATIAL.encode(SPATIAL.keyframe("home"))
    near = synthesize(home, bias="sign-matched", bias_magnitude=0.5).unwrap()
    target = np.full((SPATIAL.n_links, 6), 0.3)
    small = synthesize(target, bias="sign-matched", bias_magnitude=2.0).unwrap()
    proofs = [limits_proved(SPATIAL, network, start) for network, start in ((near, home), (small, target))]
    assert any(proofs)
    for network, start, proved in zip((near, small), (home, target), proofs, strict=True):
        q = SPATIAL.decode(network.trajectory(start, 20.0).xi).q
        assert not proved or SPATIAL.limit_excess(q).max() <= 0.0
    assert not limits_proved(
        FREE, synthesize(FREE.encode(FREE.keyframe("home"))).unwrap(), FREE.encode(FREE.keyframe("home"))
    )
