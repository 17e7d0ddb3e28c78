"""A control loop in which things go wrong: each fault by injection, and thousands of random ones."""

from __future__ import annotations

import dataclasses
import itertools
import signal
import threading
from collections import Counter

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError
from lieednn_sim.planning import plan
from lieednn_sim.policies import JointPolicy, LoopOptions, MotionTracker, control_loop, make_policy
from lieednn_sim.policies.loop_faults import LimitedReference

GOAL = np.array([0.3, -0.2, 0.3, 0.2])
HOME = np.zeros(4)
AWAY = np.array([0.5, 1.0, 1.0, 1.0])
pytestmark = pytest.mark.usefixtures("clock")


class Robot:
    """A robot that is where its last reference was, and logs what it gets; what goes wrong is given by period.

    ``reads[k]`` is returned, or called, in place of the joints in period k, and ``writes[k]`` is called before anything
    is taken.
    """

    def __init__(self, reads=None, writes=None, start=HOME):
        self.q, self.rates, self.reads, self.writes = [start.copy()], [np.zeros_like(start)], reads or {}, writes or {}
        self._read, self._written = itertools.count(), itertools.count()

    def read(self):
        value = self.reads.get(next(self._read), self.q[-1])
        return value() if callable(value) else value

    def write(self, q, qd):
        self.writes.get(next(self._written), lambda: None)()
        assert len(self.q) < 5000, "the loop does not end"
        self.q.append(q)
        self.rates.append(qd)

    def excess(self, arm, rate):
        """Largest acceleration of positions and of rates, and largest velocity, by the limits."""
        q, limits = np.array([self.q[0], *self.q]), arm.acceleration_limits
        bend, velocity = np.diff(q, 2, axis=0) * rate**2 / limits, np.diff(q, axis=0) * rate / arm.velocity_limits
        change = np.diff(self.rates, axis=0) * rate / limits
        return max(float(np.abs(part).max(initial=0.0)) for part in (bend, change, velocity))


def raising(error):
    def function(*_):
        raise error

    return function


def run(arm, robot, *, name="linear-attractor", target=GOAL, rate=100.0, duration=0.6, feedback=None, **how):
    policy = make_policy(name, arm, GOAL, rate=rate, feedback=feedback) if isinstance(name, str) else name
    report = control_loop(policy, robot.read, robot.write, target, duration, **how)
    # Whatever happens, references keep the limits, and the last one is at rest, or the report says that it is not.
    assert robot.excess(arm, policy.rate) < 1.0011
    assert report.at_rest == (not robot.rates[-1].any())
    return report


