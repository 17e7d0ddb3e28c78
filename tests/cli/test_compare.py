"""``lieednn-sim compare``: files, messages, refusals."""

from __future__ import annotations

from lieednn_sim.cli import main
from lieednn_sim.studies import Comparison
from lieednn_sim.studies.reactions import study
from lieednn_sim.studies.reactions.study import COMPARED, DISTURBANCES, Reaction

ARGUMENTS = ["--planners", "minimum-jerk", "--arms", "telescopic_pr", "--scenes", "free", "--seeds", "1"]
ARGUMENTS += ["--controllers", "computed-torque", "--duration", "1", "--hold", "0.1", "--jobs", "1", "--output"]


def test_the_command_writes_table_summary_and_page(tmp_path, capsys):
    words = [*ARGUMENTS, str(tmp_path / "out"), "--mass-scale", "1.2", "--time-budget", "50"]
    assert main(["compare", *words]) == 0
    assert "arrived: minimum-jerk 1 of 1" in capsys.readouterr().out
    names = {"comparison.sqlite", "comparison.csv", "comparison.md", "comparison.html", "lieednn_sim.json"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names
    table = Comparison.read(tmp_path / "out")
    assert table.settings == {"duration": 1.0, "hold": 0.1, "mass_scale": 1.2, "time_budget": 50.0}
    (row,) = table.rows.values()
    assert (row.planner, row.controller, row.mass_scale) == ("minimum-jerk", "computed-torque", 1.2)
    assert "lieednn-sim compare --planners minimum-jerk" in (tmp_path / "out" / "comparison.html").read_text("utf-8")


def test_planners_that_react_have_a_table_and_a_section_of_the_page(tmp_path, monkeypatch, undrawn):
    def ran(arm, scene, policy, seed):
        return [Reaction(arm, scene, policy, name, seed, step_us=7.25) for name in DISTURBANCES]

    monkeypatch.setattr(study.Reactions, "run", staticmethod(ran))
    assert main(["compare", *ARGUMENTS, str(tmp_path), "--reactive", "1", "--views", "0"]) == 0
    assert "| free | push | fabric | 1 of 1 | 0 | 0 |" in (tmp_path / "reactions.md").read_text("utf-8")
    page = (tmp_path / "comparison.html").read_text("utf-8")
    assert page.count("<td>payload</td>") == len(COMPARED)
    assert '<details id="reactions">' in page
    assert ">7.25<" in page
