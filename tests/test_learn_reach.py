"""Figures and tables of the study of learning, without the libraries that it needs."""

from __future__ import annotations

import learn_reach
import numpy as np
import pytest


def test_jerk_and_time_of_arrival_by_hand():
    # Velocities t^2 of one joint and rest of the other: second differences of 2 and of 0.
    t = 0.1 * np.arange(6.0)
    velocities = np.column_stack([t**2, 0.0 * t])
    assert learn_reach.jerk(velocities, 0.1) == pytest.approx(np.sqrt(2.0))
    assert learn_reach.arrival([False, True, False, True, True]) == pytest.approx(0.3)
    assert learn_reach.arrival([True, True]) == 0.0
    assert learn_reach.arrival([False, True, False]) is None


def test_the_expert_is_evaluated_and_random_actions_fail():
    where = learn_reach.environment()
    rows = learn_reach.evaluate(learn_reach.expert_of(where), 1, where)
    assert rows["success"] == [True]
    assert 0.0 < rows["goal_s"][0] < 5.0
    assert rows["mm"][0] < 1.0
    rng = np.random.default_rng(0)
    assert learn_reach.evaluate(lambda _: rng.uniform(-1.0, 1.0, 8), 1)["success"] == [False]


@pytest.mark.usefixtures("drawing")
def test_the_table_has_means_ranges_and_pooled_quantiles(tmp_path):
    def made(success, mm, **more):
        last = {"success": success, "mm": mm, "deg": [0.1, 0.1], "jerk": [1.0, 3.0], "goal_s": [2.0, None]}
        return {"last": last, **more}

    clones = [
        made([True, True], [0.0, 1.0], curve=[[10, 0.0], [20, 1.0]], cpu_s=60.0),
        made([True, False], [2.0, 3.0], curve=[[10, 0.5], [20, 1.0]], cpu_s=120.0),
    ]
    runs = {learn_reach.EXPERT: [made([True, True], [0.0, 0.0])], "clone": clones}
    expert, clone = learn_reach.report(runs)[-2:]
    assert expert == "| expert |  | 100 (100 to 100) | 0 | 0 | 0.1 | 0.1 | 2 | 2.0 |  |"
    assert clone == "| clone | 20 | 75 (50 to 100) | 1.5 | 2.85 | 0.1 | 0.1 | 2 | 2.0 | 1.5 |"
    learn_reach.plot(runs, tmp_path / "learning.png")
    assert (tmp_path / "learning.png").stat().st_size > 1000
