"""Scripts that no other test runs, each on as little as it can do."""

from __future__ import annotations

import pickle
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cost_over_time
import evaluate_demonstrations
import numpy as np
import picture_arms
import pytest
import real_robots
import robustness
import settling
import shaped
from common import saved_rows
from PIL import Image

from lieednn_sim.arm import Arm
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.errors import FileError, NoSolutionError
from lieednn_sim.planning.motion import Motion
from lieednn_sim.registry import RIVALS


@pytest.mark.rendering
def test_the_picture_of_the_arms(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(picture_arms, "SIZE", (64, 48))
    monkeypatch.setattr(picture_arms, "ALONE", ("telescopic_pr",))
    monkeypatch.setattr(picture_arms, "AMONG", (("telescopic_pr", "free", 1),))
    path = tmp_path / "arms.jpg"
    picture_arms.main(str(path))
    assert capsys.readouterr().out == f"{path}\n"
    with Image.open(path) as picture:
        assert picture.size == (64, 96)


@pytest.mark.usefixtures("drawing")
def test_the_tables_of_loads_that_swing_go_on_where_they_were(tmp_path, monkeypatch):
    monkeypatch.setattr(settling, "LAWS", ("none", "ei", "least-energy"))
    loads = ({}, {"mass": 0.8}, {"length": 0.8})
    monkeypatch.setattr(settling, "LOADS", loads)
    monkeypatch.setattr(settling, "FACTORS", (0.8, 1.0))
    monkeypatch.setitem(settling.TASKS, "crane", replace(settling.TASKS["crane"], cases=1, loads=loads))
    monkeypatch.setattr(settling, "MOTIONS", 1)
    words = ["--tasks", "crane", "--planners", "lieednn-shaped,minimum-jerk", "--output", str(tmp_path)]
    settling.main(words)
    table = (tmp_path / "settling.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line.startswith("| ")]
    plain, ei, calm = (next(row for row in rows if row[1] == law) for law in settling.LAWS)
    assert (calm[0], calm[2], calm[3], calm[8]) == ("lieednn-shaped", "1 of 1", "8", "1")
    assert float(calm[5]) < 0.05 < 0.15 < float(plain[5])
    assert "| minimum-jerk | none | 0 of 1 | - |" in table
    (ratio,) = re.findall(r"in 1 of 1 plans. The median ratio is (\S+)\.$", table, re.MULTILINE)
    assert float(ratio) == pytest.approx(float(calm[4]) / float(ei[4]), rel=0.05)
    (varied,) = [row for row in rows if row[:2] == ["crane", "least-energy"]]
    assert float(varied[2]) == pytest.approx(float(calm[5]), abs=1e-3)
    assert all(0.0 < float(value) < 0.1 for value in varied[2:])
    assert len(set(varied[2:])) == len(loads), "each load swings in its own way"
    # Of a random motion the linear model knows the energy that is left.
    assert rows[-1][:3] == ["crane", "1", "1"]
    with Image.open(tmp_path / "settling.png") as picture:
        assert min(picture.size) > 100
    arm, _ = settling.boom(0)
    assert [round(mode.frequency, 1) for mode in PassiveJoints(arm).modes(arm.keyframe("home"))] == [0.8, 0.8]
    for name in ("measured", "linear"):
        monkeypatch.setattr(settling, name, None)
    monkeypatch.setattr(settling, "plot", lambda *_: None)
    settling.main(words)
    assert (tmp_path / "settling.md").read_text() == table


class Pickling(ThreadPoolExecutor):
    """Threads that take only what could go to other processes."""

    def map(self, *work, **options):
        return super().map(*pickle.loads(pickle.dumps(work)), **options)


def test_bounds_are_measured_and_a_broken_one_is_told(tmp_path, monkeypatch, capsys):
    path = tmp_path / "robustness.md"
    monkeypatch.setattr(robustness, "worker_pool", Pickling)  # whose workers have a line below as well
    assert robustness.main(["--cases", "3", "--output", str(path)]) == 0
    assert path.read_text() in capsys.readouterr().out
    assert path.read_text().count("| 1 | 0 |") == 8 * len(robustness.KINDS)
    monkeypatch.setattr(robustness, "unstable_step", lambda jacobian, method: 1e-9)
    assert robustness.main(["--cases", "1", "--output", str(path)]) == 1


ROBOT = """
<mujoco><worldbody><body name="foot"><geom size=".04"/>
  <body name="upper" pos="0 0 .1"><joint name="a" axis="0 1 0" range="-170 170"/>
    <geom type="capsule" size=".02" fromto="0 0 .05 0 0 .3"/>
    <body name="fore" pos="0 0 .4"><joint name="b" axis="0 1 0" range="-120 120"/>
      <geom type="capsule" size=".02" fromto="0 0 .05 0 0 .5"/></body></body></body></worldbody>
</mujoco>
"""


def test_the_table_of_real_robots(tmp_path, monkeypatch, capsys):
    (tmp_path / "reacher").mkdir()
    (tmp_path / "reacher" / "reacher.xml").write_text(ROBOT)
    (tmp_path / "reacher" / "broken.xml").write_text("<mujoco/>")
    names = "reacher/reacher.xml,reacher/broken.xml,reacher/none.xml"
    words = [str(tmp_path), "--robots", names, "--targets", "1", "--output", str(tmp_path / "out")]
    real_robots.main(words)
    table = (tmp_path / "out" / "robots.md").read_text()
    row = next(line for line in table.splitlines() if line.startswith("| reacher/reacher |"))
    assert row.count("| 1 of 1 ") == 4
    assert "| 2 | 2 |" in row
    assert "| reacher/broken | not loaded |" in table
    assert "reacher/none.xml: not there" in capsys.readouterr().out
    # In the original model a folded arm is in its own foot.
    arm = Arm.load(tmp_path / "reacher" / "reacher.xml")
    original = real_robots._Original(arm, tmp_path / "reacher" / "reacher.xml")
    assert original.forward_error() < 1e-14
    t = np.array([0.0, 1.0])
    for q, depth in (([0.0, 0.0], 0.0), ([0.0, np.pi], 0.05)):
        still = Motion(
            t, t, arm.encode([q, q]), arm.encode(q), np.array([q, q]), np.zeros((2, 2)), *np.zeros((2, 2, 2))
        )
        assert (original.penetration(still) > depth) == (depth > 0.0)
    monkeypatch.setattr(real_robots, "try_robot", None)
    real_robots.main(words)
    assert (tmp_path / "out" / "robots.md").read_text() == table


def test_the_table_of_demonstrations(tmp_path, monkeypatch):
    (tmp_path / "robottasks").mkdir()
    s = np.linspace(0.0, 1.0, 30)[:, None]
    turns = np.concatenate([np.cos(0.4 * s), np.sin(0.4 * s), 0.0 * s, 0.0 * s], axis=1)
    rows = [np.concatenate([20.0 * (1.0 - s), k * s * (1.0 - s), 0.0 * s, turns], axis=1) for k in (8.0, 9.0)]
    np.save(tmp_path / "robottasks" / "bend.npy", rows)
    monkeypatch.setattr("lieednn_sim.studies.demonstrations.models.SAMPLES", 60)
    words = [str(tmp_path), "--starts", "3", "--output", str(tmp_path / "out")]
    evaluate_demonstrations.main(words)
    first = (tmp_path / "out" / "demonstrations.md").read_text()
    assert "| bend | lieednn-shaped | 40 |" in first
    assert "- Every start arrives, and there is no other attractor: holds.\n" in first
    assert first.count("| 3/3 | 0 |") == 1 + len(RIVALS)
    # What is there is not computed again.
    monkeypatch.setattr(evaluate_demonstrations, "scores", None)
    evaluate_demonstrations.main(words)
    assert (tmp_path / "out" / "demonstrations.md").read_text() == first


def test_cost_over_time_is_the_best_of_all_runs_until_then():
    def run(planner, seed, length, cpu_s):
        return {"planner": planner, "arm": "arm", "seed": seed, "length": length, "cpu_s": cpu_s}

    none = np.inf
    runs = [
        run("rrt-star", 0, 3.0, 0.2),
        # More work, and a longer path: the one before stays.
        run("rrt-star", 0, 4.0, 0.4),
        run("rrt-star", 0, 2.0, 3.0),
        run("stomp", 0, 2.5, 0.6),
        run("rrt-star", 1, none, 0.3),
        run("rrt-star", 1, 6.0, 0.9),
        run("stomp", 1, 5.0, 20.0),
        run("stomp", 2, 1.0, 0.5),
        run("rrt-star", 2, none, 0.1),
    ]
    ratios = cost_over_time.best_by(runs, (0.25, 1.0, 4.0))
    np.testing.assert_allclose(ratios["rrt-star"], [[1.5, 1.5, 1.0], [none, 1.2, 1.2], [none, none, none]])
    np.testing.assert_allclose(ratios["stomp"], [[none, 1.25, 1.25], [none, none, none], [none, 1.0, 1.0]])
    told = cost_over_time.report(runs, "command")
    assert told[-2] == "| rrt-star | - (1) | - (1) | 1.500 (2) | 1.500 (2) | 1.200 (2) | 1.200 (2) | 3 |"
    assert told[-1] == "| stomp | - (0) | - (1) | 1.250 (2) | 1.250 (2) | 1.250 (2) | 1.250 (2) | 20 |"


@pytest.mark.usefixtures("drawing")
def test_cost_over_time_measures_and_draws(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(cost_over_time.LADDERS, "stomp", ("rounds", (1, 2)))
    monkeypatch.setattr(cost_over_time, "FIRST_SEED", 2)
    words = ["--planners", "stomp", "--seeds", "1", "--arms", "telescopic_pr", "--output"]
    cost_over_time.main([*words, str(tmp_path)])
    text = (tmp_path / "cost_over_time.md").read_text()
    assert text in capsys.readouterr().out
    names = {path.stem for path in (tmp_path / "runs").iterdir()}
    assert names == {"stomp-telescopic_pr-2-1", "stomp-telescopic_pr-2-2"}
    with Image.open(tmp_path / "cost_over_time.png") as picture:
        assert min(picture.size) > 100
    # What is there is not made again, and the table is the same.
    monkeypatch.setattr(cost_over_time, "measured", None)
    monkeypatch.setattr(cost_over_time, "plot", lambda *_: None)
    cost_over_time.main([*words, str(tmp_path)])
    assert capsys.readouterr().out == f"{text}\n"
    with pytest.raises(SystemExit):
        cost_over_time.main(["--planners", "minimum-jerk"])


def test_shaped_networks_are_measured_beside_their_guides(tmp_path):
    output = tmp_path / "new" / "folder"
    words = ["--arms", "telescopic_pr", "--scenes", "window", "--seeds", "1", "--output", str(output)]
    shaped.main(words)
    row = shaped.measured("telescopic_pr", "free", 0)
    assert (row["guide"], row["certified"]) == ("minimum-jerk", 1)
    assert row["jerk"] == pytest.approx(1.0, abs=0.05)
    assert row["effort"] == pytest.approx(1.0, abs=0.05)
    assert 0.0 < row["gap_mm"] < 1.0
    assert "| telescopic_pr | window | 1 of 1 | 1 |" in (output / "summary.md").read_text()


def test_rows_are_measured_once_and_failures_are_kept_with_their_reasons(tmp_path):
    measured = []

    def measure(name, seed):
        measured.append(seed)
        if seed == 1:
            raise NoSolutionError("no way")
        return {"length": 2.0}

    cases = [{"name": "an arm", "seed": seed} for seed in range(3)]
    made = saved_rows(tmp_path, cases[:2], measure)
    assert made == [
        {"name": "an arm", "seed": 0, "length": 2.0, "reason": ""},
        {"name": "an arm", "seed": 1, "reason": "no way"},
    ]
    assert saved_rows(tmp_path, cases, measure)[:2] == made
    assert measured == [0, 1, 2]
    (tmp_path / "an arm-0.json").write_text('{"asked": "an arm, 7", "made": {}}')
    with pytest.raises(FileError, match=r"an arm-0\.json was made with an arm, 7"):
        saved_rows(tmp_path, cases, measure)
