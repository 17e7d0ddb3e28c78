"""The moving pictures of the README's first screen: `python docs/loops.py [push] [live]` writes results/loops/*.gif.

The first needs OpenGL, the second the extra view, Selenium and Chromium. The third picture there is a film of
`scripts/tasks.py`.
"""

from __future__ import annotations

import io as stream
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation
from selenium import webdriver

import lieednn_sim as ls
from lieednn_sim.io import atomic_path
from lieednn_sim.live import Page, Session
from lieednn_sim.planning import ShapedOptions
from lieednn_sim.rendering import opengl, scene_setup

SIZE = (640, 360)
# A picture, and for how long it is shown [s].
Frame = tuple[Image.Image, float]


def pushed() -> Iterator[Frame]:
    """The push of the example `push_and_return`: slowly while the arm is off its way."""
    arm = ls.Arm.load("telescopic_compound", scene="window", seed=0)
    target = ls.draw_target(arm, seed=0)
    policy = ls.make_policy("lieednn-shaped", arm, target, options=ShapedOptions(rate=0.1))
    push = ls.Push("link 3", force=(760.0, 410.0, -60.0), start=0.32, duration=0.2)
    run = ls.follow(policy, target, duration=4.0, disturbances=ls.Disturbances(pushes=(push,))).rollout
    judged = ls.evaluate(run)
    assert judged.peak_contact_force_n == 0.0
    model, marker = scene_setup.staged(arm, scene_setup.occupied(run))
    data, view = mujoco.MjData(model), mujoco.MjvCamera()
    scene_setup.mark(arm, data, marker, target)
    view.lookat[:], view.azimuth, view.elevation, view.distance = (-0.93, -0.22, 1.95), 150.0, -16.0, 1.6
    strength, body = np.linalg.norm(push.force), push.body_id(arm, model)
    opengl.require()
    with mujoco.Renderer(model, SIZE[1], SIZE[0]) as renderer:
        for now in (*np.arange(0.0, 0.3, 0.03), *np.arange(0.3, 0.8, 0.016), *np.arange(0.8, 2.6, 0.075), run.t[-1]):
            k, last = round(now / run.timestep), now == run.t[-1]
            data.qpos[:] = run.qpos[k]
            mujoco.mj_forward(model, data)
            for _ in range(2):
                renderer.update_scene(data, view)
            scene = renderer.scene
            for before, after in zip(run.link_position[:k:6, -1], run.link_position[6:k:6, -1], strict=False):
                _add(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, 0.007, before, after, (0.98, 0.80, 0.10, 1.0))
            words = "returns by itself" if push.end <= now < 1.0 else "on its way through the window"
            if push.start <= now < push.end:
                words = f"pushed: {strength:.0f} N"
                there, along = data.xipos[body], np.array(push.force) / strength
                _add(scene, mujoco.mjtGeom.mjGEOM_ARROW, 0.03, there - 0.5 * along, there, (1.0, 0.1, 0.1, 1.0))
            if last:
                words = f"arrived, never nearer than {judged.clearance_mm:.0f} mm"
            yield _captioned(renderer.render(), words), 1.5 if last else 0.06


def _add(scene: Any, kind: Any, width: float, a: Any, b: Any, colour: Any) -> None:
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(colour, dtype=np.float32))
    mujoco.mjv_connector(geom, kind, width, a, b)
    scene.ngeom += 1


def _captioned(picture: Any, words: str) -> Image.Image:
    image, font = Image.fromarray(picture), ImageFont.load_default(27)
    draw = ImageDraw.Draw(image)
    draw.rounded_rectangle((12, 12, 40 + draw.textlength(words, font), 54), 8, fill=(20, 26, 33))
    draw.text((26, 16), words, font=font, fill="white")
    return image


class Stepped(Session):
    """A session whose time goes on only by `advance`, as slowly as pictures are taken."""

    def run(self) -> None:
        pass


