"""Pages that play a motion: what is in them, and what a browser makes of them."""

from __future__ import annotations

import contextlib
import io
import json
import sys
import time

import numpy as np
import pytest
from PIL import Image
from rollouts import make_rollout

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.planning.clearance import Clearance
from lieednn_sim.rendering import page, scene_setup, viser_scene
from lieednn_sim.rendering.page import _Copy, record, render_page
from lieednn_sim.rendering.viewpoint import Viewpoint, viewpoint
from lieednn_sim.rendering.viser_server import quiet_server


@pytest.fixture(scope="module")
def rollout():
    """The arm goes from home to its keyframe 'extended' within 0.2 s, and rests for 0.8 s: no slow page misses it."""
    arm = Arm.load("telescopic_pr")
    share = np.clip(np.linspace(0.0, 5.0, 101), 0.0, 1.0)[:, None]
    q = arm.keyframe("home") + share * (arm.keyframe("extended") - arm.keyframe("home"))
    return make_rollout(arm, q, motion_end=0.2)


@pytest.fixture(scope="module")
def staged(rollout):
    """What a page of it shows, and the target's marker."""
    model, marker = scene_setup.staged(rollout.arm, scene_setup.occupied(rollout))
    return viser_scene.Shapes(model), marker


def test_without_viser_the_error_says_what_to_install(gantry, tmp_path, monkeypatch):
    rollout = make_rollout(gantry)
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(LieEDNNError, match=r"viser is not installed .*: pip install 'lieednn_sim\[view\]'"):
        render_page(rollout, tmp_path / "motion.html")
    assert list(tmp_path.iterdir()) == []


def test_bad_input_is_refused(rollout, gantry, tmp_path):
    with pytest.raises(InputError, match=r"must end in \.html, got 'motion\.mp4'"):
        render_page(rollout, tmp_path / "motion.mp4")
    with pytest.raises(InputError, match="no camera 'moon'"):
        render_page(rollout, tmp_path / "motion.html", camera="moon")
    with pytest.raises(InputError, match="of one arm in one scene"):
        record([rollout, make_rollout(gantry)])
    with pytest.raises(InputError, match="one for each of 1 rollouts, got 2"):
        record([rollout], ["a", "b"])


def test_a_viewpoint_sees_what_a_film_sees(gantry):
    """A camera 5 m from the origin that looks along y, slightly down; by hand."""
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = 90.0, -30.0, 5.0
    data = kinematics_at(gantry.model, gantry.qpos(gantry.keyframe("home")))
    view = viewpoint(gantry.model, data, camera, np.zeros((1, 3)))
    np.testing.assert_allclose(view.position, [0.0, -5.0 * np.cos(np.pi / 6), 2.5], atol=1e-5)
    np.testing.assert_allclose(view.look_at, 0.0, atol=1e-5)
    assert view.field_of_view == pytest.approx(np.deg2rad(gantry.model.vis.global_.fovy), abs=1e-5)
    assert view.ratio(np.array([[1.0, 0.0, 0.0]])) == pytest.approx(0.2 / np.tan(0.5 * view.field_of_view), rel=1e-5)


def test_backing_off_fills_the_picture():
    """With 90 degrees and a picture twice as wide as high, the edges are where x = 2 z and y = z."""
    view = Viewpoint(np.array([0.0, -9.0, 0.0]), np.zeros(3), 0.5 * np.pi)
    wide = view.back_off(np.array([[-6.0, 0.0, 0.0], [6.0, 0.0, 0.0]]), 2.0)
    np.testing.assert_allclose(wide.position, [0.0, -3.0, 0.0], atol=1e-9)
    high = view.back_off(np.array([[-6.0, 0.0, 0.0], [6.0, 0.0, 8.0]]), 2.0)
    np.testing.assert_allclose(high.position, [0.0, -4.0, 4.0], atol=1e-9)


