"""Scripts that no other test runs, each on as little as it can do."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import cost_over_time
import evaluate_demonstrations
import growth
import kept_ways
import numpy as np
import picture_arms
import pytest
import real_robots
import robot_reports
import robustness
import tune_rivals
from PIL import Image

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.planning.baselines.primitives import DmpOptions
from lieednn_sim.planning.motion import Motion
from lieednn_sim.registry import RIVALS
from lieednn_sim.synthesis import ShapingOptions


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


def test_bounds_are_measured_and_a_broken_one_is_told(tmp_path, monkeypatch, capsys):
    path = tmp_path / "robustness.md"
    assert robustness.main(["--cases", "3", "--output", str(path)]) == 0
    assert path.read_text() in capsys.readouterr().out
    assert path.read_text().count("| 1 | 0 |") == len(robustness.BOUNDS) * len(robustness.KINDS)
    monkeypatch.setattr(robustness, "unstable_step", lambda jacobian, method: 1e-9)
    assert robustness.main(["--cases", "1", "--output", str(path)]) == 1


def test_ways_that_are_kept_are_counted_and_measured(capsys):
    kept_ways.main(["telescopic_pr", "--ways", "1"])
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[1] for row in rows] == ["line", "orientation"]
    for _, _, drawn, followed, planned, distance, angle, *_ in rows:
        assert int(drawn) >= int(followed) == int(planned) == 1
        assert float(distance) < 0.5
        assert float(angle) < 0.1


def test_growth_is_measured_in_sizes_that_grow_as_they_say(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(growth, "ShapingOptions", lambda **options: ShapingOptions(**options | {"iterations": 1}))
    small = dict(zip(growth.SERIES, ((4, 6), (1, 2), (20, 40), (2, 3), (1, 2)), strict=True))
    monkeypatch.setattr(growth, "SERIES", {name: (of, small[name]) for name, (of, _) in growth.SERIES.items()})
    assert growth.main(["--quick", "--output", str(tmp_path)]) == 0
    assert (tmp_path / "growth.md").read_text() in capsys.readouterr().out
    rows = (tmp_path / "growth.csv").read_text().splitlines()[1:]
    assert len(rows) == 2 * len(growth.SERIES)
    assert all(float(row.rsplit(",", 1)[1]) > 0.0 for row in rows)
    with Image.open(tmp_path / "growth.png") as picture:
        assert picture.size[0] > 4 * picture.size[1]
    # Three times as large, nine times as long, between the largest two.
    assert growth.exponent(np.array([1.0, 2.0, 6.0]), np.array([5.0, 1.0, 9.0])) == pytest.approx(2.0)
    # Each sphere makes as many more pairs as the one before; a chain of so many links has as many joints.
    pairs = [len(growth.Collisions(growth.loaded(tmp_path, 4, count)).pairs) for count in (0, 1, 2)]
    assert pairs[2] - pairs[1] == pairs[1] - pairs[0] > 0
    arm = growth.loaded(tmp_path, 3)
    assert arm.n_links == arm.n_joints == 3


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


# Two tubes that overlap, a sticky hinge with a servo, a slide whose range follows from its follower, and a finger.
CLUMSY = """
<mujoco><worldbody><body name="foot"><geom size=".1"/>
  <body name="upper" pos="0 0 .15"><joint name="a" axis="0 1 0" range="-170 170" frictionloss="2"/>
    <geom type="capsule" size=".03" fromto="0 0 -.02 0 0 .3"/>
    <body name="tube" pos="0 0 .3"><joint name="s" type="slide" axis="0 0 1" range="0 .4"/>
      <geom type="capsule" size=".02" fromto="0 0 -.2 0 0 .3"/>
      <body name="hand" pos="0 0 .4"><joint name="b" axis="0 1 0"/><geom size=".02"/>
        <body name="finger" pos="0 0 .06"><joint name="finger" range="-20 20"/><geom size=".01"/></body></body></body>
  </body></body></worldbody>
  <actuator><position joint="a" kp="400" kv="20" gear="2" forcerange="-30 30"/><motor joint="s" ctrlrange="-50 50"/>
    <position name="grip" joint="finger" kp="1"/></actuator>
