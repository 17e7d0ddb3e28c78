"""Pictures of robots whose files have neither light nor floor nor camera, looked at."""

from __future__ import annotations

import numpy as np
import pytest
from rollouts import make_rollout

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.checks import ancestry
from lieednn_sim.rendering import scene_setup
from lieednn_sim.rendering.camera import Camera
from lieednn_sim.rendering.viewpoint import unhidden, viewpoint


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


def test_the_marker_is_no_larger_than_the_hand_and_links_of_one_colour_have_tones(arm):
    model, marker = scene_setup.staged(arm, scene_setup.reached(arm))
    ball = int(model.body_geomadr[np.flatnonzero(model.body_mocapid == marker)[0]])
    last = arm.frames.bodies[-1]
    hand = 2.0 * model.geom_aabb[model.geom_bodyid == last, 3:].max(axis=0)
    assert 0.0 < 2.0 * model.geom_size[ball, 0] <= np.median(hand) + 1e-9
    links = [model.geom_rgba[model.geom_bodyid == body, :3].mean() for body in ancestry(model, int(last))[1:]]
    assert (np.diff(links) > 0.1).all()
    assert (arm.model.geom_rgba[:2] == 0.5)[:, :3].all(), "the arm itself stays as it is"


def test_the_camera_looks_from_where_a_wall_hides_nothing(tmp_path, two_hinges):
    """The wall stands before the usual side, at which most of the path is hidden."""
    path, scene = tmp_path / "robot.xml", tmp_path / "wall.yaml"
    path.write_text(two_hinges)
    scene.write_text(
        "obstacles: [{shape: box, name: wall, size: [0.05, 3, 3], position: [0.56, -0.22, 0], rpy: [0, 0, -0.96]}]"
    )
    arm = Arm.load(path, scene)
    run = make_rollout(arm, np.linspace(0.0, 1.0, 20)[:, None] * [0.9, -0.9])
    points = scene_setup.occupied(run)
    shares = []
    for rollout in (None, run):
        camera = scene_setup.camera(arm, None, points, rollout)
        data = kinematics_at(arm.model, run.qpos[0])
        eye = viewpoint(arm.model, data, camera, points).position
        shares.append(unhidden(arm.model, data, eye, run.link_position[:, -1]).mean())
    assert shares[0] < 0.2
    assert shares[1] > 0.8
