"""The front door: lazily imported rooms, and results that print in a few lines."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim import versions
from lieednn_sim.errors import InputError
from lieednn_sim.learning import TrainingOptions, train


def test_rooms_are_there_without_being_imported_before_and_no_more_than_is_needed():
    """Subpackages of SciPy take twice as long as MuJoCo; what starts a process or sets a variable is rendering's."""
    code = """
import os, subprocess, sys, scipy
before, loaded = dict(os.environ), set(sys.modules)
def refuse(*_, **__):
    raise AssertionError("a process was started")
subprocess.Popen.__init__ = refuse
import lieednn_sim as ls
from lieednn_sim.cli import console
assert "lie" in dir(ls)
print(ls.arm.Arm.__name__, *[name for name in set(sys.modules) - loaded if name.startswith("scipy.")])
print(ls.lie.hat.__name__, ls.simulation.Rollout.__name__, ls.Arm.load("telescopic_pr").name)
assert dict(os.environ) == before, set(os.environ.items()) ^ set(before.items())
"""
    environment = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "LIEEDNN_SIM_GL")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "Arm\nhat Rollout telescopic_pr\n"), done.stderr
    with pytest.raises(AttributeError, match="no attribute 'plans'"):
        ls.plans  # noqa: B018


def test_a_checkout_that_is_on_the_path_but_not_installed_has_no_version(monkeypatch):
    monkeypatch.setattr(versions, "_version", versions._version.__wrapped__)
    monkeypatch.setattr(versions, "installed", {"mujoco": "3.17.0", "numpy": "2.4", "scipy": "1.17"}.get)
    assert versions.versions()["lieednn_sim"] == ls.__version__ == "unknown"


def test_a_keyframe_is_a_configuration_wherever_one_is_given():
    arm = ls.Arm.load("telescopic_pr")
    home, target = arm.keyframe("home"), arm.keyframe("extended")
    named, given = (
        ls.plan(arm, q, start=q0, planner="minimum-jerk") for q, q0 in (("home", "extended"), (home, target))
    )
    np.testing.assert_array_equal(named.motion.q, given.motion.q)
    np.testing.assert_array_equal(ls.plan(arm, target, planner="minimum-jerk").motion.q[0], home)
    policies = [
        ls.make_policy("linear-attractor", arm, q, start=q0) for q, q0 in (("extended", "home"), (target, home))
    ]
    runs = [ls.follow(one, q, 0.05, start="retracted") for one, q in zip(policies, ("extended", target), strict=True)]
    np.testing.assert_array_equal(runs[0].rollout.q, runs[1].rollout.q)
    np.testing.assert_array_equal(runs[1].target, np.tile(target, (26, 1)))
    known = f"no keyframe 'extendde'; keyframes of telescopic_pr: {', '.join(arm.keyframes)}"
    for call in (
        lambda: ls.plan(arm, "extendde"),
        lambda: ls.make_policy("tracker", arm, target, start="extendde"),
        lambda: ls.follow(policies[0], "extendde", 0.1),
        lambda: ls.solve_ik(arm, [0.5, 0.5, 0.5], start="extendde"),
    ):
        with pytest.raises(InputError, match=known):
            call()


def test_a_seed_may_be_a_generator():
    arm = ls.Arm.load("telescopic_pr")
    goal, target = arm.keyframe("extended"), 0.3 * np.ones((2, 6))
    given = {"options": TrainingOptions.tracked(max_epochs=2)}
    calls = {
        "draw_target": lambda seed: ls.draw_target(arm, seed),
        "synthesize": lambda seed: ls.synthesize(target, seed=seed).network.weight,
        "train": lambda seed: ls.train(target, seed=seed, **given).weight,
        "plan": lambda seed: ls.plan(arm, "extended", planner="qshnn", seed=seed).motion.q,
        "scene": lambda seed: ls.Arm.load("telescopic_pr", "poles", seed).model.geom_pos,
        "policy": lambda seed: ls.make_policy("mppi", arm, "extended", seed=seed).step(None, goal)[1],
    }
    for name, call in calls.items():
        rng = np.random.default_rng(1)
        first, second = call(rng), call(rng)
        assert not np.array_equal(first, second), name
        np.testing.assert_array_equal(call(np.random.default_rng(1)), first)
        np.testing.assert_array_equal(call(np.random.SeedSequence(1)), first)
        np.testing.assert_array_equal(call(np.int64(3)), call(3))
    with pytest.raises(InputError, match="seed must be a whole number, got a Generator"):
        ls.Disturbances(position_noise=0.1, seed=rng)


def test_every_result_has_a_short_repr():
    arm = ls.Arm.load("telescopic_pr")
    target = arm.keyframe("extended")
    planned = ls.plan(arm, target, planner="lieednn-shaped", duration=2.0)
    network, rollout = planned.network, ls.simulate(arm, planned, hold=0.0)
    policy = ls.NetworkPolicy(arm, network)
    following = ls.follow(policy, lambda t: target, 0.2)
    evaluation, xi = ls.evaluate(rollout), arm.encode(target)
    trained = train(xi, TrainingOptions.tracked(max_epochs=2))
    results = [arm, planned, planned.motion, rollout, following, evaluation, ls.evaluate_following(following)]
    results += [evaluation.end_effector, network, network.certificate, network.assess(), network.robustness()]
    results += [network.equilibrium(), network.trajectory(network.start(planned.motion.xi[0]), 1.0)]
    results += [trained, trained.history, ls.synthesize(xi, bias="sign-matched"), ls.simulate_many(arm, [planned])]
    results += [policy, ls.plan(arm, target, planner="minimum-jerk")]
    for result in results:
        assert len(repr(result)) < 700, type(result)
    x, y, z = arm.tip(planned.motion.q[-1])
    assert str(planned).splitlines() == [
        f"lieednn-shaped: telescopic_pr in 2 s, end effector to ({x:.3f}, {y:.3f}, {z:.3f}) m",
        str(network.certificate),
        f"clearance: {planned.clearance}",
    ]
    assert repr(policy) == "<NetworkPolicy of telescopic_pr at 100 Hz, certified>"
    assert str(results[-1]).splitlines()[1] == "no network, no proof"
    following = ls.follow(policy, lambda t: (1.0 - t) * arm.keyframe("home") + t * target, 0.2)
    errors = ls.evaluate_following(following)
    assert str(errors).startswith(f"{1e3 * errors.lag_s:.3g} ms behind the target, end effector {errors.rms_mm:.3g} mm")
    assert repr(evaluation).startswith("<Evaluation of telescopic_pr, free, by position-servo: arrives after ")
    assert repr(network.assess()) == f"<Verdict: {str(network.assess()).splitlines()[0]}>"
    assert np.isfinite(evaluation.final_worst_mm)
