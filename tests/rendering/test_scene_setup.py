"""Pictures of robots whose files have neither light nor floor nor camera, looked at."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.rendering import scene_setup
from lieednn_sim.rendering.video import Camera


@pytest.fixture
def arm(tmp_path, two_hinges) -> Arm:
    path = tmp_path / "robot.xml"
    path.write_text(two_hinges)
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
