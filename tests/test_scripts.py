"""Scripts that no other test runs, each on as little as it can do."""

from __future__ import annotations

import json

import evaluate_demonstrations
import numpy as np
import picture_arms
import pytest
import real_robots
import robustness
from PIL import Image

from lieednn_sim.arm import Arm
from lieednn_sim.planning.motion import Motion


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


def test_the_table_of_demonstrations(tmp_path, monkeypatch, capsys):
    (tmp_path / "robottasks").mkdir()
    s = np.linspace(0.0, 1.0, 30)[:, None]
    turns = np.concatenate([np.cos(0.4 * s), np.sin(0.4 * s), 0.0 * s, 0.0 * s], axis=1)
    rows = [np.concatenate([20.0 * (1.0 - s), k * s * (1.0 - s), 0.0 * s, turns], axis=1) for k in (8.0, 9.0)]
    np.save(tmp_path / "robottasks" / "bend.npy", rows)
    monkeypatch.setattr(evaluate_demonstrations, "NEURONS", (2,))
    monkeypatch.setattr("lieednn_sim.evaluation.paths.SAMPLES", 60)
    words = [str(tmp_path), "--starts", "3", "--output", str(tmp_path / "out")]
    evaluate_demonstrations.main(words)
    first = (tmp_path / "out" / "demonstrations.md").read_text()
    assert "| bend | lieednn-shaped | 38 |" in first
    assert "- Every start arrives, and there is no other attractor: holds.\n" in first
    assert first.count("| 3/3 | 0 |") == 4
    assert json.loads((tmp_path / "out" / "bend.json").read_text())["certified"]
    # What is there is not computed again.
    monkeypatch.setattr(evaluate_demonstrations, "evaluate", None)
    evaluate_demonstrations.main(words)
    assert (tmp_path / "out" / "demonstrations.md").read_text() == first
    assert capsys.readouterr().out.startswith("bend: done")
