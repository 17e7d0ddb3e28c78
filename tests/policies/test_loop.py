"""A policy in a loop of one's own: a robot that is led, deadlines, and loops that end."""

from __future__ import annotations

import gc
import time
from unittest.mock import Mock

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError
from lieednn_sim.planning import plan
from lieednn_sim.planning.clearance import proved_clearance
from lieednn_sim.policies import control_loop, make_policy
from lieednn_sim.policies import loop as module

GOAL = np.array([0.3, -0.2, 0.3, 0.2])


def test_a_robot_is_led_at_200_hertz_and_yielded_to(gantry, monkeypatch):
    """Its drives reach half of a reference's distance in a period; somebody holds its second joint aside for a while.

    Six seconds of periods, as fast as the robot answers.
    """
    monkeypatch.setattr(module.time, "sleep", lambda _: None)
    policy = make_policy("lieednn-shaped", gantry, GOAL, rate=200.0)
    channels, references, robot = [], [], np.zeros(4)

    def read():
        channels.append(policy.channels() if references else np.zeros(2))
        return robot.copy()

    def write(q, qd):
        references.append(q)
        aside = min(robot[1] + 0.04, 0.5)
        robot[:] += 0.5 * (q - robot)
        if 100 <= len(references) < 150:
            robot[1] = aside

    report = control_loop(policy, read, write, GOAL, 6.0)
    # Two periods more to come to rest.
    assert len(references) == len(report.lateness) == len(report.step_time) == 1202
    pace, behind = np.array(channels[2:]).T
    held = slice(112, 149)
    # It waits at a hundredth of its speed, a sixth of the range of 4 m off, and its reference comes along.
    assert pace[held].max() < 0.05
    assert behind[held].max() > 0.1
    assert references[150][1] > 0.2
    np.testing.assert_allclose(references[-1], GOAL, atol=2e-2)
    assert report.missed == (report.lateness > 0.0).sum()


def test_lateness_by_hand(gantry, clock):
    """The reference of the third period takes 35 ms of 20: the next begins at once, and the others are in time."""
    policy = make_policy("linear-attractor", gantry, GOAL, rate=50.0)
    times, late = [], []

    def write(q, qd):
        times.append(clock.now)
        clock.now += 0.035 if len(times) == 3 else 0.005

    report = control_loop(
        policy, lambda: policy.q, write, lambda t: GOAL * min(t, 1.0), 0.1, on_late=lambda *one: late.append(one)
    )
    np.testing.assert_allclose(times[:5], [0.0, 0.02, 0.04, 0.075, 0.095])
    np.testing.assert_allclose(report.lateness[:5], [-0.015, -0.015, 0.015, -0.015, -0.015])
    assert (report.missed, len(late), late[0][0]) == (1, 1, 2)
    assert late[0][1] == pytest.approx(0.015)
    assert str(report).startswith(f"{len(times)} periods, 1 late, by up to 15 ms; the policy took 0 us")


def test_the_target_is_asked_for_at_the_time_since_the_beginning(gantry, clock):
    policy, asked = make_policy("linear-attractor", gantry, GOAL, rate=50.0), []
    clock.now = 100.0

    def target(t):
        asked.append(t)
        return GOAL

    control_loop(policy, lambda: policy.q, lambda q, qd: None, target, 0.06)
    np.testing.assert_allclose(asked[-3:], [0.0, 0.02, 0.04], atol=1e-9)


def test_it_begins_where_the_arm_is_and_collects_no_garbage_meanwhile(gantry):
    policy, states = make_policy("linear-attractor", gantry, GOAL, rate=500.0), []
    sent = []

    def write(q, qd):
        sent.append(q)
        states.append(gc.isenabled())

    control_loop(policy, lambda: -GOAL, write, GOAL, 0.01)
    assert states == [False] * len(sent)
    assert gc.isenabled()
    assert np.abs(sent[0] + GOAL).max() < 0.01
    with pytest.raises(KeyboardInterrupt):
        control_loop(policy, lambda: -GOAL, Mock(side_effect=KeyboardInterrupt), GOAL, 0.01)
    assert gc.isenabled()


