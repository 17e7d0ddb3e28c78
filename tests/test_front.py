"""The front door: lazily imported rooms, and results that print in a few lines."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim.evaluation import evaluate_following
from lieednn_sim.learning import TrainingOptions, train


def test_rooms_are_there_without_being_imported_before():
    code = "import lieednn_sim as ls; assert 'lie' in dir(ls); print(ls.planning.plan.__name__, ls.lie.hat.__name__)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "plan hat\n"
    with pytest.raises(AttributeError, match="no attribute 'plans'"):
        ls.plans  # noqa: B018


def test_every_result_has_a_short_repr():
    arm = ls.Arm.load("telescopic_pr")
    target = arm.keyframe("extended")
    planned = ls.plan(arm, target, planner="lieednn-shaped", duration=2.0)
    network, rollout = planned.network, ls.simulate(arm, planned, hold=0.0)
    following = ls.follow(ls.NetworkPolicy(arm, network), lambda t: target, 0.2)
    evaluation, xi = ls.evaluate(rollout), arm.encode(target)
    trained = train(xi, TrainingOptions.tracked())
    results = [arm, planned, planned.motion, rollout, following, evaluation, evaluate_following(following)]
    results += [evaluation.end_effector, network, network.certificate, network.assess(), network.robustness()]
    results += [network.equilibrium(), network.trajectory(network.start(planned.motion.xi[0]), 1.0)]
    results += [trained, trained.history, ls.synthesize(xi, bias="sign-matched"), ls.simulate_many(arm, [planned])]
    for result in results:
        assert len(repr(result)) < 700, type(result)
    assert repr(evaluation).startswith("<Evaluation of telescopic_pr, free, by position-servo: ends 0")
    assert repr(network.assess()) == f"<Verdict: {str(network.assess()).splitlines()[0]}>"
    assert np.isfinite(evaluation.final_worst_mm)
