"""Policies: recovery by hand, rivals that arrive, the table that goes on, its summary."""

import dataclasses
import itertools
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.errors import InputError
from lieednn_sim.planning import Plan, plan
from lieednn_sim.policies import Fabric, FilteredPolicy, make_policy
from lieednn_sim.registry import POLICIES
from lieednn_sim.simulation import Disturbances, Push
from lieednn_sim.studies import compute
from lieednn_sim.studies.reactions import study, summary
from lieednn_sim.studies.reactions.disturbing import UndisturbedPath, pushing_force, walking_pole
from lieednn_sim.studies.reactions.study import DISTURBANCES, Reaction, Task


def test_a_recovery_by_hand(gantry):
    # Along x, of which the range is 2 m, pushed aside along y, whose range is 4 m.
    t = np.linspace(0.0, 1.0, 101)
    path = np.zeros((101, 4))
    path[:, 0] = t
    pushed = path.copy()
    pushed[20:60, 1] = 0.4 * (1.0 - (t[20:60] - 0.2) / 0.4)
    recovery = UndisturbedPath(gantry, path).recovery(t, pushed, 0.2, 0.3)
    assert recovery.deviation == pytest.approx(0.1)
    # Within a tenth of it from t = 0.56 on, 0.26 s after the push, with 0.36 of the 0.8 m gone.
    assert recovery.time_s == pytest.approx(0.26, abs=0.011)
    assert recovery.fraction == pytest.approx(0.36 / 0.8, abs=0.02)
    pushed[60:, 1] = 0.3
    assert UndisturbedPath(gantry, path).recovery(t, pushed, 0.2, 0.3).time_s is None
    # Back before the disturbance is over: what is gone counts from when it is.
    early = UndisturbedPath(gantry, path).recovery(t, np.where(np.arange(101)[:, None] < 60, pushed, path), 0.2, 0.7)
    assert (early.time_s, early.fraction) == pytest.approx((0.0, 0.5 / 0.8), abs=0.02)


def test_a_path_of_few_samples_is_gone_between_them(gantry):
    distance, fraction = UndisturbedPath(gantry, np.array([[0.0, 0.0, 0.0, 0.0], [0.8, 0.0, 0.0, 0.0]])).nearest(
        np.array([[0.2, 0.0, 0.0, 0.0], [0.2, 0.4, 0.0, 0.0]])
    )
    np.testing.assert_allclose(distance, [0.0, 0.1], atol=1e-3)
    np.testing.assert_allclose(fraction, [0.25, 0.25], atol=1e-3)


def test_the_force_of_a_push_is_found_where_actuators_give_way_all_at_once():
    tried = []

    def off(force):
        tried.append(force)
        return 1e-5 * force + 3e-3 * max(force - 900.0, 0.0)

    assert 0.08 < off(pushing_force(off)) < 0.12
    assert len(tried) <= 13
    assert pushing_force(lambda force: 1e-6 * force) == 2e4


@pytest.fixture(scope="module")
def task(gantry):
    target = np.array([0.3, -0.4, 0.5, 0.6])
    motion = plan(gantry, target, planner="minimum-jerk", duration=2.0).motion
    return Task(gantry, "free", target, motion, 0)


@pytest.mark.parametrize("name", ["dmp", "fabric", "tracker"])
def test_a_policy_arrives_also_pushed(name, task):
    push = Disturbances(pushes=(Push("end effector", (0.0, 20.0, 0.0), 0.5, 0.2),))
    policy = task.policy(name)
    for changes in (None, push):
        following = study._run(policy, task.target, changes, 6.0)
        np.testing.assert_allclose(following.rollout.q[-1], task.target, atol=5e-3)
        assert len(following.step_time) == 601, "at 100 Hz"
    assert np.abs(following.rollout.q_ref - task.arm.keyframe("home")).max() < 0.7


def test_a_push_throws_a_joint_a_tenth_of_its_range_off_in_the_run_itself(task):
    policy = task.policy("linear-attractor")
    path = UndisturbedPath(task.arm, study._run(policy, task.target, None, 2.0).rollout.q)
    targets, changes, end = study._disturbed(task, policy, "push", 0.4, path)
    rollout = study._run(policy, targets, changes, 2.0).rollout
    assert path.recovery(rollout.t, rollout.q, 0.4, end).deviation == pytest.approx(0.1, rel=0.2)


