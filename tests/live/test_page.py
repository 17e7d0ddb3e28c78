"""The live view in a real browser: its target and links are dragged with the mouse, its menus and buttons used."""

import io
import signal
import sys
import time
from importlib.util import find_spec
from urllib.request import urlopen

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import lieednn_sim as ls
from lieednn_sim import registry
from lieednn_sim.arm import Arm
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.live import Page, Session, Settings
from lieednn_sim.live.page import warning
from lieednn_sim.live.scene import Observer

# Without importing it, which takes every worker long.
pytestmark = pytest.mark.skipif(find_spec("viser") is None, reason="viser is not installed")
WIDTH, HEIGHT = 720, 560
# For a page that has begun: few pictures a second, since to draw without a graphics card takes all that a core has. The
# player would answer to few of them by another resolution, which takes longest, unless the page's address has one.
RARE = """if (!window.rare) { window.rare = true; const draw = requestAnimationFrame;
window.requestAnimationFrame = (frame) => setTimeout(draw, 250, frame); }"""
RESOLUTION = "?fixedDpr=1"


def wait(event):
    """Wait until something is so, and return it; the limit is for a test that would hang."""
    ends = time.monotonic() + 240.0
    while not (found := event()):
        assert time.monotonic() < ends
        time.sleep(0.1)
    return found


@pytest.fixture(scope="module")
def page():
    """A page whose arm has come to its first target."""
    session = Session(Arm.load("telescopic_pr"), settings=Settings(policy="linear-attractor"), target="extended")
    session.speed = 4.0
    with Page(session) as made:
        # To light a scene by its surroundings and to throw shadows takes a processor that draws longer than all else.
        made._server.scene.configure_environment_map(None)
        made._server.scene.configure_default_lights(cast_shadow=False)
        wait(lambda: arrived(made))
        # Near the target, so that the handle is large in a small picture.
        target = session.aimed.position
        made._server.initial_camera.position = target + np.array([0.7, -1.0, 0.6])
        made._server.initial_camera.look_at = target
        session.paused = True  # but in a browser: its thread takes what others need
        yield made


@pytest.fixture
def browser(page, opened):
    """The page in the browser."""
    driver = opened(page.url + RESOLUTION, WIDTH, HEIGHT)
    wait(lambda: "certified" in text(driver))
    wait(page._server.get_clients)
    # That it draws with the processor it tells in a corner, which may be where the mouse is to go.
    hide = "document.head.insertAdjacentHTML('beforeend', '<style>.mantine-Notifications-root{display:none}</style>')"
    driver.execute_script(hide)
    driver.execute_script(RARE)
    page.session.paused = False
    yield driver
    page.session.paused = True


def tip(page):
    arm = page.session.arm
    return np.asarray(arm.link_poses(page.session.tick.q)[-1].translation)


def arrived(page):
    return page.session.tick.policy and np.linalg.norm(tip(page) - page.session.aimed.position) < 1e-3


def pixel(page, browser, point):
    """Where the browser shows a point of the world, from its own camera."""
    camera = next(iter(page._server.get_clients().values())).camera
    x, y, z = Rotation.from_quat(camera.wxyz, scalar_first=True).inv().apply(point - camera.position)
    box = browser.execute_script(
        "const b = document.querySelector('canvas').getBoundingClientRect(); return [b.x, b.y, b.width, b.height]"
    )
    scale = 0.5 * box[3] / np.tan(0.5 * camera.fov)
    return np.array([box[0] + 0.5 * box[2] + scale * x / z, box[1] + 0.5 * box[3] + scale * y / z])


def text(browser):
    """All text of the page, also what is hidden: to find what is shown, the browser lays everything out."""
    return browser.execute_script("return document.body.textContent")


def picture(browser, mode="RGB"):
    """Colours of all pixels."""
    return np.asarray(Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert(mode))


