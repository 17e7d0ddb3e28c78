"""The tasks of the field: scenes with the numbers that their READMEs state, starts and goals that can be used, rows."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import reference
import task_cases
import tasks

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.collision import Collisions

_ROW = re.compile(r"^\| `(\w+)`.*?\| (-?[\d.]+) to (-?[\d.]+) .*?\| ([\d.]+) .*?\| ([\d.]+) ", re.MULTILINE)


@dataclass
class Found:
    """A plan, as far as its timing goes."""

    t: Any
    q: Any
    qd: Any


def scene(name):
    model = mujoco.MjModel.from_xml_path(str(task_cases.ASSETS / name / "scene.xml"))
    return model, mujoco.MjData(model)


def between(model, data, one, other, **joints):
    """Distance of two sites or bodies [m], with some joints where they are asked to be."""
    mujoco.mj_resetData(model, data)
    for joint, value in joints.items():
        data.joint(joint).qpos = value
    mujoco.mj_kinematics(model, data)
    there = [data.site(name).xpos if name in ("tip", "load") else data.body(name).xpos for name in (one, other)]
    return float(np.linalg.norm(there[0] - there[1]))


@pytest.mark.parametrize(("name", "joints"), [("boom", 5), ("harvester", 3), ("crane", 4)])
def test_the_joints_have_the_limits_of_the_readme(name, joints):
    model, _ = scene(name)
    rows = _ROW.findall((task_cases.ASSETS / name / "README.md").read_text(encoding="utf-8"))
    assert len(rows) == joints
    stated = np.array([row[1:] for row in rows], float)
    np.testing.assert_allclose([model.joint(row[0]).range for row in rows], stated[:, :2])
    np.testing.assert_allclose(model.numeric("velocity_limit").data, stated[:, 2])
    np.testing.assert_allclose(model.numeric("acceleration_limit").data, stated[:, 3])


def test_lengths_and_masses_are_the_published_ones():
    boom, data = scene("boom")
    assert between(boom, data, "rail", "tip") == pytest.approx(8.0)
    out = {"carriage": 5.0, "telescope": 4.25, "follow": 4.25, "reach": 0.5}
    assert between(boom, data, "rail", "tip", **out) == pytest.approx(22.0)
    assert mujoco.mj_getTotalmass(boom) == pytest.approx(4600.0)
    section = next(g for g in range(boom.ngeom) if boom.body(boom.geom_bodyid[g]).name == "section1")
    np.testing.assert_allclose(2.0 * boom.geom_size[section, 1:], (0.25, 0.4))
    crane, data = scene("crane")
    inside, reach = {"inner": 0.0, "outer": 0.0}, np.array([9.3, 0.0])
    mujoco.mj_resetData(crane, data)
    for joint, value in (inside | {"telescope": 1.9}).items():
        data.joint(joint).qpos = value
    mujoco.mj_kinematics(crane, data)
    np.testing.assert_allclose(data.site("tip").xpos[:2], reach, atol=1e-12)
    load = crane.body_subtreemass[crane.body("grapple").id] + 10.0  # with the hook
    assert load == pytest.approx(510.0)
    assert load * 9.81 * 9.3 == pytest.approx(46.5e3, rel=1e-2)
    assert between(crane, data, "tip", "load") == pytest.approx(1.4)
    # What the load bends: its moment over the stiffness, times the length that turns.
    bent = 510.0 * 9.81 * 1.2 / crane.joint("bend_down").stiffness[0] * 1.2
    assert bent == pytest.approx(0.06, abs=0.015)
    assert task_cases.Crane.amplitude(np.array([0.05, 0.03, 0.04])) == pytest.approx(0.012)


@pytest.mark.parametrize("task", [task_cases.Boom(), task_cases.Crane(), task_cases.Harvester()])
def test_starts_and_goals_are_free(task):
    for case in range(tasks.CASES if not isinstance(task, task_cases.Harvester) else 1):
        done = task.start(case)
        arm = ls.Arm.of(done.model, done.data, task.joints, tip="tip")
        collisions, n = Collisions(arm), len(task.joints)
        start = arm.keyframe("home")
        goals = [task.goals[case]] if hasattr(task, "goals") else [task._aim(done, fruit, 0.01) for fruit in range(4)]
        for q in (start, *goals):
            assert len(q) == n
            arm.check_reachable(q)
            assert collisions.clearance(np.array(q)) > (0.033 if isinstance(task, task_cases.Boom) else 0.002)


def test_a_load_at_rest_hangs_below_the_hook_and_a_trapezoid_is_one():
    done = task_cases.Crane().start(0)
    line = done.data.site("tip").xpos - done.data.site("load").xpos
    np.testing.assert_allclose(line, (0.0, 0.0, 1.4), atol=2e-3)
    # A path with a corner, at first at uneven speed.
    t = np.linspace(0.0, 2.0, 401)
    s = 7.0 * (t / 2.0) ** 2
    q = np.stack([np.minimum(s, 3.0), np.maximum(s - 3.0, 0.0)], axis=1)
    timed = task_cases.trapezoidal(Found(t, q, q), ramp=0.25)
    speed = np.abs(np.diff(timed.q, axis=0)).sum(axis=1) / 0.005
    np.testing.assert_allclose(timed.q[[0, -1]], q[[0, -1]], atol=1e-9)
    assert speed[105:150] == pytest.approx(3.5 / 0.75, rel=1e-2)
    assert speed[49] == pytest.approx(3.5 / 0.75 / 2.0, rel=3e-2)


def test_rows_of_a_planner_that_fails_and_of_a_task_left_out(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(tasks, "CASES", 1)
    words = ["--tasks", "boom,shelf", "--planners", "minimum-jerk", "--output", str(tmp_path)]
    tasks.main([*words, "--menagerie", str(tmp_path)])
    assert "shelf: left out: it needs MuJoCo Menagerie" in capsys.readouterr().out
    row = json.loads((tmp_path / "runs/boom-minimum-jerk-0.json").read_text())["made"]
    assert "within 33 mm of 'world'" in row["missed"]
    table = (tmp_path / "tasks.md").read_text()
    assert "| minimum-jerk | 0 of 1 | 0 | - | - | - |" in table
    assert "- minimum-jerk, 1 of 1, such as case 1: motion 1: 'tool' would come within" in table
    # A case that is done is not done again, and a figure beyond its mark fails.
    monkeypatch.setattr(tasks, "attempt", None)
    tasks.main([*words[:1], "boom", *words[2:]])
    figures = {"time_s": 60.0, "clearance_mm": 40.0, "tip_mm": 11.0}
    row = {"planner": "x", "case": 0, "cpu_s": 1.0, "missed": "tip_mm 11", "figures": figures}
    assert "| x | 0 of 1 | 1 | 60 | 40 | 11.00 | 1.00 |" in tasks.as_markdown({"boom": [row]})
    assert task_cases.Boom().missed({"tip_mm": 11.0, "clearance_mm": 29.0}) == ["tip_mm", "clearance_mm"]
    films = {f"tasks_{name}.gif" for name in tasks.TASKS}
    assert films <= set(reference.STUDIES["tasks"]["outputs"])