@pytest.mark.parametrize("name", ["gantry", "telescopic_compound"])
def test_a_target_moves_no_nearer_to_limits_than_other_targets_are(name, gantry, task):
    """From the very limits: of slides and hinges here, of the angle of a ball joint there."""
    arm = gantry if name == "gantry" else Arm.load(name)
    corner = arm.within_angles(arm.position_limits[:, 1])
    for seed in range(5):
        task = dataclasses.replace(task, arm=arm, target=corner, seed=seed)
        moved = study._disturbed(task, None, "target", 0.0, None)[0][-1]
        assert (moved != corner).all()
        low, high = arm.position_limits.T
        assert (high - moved >= 0.05 * (high - low) - 1e-12).all()
        for ball in arm.space.balls:
            assert np.linalg.norm(moved[ball]) <= 0.9 * high[ball][0] + 1e-12


def test_a_row_by_hand(task, monkeypatch):
    measured = {"final_worst_mm": 3.0, "final_effector_mm": 1.0, "velocity_fraction": 0.25, "force_fraction": 0.75}
    measured |= {"path_m": 1.5, "settling_s": 2.5}
    monkeypatch.setattr(study, "evaluate", lambda rollout, clearance: SimpleNamespace(shortfall="", **measured))
    # An actuator at half its limit and one at all of it, for three steps of 0.1 s.
    arm = SimpleNamespace(force_limits=np.array([2.0, 10.0]))
    rollout = SimpleNamespace(arm=arm, force=np.tile([1.0, -10.0], (3, 1)), timestep=0.1)
    following = SimpleNamespace(rollout=rollout, step_time=[1e-6, 9e-6, 2e-6])
    row = study._row(task, "tracker", "none", following)
    assert (row.final_mm, row.velocity_fraction, row.force_fraction) == (3.0, 0.25, 0.75)
    assert (row.path_m, row.settled_s) == (1.5, 2.5)
    assert (row.effort, row.step_us) == pytest.approx((0.3 * 0.5 * (0.25 + 1.0), 2.0))


def test_the_disturbances_of_a_tracker_by_hand(task, monkeypatch):
    ran, run = {}, study._run

    def recorded(policy, targets, changes=None, *duration):
        following = run(policy, targets, changes, *duration)
        kind = "target" if targets.ndim > 1 else "none"
        if changes is not None:
            kind = ("push" if changes.pushes[0].duration == 0.2 else "payload") if changes.pushes else "obstacle"
        ran[kind] = targets, changes, following.rollout
        return following

    monkeypatch.setattr(study, "_run", recorded)
    monkeypatch.setattr(study, "_task", lambda *case: task)
    rows = {row.disturbance: row for row in study.run_reactions("gantry", "free", "tracker", 3)}
    assert list(rows) == list(DISTURBANCES)
    assert [row.deviation is None for row in rows.values()] == [True, False, False, True, True]
    # Of 2 s of minimum jerk 35 % of the path are gone where 10 s^3 - 15 s^4 + 6 s^5 = 0.35, at s = 0.4186.
    (push,) = ran["push"][1].pushes
    assert push.start == pytest.approx(0.84)
    assert rows["push"].push_n == pytest.approx(np.linalg.norm(push.force), rel=1e-3)
    assert rows["push"].deviation > 0.08
    assert 0.0 < rows["push"].back_s < 2.0
    # 10 N hang at a servo of 1000 N/m, and stay there.
    assert (ran["payload"][2].q[-1] - task.target)[2] == pytest.approx(-0.01, abs=1e-6)
    assert rows["payload"].final_mm == pytest.approx(10.0)
    assert (rows["payload"].back_s, rows["payload"].reason[:8]) == (None, "arrival:")
    # It plays on to the first target, and is judged by the one that counts from then on.
    targets = ran["target"][0]
    assert ((targets == task.target).all(axis=1) == (np.arange(len(targets)) < 84)).all()
    away = (targets[-1] - task.target)[:3]
    assert rows["target"].final_mm == pytest.approx(1e3 * np.linalg.norm(away), rel=1e-3)
    assert (rows["none"].success, rows["target"].success) == (True, False)