def test_a_measurement_may_be_missing_but_not_the_first(gantry):
    policy = make_policy("linear-attractor", gantry, GOAL, rate=500.0)
    # One for each period, the last ones of which come to rest.
    measured = iter([np.zeros(4), *[None] * 9])
    began = time.perf_counter()
    report = control_loop(policy, lambda: next(measured), lambda q, qd: None, GOAL, 0.004)
    assert time.perf_counter() - began >= 0.002 * len(report.lateness) > 0.004
    assert report.faults["missing"] == len(report.lateness) - 1
    with pytest.raises(InputError, match="read must return measured joints the first time"):
        control_loop(policy, lambda: None, lambda q, qd: None, GOAL, 0.01)
    with pytest.raises(InputError, match="duration must be positive"):
        control_loop(policy, lambda: GOAL, lambda q, qd: None, GOAL, 0.0)
    with pytest.raises(InputError, match="duration must be at most 10000000 control periods"):
        control_loop(policy, lambda: GOAL, lambda q, qd: None, GOAL, 1e9)


def test_it_stops_where_the_robot_leaves_the_proof_of_its_plan(monkeypatch):
    """From 1.5 s on something turns the first joint away by a milliradian a period; references are kept exactly."""
    monkeypatch.setattr(module.time, "sleep", lambda _: None)
    arm = Arm.load("telescopic_pr", scene="window", seed=1)
    made = plan(arm, draw_target(arm, seed=1))
    policy = make_policy("tracker", arm, made, rate=100.0)
    references, measured, aside = [made.motion.q[0]], [], 0.0

    def read():
        slipped = max(len(references) - 151, 0) * aside
        measured.append(references[-1] + slipped * np.eye(arm.n_joints)[0])
        return measured[-1]

    def run(**stop):
        del references[1:], measured[:]
        return control_loop(policy, read, lambda q, qd: references.append(q), made.target, 3.0, **stop)

    assert run(stop_outside=True).stopped == ""
    # Two periods come to rest from the last of the plan's speed.
    assert len(references) == 303
    aside = 1e-3
    assert run().stopped == ""
    report = run(stop_outside=True)
    # Within three periods of 5 samples each, the proof of the measured errors themselves ends in the last one.
    last = next(k for k in range(300) if f"at t = {0.01 * k:.3f} s: joint 'turn' is" in report.stopped)
    q, qd, off = made.motion.q, made.motion.qd, np.zeros_like(made.motion.q)
    for period, proved in ((last - 2, True), (last - 1, True), (last, False)):
        off[:, 0], span = aside * (period - 150), slice(5 * period - 5, 5 * period + 1)
        assert proved_clearance(arm, made.t[:6], q[span], qd[span], off[span]).proved == proved
    # The reference brakes at once, within the limits of acceleration, from where it is, and the loop ends at rest.
    sent = np.array(references)
    np.testing.assert_array_equal(sent[: last + 1], q[: 5 * last + 1 : 5])
    assert last + 2 < len(sent) < last + 60
    change = np.diff(np.diff(sent[last - 1 :], axis=0), axis=0) * 100.0**2
    assert (np.abs(change) <= 1.05 * arm.acceleration_limits).all()
    assert len(report.lateness) == len(sent) - 1
    assert report.message == "moves"
    assert str(report).endswith(f"; stopped: {report.stopped}")


def test_only_a_plan_can_be_left(gantry):
    policy = make_policy("linear-attractor", gantry, GOAL, rate=500.0)
    with pytest.raises(InputError, match="needs a policy that plays a plan, 'tracker', got NetworkPolicy"):
        control_loop(policy, lambda: GOAL, lambda q, qd: None, GOAL, 0.01, stop_outside=True)
