"""The command ``sequence``, from a file to its run."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest
from PIL import Image

import lieednn_sim as ls
from lieednn_sim.cli import main

MODEL = """
<mujoco model="pusher">
  <worldbody>
    <geom type="plane" size="2 2 .1"/>
    <body name="ball" pos="-.5 0 .5"><freejoint/><geom size=".03"/></body>
    <body name="arm" pos="0 0 .3">
      <joint name="turn" axis="0 0 1" range="-90 90" damping="1"/>
      <geom type="capsule" size=".03" fromto=".1 0 0 .3 0 0"/>
      <body name="tube" pos=".3 0 0">
        <joint name="out" type="slide" axis="1 0 0" range="-.02 .2"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .2 0 0"/>
        <body name="claw" pos=".2 0 0"><joint name="claw" type="slide" axis="0 0 1" range="0 .05" damping="5"/>
          <geom type="box" size=".01 .01 .01" pos=".05 0 0" mass=".05"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="turn" kp="400" kv="40"/><position joint="out" kp="4000" kv="200"/>
    <position name="claw" joint="claw" kp="400" kv="10"/>
  </actuator>
  <keyframe><key name="aside" qpos="-.5 0 .03 1 0 0 0 .5 .1 0"/></keyframe>
</mujoco>
"""
FILE = """
model: pusher.xml
joints: [turn, out]
planner: minimum-jerk
duration: 1.0
steps:
  - {name: out, joints: [0.4, 0.1]}
  - {name: up, actuate: {claw: 0.05}, seconds: 1, until: settled}
  - {keyframe: aside, duration: 1.5, max_time_scale: 2}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pusher.xml").write_text(MODEL)
    (tmp_path / "steps.yaml").write_text(FILE)
    return tmp_path


def test_a_file_is_planned_and_simulated(folder, capsys):
    words = ["sequence", "steps.yaml", "--output", "made", "--no-page", "--no-video", "--hold", "0.25"]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "  0.00 to   1.00 s  out    minimum-jerk: no network, no proof" in told
    assert "ball ended " in told
    report = json.loads((folder / "made" / "report.json").read_text())
    assert [step["name"] for step in report["steps"]] == ["out", "up", "aside"]
    assert report["steps"][2]["planned_end_s"] - report["steps"][2]["planned_begin_s"] == pytest.approx(1.5)
    assert set(report["largest_tracking_error"]) == {"turn", "out"}
    # The ball falls all the time, in the plan only while the claw moves.
    ball = report["objects"]["ball"]
    assert ball["simulated"] == pytest.approx([-0.5, 0.0, 0.03], abs=1e-3)
    seconds = report["steps"][1]["planned_end_s"] - report["steps"][1]["planned_begin_s"]
    assert ball["planned"][2] == pytest.approx(max(0.5 - 0.5 * 9.81 * seconds**2, 0.03), abs=0.03)
    model = mujoco.MjModel.from_xml_path("pusher.xml")
    with np.load(folder / "made" / "sequence.npz") as planned, np.load(folder / "made" / "run.npz") as run:
        assert planned["qpos"].shape == (len(planned["t"]), model.nq)
        np.testing.assert_allclose(planned["qpos"][-1, 7:9], model.key("aside").qpos[7:9], atol=1e-9)
        np.testing.assert_allclose(run["qpos"][-1, 7:], [0.5, 0.1, 0.05], atol=5e-3)
        assert run["t"][-1] == pytest.approx(report["simulated_s"] + 0.25)
    # Its own files are replaced, others are not.
    (folder / "made" / "notes.txt").write_text("mine")
    assert main(words) == 0
    assert (folder / "made" / "notes.txt").read_text() == "mine"
    assert main([*words[:2], "--output", "."]) == 2
    assert "holds files that no command of this package made" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("model: pusher.xml\n", "", "it needs either a model, an MJCF file, or an arm"),
        ("model: pusher.xml", "model: gone.xml", "no such file: gone.xml"),
        ("planner:", "planer:", "steps.yaml: unknown 'planer'; allowed: model, arm"),
        ("joints: [turn, out]", "joints: turn", "joints must be a list of names, got 'turn'"),
        ("{name: out, joints: [0.4, 0.1]}", "{joints: [0.4, 0.1], pose: {}}", "step 1 needs one of .*joints and pose"),
        ("{name: out, joints: [0.4, 0.1]}", "{pose: {rpy: [0, 0, 0]}}", "step 1, pose: it has no position"),
        ("{name: out, joints: [0.4, 0.1]}", "{pose: {place: 1}}", "step 1, pose: it: unknown 'place'"),
        ("{name: out, joints: [0.4, 0.1]}", "{joints: [0.4]}", "step 1, 'move': the goal of turn, out"),
        ("seconds: 1, until: settled", "until: soon", "step 2, actuate: no event 'soon'"),
        ("seconds: 1, until: settled", "until: [ball]", "step 2, actuate: until must be"),
        ("{claw: 0.05}", "{fist: 0.05}", "no actuator 'fist'"),
        ("keyframe: aside", "keyframe: [1]", "step 3, keyframe: it must be the name"),
        ("keyframe: aside", "holding: ball", "step 3 needs one of"),
        ("max_time_scale: 2", "speed: 2", "step 3: unknown 'speed'; allowed: keyframe, name"),
        ("steps:", "steps: 3\nmore:", "unknown 'more'"),
        ("model: pusher.xml", "model: !!python/object/apply:os.system [ls]", "not a valid description"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(folder, capsys, old, new, message):
    assert old in FILE
    (folder / "steps.yaml").write_text(FILE.replace(old, new))
    assert main(["sequence", "steps.yaml", "--output", "made", "--no-page", "--no-video"]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert message.split(".*")[0] in told
    assert message.split(".*")[-1] in told


@pytest.mark.rendering
def test_pictures_show_the_given_model_with_what_moves_in_it(folder):
    """A red ball falls through the picture of a black room."""
    model = mujoco.MjModel.from_xml_string(MODEL.replace('size=".03"/></body>', 'size=".03" rgba="1 0 0 1"/></body>'))
    data = mujoco.MjData(model)
    found = ls.plan_in(model, data, ["turn", "out"], [0.4, 0.1], planner="minimum-jerk", duration=1.0)
    run = ls.run_in(model, data, found, hold=0.0)
    assert ls.render_video(run, "film.mp4", size=(160, 120), fps=4, preset="draft") == 5
    ls.render_still(run, "still.png", size=(160, 120), preset="draft")
    picture = np.asarray(Image.open("still.png")).astype(int)
    red = picture[..., 0] > 1.5 * picture[..., 1] + 15
    rows = np.flatnonzero(red.any(axis=1))
    assert np.ptp(rows) > 20
