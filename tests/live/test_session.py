"""The session of a live view, stepped by hand: targets, refusals, pushes, menus, and that all of it is repeatable."""

import contextlib
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.live import session as session_module
from lieednn_sim.live.panel import Plots
from lieednn_sim.live.scene import Observer, status
from lieednn_sim.live.session import Session, Worker
from lieednn_sim.live.settings import Settings
from lieednn_sim.planning import plan
from lieednn_sim.policies import MotionTracker

QUICK = Settings(policy="linear-attractor")


@pytest.fixture(scope="module")
def arm():
    return Arm.load("telescopic_pr")


@pytest.fixture
def begin(arm):
    """A function that begins a session whose policy is made."""
    open_ones = []

    def session(where=arm, **options):
        made = Session(where, **{"settings": QUICK, **options})
        open_ones.append(made)
        made.settle()
        return made

    yield session
    for made in open_ones:
        made.close()


def wait(event):
    """Wait until something is so; the limit is for a test that would hang."""
    ends = time.monotonic() + 120.0
    while not event():
        assert time.monotonic() < ends
        time.sleep(0.002)


def tip(arm, q):
    return np.asarray(arm.link_poses(q)[-1].translation)


def test_a_dragged_target_is_reached_within_a_millimetre_under_a_bound_that_holds(arm, begin):
    session = begin(settings=Settings(), target="extended")
    observer, goal = Observer(session), session.aimed.position - np.array([0.3, -0.1, 0.1])
    # Of several requests that wait only the newest counts.
    for share in (0.2, 0.5, 1.0):
        session.aim(session.aimed.position + share * (goal - session.aimed.position))
    session.settle()
    seen = []
    for _ in range(20):
        session.advance(20)
        progress = session.tick.progress
        assert progress.distance <= progress.bound
        seen.append(progress.distance)
    np.testing.assert_allclose(session.aimed.position, goal, atol=1e-6)
    assert np.linalg.norm(tip(arm, session.tick.q) - goal) < 1e-3
    shown = observer.look()
    assert shown.arrived
    assert shown.distance == pytest.approx(np.linalg.norm(tip(arm, session.tick.q) - goal), abs=1e-6)
    assert shown.state == "has arrived"
    for far in ({"distance": 1.1e-3}, {"angle": np.deg2rad(0.11)}):
        assert not shown._replace(**far).arrived
    # What the policy says counts for an arm that has not arrived, unless its reference has.
    held = {"angle": np.deg2rad(0.11), "tracking": 0.0021}
    said = shown.tick._replace(message="is held back by the position limit of joint 'wrist_pitch'")
    assert shown._replace(tick=said, **held).state == said.message
    at_rest = shown.tick._replace(message="moves", q_ref=shown.tick.target)
    assert shown._replace(tick=at_rest, **held).state == "its reference has arrived, the arm is still 2.1 mm off"
    certificate = session.policy.network.certificate
    assert certificate.lambda_max < certificate.bound == 1.0
    # The bound is no triviality: it falls as the distance does.
    assert progress.bound < 0.05 * seen[0]
    # The path that is drawn ahead begins at the reference and ends at the target.
    np.testing.assert_allclose(session.path[-1], goal, atol=1e-6)


@pytest.mark.parametrize("policy", ["lieednn-shaped", "tracker"])
def test_the_way_ahead_is_proved_to_be_clear_until_the_arm_is_pushed_off_it(begin, policy):
    arm = Arm.load("telescopic_pr", scene="window", seed=1)
    session = begin(arm, settings=Settings(policy=policy))
    observer, collisions = Observer(session), Collisions(arm)
    session.aim_at(draw_target(arm, 3))
    session.settle()
    proved, measured = session.way.clearance, []
    assert proved.proved
    for _ in range(24):
        session.advance(10)
        assert session.way.holds(session.tick.q)
        measured.append(collisions.clearance(session.tick.q))
    assert 0.03 < proved.bound < 0.05
    assert proved.bound <= min(measured) + 5e-4, "the arm follows to half of a millimetre"
    assert measured[-1] > 1.2 * min(measured), "it has passed the frame"
    words = f"{proved.at()}</b><br>the arm is "
    assert f"{words}inside" in status(observer.look())
    assert "color:inherit;min-height" in status(observer.look())
    session.push(arm.link_names[-1], [300.0, 300.0, 0.0], 0.3)
    session.advance(20)
    assert f"{words}<b" in status(observer.look())
    session.reset()
    session.advance()
    assert "way ahead" not in status(observer.look())