def drag(browser, start, end):
    """Press the mouse at a pixel, move it in steps, and leave it pressed."""
    mouse = {"button": "left", "buttons": 1, "clickCount": 1}

    def send(kind, place, **more):
        what = {"type": kind, "x": float(place[0]), "y": float(place[1]), **more}
        browser.execute_cdp_cmd("Input.dispatchMouseEvent", what)

    send("mouseMoved", start)
    send("mousePressed", start, **mouse)
    for share in np.linspace(0.0, 1.0, 4)[1:]:
        send("mouseMoved", start + share * (end - start), **mouse)
    return lambda: send("mouseReleased", end, **mouse)


def press(browser, path):
    """Click at what a path of XML leads to."""
    found = wait(lambda: browser.find_elements("xpath", path))[0]
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", found)
    found.click()


@pytest.mark.browser
def test_the_mouse_drags_the_target_and_the_arm_arrives_within_a_millimetre(page, browser):
    before = page.session.aimed.position
    # The handle's arrow along z, which the mouse moves along itself; nearer to the middle are its rings and planes.
    along = Rotation.from_quat(page.session.aimed.quaternion, scalar_first=True).apply([0.0, 0.0, 1.0])
    start, end = (pixel(page, browser, before + length * along) for length in (0.25, 0.05))

    def blue():
        x, y = np.round(start).astype(int)
        red, _, ink = np.moveaxis(picture(browser)[y - 3 : y + 4, x - 3 : x + 4].astype(int), -1, 0)
        return (ink - red > 100).any()

    wait(blue)  # the arrow is there
    drag(browser, start, end)()
    wait(lambda: np.linalg.norm(page.session.aimed.position - before) > 0.1)
    wait(lambda: arrived(page))
    away = page.session.aimed.position - before
    assert page.session.aimed.problem == ""
    assert np.linalg.norm(away) > 0.1
    np.testing.assert_allclose(np.cross(away, along), 0.0, atol=1e-3)


@pytest.mark.browser
def test_a_link_that_the_mouse_holds_yields_and_returns(page, browser):
    wait(lambda: arrived(page))
    frames = page.session.arm.link_poses(page.session.tick.q)
    there, held = tip(page), np.mean([frames[k].translation for k in (-2, -1)], axis=0)
    start = pixel(page, browser, held)
    let_go = drag(browser, start, start + np.array([0.0, 60.0]))
    wait(lambda: np.linalg.norm(tip(page) - there) > 2e-3)
    # The mouse is below the link, and pulls it down.
    assert page.session.tick.force[2] < 0.0
    let_go()
    wait(lambda: not page.session.tick.force.any() and arrived(page))


@pytest.mark.browser
def test_the_button_pushes_and_the_menu_changes_the_policy(page, browser):
    wait(lambda: arrived(page))
    there = tip(page)
    # Slowly, so that a busy machine cannot miss it.
    page.session.speed = 0.1
    press(browser, "//button[normalize-space()='push']")
    wait(lambda: np.linalg.norm(tip(page) - there) > 1e-3)
    page.session.speed = 4.0
    wait(lambda: arrived(page))
    press(browser, "//input[@value='linear-attractor']")
    press(browser, "//*[@role='option'][normalize-space()='fabric']")
    wait(lambda: page.session.tick.policy == "fabric")
    wait(lambda: "none" in text(browser))  # no proof
    wait(lambda: not page._scene._planned.visible)  # nor a known way


