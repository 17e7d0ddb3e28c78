"""Policies as C99, compiled and run beside Python's: references, what is done about faults, and the page."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compiling import COMPILER, FLAGS, address, compiled, library
from mechanisms import ODD_ARM

from lieednn_sim import draw_target
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.network_planners import without_weights
from lieednn_sim.policies import Feedback, MotionTracker, NetworkPolicy, make_policy
from lieednn_sim.policies.loop_faults import LimitedReference

MISSING, JUMPED, STALE, REFUSED, FAILED, LIMITED, BRAKING, AT_REST = (1 << k for k in range(8))
PAGE = Path(__file__).resolve().parents[2] / "docs" / "howto" / "policy_as_code.md"


class Compiled:
    """An exported policy as a shared library, started at joints ``(n,)``."""

    def __init__(self, policy, folder, q) -> None:
        self.library = library(policy.to_c(folder))
        self.n, self.memory = policy.arm.n_joints, np.zeros(100_000)
        assert self.library.policy_start(address(self.memory), address(q)) == 0

    def part(self, k, count=None):
        """Entries of the struct after k times the joints."""
        return self.memory[k * self.n :][: count or self.n].copy()

    @property
    def q(self):
        return self.part(0)

    @property
    def qd(self):
        return self.part(1)

    @property
    def counts(self):
        return self.memory[4 * self.n + 2 :].view(ctypes.c_ulong)[:8].tolist()

    def start(self, q):
        return self.library.policy_start(address(self.memory), address(q))

    def step(self, measured, target):
        return self.library.policy_step(address(self.memory), address(measured), address(target))

    def stop(self):
        self.library.policy_stop(address(self.memory))


@pytest.fixture(scope="module")
def odd(tmp_path_factory):
    path = tmp_path_factory.mktemp("odd") / "scene.xml"
    path.write_text(ODD_ARM)
    return Arm.from_xml(path, "odd")


def policies(kind, request):
    """A policy that is reset, and targets."""
    name, maker, rate = kind
    if name in ("gantry", "odd"):
        arm = request.getfixturevalue(name)
        arm = replace(arm, velocity_limits=0.3 * arm.ranges, acceleration_limits=3.0 * arm.ranges)
        low, high = arm.position_limits.T
        middle, some = 0.5 * (low + high), np.random.default_rng(0).uniform(-0.25, 0.25, (9, arm.n_joints))
        targets = middle + some * (high - low)
        network = (request.getfixturevalue("cascade") if maker == "cascade" else without_weights)(
            arm.encode(targets[0])
        )
        # Hidden neurons begin so far away that a period takes several steps.
        network = network.with_start(8.0 * network.hidden_start)
        policy = NetworkPolicy(arm, network, rate, feedback=Feedback(rate=20.0))
        policy.reset(middle)
        return policy, targets
    arm = Arm.load(name)
    targets = some_targets(arm)
    return make_policy(maker, arm, targets[0], rate=rate), targets


def some_targets(arm):
    """Every second one is at limits, where a push leads beyond them."""
    targets = [draw_target(arm, seed=seed) for seed in range(9)]
    targets[1::2] = [arm.within_angles(np.clip(5.0 * target, *arm.position_limits.T)) for target in targets[1::2]]
    return targets


@compiled
@pytest.mark.parametrize(
    "kind",
    [
        ("telescopic_pr", "lieednn-shaped", 100.0),
        ("telescopic_rrp", "lieednn-certified", 500.0),
        ("telescopic_compound", "linear-attractor", 100.0),
        ("gantry", "cascade", 20.0),
        ("odd", "linear", 200.0),
    ],
    ids=lambda kind: kind[0],
)
def test_references_are_those_of_python(kind, request, tmp_path):
    """Behind an arm that lags, is pushed and measured with noise and losses, and targets that jump and move."""
    policy, targets = policies(kind, request)
    arm, rng = policy.arm, np.random.default_rng(1)
    code = Compiled(policy, tmp_path, policy.q)
    place, push, target, way = policy.q, 0.0, targets[0], 0.0
    seen, limited, pulled, rows = 0, 0, 0, []
    for k in range(400):
        if k % 80 == 0:
            target = targets[k // 80]
            way = rng.uniform(-0.1, 0.1, arm.n_joints) * (k % 160) / 80 * arm.ranges * policy.period
            push = 0.05 * rng.normal(size=arm.n_joints) * arm.ranges * (k % 240 == 0)
        if (arm.limit_excess(target + way) < 0.0).all():
            target = target + way
        place = place + (policy.q + push - place) * min(0.25, 8.0 * policy.period)
        measured = place + rng.choice([0.0, 2e-3]) * rng.normal(size=arm.n_joints) * arm.ranges
        if k % 40 < 8 and k % 3:
            measured = None
        q, qd = policy.step(measured, target)
        status = code.step(measured, target)
        assert status & ~LIMITED == (MISSING if measured is None else 0)
        rows.append([code.part(2), q, code.part(3), qd])
        assert bool(status & LIMITED) == policy._limited
        assert code.part(4, 2).tolist() == pytest.approx(policy.channels(), rel=1e-6)
        seen, limited, pulled = seen + (measured is not None), limited + bool(status & LIMITED), pulled + policy.pulled
    coded, found, coded_rates, rates = np.moveaxis(rows, 1, 0)
    np.testing.assert_allclose(coded, found, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(coded_rates, rates, rtol=0.0, atol=1e-9)
    # All of it was tried.
    assert min(seen, limited, pulled) > 20
    assert code.counts[0] == 400 - seen


@compiled
def test_it_brakes_as_the_loop_does(tmp_path):
    arm = Arm.load("telescopic_pr")
    policy = make_policy("lieednn-certified", arm, "extended", rate=100)
    code = Compiled(policy, tmp_path, policy.q)
    for _ in range(30):
        code.step(policy.q, arm.keyframe("extended"))
        policy.step(policy.q, arm.keyframe("extended"))
    assert np.abs(code.qd).max() > 0.1
    stopping = MotionTracker.stopping(arm, code.q, code.qd, 100.0)
    code.stop()
    for _ in range(60):
        q, qd = stopping.step(None, policy.q)
        status = code.step(code.q, arm.keyframe("home"))
        np.testing.assert_allclose(code.q, q, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(code.qd, qd, rtol=0.0, atol=1e-9)
        assert status == (BRAKING if qd.any() else BRAKING | AT_REST)
    assert status == BRAKING | AT_REST
    assert code.start(code.q) == 0
    assert code.step(code.q, code.q) == 0
    # It takes two periods at least.
    code.stop()
    assert [code.step(code.q, None) for _ in range(2)] == [BRAKING, BRAKING | AT_REST]


@compiled
def test_faults_are_told_and_braked_for(tmp_path):
    arm = Arm.load("telescopic_pr")
    home, goal = arm.keyframe("home"), arm.keyframe("extended")
    code = Compiled(make_policy("lieednn-certified", arm, goal, rate=100), tmp_path, home)
    statuses = lambda measured, count: [code.step(measured(), goal) & ~LIMITED for _ in range(count)]  # noqa: E731
    here = lambda: code.q  # noqa: E731
    bad = np.array([np.nan, *home[1:]])

    # Twenty periods in a row go on without feedback, one more does not.
    assert statuses(lambda: None, 10) + statuses(lambda: bad, 10) == [MISSING] * 20
    assert statuses(here, 1) == [0]
    assert statuses(lambda: np.full(8, np.inf), 21) == [MISSING] * 20 + [MISSING | BRAKING]
    assert statuses(here, 100)[-1] == BRAKING | AT_REST
    assert code.qd.tolist() == [0.0] * 8

    # In a period of 0.01 s the first joint moves by at most 0.02 rad; twice that, and 1 % of its 5.934 rad, are 0.0993.
    assert code.start(home) == 0
    aside = np.zeros(8)
    aside[0] = 0.099
    assert code.step(home + aside, home) & ~LIMITED == 0
    assert code.step(home - 0.01 * aside, home) & ~LIMITED == JUMPED
    # In two periods 0.1393.
    assert code.step(home - 0.4 * aside, home) & ~LIMITED == 0

    # The very same joints, those of the start included, while the reference goes on.
    assert code.start(home) == 0
    told = statuses(lambda: home, 200)
    first = told.index(STALE | BRAKING)
    assert first == 50
    assert set(told[:first]) == {0}
    assert told[-1] & (BRAKING | AT_REST) == BRAKING | AT_REST
    # At rest they may stay the same.
    assert code.start(home) == 0
    assert {code.step(home, home) for _ in range(100)} == {0}

    # Targets: the last one stays.
    there = np.array([code.step(code.q, goal) & ~LIMITED for _ in range(20)])
    way = code.q
    for refused in (bad, np.full(8, np.inf), np.where(np.arange(8) == 3, 0.4501, goal)):
        assert code.step(code.q, refused) & ~LIMITED == REFUSED
    assert not there.any()
    assert np.abs(code.q - goal).max() < np.abs(way - goal).max()
    assert [code.step(code.q, None) & ~LIMITED for _ in range(600)][-1] == 0
    # What is sent is the network's own reference again.
    assert (code.q == code.part(2)).all()
    np.testing.assert_allclose(code.q, goal, atol=1e-3)
    assert code.counts[3] == 3

    # One that was rounded to 32 bits is at the limit.
    assert code.step(code.q, np.where(np.arange(8) == 7, np.float32(0.3), goal)) & ~LIMITED == 0

    # No start out of reach, and no reference without a start.
    assert code.start(bad) == REFUSED
    assert code.step(home, goal) == FAILED
    assert code.start(np.where(np.arange(8) == 3, 0.46, home)) == REFUSED
    assert code.start(np.where(np.arange(8) == 3, 0.4505, home)) == 0
    assert code.q[3] == 0.45


@compiled
def test_a_start_a_little_beyond_limits_is_at_them(tmp_path):
    arm = Arm.load("telescopic_compound")
    policy = make_policy("linear-attractor", arm, "home", rate=100)
    beyond = np.zeros(24)
    beyond[1], beyond[3:6] = -0.1605, 1.6005 * np.array([0.48, -0.6, 0.64])
    code = Compiled(policy, tmp_path, beyond)
    policy.reset(beyond)
    np.testing.assert_allclose(code.q, policy.q, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(code.q[3:6]), 1.6, rtol=1e-14)


@compiled
@pytest.mark.parametrize("name", ["telescopic_pr", "telescopic_compound"])
def test_no_fault_makes_the_reference_jump(name, tmp_path):
    """Positions, speeds and accelerations keep their limits, whichever way they are found; every end is at rest."""
    arm, rng = Arm.load(name), np.random.default_rng(3)
    targets = some_targets(arm)
    policy = make_policy("lieednn-certified", arm, targets[0], rate=100)
    code = Compiled(policy, tmp_path, policy.q)
    (low, high), gain = arm.position_limits.T, 1.0011 * 0.01 * arm.acceleration_limits
    q, qd, mean, target, ends, braking = code.q, code.qd, 0.0, targets[0], 0, 0
    for _ in range(2_000):
        if rng.random() < 0.02:
            target = targets[rng.integers(9)]
        wanted, measured = target, q + 3e-3 * rng.normal(size=len(q)) * arm.ranges
        fault = rng.integers(40)
        if fault < 3:
            measured = [None, np.full(len(q), rng.choice([np.nan, np.inf, -1e308])), measured + rng.normal()][fault]
        elif fault < 6:
            wanted = [None, target + np.nan, 1e3 * target + 1.0][fault - 3]
        status = code.step(measured if rng.random() > 0.1 or braking else None, wanted)
        now, rate = code.q, code.qd
        assert ((low <= now) & (now <= high)).all()
        assert (np.abs(rate) <= 1.0011 * arm.velocity_limits).all()
        assert (np.abs(rate - qd) <= gain).all()
        before, mean = mean, 100.0 * (now - q)
        assert (np.abs(mean - before) <= 1.0001 * gain).all()
        assert (np.abs(rate - mean) <= 0.5001 * gain).all()
        q, qd, braking = now, rate, status & BRAKING
        if rng.random() < 5e-3:
            code.stop()
        if status & AT_REST:
            assert not qd.any()
            assert code.start(q) == 0
            ends, mean = ends + 1, 0.0
    assert ends > 4


@compiled
@pytest.mark.parametrize("name", ["telescopic_pr", "telescopic_compound"])
def test_what_is_sent_is_what_the_loop_sends(name, tmp_path):
    """By a network that comes to limits so fast that joints could not stop there, and turns at once."""
    arm, rng = Arm.load(name), np.random.default_rng(5)
    policy = make_policy("linear-attractor", arm, "home", rate=100, convergence_rate=20.0)
    code, rows = Compiled(policy, tmp_path, policy.q), []
    for k in range(1_560):
        if k % 390 == 0:
            side = k // 390 % 2
            limit = arm.within_angles(arm.position_limits[:, side])
            inside = np.clip(limit + (0.4 - 0.8 * side) * arm.velocity_limits, *arm.position_limits.T)
            policy.reset(inside)
            sent, brake = LimitedReference(arm, policy.q, policy.period), None
            assert code.start(policy.q) == 0
        measured = policy.q + 2e-3 * rng.normal(size=arm.n_joints) * arm.ranges * (k % 40 == 0)
        target = limit if k % 130 < 80 else inside
        reference = policy.step(measured, target)
        if k % 390 == 270 + 7 * (k // 390):
            code.stop()
            brake = MotionTracker.stopping(arm, sent.q, sent.qd, 100.0)
        sent.towards(*(reference if brake is None else brake.act(None, brake.end)))
        status = code.step(measured, target)
        rows.append([code.q, sent.q, code.qd, sent.qd])
        if brake is not None:
            assert bool(status & AT_REST) == (np.abs(sent.qd).max() <= 1e-9 and brake.message == "has ended")
    coded, wanted, coded_rates, rates = np.moveaxis(rows, 1, 0)
    # Square roots of what is left make more of rounding.
    np.testing.assert_allclose(coded, wanted, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(coded_rates, rates, rtol=0.0, atol=1e-7)


@compiled
def test_joints_that_come_to_a_limit_too_fast_brake_as_in_the_loop(tmp_path):
    """From random states near limits; policies, which brake in time by themselves, seldom lead there."""
    arm, rng = Arm.load("telescopic_pr"), np.random.default_rng(0)
    policy = make_policy("linear-attractor", arm, "home", rate=100)
    n, folder = arm.n_joints, policy.to_c(tmp_path)
    source = folder / "policy.c"
    source.write_text(
        f"{source.read_text()}void go(policy *p, const double *q, const double *qd) {{ follow(p, q, qd); }}\n"
    )
    code, memory = library(folder), np.zeros(100_000)
    code.policy_start(address(memory), address(policy.q))
    sent, v = LimitedReference(arm, policy.q, 0.01), arm.velocity_limits
    for _ in range(300):
        side = rng.integers(2, size=n)
        limit, way = arm.position_limits[np.arange(n), side], 2.0 * side - 1.0
        # So slowly at the limit itself that they can turn back at once.
        speed = np.minimum(v, rng.choice([0.02, 10.0]) * arm.acceleration_limits) * rng.random(n)
        sent.q, sent.qd = limit - way * (speed * rng.choice([0.01, 1.0], n) * rng.random(n)), way * speed
        memory[: 2 * n] = *sent.q, *sent.qd
        wished = limit + way, way * v
        sent.towards(*wished)
        code.go(address(memory), *map(address, wished))
        np.testing.assert_allclose(memory[: 2 * n], [*sent.q, *sent.qd], rtol=0.0, atol=1e-9)


TURNERS = """<mujoco><compiler angle="radian"/><worldbody><site name="base_frame"/><body>
  <joint name="/*int" axis="0 0 1" range="-1 1" damping="1"/><geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
  <body pos="0.3 0 0"><joint name="*/" axis="0 1 0" range="-1 1" damping="1"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/></body></body></worldbody></mujoco>"""
WRAPPED = """#define LIEEDNN_API static inline
#include "{0}/lieednn.c"
#include "{0}/policy.c"
#ifdef __cplusplus
extern "C"
#endif
unsigned {0}_begin(policy *p, const double *q);
unsigned {0}_begin(policy *p, const double *q) {{ return policy_start(p, q) ? 0 : POLICY_JOINTS; }}
"""


@compiled
@pytest.mark.parametrize("language", ["c", "c++"])
def test_two_arms_are_in_one_program_of_c_or_cpp_without_a_warning(language, tmp_path):
    """Those of few joints, and with odd names, too. C and C++ call each other's functions."""
    if language == "c++" and not shutil.which("c++"):
        pytest.skip("there is no C++ compiler")
    (tmp_path / "turners.xml").write_text(TURNERS)
    arms = {"left": Arm.load(tmp_path / "turners.xml"), "right": Arm.load("telescopic_pr")}
    for name, arm in arms.items():
        make_policy("linear-attractor", arm, arm.keyframe("home"), rate=100.0).to_c(tmp_path / name)
        (tmp_path / f"{name}.c").write_text(WRAPPED.format(name))
    compiler = [COMPILER, *FLAGS] if language == "c" else ["c++", "-x", "c++", *FLAGS[2:]]
    for program in ([tmp_path / "left.c", tmp_path / "right.c"], sorted((tmp_path / "left").glob("*.c"))):
        made = tmp_path / f"{program[0].stem}.so"
        subprocess.run([*compiler, "-O0", "-shared", "-fPIC", *program, "-o", made, "-lm"], check=True)
    both, alone = ctypes.CDLL(str(tmp_path / "left.so")), ctypes.CDLL(str(tmp_path / "lieednn.so"))
    for name, arm in arms.items():
        memory = np.zeros(100_000)
        assert both[f"{name}_begin"](address(memory), address(arm.keyframe("home"))) == arm.n_joints
    assert alone.policy_start(address(memory), address(np.zeros(2))) == 0


