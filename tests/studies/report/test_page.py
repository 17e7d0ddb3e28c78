"""The page of a comparison: what is in it, and what a browser makes of it."""

from __future__ import annotations

import contextlib
import re
from dataclasses import replace

import pytest

from lieednn_sim.errors import InputError
from lieednn_sim.studies import Case, Comparison, Row, Settings, compute
from lieednn_sim.studies.comparison.summary import winners
from lieednn_sim.studies.report import choose_problems, figures, page, view, write_page
from lieednn_sim.studies.report.figures import FAMILIES, family

CONTROLLERS = ("position-servo", "computed-torque")
SETTINGS = Settings(duration=1.2, hold=0.1)


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Two planners, two scenes, two controllers, and rows of more arms and failures made up from them."""
    selection = Comparison(("minimum-jerk", "se3-geodesic"), ("telescopic_pr",), ("free",), CONTROLLERS, seeds=1)
    made = compute(replace(selection, common=SETTINGS), tmp_path_factory.mktemp("table"))
    for index, row in enumerate(made.rows.values()):
        for arm, scene in (("telescopic_pr", "window"), ("another_arm", "free")):
            values = {"tracking_rms_mm": 10.0 ** (index - 3), "planning_s": 0.5 + index}
            made.add([replace(row, arm=arm, scene=scene, seed=3, **values)])
    reason = "plan: <b>no</b> way past 'link4' & co after 3.5 s"
    made.add([Row("another_arm", "free", "rrt-connect", row.controller, row.seed, row.mass_scale, reason)])
    return made


@pytest.fixture(scope="module", autouse=True)
def not_laid_out():
    """Figures are not laid out; `test_numbers.py` does that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "fix_layout", lambda figure, _: figure.set_layout_engine(None))
        yield


@pytest.fixture(scope="module")
def figures_kept():
    """In its context pages take the figures that were drawn in it before: to draw them takes longer than all else."""
    drawn, draw = {}, page.plots

    def plots(rows, controller):
        key = (*rows, controller)
        if key not in drawn:
            drawn[key] = draw(rows, controller)
        return drawn[key]

    @contextlib.contextmanager
    def keeping():
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(page, "plots", plots)
            yield

    return keeping


def text_of(path):
    return path.read_text(encoding="utf-8")


def test_the_page_asks_for_nothing_and_says_what_was_compared(table, figures_kept, tmp_path):
    path = tmp_path / "page.html"
    given = {
        "date": "2030-01-02",
        "missing": {"rrt-star": "pip install it"},
        "command": "lieednn-sim compare --seeds 1",
    }
    with figures_kept():
        write_page(path, table, **given)
    text = text_of(path)
    # Addresses are names of XML vocabularies or data; nothing else is loaded.
    assert set(re.findall(r"""(?:src|href|poster)=["'](?!#|data:)([^"']*)""", text)) == set()
    assert set(re.findall(r"https?://[^\"'\s<)]+", text)) <= {
        "http://www.w3.org/2000/svg",
        "http://www.w3.org/1999/xlink",
    }
    assert "@import" not in text
    assert "url(" not in re.sub(r"url\(#", "", text)
    for word in (
        "2030-01-02",
        "rrt-star (pip install it)",
        "lieednn-sim compare --seeds 1",
        table.versions["mujoco"],
        "another_arm",
    ):
        assert word in text
    # What comes from data is text, not markup.
    assert "&lt;b&gt;no&lt;/b&gt; way past" in text
    assert "<b>no</b>" not in text
    again = tmp_path / "again.html"
    write_page(again, table, **given)
    assert text_of(again) == text


def test_the_winners_are_the_best_on_problems_that_all_solved():
    """'dmp' fails at the hard problem, so that it is not asked further; 'stomp' has too few seeds."""
    rows = []
    for planner, seconds, lengths, seeds in (
        ("minimum-jerk", (0.1, 0.3, 9.0), (1.0, 1.0, 5.0), 3),
        ("rrt-connect", (0.2, 0.2, 0.2), (1.0, 1.01, 5.0), 3),
        ("dmp", (0.01, 0.01, None), (0.1, 0.1, None), 3),
        ("stomp", (0.001,), (0.01,), 1),
    ):
        for seed in range(seeds):
            reason = "" if seconds[seed] else "plan: no way"
            measured = {"planning_s": seconds[seed], "path_ranges": lengths[seed]}
            rows.append(Row("arm", "wall", planner, "pd", seed, 1.0, reason, **measured))
    won = winners([*rows, replace(rows[0], controller="other", reason="contact")], "pd")["wall"]
    assert won["arrives"] == (("minimum-jerk", "rrt-connect"), 1.0, ("dmp", 2 / 3))
    assert won["is planned soonest"] == (("rrt-connect",), 0.2, ("minimum-jerk", 0.3))
    assert won["is shortest"] == (("minimum-jerk", "rrt-connect"), 1.0, None)
    assert won["withstands pushes, proved"] is None


