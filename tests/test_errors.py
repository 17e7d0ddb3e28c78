"""Two kinds of failure, never mixed: bad input, and a search that found nothing for good input."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim import errors
from lieednn_sim.arm import Arm, targets
from lieednn_sim.environments import tasks, trajectories
from lieednn_sim.errors import InputError, NoSolutionError


def test_each_error_is_of_one_kind():
    searches = {errors.NotCertifiedError, errors.PlanError, errors.TooFastError, errors.OutOfTimeError}
    kinds = {one for one in vars(errors).values() if isinstance(one, type) and issubclass(one, errors.LieEDNNError)}
    assert {one for one in kinds if issubclass(one, NoSolutionError)} == {NoSolutionError, *searches}
    assert not issubclass(NoSolutionError, ValueError | OSError)


@pytest.mark.parametrize(
    "search",
    [
        lambda: targets.draw_target(Arm.load("telescopic_pr")),
        lambda: targets.draw_target(Arm.load("telescopic_pr", "window")),
        lambda: trajectories.band_limited(Arm.load("telescopic_pr"), np.random.default_rng(0), 1.0),
        lambda: tasks.make_task("track", reference="plan").begin(np.random.default_rng(0)),
    ],
)
def test_what_is_drawn_in_vain_was_no_bad_input(search, monkeypatch):
    for module in (targets, trajectories, tasks):
        monkeypatch.setattr(module, "_ATTEMPTS", 0)
    with pytest.raises(NoSolutionError, match=r"^no (target|random trajectory|plan)") as failed:
        search()
    assert not isinstance(failed.value, InputError)