</mujoco>
"""


def test_a_report_that_is_wrong_is_found_out(tmp_path):
    path = tmp_path / "clumsy.xml"
    path.write_text(CLUMSY)
    arm = Arm.load(path, links=["upper", "tube", "hand"])
    model = mujoco.MjModel.from_xml_string(CLUMSY)

    def wrong(**changes):
        told = dataclasses.replace(arm.import_report, **changes)
        changed = dataclasses.replace(arm, import_report=told)
        return " | ".join(robot_reports.wrong_in_report(changed, model, model.qpos0, path))

    report = arm.import_report
    assert wrong() == ""
    assert "joints in no place or in two: {'finger'}" in wrong(locked=())
    assert "tube is moved by ['s'], not ('b',)" in wrong(groups=(("a",), ("b",), ("s",)))
    for words, found in (
        ("contacts ignored between", "contacts of 'foot' and 'upper' are off, and the report does not say so"),
        ("s: moved off its limits", "s: at 0 in the reference position, at 0.02 at home, not told"),
        ("b: had no range", "b: range [-inf, inf] became"),
        ("a: dry friction", "a: dry friction leaves it 0.0013 off, not told"),
        ("acceleration limits", "a: acceleration limit"),
    ):
        assert any(words in note for note in report.notes), words
        assert found in wrong(notes=tuple(note for note in report.notes if words not in note))
    assert "'foot' and 'hand' are off" in wrong(notes=(*report.notes, "contacts ignored between 'foot' and 'hand'"))
    first, *others = report.servos
    assert "a: force limit 60, the report says (-30" in wrong(
        servos=(dataclasses.replace(first, force_range=(-30.0, 30.0)), *others)
    )
    assert "a: gains [1600." in wrong(servos=(dataclasses.replace(first, kp=400.0), *others))


def test_failures_are_held_against_the_report():
    ways = "note: 3 of 9 straight paths from home ... come within 2 mm of contact, between 'hand' and 'foot' (3): ..."
    failure = "'foot' would come within 2 mm of 'hand' at t = 1.00 s"
    assert real_robots._unexplained_plan("p 1", failure, [ways]) == []
    assert real_robots._unexplained_plan("p 1", failure.replace("hand", "arm"), [ways]) != []
    assert real_robots._unexplained_plan("p 1", "joint 'a' would jump", [ways]) == ["p 1: joint 'a' would jump"]
    slow = (
        "joint 'a' would move at 2.5 rad/s at t = 1.97 s, its limit is 0.84 rad/s; a duration of at least 12 s keeps it"
    )
    assert real_robots._unexplained_plan("p 1", slow, ["note: velocity limits of the URDF [rad/s, m/s]: a 0.84"]) == []
    assert real_robots._unexplained_plan("p 1", slow, ["note: velocity limits of the URDF [rad/s, m/s]: a 0.9"]) != []
    stuck = "joint 'a' ends 1 degrees off, ...: dry friction of 2 N m / kp 40 holds it anywhere within 2.86 degrees"
    found = SimpleNamespace(causes=(stuck, "what helps: the controller inverse-dynamics"), shortfall="arrival: ...")
    assert real_robots._unexplained_error("s 1", found, ["note: a: dry friction of 2 leaves it up to ..."]) == []
    assert real_robots._unexplained_error("s 1", found, ["note: a: sags by ..."]) == [f"s 1: {stuck}"]
    assert real_robots._unexplained_error("s 1", SimpleNamespace(causes=(), shortfall="contact"), []) == [
        "s 1: contact"
    ]


def test_the_table_of_demonstrations(tmp_path, monkeypatch, in_this_process):
    (tmp_path / "robottasks").mkdir()
    s = np.linspace(0.0, 1.0, 30)[:, None]
    turns = np.concatenate([np.cos(0.4 * s), np.sin(0.4 * s), 0.0 * s, 0.0 * s], axis=1)
    rows = [np.concatenate([20.0 * (1.0 - s), k * s * (1.0 - s), 0.0 * s, turns], axis=1) for k in (8.0, 9.0)]
    np.save(tmp_path / "robottasks" / "bend.npy", rows)
    monkeypatch.setattr(evaluate_demonstrations, "OPTIONS", ShapingOptions(neurons=(2,), placed_neurons=()))
    monkeypatch.setattr("lieednn_sim.evaluation.paths.SAMPLES", 60)
    words = [str(tmp_path), "--starts", "3", "--output", str(tmp_path / "out")]
    with in_this_process():
        evaluate_demonstrations.main(words)
    first = (tmp_path / "out" / "demonstrations.md").read_text()
    assert "| bend | lieednn-shaped | 38 |" in first
    assert "- Every start arrives, and there is no other attractor: holds.\n" in first
    assert first.count("| 3/3 | 0 |") == 1 + len(RIVALS)
    # What is there is not computed again.
    monkeypatch.setattr("lieednn_sim.studies.demonstrations.study.score", None)
    evaluate_demonstrations.main(words)
    assert (tmp_path / "out" / "demonstrations.md").read_text() == first


def tuned(setting, *lengths):
    """Rows of a setting on problems 1000, 1001, ...; None where it made no motion."""
    return [
        {
            "planner": "dmp",
            "setting": setting,
            "arm": "telescopic_pr",
            "scene": "window",
            "seed": str(1000 + k),
            "length": "" if length is None else str(length),
            "cpu_s": "" if length is None else "0.5",
            "reason": "",
        }
        for k, length in enumerate(lengths)
    ]


def test_a_setting_is_better_when_it_arrives_more_often_or_on_shorter_paths():
    rows = [
        *tuned("defaults", 1.0, 2.0, None, 4.0),
        *tuned("shorter", 0.9, 1.8, None, 5.0),
        *tuned("hardly shorter", 0.99, 1.98, None, 3.96),
        *tuned("more often", 1.5, 2.0, 3.0, 4.0),
        *tuned("shorter, but seldom", 0.5, None, None, 2.0),
    ]
    text = tune_rivals.summary(rows, "command")
    told = {line.split(" | ")[0].removeprefix("| "): line for line in text.splitlines() if " of 4 " in line}
    assert told["defaults"] == "| defaults | 3 of 4 | 1.000 | 0.50 |  |"
    assert told["shorter"] == "| shorter | 3 of 4 | 0.900 | 0.50 | better |"
    assert told["hardly shorter"] == "| hardly shorter | 3 of 4 | 0.990 | 0.50 |  |"
    assert told["more often"] == "| more often | 4 of 4 | 1.000 | 0.50 | better |"
    assert told["shorter, but seldom"] == "| shorter, but seldom | 2 of 4 | 0.500 | 0.50 |  |"


def test_every_number_of_the_options_is_tried_twice(tmp_path, capsys, monkeypatch):
    tried = tune_rivals.settings(DmpOptions())
    assert {name: (one.basis_functions, one.least_fraction) for name, one in tried.items()} == {
        "defaults": (20, 0.01),
        "basis_functions x 0.5": (10, 0.01),
        "basis_functions x 2": (40, 0.01),
        "least_fraction x 0.5": (20, 0.005),
        "least_fraction x 2": (20, 0.02),
    }
    monkeypatch.setattr(tune_rivals, "SCENES", ("window",))
    words = ["--planners", "trajectory-optimisation", "--seeds", "1", "--arms", "telescopic_pr", "--output"]
    monkeypatch.setattr(tune_rivals, "settings", lambda options: {"defaults": options})
    tune_rivals.main([*words, str(tmp_path)])
    assert "| defaults | 1 of 1 | 1.000 | " in capsys.readouterr().out
    # What is there is not made again.
    monkeypatch.setattr(tune_rivals, "row", None)
    tune_rivals.main([*words, str(tmp_path)])
    with pytest.raises(SystemExit):
        tune_rivals.main(["--planners", "lieednn-shaped"])


def test_cost_over_time_is_the_best_of_all_runs_until_then():
    run = cost_over_time.Run
    runs = [
        run("rrt-star", "arm", 0, "tests 1", 3.0, 0.2),
        # More work, and a longer path: the one before stays.
        run("rrt-star", "arm", 0, "tests 2", 4.0, 0.4),
        run("rrt-star", "arm", 0, "tests 4", 2.0, 3.0),
        run("stomp", "arm", 0, "steps 1", 2.5, 0.6),
        run("rrt-star", "arm", 1, "tests 1", np.inf, 0.3, "none found"),
        run("rrt-star", "arm", 1, "tests 2", 6.0, 0.9),
        run("stomp", "arm", 1, "steps 1", 5.0, 20.0),
        run("stomp", "arm", 2, "steps 1", 1.0, 0.5),
        run("rrt-star", "arm", 2, "tests 1", np.inf, 0.1, "none found"),
    ]
    ratios = cost_over_time.best_by(runs, (0.25, 1.0, 4.0))
    none = np.inf
    np.testing.assert_allclose(ratios["rrt-star"], [[1.5, 1.5, 1.0], [none, 1.2, 1.2], [none, none, none]])
    np.testing.assert_allclose(ratios["stomp"], [[none, 1.25, 1.25], [none, none, none], [none, 1.0, 1.0]])
    told = cost_over_time.table(runs, "command").splitlines()
    assert told[-2] == "| rrt-star | - (1) | - (1) | 1.500 (2) | 1.500 (2) | 1.200 (2) | 1.200 (2) | 3 |"
    assert told[-1] == "| stomp | - (0) | - (1) | 1.250 (2) | 1.250 (2) | 1.250 (2) | 1.250 (2) | 20 |"


def test_cost_over_time_measures_and_draws(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(cost_over_time.LADDERS, "stomp", ("rounds", (1, 2)))
    monkeypatch.setattr(cost_over_time, "FIRST_SEED", 2)
    words = ["--planners", "stomp", "--seeds", "1", "--arms", "telescopic_pr", "--output"]
    assert cost_over_time.main([*words, str(tmp_path)]) == 0
    assert capsys.readouterr().out.strip() == (tmp_path / "cost_over_time.md").read_text().strip()
    first, second = (tmp_path / "cost_over_time.csv").read_text().splitlines()[1:]
    assert first.startswith("stomp,telescopic_pr,2,rounds 1,")
    assert second.startswith("stomp,telescopic_pr,2,rounds 2,")
    with Image.open(tmp_path / "cost_over_time.png") as picture:
        assert min(picture.size) > 100
    # What is there is not made again, and the table is the same.
    monkeypatch.setattr(cost_over_time, "measured", None)
    written = (tmp_path / "cost_over_time.csv").read_bytes()
    assert cost_over_time.main([*words, str(tmp_path)]) == 0
    assert capsys.readouterr().out.strip() == (tmp_path / "cost_over_time.md").read_text().strip()
    assert (tmp_path / "cost_over_time.csv").read_bytes() == written
    with pytest.raises(SystemExit):
        cost_over_time.main(["--planners", "minimum-jerk"])