def test_planners_have_the_colours_of_their_families():
    assert family("rrt-connect") == family("sscbirrt")
    found = [family(name) for name in ("minimum-jerk", "stomp", "rrt-connect", "lieednn-shaped", "my-own")]
    assert found[-1] == "others"
    assert len({FAMILIES[name] for name in found}) == 5


def test_an_empty_table_is_refused(tmp_path):
    with pytest.raises(InputError, match="is empty"):
        write_page(tmp_path / "page.html", Comparison(common=SETTINGS).open(tmp_path / "table"))


def test_problems_are_those_of_the_best_of_lieednn_and_others_in_turn(tmp_path):
    """Two scenes; 'dmp' fails in one, 'lieednn-shaped' succeeds once more than 'lieednn-certified'."""
    others = ["minimum-jerk", "se3-geodesic", "linear-attractor", "dmp", "promp"]
    failed = {("free", "dmp", 0), ("poles", "lieednn-certified", 0)}
    table = Comparison().open(tmp_path)
    table.add(
        [
            Row("arm", scene, planner, "pd", seed, 1.0, "contact" if (scene, planner, seed) in failed else "")
            for scene in ("free", "poles")
            for planner in ("lieednn-certified", "lieednn-shaped", *others)
            for seed in (0, 1)
        ]
    )
    # Where fewer arrived comes last.
    table.add([Row("arm", "a wall", planner, "pd", 0, 1.0) for planner in ("lieednn-shaped", "dmp")])
    first, second, last = choose_problems(table, 3, "pd")
    assert [case.scene for case in last] == ["a wall"] * 2
    for cases in (first, second):
        assert len({(case.arm, case.scene, case.seed) for case in cases}) == 1
        assert cases[0].planner == "lieednn-shaped"
        assert len({case.planner for case in cases}) == 4
        assert {case.seed for case in cases} == {1}, "the seed that all solved"
    assert {case.planner for case in first} & {case.planner for case in second} == {"lieednn-shaped"}
    assert choose_problems(table, 1, "pd") == [first]
    assert choose_problems(table, 2, "another") == []


@pytest.fixture(scope="module")
def address(table, figures_kept, tmp_path_factory):
    """Of the page with two views."""
    path = tmp_path_factory.mktemp("page") / "page.html"
    with figures_kept():
        cases = [Case("telescopic_pr", "free", planner, 0) for planner in ("minimum-jerk", "se3-geodesic")]
        shown = view(table, cases, "position-servo")
        write_page(path, table, views=[shown, shown])
    assert path.stat().st_size < 3e6
    return path.as_uri()


@pytest.fixture
def browser(address, opened):
    driver = opened(address, 1280, 1000)
    driver.execute_script("document.querySelectorAll('details').forEach((part) => (part.open = true))")
    return driver


def column(driver, index):
    """Keys of the shown rows of a column: numbers, None where missing."""
    return driver.execute_script(
        "return [...document.querySelectorAll('#medians tbody tr')].filter(r => !r.hidden).map(r => {"
        "const c = r.cells[arguments[0]]; return c.dataset.value === undefined ? c.textContent.trim() :"
        "c.dataset.value === '' ? null : Number(c.dataset.value)})",
        index,
    )


def heading(driver, word):
    """Index and element of the column whose heading begins with a word."""
    found = driver.find_elements("css selector", "#medians thead th")
    return next((index, cell) for index, cell in enumerate(found) if cell.text.startswith(word))


