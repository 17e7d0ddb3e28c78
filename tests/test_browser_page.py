"""The site's page in which an arm moves: its policy beside Python's, and the built file in a browser."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

import lieednn_sim as ls

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "browser"
WIDTH, HEIGHT = 480, 360


@pytest.fixture(scope="module")
def maker():
    """The module that makes the page."""
    spec = importlib.util.spec_from_file_location("browser_page", FOLDER / "browser_page.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def built(maker, tmp_path_factory):
    """The page, made anew; its packages are fetched unless `make docs` has done so."""
    if shutil.which("npm") is None:
        pytest.skip("no npm")
    path = tmp_path_factory.mktemp("site") / "browser.html"
    try:
        maker.write(path)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"the packages of the page could not be fetched: {error}")
    return path


@pytest.fixture
def browser(built, opened):
    """The page in a browser, with an arm that moves."""
    driver = opened(built.as_uri(), WIDTH, HEIGHT)
    # To draw without a graphics card takes all that there is, and four pictures a second are enough here.
    driver.execute_script("const draw = requestAnimationFrame; requestAnimationFrame = (f) => setTimeout(draw, 250, f)")
    wait(lambda: driver.execute_script("return globalThis.page?.world.data.time > 0"))
    return driver


def wait(event):
    """Wait until something is so; the limit is for a test that would hang."""
    ends = time.monotonic() + 240.0
    while not event():
        assert time.monotonic() < ends
        time.sleep(0.02)


def wait_while_it_goes_on(driver, event):
    """As `wait`, for what the arm does: half a second of its time at once, since to draw it takes much longer."""
    advance = "for (let k = 0; k < 50; k++) page.world.advance();"
    wait(lambda: (driver.execute_script(advance), event())[1])


def number(driver, name):
    """The first number that the page tells in a row."""
    return float(re.search(r"[\d.]+", driver.find_element("id", name).text)[0])


def pixel(driver, point):
    """Where the page shows a point, given in JavaScript."""
    return np.array(
        driver.execute_script(f"""
        const box = document.getElementById("stage").getBoundingClientRect();
        const seen = {point}.project(page.stage.camera);
        return [box.x + box.width * (seen.x + 1) / 2, box.y + box.height * (1 - seen.y) / 2];""")
    )


def drag(driver, start, end):
    """Press the mouse at a pixel and move it; what is returned lets it go."""
    mouse = {"button": "left", "buttons": 1, "clickCount": 1}

    def send(kind, place, more):
        what = {"type": f"mouse{kind}", "x": float(place[0]), "y": float(place[1]), **more}
        driver.execute_cdp_cmd("Input.dispatchMouseEvent", what)

    send("Moved", start, {})
    send("Pressed", start, mouse)
    for share in (0.5, 1.0):
        send("Moved", start + share * (end - start), mouse)
    return lambda: send("Released", end, mouse)


def run(driver, begin, periods):
    """How far the arm was from the ball at most, and is at the end [m], contacts, and whether the bound held."""
    return driver.execute_script(f"""
        {begin}
        const {{ world }} = page;
        const far = () => world.tip.distanceTo(world.tipAt(world.target));
        let [farthest, touched, kept] = [0, 0, true];
        for (let k = 0; k < {periods}; k++) {{
            world.advance();
            farthest = Math.max(farthest, far());
            touched += world.data.ncon;
            const [distance, bound] = world.policy.progress();
            kept &&= distance <= bound + 1e-9;
        }}
        return [farthest, far(), touched, kept];""")


@pytest.mark.browser
@pytest.mark.parametrize("scene", ["free", "window"])
def test_its_policy_is_that_of_python(scene, maker, opened, tmp_path):
    """Behind an arm that lags and is pushed, for targets that jump, over 1,000 periods."""
    policy, target = maker.policy_of(scene)
    arm, rng = policy.arm, np.random.default_rng(1)
    targets = [target, *(ls.draw_target(arm, seed=seed) for seed in (2, 3, 4))]
    given = {**maker.exported(policy), "guarantees": maker.guarantees(policy, target)}
    place, push, rows, expected, pulled, limited = policy.q, 0.0, [], [], 0, 0
    for k in range(1_000):
        if k % 125 == 0:
            push = 0.05 * rng.normal(size=arm.n_joints) * arm.ranges * (k % 250 == 125)
        place = place + 0.08 * (policy.q + push - place)
        rows.append([*place, *targets[k // 250]])
        q, _ = policy.step(place, targets[k // 250])
        expected.append([*policy.xi.ravel(), *q])
        pulled, limited = pulled + policy.pulled, limited + policy._limited
    assert min(pulled, limited) > 20
    run = f"""const [given, home, rows] = {json.dumps([given, arm.keyframe("home").tolist(), np.array(rows).tolist()])};
        const policy = new Policy(given, home, rows[0].slice(8));
        globalThis.states = rows.map((row) => {{
            policy.step(row.slice(0, 8), row.slice(8));
            return [...policy.x, ...policy.q];
        }});"""
    path = tmp_path / "policy.html"
    path.write_text(f'<script type="module">{(FOLDER / "policy.js").read_text()}{run}</script>', encoding="utf-8")
    driver = opened(path.as_uri(), WIDTH, HEIGHT)
    wait(lambda: driver.execute_script("return Boolean(globalThis.states)"))
    states = np.array(driver.execute_script("return globalThis.states"), dtype=float)
    np.testing.assert_allclose(states, expected, rtol=0.0, atol=1e-9)


# Not one of those that REQUIRE_BROWSER requires: it also needs what npm fetches.
def test_the_arm_follows_the_ball_yields_and_goes_through_the_window(built, browser):
    assert built.stat().st_size < 5_000_000
    wait_while_it_goes_on(browser, lambda: browser.find_element("id", "state").text == "has arrived within 1 mm")

    # The ball is dragged to the left and down, in the plane of the screen.
    where = "page.stage.ball.position.clone()"
    start, way = pixel(browser, where), np.array([-30.0, 30.0])
    before = browser.execute_script(f"return {where}.toArray()")
    drag(browser, start, start + way)()
    ball = "return page.world.tipAt(page.world.target).toArray()"
    wait(lambda: np.linalg.norm(np.subtract(browser.execute_script(ball), before)) > 0.2)
    away = "return page.world.tip.distanceTo(page.world.tipAt(page.world.target))"
    wait_while_it_goes_on(browser, lambda: browser.execute_script(away) < 1e-3)
    wait(lambda: number(browser, "reach") < 1.0)
    assert browser.find_element("id", "reach").text.endswith(" mm from the ball")
    np.testing.assert_allclose(pixel(browser, where), start + way, atol=2.0)

    # A link that the mouse holds is pulled towards it, until it is let go.
    link = "page.stage.geoms.find((geom) => geom.userData.body === 5).matrix"
    start = pixel(browser, f"page.world.tip.setFromMatrixPosition({link})")
    let_go = drag(browser, start, start + np.array([0.0, 45.0]))
    # With a first step of the mouse it does not pull yet.
    wait(lambda: (browser.execute_script("return page.world.push?.acts?.z") or 0.0) < 0.0)
    let_go()
    wait(lambda: browser.execute_script("return page.world.push === null"))

    # A push throws it off, and it returns; what is proved of the network holds meanwhile.
    farthest, near, touched, kept = run(browser, "document.getElementById('push').click();", 1500)
    assert farthest > 5e-3
    assert near < 1e-3
    assert touched == 0
    assert kept

    # Through the window from home, and again after a push, without contact.
    browser.find_element("id", "window").click()
    wait(lambda: "0.02 <" in browser.find_element("id", "proof").text)
    for begin, least in (("page.world.begin();", 0.3), ("document.getElementById('push').click();", 0.05)):
        farthest, near, touched, kept = run(browser, begin, 1000)
        assert farthest > least
        assert near < 1e-3
        assert touched == 0
        assert kept
    complaints = [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert complaints == []
    asked = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    addresses = [entry["params"]["request"]["url"] for entry in asked if entry["method"] == "Network.requestWillBeSent"]
    assert [address for address in addresses if not address.startswith(("file:", "blob:", "data:"))] == []


def test_where_npm_is_not_the_page_and_the_log_say_so(maker, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(maker, "WORK", tmp_path / "work")
    maker.write_or_say_why_not(tmp_path / "browser.html")
    assert "npm is not installed. Install npm" in (tmp_path / "browser.html").read_text(encoding="utf-8")
    assert capsys.readouterr().err.startswith("docs: browser.html: This page was left out")
