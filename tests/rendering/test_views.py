"""Pictures, films, pages and exports of a view, whose model holds more than the arm."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from PIL import Image

import lieednn_sim as ls
from lieednn_sim.exports import export
from lieednn_sim.rendering import scene_setup
from lieednn_sim.rendering.camera import Camera

CELL = """
<mujoco model="cell">
  <option timestep="0.005"/>
  <worldbody>
    <geom type="plane" size="3 3 .1"/>
    <body name="ball" pos="-.5 0 .6"><freejoint/><geom size=".05"/></body>
    <body name="far" pos="9 9 .5"><geom size=".05"/></body>
    <body name="a" pos="0 0 .5">
      <joint name="turn" axis="0 0 1" range="-120 120" damping="1"/>
      <geom type="capsule" size=".04" fromto="0 0 0 .4 0 0"/><site name="tip" pos=".4 0 0"/>
    </body>
  </worldbody>
  <actuator><motor name="turn" joint="turn"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def run():
    model = mujoco.MjModel.from_xml_string(CELL)
    arm = ls.Arm.of(model, mujoco.MjData(model), ["turn"], tip="tip")
    steps = [ls.Move([0.8], planner="minimum-jerk", duration=0.5, name="there"), ls.Actuate({}, 0.2)]
    return ls.simulate(arm, ls.plan_sequence(arm, steps), hold=0.1)


def test_what_moves_is_framed_and_the_caption_names_the_step(run):
    points = scene_setup.occupied(run)
    low, high = points.min(axis=0), points.max(axis=0)
    assert low[0] == pytest.approx(-0.55)
    assert high[0] < 1.0
    np.testing.assert_allclose(low[2], run.qpos[:, 2].min() - 0.05, atol=0.02)
    assert scene_setup.caption(run, 0.3) == ["cell", "there"]
    assert scene_setup.caption(run, 0.6) == ["cell", "wait"]
    model, _ = scene_setup.staged(run.arm, points)
    assert model is not run.arm.model
    assert (model.nbody, model.nlight) == (run.arm.model.nbody, 0)
    assert model.vis.headlight.ambient[0] > run.arm.model.vis.headlight.ambient[0]
    assert scene_setup.planned_frames(run).shape == (len(run.t), 1, 4, 4)


def test_a_page_and_every_table_is_made(run, tmp_path):
    ls.render_page(run, tmp_path / "run.html", title="a cell")
    text = (tmp_path / "run.html").read_text()
    assert "<b>cell</b>" in text
    assert "feedback-linearisation" in text
    for name in ("csv", "rerun", "ros2"):
        assert export(run, tmp_path / name, format=name, rate=20.0)


@pytest.mark.rendering
def test_the_ball_falls_in_the_pictures(run, tmp_path):
    ls.render_still(run, tmp_path / "run.png", size=(320, 240), preset="draft")
    assert ls.render_video(run, tmp_path / "run.gif", size=(320, 240), fps=5, preset="draft") == 5
    with Camera(run.arm, size=(320, 240), preset="draft", points=scene_setup.occupied(run)) as camera:
        first, last = (camera.picture_at(run.qpos[k]).astype(int) for k in (0, -1))
        same = camera.picture(run.q[0]).astype(int)
    np.testing.assert_array_equal(first, same)
    assert (np.abs(first - last) > 30).any(axis=-1).mean() > 0.003
    assert np.asarray(Image.open(tmp_path / "run.png")).std() > 10