@pytest.mark.browser
@pytest.mark.rendering
def test_in_a_browser_the_page_loads_without_a_complaint(browser):
    assert browser.get_log("browser") == []
    assert browser.find_element("tag name", "h1").text == "Motion planners compared"
    # On a phone nothing but tables scrolls sideways.
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    drawn = browser.execute_script("return [...document.querySelectorAll('figure svg')].map(s => s.getBBox().width)")
    assert len(drawn) == 10  # five figures for each of two arms
    assert min(drawn) > 100


@pytest.mark.browser
@pytest.mark.rendering
def test_in_a_browser_the_page_begins_with_the_winners_and_is_short(browser):
    """All but these is closed at first, and open where the address names it."""
    script = "document.querySelectorAll('details').forEach((part) => (part.open = false))"
    browser.execute_script(script)
    assert browser.execute_script("return document.documentElement.scrollHeight") < 2000
    assert browser.find_element("tag name", "h2").text == "Who wins what, and where"
    row = browser.find_elements("css selector", "#winners tbody tr")[0]
    assert [cell.text.splitlines()[0] for cell in row.find_elements("css selector", "th, td")] == [
        "arrives",
        *["100 %"] * 2,
    ]
    browser.get(browser.current_url.partition("#")[0] + "#failures")
    browser.refresh()
    shown = browser.find_elements("css selector", "details[open]")
    assert [part.get_attribute("id") for part in shown] == ["failures"]


@pytest.mark.browser
@pytest.mark.rendering
@pytest.mark.parametrize("word", ["tracking RMS", "planning", "planner"])
def test_in_a_browser_a_click_sorts_both_ways(browser, word):
    index, cell = heading(browser, word)
    before = column(browser, index)
    for direction in ("ascending", "descending"):
        cell.find_element("tag name", "button").send_keys("\ue007")  # the Enter key: no mouse is needed
        values = [value for value in column(browser, index) if value is not None]
        assert values == sorted(values, reverse=direction == "descending")
        assert len(set(values)) > 2
        # What is missing stays last.
        assert column(browser, index)[: len(values)] == values
        assert cell.get_attribute("aria-sort") == direction
        others = browser.find_elements("css selector", "#medians th[aria-sort='none']")
        assert len(others) == len(browser.find_elements("css selector", "#medians thead th")) - 1
    assert sorted(map(str, before)) == sorted(map(str, column(browser, index)))


@pytest.mark.browser
@pytest.mark.rendering
def test_in_a_browser_filters_hide_rows_and_figures(browser):
    total = len(column(browser, 0))
    for name, value, index in (("arm", "telescopic_pr", 1), ("controller", "position-servo", 3)):
        browser.find_element("css selector", f"select[name={name}] option:nth-child(n+2)")
        browser.execute_script(
            "const s = document.querySelector(`select[name=${arguments[0]}]`); s.value = arguments[1];"
            "s.dispatchEvent(new Event('change', {bubbles: true}))",
            name,
            value,
        )
        assert set(column(browser, index)) == {value}
    shown = column(browser, 0)
    assert 0 < len(shown) < total
    assert browser.find_element("css selector", ".filters output").text == f"{len(shown)} of {total} rows"
    blocks = browser.find_elements("css selector", ".arm")
    assert [block.get_attribute("data-arm") for block in blocks if block.is_displayed()] == ["telescopic_pr"]
    browser.find_element("css selector", ".filters button[type=reset]").click()
    # The page filters again after the form is reset, which is after the click has returned.
    wait = pytest.importorskip("selenium.webdriver.support.wait")
    wait.WebDriverWait(browser, 60.0).until(lambda driver: len(column(driver, 0)) == total)


@pytest.mark.browser
@pytest.mark.rendering
def test_in_a_browser_a_click_plays_two_planners_side_by_side(browser):
    """A second view takes the first one's place, before that has drawn anything: to draw takes longer than all else."""
    browser.set_window_size(400, 400)
    buttons = browser.find_elements("css selector", ".view button")
    assert len(buttons) == 2
    for button in buttons:
        browser.execute_script("arguments[0].click()", button)
        (frame,) = browser.find_elements("css selector", ".view iframe")
    wait = pytest.importorskip("selenium.webdriver.support.wait")
    browser.switch_to.frame(frame)
    wait.WebDriverWait(browser, 300.0).until(
        lambda driver: driver.execute_script(
            "const poses = window.__viserMutable?.nodePoseData;"
            "return poses && '/0/link1' in poses && '/1/link1' in poses"
        )
    )
    browser.switch_to.default_content()