@pytest.mark.browser
def test_another_tab_shows_the_arm_its_loss_leaves_the_first_and_nothing_complains(page, browser):
    page.session.paused = True  # it is not about motion
    first = browser.current_window_handle
    browser.switch_to.new_window("tab")
    browser.get(page.url + RESOLUTION)
    wait(lambda: len(page._server.get_clients()) == 2)
    wait(lambda: "policy" in text(browser))
    browser.execute_script(RARE)

    def orange():
        hue, saturation, value = np.moveaxis(picture(browser, "HSV")[:, : WIDTH // 2], -1, 0)
        return int(((hue > 5) & (hue < 25) & (saturation > 150) & (value > 100)).sum())

    wait(lambda: orange() > 1000)
    complaints = browser.get_log("browser")
    browser.close()  # a lost connection
    browser.switch_to.window(first)
    wait(lambda: len(page._server.get_clients()) == 1)
    wait(lambda: orange() > 1000)
    # Chromium itself grumbles about how the panel scrolls. On a busy machine viser's own script has been seen to
    # stumble once over what came early, after which it drew all the same.
    known = ("preventDefault", "object null is not iterable")
    entries = [entry for entry in (*complaints, *browser.get_log("browser")) if entry["level"] == "SEVERE"]
    complaints = [entry["message"] for entry in entries]
    assert [line for line in complaints if not any(words in line for words in known)] == []


def test_a_dragged_link_is_pulled_harder_the_farther_the_mouse_is_up_to_the_sliders_force(page):
    for away, force in ((0.0, 0.0), (0.15, 75.0), (0.3, 150.0), (3.0, 150.0)):
        np.testing.assert_allclose(page._panel.spring([1.0, 0.0, 0.5], [1.0, away, 0.5]), [0.0, force, 0.0], atol=1e-9)


def test_a_force_is_an_arrow_of_3_millimetres_for_a_newton_and_of_80_centimetres_at_most(page):
    snapshot = Observer(page.session).look()
    for newtons, length in ((100.0, 0.3), (800.0, 0.8)):
        tick = snapshot.tick._replace(force=np.array([0.0, newtons, 0.0]), pushed=np.ones(3))
        page._scene.show(snapshot._replace(tick=tick), None)
        begin, end = page._scene._arrow.points[0]
        np.testing.assert_allclose(end - begin, [0.0, length * page._scene._scale, 0.0], rtol=1e-5)


def test_the_command_shows_an_own_robot_until_ctrl_c(start, tmp_path, two_hinges):
    (tmp_path / "mine.xml").write_text(two_hinges)
    (tmp_path / "table.yaml").write_text("obstacles: [{shape: sphere, name: lamp, radius: 0.1, position: [2, 0, 1]}]")
    words = ["view", str(tmp_path / "mine.xml"), "--scene", str(tmp_path / "table.yaml"), "--no-browser"]
    process = start("-m", "lieednn_sim", *words)
    lines = iter(process.stdout.readline, "")
    address = next(line for line in lines if line.startswith("view: "))
    assert b"<html" in urlopen(address.split()[1]).read()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert errors == "lieednn-sim: interrupted; files already reported are complete\n"
    assert process.returncode == 130


def test_other_machines_are_let_in_with_a_warning_and_only_when_asked_for():
    assert [warning(host) for host in ("127.0.0.1", "localhost", "::1")] == ["", "", ""]
    assert "at 0.0.0.0 can see the page" in warning("0.0.0.0")


def test_a_load_beyond_the_usual_ones_is_shown_to_others_and_a_planner_that_is_not_installed_is_refused(monkeypatch):
    given = {"payload": 800.0, "mass_scale": 3.0, "rho": 0.02}
    warned = pytest.warns(UserWarning, match="anybody who can reach this machine")
    # To prove what a network does that is this much slower than its motion takes seconds.
    with warned, ls.view(host="0.0.0.0", browser=False, policy="linear-attractor", **given) as page:
        shown = [handle.value for handle in page._server.gui._gui_input_handle_from_uuid.values()]
        assert set(given.values()) <= {value for value in shown if isinstance(value, float)}
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(LieEDNNError, match=r"'rrt-connect' is not installed: pip install 'lieednn_sim\[rivals\]'"):
        ls.view(browser=False, planner="rrt-connect")


def test_without_viser_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(LieEDNNError, match=r"pip install 'lieednn_sim\[view\]'"):
        ls.view(browser=False)
