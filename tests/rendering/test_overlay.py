"""What is drawn over the arm, and which sample a frame of a video shows: by hand, without OpenGL."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from types import SimpleNamespace

import gantries
import numpy as np
from rollouts import make_rollout

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.planning.clearance import Clearance
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.rendering import video
from lieednn_sim.rendering.camera import Camera
from lieednn_sim.rendering.overlay import (
    LOAD_COLOUR,
    PLANNED_COLOUR,
    TRACED_COLOUR,
    Overlay,
    draw_lines,
    write_caption,
)
from lieednn_sim.simulation import simulate


def drawn(overlay, k):
    """Kind, colour, width, first end and vector to the other one of each geom of a sample."""
    scene = mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), 100)
    overlay.draw(scene, k)
    found = []
    for geom in scene.geoms[: scene.ngeom]:
        arrow = geom.type == int(mujoco.mjtGeom.mjGEOM_ARROW)
        # A capsule is given by its middle and half of its length.
        vector = geom.mat[:, 2] * geom.size[2] * (1.0 if arrow else 2.0)
        begin = geom.pos if arrow else geom.pos - 0.5 * vector
        found.append((arrow, geom.rgba.copy(), geom.size[0], begin.copy(), vector.copy()))
    return found


def test_an_overlay_is_the_planned_way_what_is_travelled_and_the_frames_of_now():
    """The second frame is turned by a quarter about z, so that its x axis points along y."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    planned = np.tile(np.eye(4), (3, 2, 1, 1))
    planned[1, :, :3, :3] = turn
    planned[:, 1, :3, 3] = [[0.0, 0.0, 1.0], [0.5, 0.0, 1.0], [0.5, 0.5, 1.0]]
    traced = planned[:, 1, :3, 3] + [0.0, 0.0, 0.1]
    way, travelled = Overlay(planned, traced, 0.5).paths(lambda points: (points, points[:, 2] > 1.05), 1, 500)
    np.testing.assert_array_equal(way[0], planned[:, 1, :3, 3])
    np.testing.assert_array_equal(travelled[0], traced[:2])  # up to now, and no further
    assert not way[1].any()
    assert travelled[1].all()
    assert travelled[2] > way[2] > 1.0
    frames = drawn(Overlay(planned, traced, 0.5), 1)
    assert len(frames) == 6
    for place, arrows in (([0.0, 0.0, 0.0], frames[:3]), ([0.5, 0.0, 1.0], frames[3:])):
        for axis, (arrow, colour, _, begin, vector) in enumerate(arrows):
            assert arrow
            assert colour[:3].argmax() == axis
            np.testing.assert_allclose(begin, place, atol=1e-6)
            np.testing.assert_allclose(vector, 0.11 * turn[:, axis], atol=1e-6)


def test_paths_have_the_colours_of_the_legend_and_are_thin_where_they_are_hidden():
    pixels = np.column_stack([np.linspace(40.0, 360.0, 9), np.full(9, 150.0)])
    free = np.arange(9) < 5
    image = draw_lines(np.zeros((200, 400, 3), np.uint8), [(pixels, free, 5.0, TRACED_COLOUR)])
    thick, thin = image[:, 120].any(axis=1).sum(), image[:, 320].any(axis=1).sum()
    assert 4 <= thick <= 7
    assert 1 <= thin < thick
    legend = write_caption(np.zeros((200, 400, 3), np.uint8), ["words"])
    assert (legend == image[150, 100]).all(axis=-1).sum() > 10
    # What is behind the camera has no pixels.
    pixels[4:] = np.nan
    draw_lines(image, [(pixels, free & (np.arange(9) < 4), 5.0, PLANNED_COLOUR)])


def test_the_path_of_a_load_is_that_of_its_centre_of_mass():
    arm = gantries.gantry()
    run = simulate(arm, ls.plan(arm, [1.0], planner="minimum-jerk", duration=2.0), hold=0.0)
    overlay, (cart, angle) = Overlay.of(run, 1.0), run.qpos.T
    np.testing.assert_allclose(overlay.traced_load[:, 0], cart - gantries.LENGTH * np.sin(angle), atol=1e-9)
    assert angle.max() > 0.05
    # In pictures up to now, as the end effector's.
    _, (tip, *_), (load, *_, colour) = overlay.paths(lambda points: (points, np.ones(len(points), bool)), 100, 480)
    assert colour == LOAD_COLOUR
    np.testing.assert_allclose([tip[-1], load[-1]], [overlay.traced_tip[100], overlay.traced_load[100]])


