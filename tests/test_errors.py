"""Two kinds of failure, never mixed: bad input, and a search that found nothing for good input."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim import errors, simulation
from lieednn_sim.arm import Arm, targets
from lieednn_sim.environments import tasks
from lieednn_sim.errors import InputError, NoSolutionError


def test_each_error_is_of_one_kind():
    searches = {errors.NotCertifiedError, errors.PlanError, errors.TooFastError, errors.OutOfTimeError}
    kinds = {one for one in vars(errors).values() if isinstance(one, type) and issubclass(one, errors.LieEDNNError)}
    assert {one for one in kinds if issubclass(one, NoSolutionError)} == {NoSolutionError, *searches}
    assert not issubclass(NoSolutionError, ValueError | OSError)
    assert issubclass(InputError, ValueError)
    assert issubclass(InputError, errors.LieEDNNError)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda error: pickle.loads(pickle.dumps(error))])
def test_errors_come_back_from_other_processes(copied):
    """One that cannot be unpickled breaks a pool of processes."""
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, errors.LieEDNNError)]
    others = [kind("why") for kind in kinds if kind is not errors.TooFastError]
    for error in (errors.TooFastError("why", 2.0), *others):
        error.add_note("a case")
        again = copied(error)
        assert (type(again), str(again), vars(again)) == (type(error), "why", vars(error))


@pytest.mark.parametrize(
    "search",
    [
        lambda: targets.draw_target(Arm.load("telescopic_pr")),
        lambda: targets.draw_target(Arm.load("telescopic_pr", "window")),
        lambda: tasks.band_limited(Arm.load("telescopic_pr"), np.random.default_rng(0), 1.0),
    ],
)
def test_what_is_drawn_in_vain_was_no_bad_input(search, monkeypatch):
    for module, attempts in ((targets, "_ATTEMPTS"), (tasks, "_DRAWS")):
        monkeypatch.setattr(module, attempts, 0)
    with pytest.raises(NoSolutionError, match=r"^no (target|random trajectory)") as failed:
        search()
    assert not isinstance(failed.value, InputError)


FRONT_DOOR = {
    "arm must be an Arm, got {}; see Arm.load": [
        lambda other: ls.plan(other, np.zeros(8)),
        lambda other: ls.simulate(other, None),
        lambda other: ls.make_policy("tracker", other, np.zeros(8)),
        lambda other: ls.solve_ik(other, [1.0, 0.0, 1.0]),
        lambda other: simulation.Simulation(other),
    ],
    "motion must be a Plan or a Motion or a PlanSequence, got {}; see plan": [
        lambda other: ls.simulate(Arm.load("telescopic_pr"), other)
    ],
    "motions[0] must be a Plan or a Motion, got {}; see plan": [
        lambda other: simulation.simulate_many(Arm.load("telescopic_pr"), [other])
    ],
    "rollout must be a Rollout, got {}; see simulate": [
        lambda other: ls.evaluate(other),
        lambda other: ls.render_video(other, "video.mp4"),
    ],
    "path must be a string or a path, got {}": [
        lambda other: ls.LieEDNN.load(None if other is None else [other]),
        lambda other: simulation.Rollout.load(None if other is None else [other], None),
    ],
}


@pytest.mark.parametrize("other", ["telescopic_pr", None])
@pytest.mark.parametrize(("message", "call"), [(words, call) for words, calls in FRONT_DOOR.items() for call in calls])
def test_an_argument_of_another_kind_is_named_with_what_is_needed(message, call, other):
    given = "a list of 1" if "path" in message and other is not None else repr(other)
    with pytest.raises(InputError) as failed:
        call(other)
    assert str(failed.value) == message.format(given)