BAD = {
    "missing": None,
    "malformed": np.array([0.0, np.nan, 0.0, 0.0]),
    "read": raising(OSError("no cable")),
    "jump": np.array([0.9, 0.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("kind", BAD)
@pytest.mark.parametrize(("periods", "goes_on"), [(5, True), (6, False)])
def test_without_measurements_it_goes_on_without_feedback_and_then_brakes(gantry, kind, periods, goes_on):
    """The arm is where its reference is, so that feedback changes nothing; two periods with it begin a new count."""
    robot, alone = Robot(dict.fromkeys([10, *range(12, 17), *range(20, 20 + periods)], BAD[kind])), Robot()
    report = run(gantry, robot, options=LoopOptions(missing=5), duration=0.4)
    run(gantry, alone, duration=0.4)
    assert report.faults == {**dict.fromkeys(report.faults, 0), kind: 6 + periods}
    assert report.at_rest
    if goes_on:
        assert report.stopped == ""
        np.testing.assert_array_equal(robot.q, alone.q)
    else:
        assert report.stopped.startswith("no usable measurement in 6 periods, the last time since ")
        assert {"read": "no cable", "malformed": "1 NaN", "jump": "joint 'x' jumped", "missing": "None"}[kind] in str(
            report
        )
        np.testing.assert_array_equal(robot.q[:26], alone.q[:26])
        assert (robot.rates[27] < alone.rates[27])[0]
        assert isinstance(
            report.error, OSError if kind == "read" else InputError if kind == "malformed" else type(None)
        )


def test_a_list_or_too_few_numbers_are_told_apart(gantry):
    reads = {3: lambda: robot.q[-1].tolist(), 4: HOME[:3], 5: "up", 6: [[0.0] * 4], 7: np.inf * GOAL}
    robot = Robot(reads)
    report = run(gantry, robot)
    assert (report.faults["malformed"], report.stopped) == (4, "")


def test_feedback_begins_again_without_a_jump(gantry):
    """While nothing is measured for 19 periods the arm is pushed 0.12 m away; then it is let go, and comes back."""
    robot, policy = Robot(dict.fromkeys(range(30, 49))), make_policy("linear-attractor", gantry, AWAY, rate=100.0)
    for k, away in [*((k, 0.12) for k in range(49, 69)), (69, 0.06)]:
        robot.reads[k] = lambda away=away: robot.q[-1] + [0.0, away, 0.0, 0.0]
    read, paces = robot.read, []
    robot.read = lambda: (paces.append(policy.pace if paces else 1.0), read())[1]
    report = run(gantry, robot, name=policy, target=AWAY, duration=1.5)
    assert (report.stopped, report.faults["missing"], sum(report.faults.values())) == ("", 19, 19)
    # The error of 0.03 of the range is fifteen times that of half the speed.
    assert min(paces[31:50]) > 0.2
    assert max(paces[51:69]) < 0.1
    assert min(paces[75:140]) > 0.9


def test_a_policy_that_plays_a_plan_is_sent_as_it_is():
    """Also where the plan uses up the limits of acceleration, and at rates that do not divide that of its samples."""
    arm = Arm.load("telescopic_rrp")
    arm = dataclasses.replace(arm, acceleration_limits=0.02 * arm.acceleration_limits)
    made = plan(arm, draw_target(arm, seed=1), planner="minimum-jerk")
    motion = made.motion
    used = np.abs(np.diff(motion.qd, axis=0)).max(axis=0) / (motion.t[1] * arm.acceleration_limits)
    assert used.max() > 0.9
    for rate in (100.0, 333.0):
        robot, policy = Robot(start=motion.q[0]), make_policy("tracker", arm, made, rate=rate)
        # At the end it rests, and so do the measured joints: they are not stale.
        how = {"duration": motion.t[-1] + 0.3, "options": LoopOptions(stale=10)}
        assert run(arm, robot, name=policy, target=made.target, **how).stopped == ""
        policy.reset(motion.q[0])
        np.testing.assert_array_equal(robot.q[1:], [policy.step(None, made.target)[0] for _ in robot.q[1:]])


def test_how_far_is_a_jump_by_hand(gantry):
    """At 50 Hz the first joint may have moved by 1 % of 2 m and by 0.02 s at 2 m/s, after a gap by the latter twice."""
    for away, usable in ((0.0599, True), (0.0601, False), (-0.0599, True), (-0.0601, False)):
        for gap in (0.0, 0.04):
            robot = Robot({2: None if gap else HOME, 3: np.array([away + np.copysign(gap, away), 0.0, 0.0, 0.0])})
            assert run(gantry, robot, target=HOME, rate=50.0, duration=0.07).faults["jump"] == (not usable)


def test_stale_measurements_brake_where_the_reference_moves(gantry):
    robot = Robot(dict.fromkeys(range(999), HOME))
    report = run(gantry, robot, target=AWAY, duration=3.0, options=LoopOptions(stale=12, missing=3))
    assert report.stopped == "all measured joints stayed equal for 13 periods while the reference moved"
    assert (report.faults["stale"], report.at_rest, len(report.lateness) < 60) == (1, True, True)
    assert "stale: 1; stopped: all measured joints" in str(report)
    # An array that is written into is no stale one, and nothing is stale where the reference rests.
    shared = HOME.copy()

    def read():
        shared[:] = robot.q[-1]
        return shared

    robot = Robot(dict.fromkeys(range(999), read))
    assert run(gantry, robot, target=AWAY, duration=1.0, options=LoopOptions(stale=2)).stopped == ""
    robot = Robot(dict.fromkeys(range(999), HOME))
    assert run(gantry, robot, name=make_policy("linear-attractor", gantry, HOME), target=HOME).stopped == ""


BAD_TARGETS = [np.nan * GOAL, GOAL[:2], np.full(4, 9.0), None, "nowhere", raising(ValueError("no target"))]


@pytest.mark.parametrize("bad", BAD_TARGETS)
def test_a_bad_target_is_refused_and_the_last_one_stays(gantry, bad):
    def target(time):
        if 0.095 < time < 0.295:
            return bad(time) if callable(bad) else bad
        return GOAL

    robot, alone = Robot(), Robot()
    report = run(gantry, robot, target=target)
    run(gantry, alone, target=GOAL)
    assert (report.stopped, report.faults["target"], sum(report.faults.values())) == ("", 20, 20)
    np.testing.assert_array_equal(robot.q, alone.q)
    with pytest.raises(ValueError, match=r"target|no keyframe|must be an array"):
        run(gantry, Robot(), target=bad if callable(bad) else lambda _: bad)


def test_a_target_written_into_is_refused_as_any(gantry):
    shared, robot, alone = GOAL.copy(), Robot(), Robot()

    def target(time):
        shared[:] = np.nan if time > 0.095 else GOAL
        return shared

    assert run(gantry, robot, target=target).faults["target"] == 50
    run(gantry, alone, target=GOAL)
    np.testing.assert_array_equal(robot.q, alone.q)


def test_what_cannot_be_written_is_written_again(gantry):
    """Ten periods in two pieces, with as many allowed in a row as there are; then one more."""
    failing = dict.fromkeys([*range(10, 16), *range(17, 21)], raising(ConnectionError("no line")))
    robot, alone = Robot(writes=failing), Robot()
    report = run(gantry, robot, options=LoopOptions(attempts=7), duration=0.5)
    run(gantry, alone, duration=0.4)
    assert (report.stopped, report.faults["write"], report.at_rest) == ("", 10, True)
    np.testing.assert_array_equal(robot.q, alone.q)
    # The very last one, too.
    robot = Robot(writes={len(alone.q) - 2: raising(OSError)})
    assert run(gantry, robot, duration=0.4).at_rest
    np.testing.assert_array_equal(robot.q, alone.q)
    robot = Robot(writes=failing)
    report = run(gantry, robot, options=LoopOptions(attempts=6), duration=0.5)
    assert report.stopped == "write raised ConnectionError('no line') 6 times in a row"
    assert (report.at_rest, len(robot.q), len(report.lateness)) == (False, 11, 16)
    assert isinstance(report.error, ConnectionError)
    # The brake needs more than two periods, and what stopped the loop first is not forgotten.
    robot = Robot(writes=dict.fromkeys(range(32, 99), raising(ConnectionError("no line"))))
    report = run(gantry, robot, stop=lambda: len(robot.q) > 30)
    assert report.stopped == "as it was told to; write raised ConnectionError('no line') 10 times in a row"
    assert not report.at_rest


def test_references_cannot_be_written_into(gantry):
    """Otherwise a change of units in place would be the next period's beginning."""
    robot, refused = Robot(), []

    def write(q, qd):
        for given in (q, qd):
            with pytest.raises(ValueError, match="read-only"):
                given *= 57.3
            refused.append(given)

    robot.write = write
    run(gantry, robot)
    assert len(refused) > 100


def test_a_plan_is_not_left_while_its_references_cannot_be_written():
    arm = Arm.load("telescopic_pr", scene="window", seed=1)
    made = plan(arm, draw_target(arm, seed=1))
    robot = Robot(writes=dict.fromkeys(range(80, 88), raising(OSError)), start=made.motion.q[0])
    report = run(
        arm,
        robot,
        name=make_policy("tracker", arm, made, rate=100.0),
        target=made.target,
        stop_outside=True,
        duration=3.0,
    )
    assert (report.stopped, report.faults["write"]) == ("", 8)


def test_late_periods_in_a_row_may_stop_it(gantry, clock):
    def wait():
        clock.now += 0.011

    for late, stopped in ((4, ""), (3, "3 references in a row were late")):
        robot = Robot(writes=dict.fromkeys([5, 6, 8, 9, 10], wait))
        report = run(gantry, robot, target=AWAY, options=LoopOptions(late=late))
        assert (report.stopped, report.missed, report.at_rest) == (stopped, 5, True)
    # The period after those three already brakes.
    assert (robot.rates[12] < robot.rates[11]).all()


class Failing(JointPolicy):
    """Goes at 0.5 m/s, and after 20 periods returns something else in place of its reference."""

    def __init__(self, arm, last):
        super().__init__(arm, 100.0, feedback=None)
        self._last, self._steps = last, 0

    def begin(self, q):
        super().begin(q)
        self._steps = 0

    def velocity(self, target, waiting):
        return np.full(4, 0.5)

    def act(self, measured, target):
        self._steps += 1
        q, qd = super().act(measured, target)
        if self._steps <= 20:
            return q, qd
        return self._last(q) if callable(self._last) else self._last, qd


@pytest.mark.parametrize(
    ("last", "says"),
    [(raising(ZeroDivisionError("oh")), "ZeroDivisionError('oh')"), (np.nan * GOAL, "finite"), (GOAL[:2], "shape")],
    ids=["raises", "nan", "shape"],
)
def test_a_policy_that_fails_is_braked(gantry, last, says):
    robot = Robot()
    report = run(gantry, robot, name=Failing(gantry, last))
    assert says in report.stopped
    assert (report.faults["raised"], report.at_rest, type(report.error).__name__) == (
        1,
        True,
        report.stopped.split("(")[0],
    )
    # From 0.5 m/s at 10 m/s^2 after 20 periods, within five more.
    assert len(robot.q) == 26
    np.testing.assert_allclose(robot.q[-1] - robot.q[20], 0.5 * 0.5 * 0.05, atol=1e-9)


def test_a_policy_that_jumps_is_followed_within_the_limits(gantry):
    """By 0.2 m at once in each joint; it is caught up with, and equal from then on."""
    robot, wanted = Robot(), []
    policy = Failing(gantry, lambda q: q + 0.2)
    act = policy.act
    policy.act = lambda *given: (wanted.append(act(*given)), wanted[-1])[1]
    report = run(gantry, robot, name=policy, duration=1.3)
    assert (report.stopped, report.at_rest) == ("", True)
    lag = np.array([q for q, _ in wanted[3:]]) - robot.q[1:131]
    np.testing.assert_array_equal(lag[:20], 0.0)
    assert (lag[20] > 0.19).all()
    # The first joint, 0.5 m/s faster at most, needs 0.4 s at least. None goes further beyond than it would in a period.
    assert 60 < np.flatnonzero(lag[:, 0] > 0.01)[-1] < 100
    assert lag.min() > -0.005
    np.testing.assert_array_equal(lag[-10:], 0.0)


@pytest.mark.parametrize("what", ["stop", "stop raises", "on_late", "duration"])
def test_every_end_comes_to_rest(gantry, clock, what):
    event, robot = threading.Event(), Robot()
    if what == "duration":
        report = run(gantry, robot, target=AWAY, duration=0.2)
        assert (report.stopped, report.error) == ("", None)
    elif what == "stop":
        # What goes wrong while it brakes is no other reason.
        robot.writes |= {19: event.set, 20: lambda: setattr(clock, "now", clock.now + 0.02)}
        report = run(gantry, robot, target=AWAY, stop=event.is_set, on_late=raising(OSError("no screen")))
        assert (report.stopped, report.error, report.faults["raised"]) == ("as it was told to", None, 1)
    elif what == "stop raises":
        report = run(gantry, robot, target=AWAY, stop=lambda: len(robot.q) > 20 and 1 / 0)
        assert report.stopped == "ZeroDivisionError('division by zero')"
    else:
        robot.writes[19] = lambda: setattr(clock, "now", clock.now + 0.02)
        report = run(gantry, robot, target=AWAY, on_late=raising(OSError("no screen")))
        assert (report.stopped, report.faults["raised"]) == ("OSError('no screen')", 1)
    # Twenty periods, and then at once, straight ahead, as fast as the slowest joint can.
    moving = robot.rates[20]
    needed = int(np.ceil((np.abs(moving) / gantry.acceleration_limits).max() * 100.0 - 1e-9))
    assert needed > 2
    assert len(robot.q) == len(report.lateness) + 1 == 21 + needed
    np.testing.assert_allclose(robot.rates[21] / moving, robot.rates[21][0] / moving[0], atol=1e-9)
    assert report.at_rest


def test_near_a_limit_the_brake_stops_before_it(gantry):
    """Both joints go at 1 m/s; the first one takes 0.1 s to rest, in which the second one would go on by 0.05 m."""

    class Swift(JointPolicy):
        def velocity(self, target, waiting):
            return np.array([1.0, 1.0, 0.0, 0.0])

    robot = Robot(start=np.array([-0.5, 1.0, 0.0, 0.0]))
    report = run(
        gantry, robot, name=Swift(gantry, 100.0, feedback=None), stop=lambda: robot.q[-1][1] > 1.95, duration=2.0
    )
    assert (report.stopped, report.at_rest) == ("as it was told to", True)
    assert 1.955 < robot.q[-1][1] <= max(q[1] for q in robot.q) <= 2.0


def press(*_):
    signal.raise_signal(signal.SIGINT)


def test_at_limits_rounding_leaves_no_rates_for_ever():
    arm, rng = Arm.load("telescopic_pr"), np.random.default_rng(0)
    for _ in range(15):
        start = np.where(rng.random(arm.n_joints) < 0.5, *arm.position_limits.T)
        sent = LimitedReference(arm, start, 0.005)
        sent.qd = rng.choice([-0.5, 0.0, 0.5], arm.n_joints) * arm.velocity_limits
        brake = MotionTracker.stopping(arm, sent.q, sent.qd, 200.0)
        for _ in range(2000):
            sent.towards(*brake.act(None, brake.end))
            if not sent.qd.any():
                break
        assert not sent.qd.any()


def test_ctrl_c_brakes_and_a_second_one_ends_at_once(gantry):
    before, robot = signal.getsignal(signal.SIGINT), Robot(writes={19: press})
    report = run(gantry, robot, target=AWAY)
    assert (report.stopped, report.at_rest, type(report.error)) == ("by Ctrl-C", True, KeyboardInterrupt)
    assert len(robot.q) < 40
    assert signal.getsignal(signal.SIGINT) is before
    robot = Robot(writes={19: press, 21: press})
    with pytest.raises(KeyboardInterrupt):
        run(gantry, robot, target=AWAY)
    assert len(robot.q) == 22
    assert signal.getsignal(signal.SIGINT) is before
    # Also in the last period, in which nothing moves any more.
    last = run(
        gantry, Robot(writes={9: press}), name=make_policy("linear-attractor", gantry, HOME), target=HOME, duration=0.1
    )
    assert (len(last.lateness), last.stopped, type(last.error)) == (10, "by Ctrl-C", KeyboardInterrupt)


def test_a_handler_of_ones_own_and_other_threads_keep_theirs(gantry, monkeypatch):
    pressed, reports = [], []
    before = signal.signal(signal.SIGINT, lambda *_: pressed.append(True))
    try:
        assert run(gantry, Robot(writes={19: press}), stop=lambda: pressed).stopped == "as it was told to"
        assert pressed == [True]
    finally:
        signal.signal(signal.SIGINT, before)
    thread = threading.Thread(target=lambda: reports.append(run(gantry, Robot())))
    thread.start()
    thread.join()
    assert reports[0].stopped == ""


def test_bad_options_are_refused(gantry):
    with pytest.raises(InputError, match="missing must be at least 1, got 0"):
        LoopOptions(missing=0)
    with pytest.raises(InputError, match="jump must be positive"):
        LoopOptions(jump=-1.0)
    with pytest.raises(InputError, match="finite"):
        run(gantry, Robot({0: HOME * np.nan}))


class Restless(JointPolicy):
    """Its references jump by up to a tenth of the ranges, and their rates do not fit them."""

    def act(self, measured, target):
        q, qd = super().act(measured, target)
        self._off = np.where(self._rng.random(4) < 0.03, 0.1 * self._rng.uniform(-1.0, 1.0, 4), self._off)
        return self._within_limits(q + self._off * self.range), qd + 10.0 * self._off

    def begin(self, q):
        super().begin(q)
        self._rng, self._off = np.random.default_rng(0), np.zeros(4)

    def velocity(self, target, waiting):
        return 3.0 * (target - self.y)


class Chaos(Robot):
    """A simulated arm around which all goes wrong at random, which counts what did: each kind for a few periods.

    Once, after some periods, its fate is that measurements freeze, something raises, or somebody stops it.
    """

    def __init__(self, arm, clock, seed):
        super().__init__()
        self.rng, self.done, self.clock, self.arm = np.random.default_rng(seed), Counter(), clock, arm
        self.rate, often = (100.0, 200.0, 500.0)[seed % 3], self.rng.uniform(0.02, 0.3)
        self.joints, self.frozen, self.goal = HOME.copy(), HOME, GOAL
        self.measured = self.bursts(often, "missing", "malformed", "read", "jump")
        self.late, self.written, self.aims = (self.bursts(0.3 * often, each) for each in ("late", "write", "target"))
        self.fate = ("freeze", "policy", "stop", "stop raises", "on_late", "Ctrl-C", "none")[seed % 7]
        self.due = self.rng.integers(20, 150)

    def bursts(self, often, *kinds):
        while True:
            yield from [""] * int(self.rng.geometric(often))
            yield from [self.rng.choice(kinds)] * int(self.rng.integers(1, 30 if self.rng.random() < 0.02 else 4))

    def happens(self, kinds):
        kind = next(kinds)
        self.done[kind] += 1
        return kind

    def is_due(self, fate):
        return self.fate == fate and len(self.q) > self.due

    def read(self):
        if len(self.q) == 1:
            return self.joints
        if not self.is_due("freeze"):
            self.frozen = self.joints + 1e-4 * self.rng.normal(size=4)
        match self.happens(self.measured):
            case "missing":
                return None
            case "malformed":
                return (HOME[:3], np.nan * HOME, [1e300] * 4, "none")[self.rng.integers(4)]
            case "read":
                raise TimeoutError
            case "jump":
                return self.joints + 2.0 * self.arm.ranges
        return self.frozen

    def write(self, q, qd):
        if self.happens(self.late):
            self.clock.now += 1.5 / self.rate
        if self.is_due("Ctrl-C") and not self.done["pressed"]:
            self.done["pressed"] = 1
            signal.raise_signal(signal.SIGINT)
        if self.happens(self.written):
            raise ConnectionError
        super().write(q, qd)
        self.joints += 0.5 * (q - self.joints)

    def target(self, time):
        if time > 0.0 and self.happens(self.aims):
            return (np.nan * GOAL, GOAL[:2], 9.0 + GOAL)[self.rng.integers(3)]
        if self.rng.random() < 0.01:
            self.goal = self.rng.uniform(0.9 * self.arm.position_limits[:, 0], 0.9 * self.arm.position_limits[:, 1])
        return self.goal

    def fail(self, *fates):
        if any(map(self.is_due, fates)):
            self.done["raised"] += 1
            raise ZeroDivisionError(self.fate)


def test_a_thousand_random_faults(gantry, clock):
    """All that went wrong is counted, references keep the limits, and every loop ends, for a reason and at rest."""
    total, ends = Counter(), Counter()
    for seed in itertools.count():
        robot = Chaos(gantry, clock, seed)
        names = ("linear-attractor", "lieednn-certified", "lieednn-replanning")
        name = names[seed % 5] if seed % 5 < 3 else Restless(gantry, robot.rate)
        policy = make_policy(name, gantry, GOAL, rate=robot.rate) if isinstance(name, str) else name
        act = policy.act
        policy.act = lambda *given, act=act, robot=robot: (robot.fail("policy"), act(*given))[1]
        report = run(
            gantry,
            robot,
            name=policy,
            target=robot.target,
            duration=2.0,
            on_late=lambda *_, robot=robot: robot.fail("on_late"),
            stop=lambda robot=robot: robot.fail("stop raises") or robot.is_due("stop"),
        )
        assert report.faults == {kind: robot.done[kind] for kind in report.faults} | {"stale": report.faults["stale"]}
        assert report.missed == robot.done["late"]
        assert gantry.limit_excess(np.array(robot.q)).max() <= 0.0
        assert len(report.lateness) < 3.0 * robot.rate
        assert report.stopped or len(report.lateness) >= 2.0 * robot.rate
        total += Counter(report.faults) + Counter(late=report.missed)
        ends[report.stopped.split("(")[0].strip("0123456789 ")[:12]] += 1
        if sum(total.values()) > 1_000 and len(ends) == 7:
            break
        assert seed < 40, ends
    # Every kind, and every reason there is.
    assert min(total[kind] for kind in ("missing", "malformed", "read", "jump", "late", "write", "target")) > 50
    assert total["raised"] > 4 < seed
    assert len(ends) == 7
