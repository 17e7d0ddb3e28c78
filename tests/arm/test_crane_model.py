"""The arm `telescopic_crane` by MuJoCo alone: names, loop, statics by hand, masses; and the small models with loops."""

import math
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from arm.loops import PALLETISER, SCISSOR_LIFT

FOLDER = Path(__file__).parents[2] / "assets/mjcf/telescopic_crane"
KINDS = ("bodies", "joints", "geoms", "sites", "actuators", "sensors", "equalities", "excludes", "keys", "cameras")
# Pins of the cylinder from the luff pin: A on the column, B on the boom at luff = 0; length at stroke = 0 [m].
A, B, CLOSED = (0.38, -1.02), (1.1, -0.06), 1.2


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_path(str(FOLDER / "telescopic_crane.xml"))


def cylinder(luff):
    """Length by the law of cosines, lever arm, and angle to the horizontal."""
    a, b = math.hypot(*A), math.hypot(*B)
    theta = luff + math.atan2(B[1], B[0]) - math.atan2(A[1], A[0])
    length = math.sqrt(a * a + b * b - 2.0 * a * b * math.cos(theta))
    x, z = B[0] * math.cos(luff) - B[1] * math.sin(luff), B[0] * math.sin(luff) + B[1] * math.cos(luff)
    return length, a * b * math.sin(theta) / length, math.atan2(z - A[1], x - A[0])


def closed(luff, extend):
    """A qpos on the loop, the hook vertical."""
    length, _, angle = cylinder(luff)
    return np.array([0.0, luff, extend, extend, luff, 0.0, angle - math.atan2(0.8, 0.6), length - CLOSED])


def equality(data):
    """Largest residual, and the Jacobian."""
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    return np.abs(data.efc_pos[rows]).max(), data.efc_J.reshape(len(rows), -1)[rows]


@pytest.mark.parametrize("file", ["telescopic_crane.xml", "scene.xml"])
def test_everything_is_named(file):
    spec = mujoco.MjSpec.from_file(str(FOLDER / file))
    assert [kind for kind in KINDS if not all(item.name for item in getattr(spec, kind))] == []


@pytest.mark.parametrize("key", ["home", "retracted", "extended"])
def test_keyframes_meet_the_loop_and_are_at_rest(model, key):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(key).id)
    mujoco.mj_forward(model, data)
    start = data.qpos.copy()
    assert (data.ncon, equality(data)[0]) == (0, pytest.approx(0.0, abs=1e-9))
    np.testing.assert_allclose(start[1:], closed(start[1], start[2])[1:], atol=1e-12)
    mujoco.mj_step(model, data, 1000)
    np.testing.assert_allclose(data.qpos, start, atol=1e-4)
    np.testing.assert_allclose(data.site("hook").xpos[:2], data.site("end_effector").xpos[:2], atol=1e-4)


def test_no_warning_under_noise(model):
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    home, hold = data.qpos.copy(), data.ctrl.copy()
    for _ in range(2500):
        data.ctrl[:] = hold + generator.normal(scale=[0.02, 0.02, 0.01])
        mujoco.mj_step(model, data)
    assert sum(warning.number for warning in data.warning) == 0
    np.testing.assert_allclose(np.delete(data.qpos - home, [4, 5]), 0.0, atol=0.05)


@pytest.mark.parametrize(("luff", "extend"), [(0.05, 2.0), (0.6, 0.5), (1.2, 1.2)])
def test_at_rest_the_cylinder_holds_what_statics_asks_for(model, luff, extend):
    data = mujoco.MjData(model)
    data.qpos[:] = closed(luff, extend)
    data.ctrl[:] = data.qpos[[0, 2, 7]]
    mujoco.mj_step(model, data, 4000)
    luff, extend, moment = data.qpos[1], data.qpos[2], 0.0
    for body, offset in (("boom", 0.0), ("stage1", extend), ("stage2", 2.0 * extend), ("hook", 2.0 * extend)):
        x, z = model.body(body).ipos[[0, 2]] if body != "hook" else (3.28, 0.0)
        moment += 9.81 * model.body(body).mass[0] * ((x + offset) * math.cos(luff) - z * math.sin(luff))
    # The cylinder's own weight by virtual work: a centre at s along the axis from A is at the height s sin(angle).
    (length, arm, angle), turning = cylinder(luff), (cylinder(luff + 1e-5)[2] - cylinder(luff - 1e-5)[2]) / 2e-5
    for body, offset, slides in (("barrel", 0.0, 0.0), ("rod", length - CLOSED, arm)):
        lever = (model.body(body).ipos[0] + offset) * math.cos(angle) * turning + math.sin(angle) * slides
        moment += 9.81 * model.body(body).mass[0] * lever
    assert data.sensor("cylinder_force").data[0] == pytest.approx(moment / arm, rel=0.01)
    assert data.qpos[7] == pytest.approx(length - CLOSED, abs=1e-5)


def test_stroke_area_masses_and_gains_are_what_the_readme_says(model, monkeypatch):
    low, high = (cylinder(angle)[0] - CLOSED for angle in model.joint("luff").range)
    assert model.joint("stroke").range[0] <= low < high <= model.joint("stroke").range[1] < high + 1e-3
    areas = math.pi / 4.0 * np.array([-(0.10**2 - 0.07**2), 0.10**2])
    np.testing.assert_allclose(model.actuator("stroke").forcerange, 20.6e6 * areas, rtol=1e-3)
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    table = text[text.index("## Masses") : text.index("## Gains")]
    masses = {body: int(mass) for body, mass in re.findall(r"^\| `(\w+)`.* (\d+) \|$", table, re.MULTILINE)}
    assert masses == {model.body(i).name: pytest.approx(model.body(i).mass[0]) for i in range(1, model.nbody)}
    assert f"Sum {sum(masses.values())} kg" in table
    monkeypatch.chdir(FOLDER)
    exec(re.search(r"```python\n(.*?)```", text, re.DOTALL)[1], {})


@pytest.mark.parametrize(("xml", "site", "free"), [(PALLETISER, "tool", 4), (SCISSOR_LIFT, "platform", 1)])
def test_small_loops_close_and_stay_level(xml, site, free):
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    residual, jacobian = equality(data)
    assert (residual < 1e-12, model.nv - np.linalg.matrix_rank(jacobian, tol=1e-9)) == (True, free)
    data.ctrl[:] = (0.5, 0.6, 0.3, 0.4) if free == 4 else 0.1
    mujoco.mj_step(model, data, 2000)
    assert sum(warning.number for warning in data.warning) == 0
    assert equality(data)[0] < 1e-5
    np.testing.assert_allclose(data.site(site).xmat[6:], (0.0, 0.0, 1.0), atol=1e-4)