def test_only_what_a_film_shows_is_in_the_scene(staged):
    """Not the collision geometry; the glass ball of the target is as transparent as in a film."""
    shapes, model = staged[0], staged[0].model
    colours = {shape.rgba for shape in shapes.shapes}
    assert (0.2, 0.6, 0.9, 0.35) not in colours  # of collision geoms, in group 3
    assert (0.08, 0.75, 0.7, 0.25) in colours
    assert {model.body(shape.body).name for shape in shapes.shapes} >= {"base", "link1", "target"}
    assert [model.geom(geom).name for geom in shapes.floors] == ["floor"]


def test_a_floor_in_a_body_is_drawn_where_it_is():
    """As that of an imported arm; it was drawn at the pose in its body."""
    pytest.importorskip("viser")
    floor = '<body pos="0 0 -.3" euler="0 90 0"><geom type="plane" size="0 0 1" pos=".1 0 0"/></body>'
    shapes = viser_scene.Shapes(mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{floor}</worldbody></mujoco>"))
    np.testing.assert_allclose(shapes.floors[0]["position"], [0.0, 0.0, -0.4], atol=1e-9)
    np.testing.assert_allclose(shapes.floors[0]["wxyz"], [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0], atol=1e-9)


def test_edges_are_sharp_and_curved_sides_smooth():
    """A box has three vertices at each of its 8 corners; of a cylinder, all but the middles of its ends are twice."""
    pytest.importorskip("viser")
    geoms = '<body><geom type="box" size="1 1 1"/></body><body><geom type="cylinder" size="1 1" rgba="1 0 0 1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    box, cylinder = (shape.mesh for shape in viser_scene.Shapes(model).shapes)
    assert (len(box.vertices), len(box.faces)) == (24, 12)
    assert len(box.vertices) == 3 * len(np.unique(box.vertices, axis=0))
    places, times = np.unique(np.round(cylinder.vertices, 6), axis=0, return_counts=True)
    on_edge = np.hypot(*places[:, :2].T) > 0.5
    np.testing.assert_array_equal(times, np.where(on_edge, 2, 1))
    for mesh in (box, cylinder):
        assert mesh.volume == pytest.approx({24: 8.0}.get(len(mesh.vertices), np.pi * 2.0), rel=0.02)


def test_two_arms_side_by_side_share_their_geometry(gantry):
    rollout = make_rollout(gantry)
    one, two = record([rollout]), record([rollout, rollout], ["one", "other"])
    assert len(two.content) < 1.35 * len(one.content)
    assert 1.0 <= one.ratio <= two.ratio == pytest.approx(16 / 9)


def test_the_planned_path_is_left_out_only_where_it_has_been_travelled(rollout, staged):
    shapes, marker = staged
    with quiet_server() as server:
        copy = _Copy(server.scene, shapes, marker, rollout, "/0", np.zeros(3), 1.0)
        copy.show(0.1)
        ends = rollout.link_position[[rollout.t.searchsorted(0.1), -1], -1]
        np.testing.assert_allclose([copy._planned.points[0, 0], copy._planned.points[-1, -1]], ends, atol=1e-4)


@pytest.mark.parametrize(
    ("clearance", "words"),
    [
        (Clearance(0.00874, 0.1, ("a", "b"), np.empty((0, 2))), "at least 8.74 mm clear, proved"),
        (Clearance(0.00874, 0.1, (), np.array([[0.2, 0.3]]), 0.9), "clearance not proved"),
        (None, ""),
    ],
)
def test_the_caption_says_what_is_proved(rollout, tmp_path, monkeypatch, clearance, words):
    monkeypatch.setitem(vars(rollout), "clearance", clearance)
    monkeypatch.setattr(page, "record", lambda *_, **__: page.Recording(b"", 1.0))
    render_page(rollout, tmp_path / "motion.html")
    header = (tmp_path / "motion.html").read_text().split("<header>")[1].split("</header>")[0]
    assert f"<span>{words}</span>" in header or not words
    assert ("proved" in header) == bool(words)


@pytest.fixture(scope="module")
def address(rollout, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "motion.html"

    @contextlib.contextmanager
    def server():
        # To light a scene by its surroundings and to throw shadows takes a processor that draws longer than all else.
        with quiet_server() as made:
            made.scene.configure_environment_map(None)
            made.scene.configure_default_lights(cast_shadow=False)
            made.scene.add_light_ambient("/light", intensity=3.0)
            yield made

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "quiet_server", server)
        render_page(rollout, path, title="by <hand>")
    return path.as_uri()


@pytest.fixture
def browser(address, opened):
    """The page, opened from a file."""
    return opened(address, 400, 360)


@pytest.mark.browser
def test_in_a_browser_the_page_plays_to_its_end(rollout, browser):
    """The last body comes to where the simulation ends, and the arm is seen; nothing is asked of the network."""
    arm = rollout.arm
    data = kinematics_at(arm.model, arm.qpos(rollout.q[-1]))
    body = int(arm.frames.bodies[-1])
    place = browser.execute_async_script(
        "const [name, end, done] = arguments; const wait = setInterval(() => {"
        "const pose = window.__viserMutable?.nodePoseData[name]; if (!pose) return;"
        "if (Math.hypot(...pose.position.map((x, i) => x - end[i])) < 1e-3) {"
        "clearInterval(wait); document.querySelector('button').click(); done(pose.position); }}, 5)",
        f"/0/{arm.model.body(body).name}",
        data.xpos[body].tolist(),
    )
    np.testing.assert_allclose(place, data.xpos[body], atol=1e-3)
    assert browser.find_element("tag name", "header").text.split("\n")[:2] == ["telescopic_pr", "by <hand>"]

    def orange():
        picture = np.asarray(Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB")).astype(int)
        red, green, blue = np.moveaxis(picture, -1, 0)
        return np.count_nonzero((red > 150) & (green < 0.6 * red) & (blue < 0.4 * red))

    # A busy machine draws the arm later; the limit is for a test that would hang.
    ends = time.monotonic() + 240.0
    while (seen := orange()) <= 80 and time.monotonic() < ends:
        time.sleep(0.5)
    assert seen > 80, "the arm is orange"
    requests = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [item["params"]["request"]["url"] for item in requests if item["method"] == "Network.requestWillBeSent"]
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [browser.current_url]
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


@pytest.mark.browser
def test_in_a_tall_window_the_page_is_filled_and_the_arm_stays_within(browser):
    """As wide a picture as one of the least width / height has, in the whole height."""
    browser.set_window_size(400, 844)
    zoom, wide, high, ratio = browser.execute_async_script(
        "const done = arguments[0], ratio = Number(document.head.innerHTML.match(/clientHeight . ([0-9.]+)/)[1]);"
        "const wait = setInterval(() => { const eye = window.__viserMutable?.cameraControl;"
        "if (!eye || eye.camera.zoom === 1) return; const box = document.querySelector('#root canvas');"
        "clearInterval(wait); done([eye.camera.zoom, box.clientWidth, box.clientHeight, ratio]); }, 50)"
    )
    assert high > 500 > wide
    assert zoom == pytest.approx(wide / high / ratio, rel=0.02)
    assert ratio >= 1.0


def test_legs_are_drawn_between_their_ends():
    """Of the compound arm, whose legs are tendons: from lower to upper site, where MuJoCo's kinematics has them."""
    pytest.importorskip("viser")
    arm = Arm.load("telescopic_compound")
    model = arm.model
    shapes = viser_scene.Shapes(model)
    ends = {model.tendon(k).name: [f"{model.tendon(k).name}_{end}" for end in ("lower", "upper")] for k in range(24)}
    with quiet_server() as server:
        nodes = viser_scene.ModelNodes(server.scene, shapes, "/arm")
        for name in ("home", "extended"):
            data = kinematics_at(model, arm.qpos(arm.keyframe(name)))
            nodes.show(data.qpos)
            legs = [pair for node, tendons in nodes.tendons for pair in zip(tendons, node.points, strict=True)]
            drawn = {model.tendon(k).name: piece for k, piece in legs}
            assert drawn.keys() == ends.keys()
            for leg, piece in drawn.items():
                wanted = [data.site_xpos[model.site(end).id] for end in ends[leg]]
                np.testing.assert_allclose(piece, wanted, atol=1e-4)
    assert {radius for _, radius in shapes.tendons} == set(model.tendon_width.astype(np.float32).astype(float))
