"""The problem of a comparison that most planners solved, and which of them are shown."""

import pytest

from lieednn_sim.errors import InputError
from lieednn_sim.studies.comparison import together
from lieednn_sim.studies.comparison.cases import Settings
from lieednn_sim.studies.comparison.rows import Case, Row
from lieednn_sim.studies.comparison.study import Comparison


def row(planner, scene, error, *, success=True):
    return Row("an_arm", scene, planner, "mocap", 3, 1.0, "" if success else "contact", tracking_rms_mm=error)


def test_the_problem_that_most_planners_solved_is_replayed_networks_first(tmp_path, monkeypatch):
    table = Comparison(common=Settings(duration=2.5)).open(tmp_path / "table")
    table.add([row("minimum-jerk", "window", 0.1), row("rrt-connect", "window", 0.1, success=False)])
    asked = []

    def replay(case, controller, settings, *, user_files):
        asked.append((case, controller, settings.duration, user_files))
        return f"rollout of {case.planner}"

    monkeypatch.setattr(together, "replay", replay)
    assert list(together.replay_together(table.directory)) == ["minimum-jerk"]
    table.add([row("dmp", "free", 0.2), row("minimum-jerk", "free", 0.1), row("lieednn-shaped", "free", 9.0)])
    found = together.replay_together(table.directory, 2)
    assert list(found) == ["lieednn-shaped", "minimum-jerk"]
    assert found["minimum-jerk"] == "rollout of minimum-jerk"
    assert asked[-1] == (Case("an_arm", "free", "minimum-jerk", 3), "mocap", 2.5, ())
    none = Comparison(common=Settings()).open(tmp_path / "none")
    none.add([row("dmp", "free", 0.2, success=False)])
    with pytest.raises(InputError, match="no planner solved a problem"):
        together.replay_together(none.directory)