def test_a_target_out_of_reach_is_refused_with_the_joint_or_the_contact(begin):
    session = begin()
    before = session.tick.target
    session.aim([9.0, 0.0, 0.0])
    session.settle()
    session.advance()
    assert session.aimed.problem.startswith("the end effector cannot reach (9, 0, 0) m")
    assert "'extend1'" in session.aimed.problem
    assert "at the limit" in session.aimed.problem
    assert (session.tick.target == before).all()
    np.testing.assert_array_equal(session.aimed.position, [9.0, 0.0, 0.0])
    fenced = begin(Arm.load("telescopic_pr", "window"))
    fenced.aim([1.88, 0.474256, 1.47846])
    fenced.settle()
    assert fenced.wanted.filtered
    assert not session.wanted.filtered
    assert fenced.aimed.problem.endswith("'link4' touches 'obstacle_window'")


def test_the_rate_that_is_shown_is_that_of_a_linear_network(begin):
    session = begin(target="extended")
    session.advance(150)
    before = session.tick.progress.distance
    session.advance(50)
    after = session.tick.progress
    assert after.rate == pytest.approx(np.log(before / after.distance) / 0.5, rel=1e-6)


def test_the_plots_are_in_millimetres_and_of_the_network_as_it_is(arm, begin):
    plots = Plots(SimpleNamespace(add_uplot=lambda **_: SimpleNamespace()))
    session = begin(settings=Settings(), target="extended")
    observer, goal = Observer(session), session.aimed.position
    for _ in range(12):
        session.advance(20)
        snapshot = observer.look()
        plots.add(snapshot)
    t, distance = plots._distance.data
    assert t[-1] == session.tick.time
    assert distance[-1] == pytest.approx(1e3 * np.linalg.norm(goal - tip(arm, session.tick.q)), rel=1e-6)
    # The scale is logarithmic, down to 1e-3.
    assert plots._tracking.data[1][-1] == pytest.approx(max(1e3 * snapshot.tracking, 1e-3))
    progress = snapshot.tick.progress
    np.testing.assert_allclose([row[-1] for row in plots._network.data[1:]], [progress.distance, progress.bound])


def test_a_pushed_arm_yields_and_returns(arm, begin):
    session = begin()
    session.advance(10)
    there = tip(arm, session.tick.q)
    session.push("link 2", (0.0, 300.0, 0.0), 0.2)
    session.advance(20)
    np.testing.assert_array_equal(session.tick.force, [0.0, 300.0, 0.0])
    assert tip(arm, session.tick.q)[1] > there[1] + 1e-3
    session.advance()
    assert not session.tick.force.any()
    session.advance(200)
    assert np.linalg.norm(tip(arm, session.tick.q) - there) < 1e-4
    # A link that is held goes on being pulled until it is let go.
    session.pull("end effector", (0.0, -50.0, 0.0))
    session.advance(60)
    assert tip(arm, session.tick.q)[1] < there[1] - 1e-3
    session.pull("end effector", (0.0, 0.0, 0.0))
    session.advance(200)
    assert np.linalg.norm(tip(arm, session.tick.q) - there) < 1e-4
    # Farther from the axis the same force turns it farther.
    moved, frame = [], arm.link_poses(session.tick.q)[-1]
    for reach in (0.0, 0.3):
        point = frame.apply([reach, 0.0, 0.0])
        session.pull("end effector", (0.0, -50.0, 0.0), point)
        session.advance(100)
        np.testing.assert_array_equal(session.tick.pushed, point)
        moved.append(there[1] - tip(arm, session.tick.q)[1])
        session.pull("end effector", (0.0, 0.0, 0.0))
        session.advance(200)
    assert moved[1] > 1.05 * moved[0] > 0.0
    # Beyond the servos' force the arm pulls the network's state along: the bound begins again, and holds from there.
    session.push("link 2", (0.0, 2000.0, 0.0), 0.3)
    session.advance(60)
    assert session.policy.pulled
    assert session.tick.progress.time == 0.0
    assert session.tick.progress.distance > 0.1
    for _ in range(60):
        session.advance(10)
        assert session.tick.progress.distance <= session.tick.progress.bound + 1e-12
    assert session.tick.progress.time > 5.0
    assert np.linalg.norm(tip(arm, session.tick.q) - there) < 1e-3
    with pytest.raises(InputError, match="no body to push 'elbow'; allowed: base, end effector"):
        session.push("elbow", (1.0, 0.0, 0.0))


