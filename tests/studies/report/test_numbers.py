"""The page's numbers and choices, from rows that are made up."""

from __future__ import annotations

import html
import re
from dataclasses import replace

import numpy as np
import pytest

from lieednn_sim.registry import CONTROLLERS
from lieednn_sim.studies import Comparison, Settings, write_summary
from lieednn_sim.studies.comparison.rows import BY_NAME, COLUMNS, SHOWN, Row
from lieednn_sim.studies.comparison.summary import in_order, method, verdict
from lieednn_sim.studies.reactions.study import MEASURED, Reaction, Reactions
from lieednn_sim.studies.report import figures, page, write_page

# In this order in the registry, and so in what is shown.
FIRST, SECOND, THIRD = "minimum-jerk", "se3-geodesic", "rrt-connect"


def row(planner, seed, controller="position-servo", scene="free", **values):
    """A success whose columns hold their place among the columns, and a half."""
    numbers = {column.name: index + 0.5 for index, column in enumerate(COLUMNS)}
    numbers |= {column.name: 0 for column in COLUMNS if column.name.endswith(("_violations", "_excess"))}
    words = {"stability": "-", "stability_level": "-"}
    return Row("an_arm", scene, planner, controller, seed, 1.0, **words | numbers | values)


ROWS = [
    # The median of the second is the least tracking error, of the third the least time; the means are others.
    *(row(FIRST, k, tracking_rms_mm=v, planning_s=4, clearance_mm=9) for k, v in enumerate((5, 6, 0.001))),
    *(row(SECOND, k, tracking_rms_mm=v, planning_s=7, clearance_mm=8) for k, v in enumerate((2, 3, 9000))),
    *(row(THIRD, k, tracking_rms_mm=40, planning_s=v, clearance_mm=3) for k, v in enumerate((0.5, 0.25, 99))),
]
CONTACT = {"reason": "contact: up to 1 at a time"}
ROWS[1] = replace(ROWS[1], **CONTACT, clearance_mm=-2.5, velocity_violations=7)
ROWS[8] = replace(ROWS[8], reason="arrival: link 1 ends 2 mm and 0 deg off")
# Another controller follows better; what is said of tracking is of the first one.
ROWS += [row(THIRD, k, "computed-torque", tracking_rms_mm=1e-9, planning_s=99, clearance_mm=7) for k in range(3)]


@pytest.fixture
def table(tmp_path):
    made = Comparison(common=Settings()).open(tmp_path / "table")
    made.add(ROWS)
    return made


def test_the_proof_of_a_motion_counts_once():
    """Whatever the number of controllers, and not where there is no network."""
    proofs = [row(FIRST, k, stability=s) for k, s in enumerate(["global", "local", "global", "none"])]
    followed = [*proofs, *(replace(one, controller="mocap") for one in proofs), row(FIRST, 9)]
    assert verdict(followed) == "global 2/4, local 1/4, none 1/4"


def test_the_page_has_each_median_in_its_column(table, tmp_path):
    write_page(tmp_path / "page.html", table)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    body = re.search(r'<table id="medians".*?</table>', text, re.DOTALL)[0]
    lines = re.findall(r"<tr data-arm.*?</tr>", body, re.DOTALL)
    assert [re.search(r'data-planner="([^"]*)" data-controller="([^"]*)"', line).groups() for line in lines] == [
        (FIRST, "position-servo"),
        (SECOND, "position-servo"),
        (THIRD, "computed-torque"),
        (THIRD, "position-servo"),
    ]
    medians = ((2, 4.0, 5.0, 9.0, 1), (3, 7.0, 3.0, 8.0, 0), (3, 99.0, 1e-9, 7.0, 0), (2, 0.5, 40.0, 3.0, 0))
    for line, (successes, planning, tracking, clearance, violations) in zip(lines, medians, strict=True):
        values = [float(value) for value in re.findall(r'data-value="([^"]*)"', line)]
        expected = {column.name: getattr(row(FIRST, 0), column.name) for column in SHOWN}
        expected |= {"planning_s": planning, "tracking_rms_mm": tracking, "clearance_mm": clearance}
        assert values == pytest.approx([successes / 3, *expected.values(), violations])
        low, high = {2: (21, 94), 3: (44, 100)}[successes]
        assert f"{successes}/3" in line
        assert f"{low}\N{EN DASH}{high} %" in line
    titles = [html.unescape(title) for title in re.findall(r'title="([^"]*)"', body[: body.index("</thead>")])]
    assert titles[1 : len(SHOWN) + 1] == [column.meaning for column in SHOWN]


