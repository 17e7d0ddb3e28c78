"""Pictures of robots whose files have neither light nor floor nor camera, looked at."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.rendering import scene_setup
from lieednn_sim.rendering.video import Camera

LINK = """<link name="{}"><inertial><mass value="1"/>
  <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="{} 0 0"/><geometry><box size="{} .04 .04"/></geometry></collision></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3} 0 0"/>
  <axis xyz="{4}"/>  <limit lower="-1" upper="1" effort="10" velocity="1"/></joint>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Arm:
    path = tmp_path_factory.mktemp("robot") / "reacher.urdf"
    links = LINK.format("foot", 0, 0.1), LINK.format("upper", 0.15, 0.3), LINK.format("fore", 0.15, 0.3)
    joints = JOINT.format("a", "foot", "upper", 0.05, "0 0 1"), JOINT.format("b", "upper", "fore", 0.3, "0 1 0")
    path.write_text(f'<robot name="reacher">{"".join((*links, *joints))}</robot>')
    return Arm.load(path)


def test_what_is_added_neither_moves_nor_touches(arm):
    model, marker = scene_setup.staged(arm, scene_setup.reached(arm))
    assert (model.nq, model.nv, model.nu) == (arm.model.nq, arm.model.nv, arm.model.nu)
    assert model.nmocap == marker + 1 == 1
    planes = [np.count_nonzero(one.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) for one in (model, arm.model)]
    assert planes == [1, 1]
    added = np.flatnonzero(model.geom_bodyid == model.nbody - 1)
    assert len(added) == 4
    assert not (model.geom_contype | model.geom_conaffinity)[added].any()
    assert model.body_mass.sum() == arm.model.body_mass.sum()
    # Lines are as thick around an arm of two metres as around one of 1.3 m, and thinner around smaller ones.
    sizes = [scene_setup.scale(arm, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, size]])) for size in (0.65, 1.3, 2.0)]
    assert sizes == [0.5, 1.0, 1.0]
    native = Arm.load("telescopic_pr")
    same, _ = scene_setup.staged(native, scene_setup.reached(native))
    assert (same.ngeom, same.nbody, same.nlight) == (native.model.ngeom, native.model.nbody, native.model.nlight)


@pytest.mark.rendering
def test_a_robot_alone_is_lit_stands_on_a_floor_below_a_sky_and_its_target_is_marked(arm):
    home, target = np.zeros(2), np.array([0.9, -0.9])
    with Camera(arm, size=(160, 120), preset="draft") as camera:
        plain = camera.picture(home).astype(int)
    with Camera(arm, size=(160, 120), preset="draft", target=target) as camera:
        marked = camera.picture(home).astype(int)
        there = camera.picture(target).astype(int)
    # Sky above, bluer than red; floor below, grey; nothing black.
    assert (plain[2, :, 2] > plain[2, :, 0] + 20).all()
    assert np.ptp(plain[-3], axis=1).max() < 20
    assert plain.sum(axis=2).min() > 60
    changed = np.abs(marked - plain).sum(axis=2) > 40
    assert 5 < np.count_nonzero(changed) < 0.1 * changed.size
    # The hand is drawn at its marker, well inside the picture, at home and there.
    hand = np.abs(there - marked).sum(axis=2) > 60
    rows, columns = np.nonzero(hand)
    assert 3 < rows.min() < rows.max() < 116
    assert 3 < columns.min() < columns.max() < 156