def test_what_has_no_c_code_is_refused(tmp_path):
    arm = Arm.load("telescopic_pr")
    with pytest.raises(InputError, match="a ReplanningPolicy has no C code, only a NetworkPolicy has"):
        make_policy("lieednn-replanning", arm, "extended").to_c(tmp_path)
    with pytest.raises(InputError, match="'telescopic_crane' move others, or tendons, that have ranges of their own"):
        make_policy("linear-attractor", Arm.load("telescopic_crane"), "home").to_c(tmp_path)


@compiled
def test_the_page_runs(tmp_path, monkeypatch):
    """Each packet waits for the other side, however busy the machine is."""
    export, robot = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (main,) = re.findall(r"^```c\n(/\* main\.c.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(time, "sleep", lambda _: None)
    names: dict = {}
    exec(export, names)
    Path("controller/main.c").write_text(main)
    sources = sorted(Path("controller").glob("*.c"))
    subprocess.run([COMPILER, *FLAGS, *sources, "-o", "controller/run", "-lm"], check=True)
    exec(robot.replace("sockname()[1])]", 'sockname()[1]), "30"]'), names)
    assert names["controller"].returncode == 0
    assert names["status"] == BRAKING | AT_REST | MISSING
    assert abs(names["measured"] - names["target"]).max() < 2e-3