def test_menus_change_the_plant_and_the_policy_without_a_jump(begin):
    session = begin(target="extended")
    session.advance(60)
    before = session.tick
    session.choose(payload=3.0, controller="computed-torque", policy="fabric")
    session.settle()
    session.advance()
    assert session.tick.policy == "fabric"
    assert "none" in status(Observer(session).look())
    assert np.abs(session.tick.q - before.q).max() < 0.03
    assert session.tick.progress is None
    assert 0.0 < np.abs(session.tick.q_ref - before.q_ref).max() < 0.03
    session.advance(300)
    # The load is there: without it the arm would follow up to rounding.
    assert np.abs(session.tick.q - session.tick.q_ref).max() > 1e-3
    with pytest.raises(InputError, match="no policy 'guess'; allowed: dmp, fabric"):
        session.choose(policy="guess")
    with pytest.raises(InputError, match="no setting 'load'; allowed: controller, filtered"):
        session.choose(load=1.0)
    assert session.wanted.policy == "fabric"
    # What cannot be made is told, and the arm goes on as before.
    session.choose(policy="lieednn-shaped", rho=2.0)
    session.settle()
    session.advance()
    assert session.failure == "rate must be from 0.01 to 1, got 2"
    assert session.policy.channel_units
    session.choose(rho=0.5)
    session.settle()
    assert (session.failure, session.tick.policy) == ("", "fabric")
    session.advance()
    assert session.tick.policy == "lieednn-shaped"
    shown = status(Observer(session).look()._replace(gap=np.array([0.1, 2e-3])))
    assert ">certified<" in shown
    assert " proved" in shown
    assert ">2 mm and 5.73 degrees<" in shown
    session.choose(policy="lieednn-replanning")  # whose network has a certificate, but no bound on its way
    session.settle()
    session.advance()
    shown = status(Observer(session).look())
    assert ">certified<" in shown
    assert " proved" not in shown
    session.choose(policy="lieednn-shaped")
    session.settle()
    session.advance()
    assert session.policy.network.n_clock > 0


def test_another_plant_takes_over_the_motion_of_the_arm(begin):
    session = begin(target="extended")
    session.advance(30)
    before = session._engine._loop.simulation
    q, qd = before.q.copy(), before.qd.copy()
    assert np.abs(qd).max() > 0.1
    session.choose(payload=3.0)
    session.settle()
    after = session._engine._loop.simulation
    assert after is not before
    np.testing.assert_allclose([after.q, after.qd], [q, qd], atol=1e-12)


def test_a_planned_motion_begins_where_the_arm_stopped_and_is_made_again_for_each_target(arm, begin):
    session = begin(target="extended")
    session.advance(50)
    session.choose(policy="tracker", planner="minimum-jerk")
    # The arm brakes before there is a motion, within its limits.
    references = [session.tick.q_ref]
    session.advance(1)
    stop = session.policy
    assert isinstance(stop, MotionTracker)
    session.settle()  # the motion is there before the arm has stopped
    assert session.busy
    for _ in range(60):
        references.append(session.tick.q_ref)
        session.advance()
    change = np.diff(np.array(references), n=2, axis=0) * 100.0**2
    assert (np.abs(change[1:]) <= 1.01 * arm.acceleration_limits).all()
    assert not session.busy
    session.advance(480)
    assert np.abs(session.tick.q_ref - arm.keyframe("extended")).max() < 1e-9
    middle = plan(arm, "extended", planner="minimum-jerk", start=stop.end).motion
    assert session.path is not None
    np.testing.assert_allclose(session.path[0], tip(arm, middle.q[0]), atol=1e-9)
    session.aim_at("retracted")
    session.settle()
    session.advance(520)
    assert np.abs(session.tick.q_ref - arm.keyframe("retracted")).max() < 1e-9