def test_a_frame_shows_its_sample_and_says_its_time(gantry, monkeypatch, tmp_path):
    """Half a second of motion and half of rest, at 4 frames a second and 100 samples; frame k is of time k / fps."""
    t = 0.01 * np.arange(51)
    (sigma, slope), way = minimum_jerk_law(t / 0.5), np.array([0.05, 0.1, 0.2, 0.3])
    none = np.zeros((51, 2))
    motion = Motion(
        t, t, np.zeros((51, 2, 6)), np.zeros((2, 6)), sigma[:, None] * way, slope[:, None] * way / 0.5, none, none
    )
    rollout = simulate(gantry, motion, hold=0.5)
    assert np.abs(rollout.q - rollout.q_ref).max() > 1e-6
    shown, samples, captions, overlays, targets, rates = [], [], [], [], [], []

    class Pictures(contextlib.nullcontext):
        seen, scale = None, 1.0

        def picture_at(self, qpos, draw):
            shown.append(qpos)
            draw("a scene")
            return np.zeros((90, 160, 3), np.uint8)

    def writer(path, size, rate):
        rates.append(rate)
        path.touch()
        return contextlib.nullcontext(lambda _: None)

    monkeypatch.setattr(video, "Camera", lambda *_, **given: targets.append(given["run"].target) or Pictures())
    overlay = SimpleNamespace(draw=lambda _, k: samples.append(k), paths=lambda *_: [], traced_load=())
    monkeypatch.setattr(video, "Overlay", SimpleNamespace(of=lambda *given: overlays.append(given) or overlay))
    monkeypatch.setattr(video, "_writer", writer)
    monkeypatch.setattr(video, "_check_complete", lambda *_: None)
    monkeypatch.setattr(video, "write_caption", lambda _, lines, *__: captions.append(lines))
    assert video.render_video(rollout, tmp_path / "v.mp4", fps=4, title="a planner") == 5
    assert samples == [0, 25, 50, 75, 100]
    np.testing.assert_array_equal(targets, [rollout.target])
    np.testing.assert_array_equal(shown, rollout.qpos[::25])
    names = ["a planner", gantry.name, "position-servo", "at least 100 mm clear, proved"]
    assert captions == [[*names, f"{0.25 * k:.2f} s of 1.00 s"] for k in range(5)]
    ((followed, _),) = overlays
    made = Overlay.of(followed, 1.0)
    planned, traced = made.planned_frames, made.traced_tip
    np.testing.assert_array_equal(planned, gantry.link_poses(rollout.q_ref).as_matrix())
    np.testing.assert_array_equal(traced, rollout.link_position[:, 1])
    # For a while it is outside of its proof; and without a plan there is none.
    vars(rollout)["clearance"] = Clearance(0.00874, 0.1, ("a", "b"), np.array([[0.2, 0.3], [0.74, 0.9]]), 0.74)
    video.render_video(rollout, tmp_path / "v.mp4", fps=4)
    assert [lines[2] for lines in captions[5:]] == [
        "at least 8.74 mm clear, proved" if k in (0, 2, 4) else "clearance not proved" for k in range(5)
    ]
    video.render_video(replace(rollout, arm=replace(gantry, scene="poles"), motion=None), tmp_path / "v.mp4", fps=4)
    assert captions[10] == ["gantry, poles", "position-servo", "0.00 s of 1.00 s"]
    # Every third of a second is shown to the nearest step.
    for fps, steps, expected in ((25, 22, [0, 4, 8, 12, 16, 20]), (30, 12, [0, 3, 7, 10])):
        samples.clear()
        moving = make_rollout(gantry, np.linspace(np.zeros(4), np.full(4, 0.05), steps))
        assert video.render_video(moving, tmp_path / "v.mp4", fps=fps) == len(expected)
        assert (samples, rates[-1]) == (expected, fps)


def test_the_marker_is_put_at_the_target_of_the_end_effector(gantry):
    data = SimpleNamespace(mocap_pos=np.zeros((1, 3)), mocap_quat=np.zeros((1, 4)))
    camera = SimpleNamespace(_model=gantry.model, _arm=gantry, _data=data, _marker=0)
    Camera.mark(camera, [0.1, 0.2, 0.3, 0.6])
    np.testing.assert_allclose(data.mocap_pos, [[1.1, 0.2, 0.3]])
    np.testing.assert_allclose(data.mocap_quat, [[np.cos(0.3), 0.0, 0.0, np.sin(0.3)]], atol=1e-15)