def dragged() -> Iterator[Frame]:
    """The live view in Chromium, with large letters, while a mouse drags the target's handle."""
    arm = ls.Arm.load("telescopic_pr")
    session = Stepped(arm, target=0.5 * (arm.keyframe("home") + arm.keyframe("extended")))
    session.settle()
    session.advance(500)
    session.settle()
    chrome = webdriver.ChromeOptions()
    chrome.binary_location = shutil.which("chromium")
    for word in ("--headless=new", "--no-sandbox", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"):
        chrome.add_argument(word)
    service = webdriver.ChromeService(shutil.which("chromedriver"))
    with webdriver.Chrome(options=chrome, service=service) as driver, Page(session) as page:
        server = page._server
        server.scene.configure_default_lights(cast_shadow=False)
        server.gui.configure_theme(control_width="small", show_logo=False, show_share_button=False)
        handle = session.aimed.position
        server.initial_camera.look_at = middle = 0.5 * handle
        server.initial_camera.position = middle + 1.85 * np.cross([*handle[:2], 0.0], [0.0, 0.0, 1.0]) + [0.0, 0.0, 0.7]
        size = {"width": SIZE[0], "height": SIZE[1], "deviceScaleFactor": 1, "mobile": False}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        driver.get(page.url)
        _wait(lambda: "certified" in driver.execute_script("return document.body.textContent"))
        driver.execute_script(_DRESS)
        camera = next(iter(server.get_clients().values())).camera

        def seen(point: Any) -> Any:
            x, y, z = Rotation.from_quat(camera.wxyz, scalar_first=True).inv().apply(point - camera.position)
            box = driver.execute_script("return document.querySelector('canvas').getBoundingClientRect().toJSON()")
            scale = 0.5 * box["height"] / np.tan(0.5 * camera.fov)
            return scale * np.array([x, y]) / z + [box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]]

        def mouse(kind: str, place: Any, **more: Any) -> None:
            what = {"type": kind, "x": float(place[0]), "y": float(place[1]), **more}
            driver.execute_cdp_cmd("Input.dispatchMouseEvent", what)
            move = "document.getElementById('m').style.translate = `${arguments[0]}px ${arguments[1]}px`"
            driver.execute_script(move, *map(float, place))

        def shot(periods: int, pause: float = 0.08) -> Frame:
            time.sleep(0.2)  # until the page has told the session of the mouse
            session.settle()
            session.advance(periods)
            session.settle()
            said = f"{session.tick.time:.1f} s,"
            _wait(lambda: said in driver.execute_script("return document.body.textContent"))
            driver.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
            return Image.open(stream.BytesIO(driver.get_screenshot_as_png())), pause

        held = {"button": "left", "buttons": 1, "clickCount": 1}
        for axis, length in DRAGS:
            turn = Rotation.from_quat(session.aimed.quaternion, scalar_first=True)
            along = turn.apply(np.eye(3)[axis])
            start, end = (seen(session.aimed.position + (0.2 + far) * along) for far in (0.0, length))
            mouse("mouseMoved", start)
            yield shot(10)
            mouse("mousePressed", start, **held)
            for share in np.linspace(0.0, 1.0, 13)[1:]:
                mouse("mouseMoved", start + share * (end - start), **held)
                yield shot(10)
            mouse("mouseReleased", end, **held)
            for _ in range(5):
                yield shot(20)
        yield shot(150, 1.5)


# Axes of the handle along which the mouse drags it, and how far [m].
DRAGS = ((2, -0.5), (0, -0.4))
# Large letters in the panel and fewer rows, no notice that a processor draws, and the mouse, which a headless browser
# does not show.
_DRESS = """document.head.insertAdjacentHTML('beforeend', '<style>.mantine-Notifications-root, tr:nth-child(1), '
+ 'tr:nth-child(5), tr:nth-child(7), tr:nth-child(8) {display: none} table {font-size: 14px !important}</style>');
document.body.insertAdjacentHTML('beforeend', '<svg id="m" width="26" height="36" '
+ 'style="position:fixed;left:0;top:0;z-index:9999;pointer-events:none">'
+ '<path d="M1 1v27l6-6 5 12 5-2-5-12h9z" fill="#111" stroke="#fff" stroke-width="2"/></svg>')"""


def _wait(event: Callable[[], bool]) -> None:
    ends = time.monotonic() + 120.0
    while not event():
        if time.monotonic() > ends:
            raise TimeoutError("the page does not show what it should")
        time.sleep(0.05)


def write(path: Path, frames: list[Frame]) -> None:
    """Write a GIF with one palette for all frames, whose colours would flicker otherwise."""
    pictures = [picture.convert("RGB") for picture, _ in frames]
    few = np.vstack([np.asarray(picture) for picture in pictures[:: max(1, len(pictures) // 6)]])
    palette = Image.fromarray(few).quantize(160, Image.Quantize.MAXCOVERAGE)
    reduced = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    with atomic_path(path) as temporary:
        pauses = [round(1e3 * pause) for _, pause in frames]
        reduced[0].save(temporary, "GIF", save_all=True, append_images=reduced[1:], duration=pauses, loop=0)


LOOPS: dict[str, Callable[[], Iterator[Frame]]] = {"push": pushed, "live": dragged}

if __name__ == "__main__":
    folder = Path("results/loops")
    folder.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or LOOPS:
        write(folder / f"loop_{name}.gif", list(LOOPS[name]()))
