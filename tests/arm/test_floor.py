"""The floor of an imported arm: what a film shows, targets and planners know."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.obstacles import load_obstacles
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError, NoSolutionError, PlanError
from lieednn_sim.planning import default_planner, plan
from lieednn_sim.rendering import scene_setup

ARM = """
<mujoco>
  <worldbody>{0}
    <body name="foot" pos="0 0 {1}"><geom type="cylinder" size="0.06 0.1" pos="0 0 0.1"/>
      <body name="one" pos="0 0 0.26"><joint name="a" axis="0 0 1" range="-150 150"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.1"/>
        <body name="two" pos="0.15 0 0.15"><joint name="b" axis="0 1 0" range="-120 120"/>
          <geom type="capsule" size="0.03" fromto="0.05 0 0 0.5 0 0"/>
        </body></body></body>
  </worldbody>
</mujoco>
"""
PLANE = '<geom name="ground" type="plane" size="0 0 .1" pos="0 0 -0.3" contype="{0}" conaffinity="{0}"/>'


@pytest.fixture
def write(tmp_path):
    def made(plane="", height=0.0):
        path = tmp_path / "robot.xml"
        path.write_text(ARM.format(plane, height))
        return path

    return made


def floors(arm):
    """Heights of the planes that collide."""
    model = arm.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solid = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & ((model.geom_contype | model.geom_conaffinity) != 0)
    return data.geom_xpos[solid, 2].tolist()


def tip(arm, q):
    return float(arm.link_poses(q).as_matrix()[-1, 2, :] @ [0.5, 0.0, 0.0, 1.0])


def test_a_floor_is_at_the_base_and_in_the_way(write):
    arm, free = Arm.load(write()), Arm.load(write(), floor="none")
    assert (floors(arm), floors(free)) == ([0.0], [])
    assert any("a floor at a height of 0 m" in note for note in arm.import_report.notes)
    below = np.array([0.0, 1.4])
    assert tip(arm, below) < 0.0
    assert arm.near_contacts(below) == [("floor", "two")]
    assert free.near_contacts(below) == []
    assert arm.fingerprint != free.fingerprint
    assert min(tip(arm, draw_target(arm, seed)) for seed in range(10)) > 0.0
    assert min(tip(free, draw_target(free, seed)) for seed in range(10)) < 0.0


def test_no_random_target_says_that_something_is_too_near(write, tmp_path, monkeypatch):
    """The first link is always 1 cm off the arm's own fixed base, which is as near as at home."""
    path, scene = write(), tmp_path / "scene.yaml"
    path.write_text(path.read_text().replace("0 0 0.26", "0 0 0.24"))
    scene.write_text("obstacles: [{shape: box, size: [0.2, 0.2, 0.04], position: [0.9, 0, 0.2]}]")
    arm = Arm.load(path, scene)
    assert Collisions(arm).clearance(draw_target(arm, 0)) == pytest.approx(0.01)
    monkeypatch.setattr(Collisions, "is_free", lambda *_, **__: False)
    with pytest.raises(NoSolutionError, match=r"without contact, but something nearer than 20 mm, in \d+; give"):
        draw_target(arm, 0)


def test_a_floor_is_where_it_is_asked_for_and_not_under_an_arm_that_reaches_below_its_base(write):
    assert floors(Arm.load(write(), floor=-0.25)) == [-0.25]
    assert floors(Arm.load(write(height=0.7))) == [0.7]
    # Pointing down at home, to 0.41 - 0.5 - 0.03.
    hanging = Arm.load(write(height=0.0), home={"b": 1.57})
    assert floors(hanging) == []
    assert any("reaches below its base" in note for note in hanging.import_report.notes)
    # Almost down to the ground: a floor that home is free of.
    (height,) = floors(low := Arm.load(write(height=0.0), home={"b": 0.9}))
    assert -0.05 < height < 0.0
    assert low.near_contacts(low.keyframe("home")) == []
    for wrong in ("low", np.nan, True):
        with pytest.raises(InputError, match="floor must be"):
            Arm.load(write(), floor=wrong)


def test_a_plane_of_the_file_is_the_floor_even_if_it_was_only_drawn(write):
    assert floors(Arm.load(write(PLANE.format(1)))) == [-0.3]
    drawn = Arm.load(write(PLANE.format(0)))
    assert floors(drawn) == [-0.3]
    assert any("'ground' was only drawn" in note for note in drawn.import_report.notes)


def test_a_scene_has_the_last_word_and_walls(write, tmp_path):
    scene = tmp_path / "scene.yaml"
    for text, heights in (
        ("floor: none", []),
        ("floor: -0.4", [-0.4]),
        (
            "floor: none\nobstacles: [{shape: plane, position: [0, 0, 0.9], rpy: [3.141593, 0, 0], name: ceiling}]",
            [0.9],
        ),
    ):
        scene.write_text(text)
        arm = Arm.load(write(), scene)
        assert floors(arm) == heights
        up = np.array([0.0, -1.57])
        touching = [("obstacle_ceiling", "two")] if heights == [0.9] else []
        assert [tuple(sorted(pair)) for pair in arm.near_contacts(up)] == touching
    scene.write_text("floor: -0.4")
    with pytest.raises(InputError, match="has a floor in its own model"):
        Arm.load("telescopic_pr", scene)
    scene.write_text("floor: cellar")
    with pytest.raises(InputError, match="floor must be a height"):
        load_obstacles(scene)


def test_a_film_shows_that_floor_or_none(write):
    for floor, heights in ((-0.2, [-0.2]), ("none", [])):
        arm = Arm.load(write(), floor=floor)
        model, _ = scene_setup.staged(arm, scene_setup.reached(arm))
        planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
        assert model.body_pos[model.geom_bodyid[planes], 2].tolist() == heights
        assert (model.mat_texid[model.geom_matid[planes], mujoco.mjtTextureRole.mjTEXROLE_RGB] >= 0).all(), "squares"


def test_the_default_planner_goes_around_what_stands_beside_an_imported_arm(write):
    post = '<geom name="post" type="box" size=".03 .03 .3" pos=".4 0 .3"/>'
    arm = Arm.load(write(post), home={"a": -1.0}, floor="none")
    with pytest.raises(PlanError, match="'two' would come within 2 mm of 'world' at t = "):
        plan(arm, [1.0, 0.0], planner="lieednn-certified")
    planned = plan(arm, [1.0, 0.0])
    assert planned.planner == "lieednn-shaped"
    assert planned.clearance.proved
    # A floor counts, the robot's own foot does not.
    assert default_planner(Arm.load(write())) == ("lieednn-shaped", "the default among obstacles")
    assert default_planner(Arm.load(write(), floor="none"))[0] == "lieednn-certified"
    assert default_planner(Arm.load("telescopic_pr"))[0] == "lieednn-certified"