@pytest.mark.parametrize(("scene", "taught"), [("free", True), ("poles", False)])
def test_a_task_shows_the_guides_motion_and_filters_among_obstacles(scene, taught, monkeypatch, gantry, task):
    own, guides = dataclasses.replace(task.motion), task.motion
    made = Plan(own, None, guide=Plan(guides) if taught else None)
    monkeypatch.setattr(study, "arm_and_target", lambda *_: (gantry, task.target))
    monkeypatch.setattr(study, "plan", lambda *_, **__: made)
    found = study._task.__wrapped__("gantry", scene, 3, ())
    assert found.seed == 3
    assert found.motion is (guides if taught else own)
    asked = []
    monkeypatch.setattr(study, "make_policy", lambda *kind, **how: asked.append(how) or make_policy(*kind, **how))
    for name in ("linear-attractor", "dmp", "fabric", "mppi", "tracker"):
        policy = found.policy(name)
        assert (policy.rate, asked[-1]["convergence_rate"]) == (100.0, 2.0)
        assert isinstance(policy, FilteredPolicy) == (scene != "free" and name in ("linear-attractor", "dmp"))


def test_policies_of_users_run_as_they_are_and_come_last(task, tmp_path, monkeypatch):
    monkeypatch.setattr(POLICIES, "entries", dict(POLICIES.entries))
    monkeypatch.setattr("sys.path", [*sys.path])
    own = f"{tmp_path / 'somebodys_policies.py'}:mine"
    (tmp_path / "somebodys_policies.py").write_text(
        "from lieednn_sim.policies import Fabric\ndef mine(task):\n    return Fabric(task.arm, task.rate)\n"
    )
    with pytest.raises(InputError, match="no policy 'theirs'"):
        study.Reactions(["telescopic_pr"], ["free"], 1, ("dmp", "theirs"))
    assert study.Reactions(["telescopic_pr"], ["free"], 1, (own, "dmp")).policies == (own, "dmp")
    assert type(dataclasses.replace(task, scene="poles").policy(own)) is Fabric
    monkeypatch.setattr(study, "_task", lambda *case: task)
    monkeypatch.setattr(study, "DISTURBANCES", DISTURBANCES[:1])  # others are tried above
    rows = study.run_reactions("gantry", "free", own, 3)
    assert rows[0].success
    rows += study.failed_reactions("gantry", "free", "tracker", 3, "plan: none")
    assert [group.key[2] for group in summary.groups(rows)][:2] == ["tracker", own]


def test_a_pole_walks_into_the_way_but_into_no_arm(gantry):
    """Clear of the way before, and of wherever the arm was since it began; on the way, later, it is met."""
    motion, begin = plan(gantry, [0.0, 1.5, 0.0, 0.5], planner="minimum-jerk", duration=3.0).motion, 1.0
    gone = np.linspace(0.0, 1.0, len(motion.t))
    for seed in range(3):
        rng = np.random.default_rng(seed)
        arm, pole = walking_pole(gantry, motion.t, motion.q, gone, begin, rng)
        (since, until), collisions = pole.times, Collisions(arm)

        def gap(time, q, collisions=collisions, pole=pole):
            collisions.move({pole.body: pole.at(time)})
            near = collisions.distances(q, 1.0)
            walker = collisions.arm.model.body(pole.body).id
            mine = (collisions.arm.model.geom_bodyid[near.pairs] == walker).any(axis=1)
            return near.distance[mine].min(initial=np.inf)

        walks = (motion.t >= since) & (motion.t <= until)
        times, way = motion.t[walks][::20], motion.q[walks][::20]
        assert min(gap(time, q) for k, time in enumerate(times) for q in way[: k + 1]) > 0.035
        assert min(gap(0.0, q) for q in motion.q[::20]) > 0.05
        assert min(gap(9.0, q) for q in motion.q[motion.t > until][::5]) < 0.01
        assert gap(9.0, motion.q[-1]) > 0.05


def test_a_target_does_not_move_into_the_floor(task):
    # By up to half a metre, 5 cm above it.
    low = dataclasses.replace(task, target=np.array([0.3, -0.4, -0.85, 0.6]))
    for seed in range(5):
        targets, _, _ = study._disturbed(dataclasses.replace(low, seed=seed), None, "target", 0.0, None)
        assert targets[-1][2] > -0.9


