"""A policy in a loop of one's own: a robot that is led, deadlines, and loops that end."""

from __future__ import annotations

import gc
import time
from unittest.mock import Mock

import numpy as np
import pytest

from lieednn_sim.errors import InputError
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
        robot[:] += 0.5 * (q - robot)
        if 100 <= len(references) < 150:
            robot[1] = 0.5

    report = control_loop(policy, read, write, GOAL, 6.0)
    assert len(references) == len(report.lateness) == len(report.step_time) == 1200
    pace, behind = np.array(channels[2:]).T
    held = slice(100, 149)
    # It waits at a hundredth of its speed, a sixth of the range of 4 m off, and its reference comes along.
    assert pace[held].max() < 0.05
    assert behind[held].max() > 0.1
    assert references[150][1] > 0.2
    np.testing.assert_allclose(references[-1], GOAL, atol=2e-2)
    assert report.missed == (report.lateness > 0.0).sum()


@pytest.fixture
def clock(monkeypatch):
    """A clock that only goes on in `sleep`, or when it is told to."""

    class Clock:
        now = 0.0

        def perf_counter(self):
            return self.now

        def sleep(self, seconds):
            self.now += seconds

    made = Clock()
    monkeypatch.setattr(module, "time", made)
    return made


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
    np.testing.assert_allclose(times, [0.0, 0.02, 0.04, 0.075, 0.095])
    np.testing.assert_allclose(report.lateness, [-0.015, -0.015, 0.015, -0.015, -0.015])
    assert (report.missed, len(late), late[0][0]) == (1, 1, 2)
    assert late[0][1] == pytest.approx(0.015)
    assert str(report).startswith("5 periods, 1 late, by up to 15 ms; the policy took 0 us")


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
    assert states == [False] * 5
    assert gc.isenabled()
    assert np.abs(sent[0] + GOAL).max() < 0.01
    with pytest.raises(ConnectionError):
        control_loop(policy, lambda: -GOAL, Mock(side_effect=ConnectionError), GOAL, 0.01)
    assert gc.isenabled()


def test_a_measurement_may_be_missing_but_not_the_first(gantry):
    policy = make_policy("linear-attractor", gantry, GOAL, rate=500.0)
    # One for each period.
    measured = iter([np.zeros(4), None])
    began = time.perf_counter()
    assert len(control_loop(policy, lambda: next(measured), lambda q, qd: None, GOAL, 0.004).lateness) == 2
    assert time.perf_counter() - began >= 0.004
    with pytest.raises(InputError, match="read must return measured joints the first time"):
        control_loop(policy, lambda: None, lambda q, qd: None, GOAL, 0.01)
    with pytest.raises(InputError, match="duration must be positive"):
        control_loop(policy, lambda: GOAL, lambda q, qd: None, GOAL, 0.0)
    with pytest.raises(InputError, match="duration must be at most 10000000 control periods"):
        control_loop(policy, lambda: GOAL, lambda q, qd: None, GOAL, 1e9)
