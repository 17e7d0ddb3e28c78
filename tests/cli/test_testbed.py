"""Arms of one's own, planners, obstacles and disturbances on the command line."""

import json
import re

import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.cli import arms, main
from lieednn_sim.cli.run_directory import Task
from lieednn_sim.planning import OBSTACLE_PLANNER

# Three hinges; [joint] looks like markup of the terminal.
OWN = """
<mujoco>
  <worldbody>
    <body name="one"><joint name="a" axis="0 0 1" range="-90 90"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
      <body name="two" pos="0.3 0 0"><joint name="[b]" axis="0 1 0" range="-90 90"/>
        <geom type="capsule" size="0.02" fromto="0.05 0 0 0.25 0 0"/>
        <body name="three" pos="0.3 0 0"><joint name="c" axis="0 1 0" range="-90 90"/>
          <geom type="capsule" size="0.02" fromto="0.05 0 0 0.3 0 0"/><site name="tool" pos="0.3 0 0"/>
        </body></body></body>
  </worldbody>
  <keyframe><key name="bent" qpos="0.1 0.2 0.3"/></keyframe>
</mujoco>
"""


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "own.xml"
    path.write_text(OWN)
    return path


@pytest.mark.usefixtures("no_plots")
def test_an_arm_of_ones_own_goes_the_whole_road_from_another_directory(own, tmp_path, capsys, fails, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = "demo --no-page --no-video --arm own.xml --links two,tool --base world --servos design --keyframe bent"
    arguments = [*words.split(), "--home", "c=0.5", "--output", "run"]
    assert main([*arguments, "--option", "n_networks=4", "--controller", "inverse-dynamics"]) == 0
    printed = capsys.readouterr().out
    assert "target: random:0" in printed
    report = printed[printed.index("own, imported from own.xml:\n") :].splitlines()
    assert report[1] == "  links two, tool on world; actuators: 0 kept, 3 made"
    assert report[-1].startswith("done in")
    assert "  the whole report: lieednn-sim arms own.xml" in report[2:5]
    task = Task.load("run/task.json")
    assert task.arm == str(own)
    imported = {"links": ["two", "tool"], "base": "world", "keyframe": "bent", "home": {"c": 0.5}, "servos": "design"}
    assert task.imported == imported
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert main(["simulate", "../run", "--controller", "mocap", "--hold", "0.5"]) == 0
    assert main(["evaluate", "../run"]) == 0
    assert re.search(r"welds up to [\d.]+ N and", capsys.readouterr().out)
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["frames"][-1]["final_mm"] < 0.1
    monkeypatch.chdir(tmp_path)
    assert main(["plan", *arguments[3:], "--planner", "minimum-jerk", "--verbose"]) == 0
    printed = capsys.readouterr().out
    assert "configuration: keyframe 'bent', with c as given\n" in printed
    assert "link 1: two, moved by a, [b]\n" in printed
    assert "the whole report" not in printed
    own.unlink()
    assert "no such file" in fails("simulate", tmp_path / "run")


def test_arms_are_listed_and_described(own, capsys, fails, monkeypatch):
    with monkeypatch.context() as soon:
        soon.setattr(arms, "farthest", lambda arm: 1.23)
        assert main(["arms"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"telescopic_pr +4 +4 hinges, 4 slides +1\.23 ", printed)
    assert main(["arms", str(own), "--links", "two,tool", "--base", "one"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"link 1: two, moved by \[b\]", printed)
    assert re.search(r"c +rad +-1.571 +1.571 +- +- +-", printed)
    assert "no keyframe 'stow'; keyframes of the model: 'bent'" in fails("arms", str(own), "--keyframe", "stow")
    # The arm is straight at its reference, where nothing is further out.
    assert arms.farthest(Arm.load(str(own), links=("two", "tool"), base="one")) == pytest.approx(0.9, abs=1e-6)


@pytest.mark.usefixtures("no_plots")
def test_among_obstacles_the_filter_plans_and_the_clearance_is_measured(tmp_path, capsys):
    directory = tmp_path / "run"
    words = "demo --no-page --no-video --scene window --scene-seed 2 --output"
    assert main([*words.split(), str(directory)]) == 0
    task = Task.load(directory / "task.json")
    assert (task.scene, task.scene_seed, task.planner) == ("window", 2, OBSTACLE_PLANNER)
    clearance = re.search(r"least clearance ([\d.-]+) mm", capsys.readouterr().out)
    assert clearance is not None
    assert float(clearance.group(1)) > 0.0


def test_obstacles_of_a_file_go_the_whole_road_from_another_directory(own, tmp_path, fails, monkeypatch):
    scene = tmp_path / "mine.json"
    box = {"shape": "box", "size": [0.1, 0.1, 0.1], "position": [0.0, 0.0, 0.8]}
    scene.write_text(json.dumps({"obstacles": [box]}))
    monkeypatch.chdir(tmp_path)
    words = "plan --arm own.xml:two,tool --scene mine.json --target 0.5,0.2,0.1 --planner minimum-jerk --output run"
    assert main(words.split()) == 0
    task = Task.load("run/task.json")
    assert (task.arm, task.scene) == (f"{tmp_path}/own.xml:two,tool", str(scene))
    monkeypatch.chdir("/")
    assert main(["simulate", str(tmp_path / "run")]) == 0
    assert task.load_arm().scene == "mine"
    scene.write_text(json.dumps({"obstacles": [{**box, "position": [0.0, 0.1, 0.8]}]}))
    assert "in scene" in fails("simulate", tmp_path / "run")


def test_a_push_after_the_end_is_no_push(tmp_path, fails):
    # Times are rounded to steps of 2 ms.
    arguments = ["--output", tmp_path / "run", "--option", "n_networks=3", "--push", "link 1,1,2,3,4.9995,1"]
    assert "at 4.9995 s would begin when the run is over" in fails("demo", "--no-page", "--no-video", *arguments)