def test_a_session_that_is_stepped_is_a_function_of_its_requests(begin):
    def run():
        session = begin(settings=Settings(policy="lieednn-shaped", payload=0.5), target="extended")
        session.advance(30)
        early = session.tick
        session.aim(session.aimed.position - np.array([0.1, -0.2, 0.0]))
        session.settle()
        session.push("end effector", (0.0, 0.0, 80.0))
        session.advance(70)
        return session, early

    (first, _), (second, early) = run(), run()
    assert first.tick.q.tolist() == second.tick.q.tolist()
    first.reset()
    first.settle()
    first.advance(30)
    assert first.tick.q.tolist() == early.q.tolist()
    assert first.tick.time == early.time == pytest.approx(0.3)


def test_in_real_time_a_paused_loop_stands_and_a_closed_one_ends(arm, begin):
    session = begin(target="extended")
    session.speed = 4.0
    session.run()
    wait(lambda: session.tick.time > 0.05)
    session.paused = True
    stood = []
    for name in ("retracted", "home"):
        session.aim_at(name)
        wait(lambda name=name: (session.tick.target == arm.keyframe(name)).all())
        stood.append(session.tick.time)
    assert f">{stood[0]:.1f} s, paused<" in status(Observer(session).look())
    assert stood[0] == stood[1] > 0.05
    session.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "control loop"]


def test_one_late_period_is_caught_up_and_more_are_not(begin, monkeypatch):
    session, now, slept = begin(rate=100.0), [0.0], []

    def sleep(duration):
        slept.append(duration)
        now[0] += duration

    def advance():
        now[0] += 0.1 if len(slept) == 2 else 0.0
        if len(slept) == 6:
            session._closed.set()

    monkeypatch.setattr("lieednn_sim.live.session.time", SimpleNamespace(perf_counter=lambda: now[0], sleep=sleep))
    monkeypatch.setattr(session, "advance", advance)
    session._keep_time()
    np.testing.assert_allclose(slept, [0.01, 0.01, 0.0, 0.0, 0.01, 0.01, 0.01], atol=1e-12)


def test_a_worker_does_the_newest_job_by_one_blas_thread_and_tells_what_failed(monkeypatch):
    done, failed, go, begun, alone = [], [], threading.Event(), threading.Event(), []
    monkeypatch.setattr("lieednn_sim.live.worker.one_blas_thread", lambda: contextlib.nullcontext(alone.append(1)))
    worker = Worker("test", failed.append)

    def first():
        begun.set()
        go.wait(60.0)
        worker.check()
        done.append("first")

    worker.submit(first)
    begun.wait(60.0)
    worker.submit(lambda: done.append("second"))
    worker.submit(lambda: 1 / 0)
    assert worker.busy
    go.set()
    worker.wait()
    assert done == []  # the first was told that there was a newer one, the second was replaced
    assert isinstance(failed[0], ZeroDivisionError)
    assert len(alone) == 2
    worker.close()


def test_a_crane_with_a_closed_loop_and_slow_joints_is_driven_by_default(begin):
    session = begin(Arm.load("telescopic_crane"), settings=Settings(), target="extended")
    session.advance(2)
    assert (session.tick.policy, session.wanted.controller) == ("lieednn-shaped", "feedback-linearisation")
    assert session.failure == ""


def test_a_policy_that_could_not_be_made_for_a_target_is_made_for_the_next(begin, monkeypatch):
    made, make_for = [], session_module.make_for

    def first_fails(*args, **options):
        made.append(args)
        if len(made) == 1:
            raise PlanError("no way")
        return make_for(*args, **options)

    monkeypatch.setattr(session_module, "make_for", first_fails)
    session = begin()
    session.advance(2)
    assert (session.tick.policy, session.failure) == ("", "no way")
    session.aim_at("extended")
    session.settle()
    session.advance(2)
    assert (session.tick.policy, session.failure) == ("linear-attractor", "")
