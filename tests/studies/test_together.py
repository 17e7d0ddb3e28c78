"""The problems of a comparison that most planners solved, and which of them are shown."""

import pytest

from lieednn_sim.errors import InputError
from lieednn_sim.studies import Case, Comparison, Row, Settings
from lieednn_sim.studies.comparison import together
from lieednn_sim.studies.comparison.together import choose_problems, replay_together


def test_problems_are_those_of_the_best_of_lieednn_and_others_in_turn(tmp_path):
    """Two scenes; 'dmp' fails in one, 'lieednn-shaped' succeeds once more than 'lieednn-certified'."""
    others = ["minimum-jerk", "se3-geodesic", "linear-attractor", "dmp", "promp"]
    failed = {("free", "dmp", 0), ("poles", "lieednn-certified", 0)}
    table = Comparison().open(tmp_path)
    table.add(
        [
            Row("arm", scene, planner, "pd", seed, 1.0, "contact" if (scene, planner, seed) in failed else "")
            for scene in ("free", "poles")
            for planner in ("lieednn-certified", "lieednn-shaped", *others)
            for seed in (0, 1)
        ]
    )
    first, second = choose_problems(table, 2, "pd")
    for cases in (first, second):
        assert len({(case.arm, case.scene, case.seed) for case in cases}) == 1
        assert cases[0].planner == "lieednn-shaped"
        assert len({case.planner for case in cases}) == 4
        assert {case.seed for case in cases} == {1}, "the seed that all solved"
    assert {case.planner for case in first} & {case.planner for case in second} == {"lieednn-shaped"}
    assert choose_problems(table, 1, "pd") == [first]
    assert choose_problems(table, 2, "another") == []


def test_cases_are_replayed_with_the_settings_of_their_table(tmp_path, monkeypatch):
    asked = []

    def replay(case, controller, settings, *, user_files):
        asked.append((controller, settings.duration, user_files))
        return f"rollout of {case.planner}"

    monkeypatch.setattr(together, "replay", replay)
    table = Comparison(common=Settings(duration=2.5)).open(tmp_path)
    cases = [Case("an_arm", "free", name, 3) for name in ("dmp", "minimum-jerk")]
    found = replay_together(table, cases, "mocap")
    assert found == {name: f"rollout of {name}" for name in ("dmp", "minimum-jerk")}
    assert asked == [("mocap", 2.5, ())] * 2
    with pytest.raises(InputError, match="no planner solved a problem of "):
        replay_together(table, [], "mocap")
