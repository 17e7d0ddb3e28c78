"""Evasion: a pole that walks past, in and away, an arm in a cage, and where searches run."""

import dataclasses
import os
import signal
import subprocess
import sys
import textwrap
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import PlanError
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions
from lieednn_sim.policies import ReplanningOptions, ReplanningPolicy, searching
from lieednn_sim.policies.searching import aside, found
from lieednn_sim.policies.surroundings import Surroundings, evasion, path_around
from lieednn_sim.simulation import Disturbances, MovingObstacle, follow
from lieednn_sim.studies import study
from lieednn_sim.studies.study import worker_pool

POLE = "obstacle_pole"


def with_poles(gantry, *places):
    """The gantry, whose ball of 0.1 m is at (1, 0), and poles of 0.05 m, the first of which may walk."""
    spec = mujoco.MjSpec()
    for k, place in enumerate(places):
        body = spec.worldbody.add_body(name=f"pole{k or ''}", pos=[*place, 0.0])
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.05, 4.0, 0.0])
    return dataclasses.replace(gantry.with_obstacles(spec, "pole"), scene="free")


def walks(*places):
    times, points = zip(*((t, (x, y, 0.0)) for t, x, y in places), strict=True)
    return Disturbances(obstacles=(MovingObstacle(POLE, times, points),))


def test_a_pole_that_walks_past_outside_of_the_margin_moves_nothing(gantry):
    """At 0.3 m/s, 0.04 m from the ball; half the margin is 0.03 m."""
    arm = with_poles(gantry, (1.19, 1.5))
    policy = ReplanningPolicy(arm, 50.0)
    rollout = follow(policy, np.zeros(4), 9.0, disturbances=walks((0.0, 1.19, 1.5), (9.0, 1.19, -1.2))).rollout
    assert np.abs(rollout.q_ref).max() < 1e-9
    assert not rollout.channels["evading"].any()


@pytest.mark.parametrize("evade", [True, False])
def test_it_goes_out_of_the_way_of_a_pole_that_walks_in_and_comes_back(gantry, evade):
    """Within the limits; without evasion the pole hits it."""
    arm, way = with_poles(gantry, (1.0, 1.5)), walks((0.0, 1.0, 1.5), (9.0, 1.0, -1.2))
    policy = ReplanningPolicy(arm, 50.0, options=ReplanningOptions(evade=evade))
    rollout = follow(policy, np.zeros(4), 9.0, disturbances=way).rollout
    evading = rollout.channels["evading"]
    assert rollout.contacts.any() != evade
    assert (evading.max() == 1.0) == evade
    if evade:
        assert evading.min() == 0.0
        np.testing.assert_allclose(rollout.q[-1], 0.0, atol=1e-3)
        assert policy.message == "moves"
        # Before the pole is there, and not long after it has gone.
        away = rollout.t[np.abs(rollout.q[:, :3]).max(axis=1) > 0.01]
        assert 1.0 < away[0] < 4.5
        assert away[-1] < 9.0
        assert (np.abs(rollout.qd_ref) <= arm.velocity_limits).all()
        rates = rollout.qd_ref[:: round(0.02 / rollout.timestep)]
        assert (np.abs(np.diff(rates, axis=0)) <= 0.02 * 0.9 * arm.acceleration_limits).all()


def test_it_says_that_it_cannot_evade_in_a_cage(gantry):
    """Of poles 0.04 m around its ball, between two of which another one comes in."""
    angles = np.linspace(0.0, 2.0 * np.pi, 13)[1:-1]
    cage = np.stack([1.0 + 0.19 * np.cos(angles), 0.19 * np.sin(angles)], axis=1)
    arm = with_poles(gantry, (2.0, 0.0), *cage)
    policy = ReplanningPolicy(arm, 50.0, options=ReplanningOptions(search_periods=5))
    policy.reset(np.zeros(4))
    for k in range(120):
        policy.see({POLE: np.array([2.0 - 0.006 * k, 0.0, 0.0])})
        policy.step(None, np.zeros(4))
    assert policy.channels()[4] == -1.0
    assert policy.message.startswith(f"cannot evade {POLE!r}: none of ")
    assert np.abs(policy.q[:2]).max() < 0.05


def test_it_leaves_what_touches_it(gantry):
    """A pole that is 0.02 m deep in it all of a sudden, and stays."""
    policy = ReplanningPolicy(with_poles(gantry, (3.0, 0.0)), 50.0)
    policy.reset(np.zeros(4))
    for k in range(100):
        policy.see({POLE: np.array([1.13 if k > 10 else 3.0, 0.0, 0.0])})
        policy.step(None, np.zeros(4))
    assert policy.message == f"evades {POLE!r}: the target is not free"
    look = Surroundings(policy.arm, 0.05)
    look.see({POLE: np.array([1.13, 0.0, 0.0])})
    assert look.blocked(policy.q[None], only_moving=True) is None