def test_a_fabric_above_the_floor_by_hand(task):
    fabric = Fabric(task.arm, 50.0)
    fabric.reset(np.zeros(4))
    # The ball is 0.1 m off, 0.09 m above its margin; in units of its range of 5 m that falls by 5 m.
    fabric.y = np.array([0.0, 0.0, -0.8, 0.0])
    weight, slope = (0.14 / 0.09 - 1.0) ** 2, 5.0
    force = 16.0 * 0.8 / 5.0 + weight * slope * 0.3 / 0.09
    faster = 0.02 * force / (1.0 + weight * slope**2)
    np.testing.assert_allclose(fabric.velocity(np.zeros(4), 1.0), [0.0, 0.0, 5.0 * faster, 0.0], atol=1e-6)


def test_a_fabric_is_not_repelled_at_its_target(task):
    # 5 cm above the floor, a third of the distance at which it repels.
    target = np.array([0.3, -0.4, -0.85, 0.6])
    rollout = study._run(task.policy("fabric"), target, None, 5.0).rollout
    np.testing.assert_allclose(rollout.q[-1], target, atol=5e-3)


def test_a_primitive_goes_the_way_it_was_shown(task):
    rollout = study._run(task.policy("dmp"), task.target, None, 2.0).rollout
    distance, _ = UndisturbedPath(task.arm, task.motion.q).nearest(rollout.q_ref)
    assert distance.max() < 0.01
    # And when it was there.
    np.testing.assert_allclose(rollout.q_ref, task.motion.q, atol=5e-3)


def test_the_table_goes_on_and_the_summary_counts(tmp_path, monkeypatch):
    asked = []

    def ran(arm, scene, policy, seed):
        asked.append((policy, seed))
        reason = "contact: up to 1 at a time" if policy == "dmp" else ""
        return [Reaction(arm, scene, policy, name, seed, reason=reason, back_s=0.1 * seed) for name in DISTURBANCES]

    monkeypatch.setattr(study.Reactions, "run", staticmethod(ran))
    for seeds in (1, 2):
        table = compute(study.Reactions(["telescopic_pr"], ["free"], seeds, ("dmp", "tracker")), tmp_path)
    assert asked == [("dmp", 0), ("tracker", 0), ("dmp", 1), ("tracker", 1)]
    summary.write_reactions(tmp_path / "reactions.md", table)
    text = (tmp_path / "reactions.md").read_text("utf-8")
    assert "| free | push | dmp | 0 of 2 | 2 | 2 | - | - | - | 0.05 |" in text
    assert "| free | push | tracker | 2 of 2 | 0 | 2 |" in text


def test_the_summary_is_in_the_order_of_the_benchmark_and_tells_what_could_not_be_run(tmp_path):
    def row(policy, disturbance, seed, **values):
        return Reaction("an_arm", "free", policy, disturbance, seed, **values)

    table = study.Reactions((), (), 1).open(tmp_path)
    reasons = ("contact: up to 1 at a time", "arrival: link 1 ends 2 mm and 0 deg off", "")
    for policy, disturbance in itertools.product(("dmp", "linear-attractor"), ("payload", "push")):
        rows = (row(policy, disturbance, k, final_mm=(1.0, 2.0, 9.0)[k], reason=reasons[k]) for k in range(3))
        table.add(list(rows))
    table.add([row("tracker", "push", 0, reason="simulation: it fell over")])
    # Who has no problem has no row, and counts nowhere.
    table.add([row(name, "obstacle", k, reason="problem: no place") for k in range(3) for name in ("fabric", "mppi")])
    table.add([row("mppi", "obstacle", 3)])
    summary.write_reactions(tmp_path / "reactions.md", table)
    lines = (tmp_path / "reactions.md").read_text("utf-8").splitlines()
    assert [line.split(" | ")[1:3] for line in lines if line.startswith("| free")] == [
        ["push", "linear-attractor"],
        ["push", "dmp"],
        ["push", "tracker"],
        ["payload", "linear-attractor"],
        ["payload", "dmp"],
        ["obstacle", "mppi"],
    ]
    assert any(line.startswith("| free | obstacle | mppi | 1 of 1 | 0 |") for line in lines)
    assert "- free, obstacle, fabric, 3 cases: problem: no place" in lines
    assert any(line.startswith("| free | push | dmp | 1 of 3 | 1 | 0 | - | 2 |") for line in lines)
    assert lines[-1] == "- tracker, an_arm, free, push, seed 0: simulation: it fell over"