def test_reactions_stand_below_their_heads(table, tmp_path, monkeypatch):
    monkeypatch.setattr(page, "plots", lambda rows, controller: [])
    reactions = Reactions((), (), 1).open(tmp_path / "reactions")
    measured = {column.name: float(index) for index, column in enumerate(MEASURED, 2)}
    for k, reason in enumerate(("contact: up to 1 at a time", "arrival: link 1 ends 2 mm and 0 deg off", "")):
        values = measured | {"back_s": measured["back_s"] if k else None}
        reactions.add([Reaction("an_arm", "free", "dmp", "push", k, reason=reason, **values)])
    write_page(tmp_path / "page.html", table, reactions=reactions)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    section = re.search(r'<details id="reactions".*?</details>', text, re.DOTALL)[0]
    plain = [
        [
            html.unescape(re.sub(r"<.*?>", "", cell)).strip()
            for cell in re.findall(r"<t[hd].*?</t[hd]>", line, re.DOTALL)
        ]
        for line in re.findall(r"<tr.*?</tr>", section, re.DOTALL)
    ]
    heads, cells = plain
    expected = {"policy": "dmp", "scene": "free", "disturbance": "push", "arrived": "1/3", "touched": "1", "back": "2"}
    expected |= {column.heading: f"{measured[column.name]:g}" for column in MEASURED}
    assert dict(zip(heads, cells, strict=True)) == expected


def test_names_are_shown_in_markdown_as_they_are(table, tmp_path):
    table.add([row(FIRST, 8, scene="<b>a|b</b>", reason="contact: <i>x|y</i>")])
    write_summary(tmp_path / "s.md", table)
    text = (tmp_path / "s.md").read_text(encoding="utf-8")
    assert "| &lt;b&gt;a\\|b&lt;/b&gt; |" in text
    assert "<b>" not in text
    assert "<i>" not in text


def test_gaps_that_are_rounding_are_zero(table, tmp_path):
    table.add([row(FIRST, 9, scene="other", gap_mm=3e-14, planning_s=1234.5)])
    write_summary(tmp_path / "s.md", table)
    line = next(line for line in (tmp_path / "s.md").read_text(encoding="utf-8").splitlines() if "| other |" in line)
    assert "e-14" not in line
    assert "1234" in line or "1235" in line


def test_the_summary_has_each_median_in_its_column(table, tmp_path):
    table.add([row(FIRST, 7, scene="window", **CONTACT)])
    write_summary(tmp_path / "s.md", table)
    text = (tmp_path / "s.md").read_text(encoding="utf-8")
    assert "within 1 mm and 0.1 deg of the target" in text
    # What touched something was made all the same.
    assert f"| an_arm | free | {FIRST} | 3 of 3 | - |" in text
    assert f"| an_arm | free | {FIRST} | position-servo | 2 of 3 | 21% to 94% |" in text
    lines = [line.strip("| ").split(" | ") for line in text.splitlines()]
    for names, headings, expected in (
        (
            ["an_arm", "free", SECOND, "3 of 3", "-"],
            ["arm", "scene", "planner", "made"],
            {"planning [s]": "planning_s", "gap [mm]": "gap_mm", "effector jerk [m/s³]": "jerk_effector"},
        ),
        (
            ["an_arm", "free", SECOND, "position-servo", "3 of 3", "44% to 100%"],
            ["arm", "scene", "planner", "controller"],
            {"tracking RMS [mm]": "tracking_rms_mm", "clearance [mm]": "clearance_mm", "effector path [m]": "path_m"}
            | {BY_NAME["velocity_violations"].heading: "velocity_violations"},
        ),
    ):
        heading = next(line for line in lines if line[:4] == headings)
        values = next(line for line in lines if line[: len(names)] == names)
        made = row(SECOND, 0, tracking_rms_mm=3, planning_s=7, clearance_mm=8)
        for title, column in expected.items():
            assert float(values[heading.index(title)]) == pytest.approx(getattr(made, column))
    assert f"- 2 x contact, as: up to 1 at a time ({FIRST} 2)" in text


def test_the_method_says_how_long_and_with_which_masses(tmp_path):
    made = method(Comparison(common=Settings(duration=3.0, hold=2.0, mass_scale=1.5, time_budget=7.0)).open(tmp_path))
    assert re.search(r"target in 3 s .*1\.5 times the masses the controllers know.* 2 s after", made)
    assert "has spent 7 s of CPU time" in made


def test_figures_draw_values_and_medians(monkeypatch):
    drawn = []

    def keep(figure):
        drawn.append(figure)
        return "<svg/>"

    monkeypatch.setattr(figures, "_svg", keep)
    made = figures.plots(ROWS, "position-servo")
    by_title = {plot.title: figure.axes[0] for plot, figure in zip(made, drawn, strict=True)}
    tracking = by_title["tracking RMS [mm]"]
    assert [label.get_text() for label in tracking.get_yticklabels()] == [FIRST, SECOND, THIRD]
    lines = [np.asarray(line.get_xdata()) for line in tracking.lines]
    # Of each planner: quartiles, values, the median.
    np.testing.assert_allclose(lines[0], [2.5005, 5.5])
    np.testing.assert_allclose(lines[1], [5.0, 6.0, 0.001])
    np.testing.assert_allclose(lines[2], [5.0, 5.0])
    np.testing.assert_allclose(lines[5], [3.0, 3.0])
    assert all(axes.get_xlabel() == title for title, axes in by_title.items())
    assert {"clearance [mm]", "planning [s]", "joint path [ranges]"} < set(by_title)


def test_controllers_come_in_the_order_of_the_package_then_those_that_are_not_installed_any_more():
    rows = [row(FIRST, 0, controller=name) for name in ("gone", "inverse-dynamics", "position-servo")]
    names = [row.controller for row in rows]
    assert in_order(names, CONTROLLERS) == ["position-servo", "inverse-dynamics", "gone"]