def test_when_an_obstacle_comes_too_near_by_hand(gantry):
    """At 0.5 m/s from a gap of 0.43 m, it is within 0.03 m after 0.8 s; nothing moves for that."""
    look = Surroundings(with_poles(gantry, (3.0, 0.0)), 0.03)
    after = np.array([0.0, 0.78, 0.82, 0.9])
    for k in range(4):
        look.see({POLE: np.array([1.15 + 0.43 + 0.05 * (3 - k), 0.0, 0.0])})
        look.look(0.1)
    np.testing.assert_allclose(look.velocities[POLE], [-0.5, 0.0, 0.0], atol=1e-12)
    assert look.nearing(np.zeros((4, 4)), after) == (2, POLE)
    assert look.blocked(np.zeros((1, 4))) is None


def test_ways_are_free_from_when_the_arm_sets_off(gantry):
    """Poles on their way to the arm from all sides, which move on while it still waits for the search."""
    arm, lead, found_some = with_poles(gantry, (3.0, 0.0)), 0.5, 0
    for angle in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        away = np.array([np.cos(angle), np.sin(angle), 0.0])
        place, velocity = np.array([1.0, 0.0, 0.0]) + 0.7 * away, -0.8 * away
        try:
            way = evasion(arm, {POLE: place}, {POLE: velocity}, np.zeros(4), 0.06, lead, 3.0, 0)
        except PlanError:
            continue
        look, t = Surroundings(arm, 0.02), np.linspace(0.0, float(way.x[-1]), 40)
        look.see({POLE: place})
        look.velocities, found_some = {POLE: velocity}, found_some + 1
        assert look.nearing(way(t), lead + t) is None
    assert found_some > 6


def searches(arm):
    """A path around a pole, and a way out of the way of one, as arrays."""
    options, goal = RrtConnectOptions(max_collision_checks=(20_000,), fastest=True), np.array([0.0, 1.5, 0.0, 0.5])
    place = {POLE: np.array([1.0, 0.8, 0.0])}
    path = found(aside(arm, path_around, place, (np.zeros(4), goal), 0.06, options, 3))
    away = found(aside(arm, evasion, place, {POLE: np.array([0.0, -0.3, 0.0])}, np.zeros(4), 0.06, 0.2, 3.0, 3))
    return path.x, path.c, away.x, away.c


def test_it_comes_back_as_soon_as_a_pole_stands(gantry):
    """One that came at 1 m/s, before which it would have gone further away; three looks, 0.3 s, tell that it stands."""
    arm, way = with_poles(gantry, (1.0, 1.5)), walks((0.0, 1.0, 1.5), (0.9, 1.0, 0.6), (9.0, 1.0, 0.6))
    rollout = follow(ReplanningPolicy(arm, 50.0), np.zeros(4), 4.0, disturbances=way).rollout
    evading = rollout.t[rollout.channels["evading"] == 1.0]
    assert 0.9 < evading[-1] < 1.25
    np.testing.assert_allclose(rollout.q[-1], 0.0, atol=1e-3)


def test_searches_in_a_process_find_what_they_find_in_a_thread_and_go_on_there(gantry, monkeypatch):
    pytest.importorskip("ompl.geometric")
    arm = with_poles(gantry, (3.0, 0.8))
    searcher = searching._Searcher()
    monkeypatch.setattr(searching, "_searcher", lambda _: searcher)
    results = searches(arm)
    assert isinstance(searcher._pool, ProcessPoolExecutor)
    # Each search has its own arm.
    other = dataclasses.replace(gantry, name="other")
    assert [aside(each, getattr, "name").result() for each in (other, arm, other)] == ["other", "gantry", "other"]
    (worker,) = searcher._pool._processes.values()
    os.kill(worker.pid, signal.SIGSTOP)
    lost = aside(arm, getattr, "name")
    worker.kill()
    with pytest.raises(PlanError, match="the process that searched has ended"):
        found(lost)
    with pytest.warns(RuntimeWarning, match="searches run in a thread"):
        again = searches(arm)
    assert isinstance(searcher._pool, ThreadPoolExecutor)
    for first, second in zip(results, again, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_the_process_ends_with_its_parent_and_runs_no_script(tmp_path):
    """Even if that is killed; the script has no guard, and is run once."""
    script = tmp_path / "robot.py"
    script.write_text(
        textwrap.dedent("""
        import time
        from lieednn_sim.arm import Arm
        from lieednn_sim.policies import ReplanningPolicy
        from lieednn_sim.policies.searching import aside
        print("moves", flush=True)
        arm = Arm.load("telescopic_pr")
        ReplanningPolicy(arm).reset("home")
        print(aside(arm, getattr, "name").result(), flush=True)
        time.sleep(600)
    """)
    )
    run = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    assert [run.stdout.readline() for _ in range(2)] == ["moves\n", "telescopic_pr\n"]
    run.kill()
    # The process has its output open, which ends with the last of them.
    assert run.communicate(timeout=60) == ("", None)


def test_a_worker_of_a_study_ends_though_its_policy_has_such_a_process(monkeypatch):
    """Nobody else ends that, and it waits for searches; the block waits for the worker."""
    monkeypatch.setattr(study, "_prepare_worker", print)  # whose module imports much
    named = "aside(Arm.load('telescopic_pr'), getattr, 'name').result()"
    known = "from lieednn_sim.arm import Arm; from lieednn_sim.policies.searching import aside"
    with worker_pool(1) as pool:
        pool.submit(exec, f"{known}; assert {named} == 'telescopic_pr'").result()
