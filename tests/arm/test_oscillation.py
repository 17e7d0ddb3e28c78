"""What swings and bends: frequencies and damping known by hand, where it rests, and other loads."""

import gantries
import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.contacts import colliding_pairs
from lieednn_sim.arm.oscillation import PassiveJoints, with_load
from lieednn_sim.errors import NoSolutionError

GRAVITY = 9.81


def modes(arm):
    """Circular frequencies [rad/s] and damping ratios at home."""
    found = PassiveJoints(arm).modes(arm.keyframe("home"))
    return np.array([(2.0 * np.pi * mode.frequency, mode.damping) for mode in found])


def test_a_pendulum_has_the_frequency_of_its_length_and_the_damping_of_its_joint():
    inertia = 5.0 * gantries.LENGTH**2
    ((omega, ratio),) = modes(gantries.gantry(damping=3.0))
    assert omega == pytest.approx(np.sqrt(GRAVITY / gantries.LENGTH), rel=1e-5)
    assert ratio == pytest.approx(3.0 / (2.0 * inertia * omega), rel=1e-4)


def test_two_pendulums_in_a_row_have_two_modes():
    bob = '<geom type="sphere" size="0.001" pos="0 0 -1" mass="2"/>'
    link = '<body pos="0 0 {}"><joint name="{}" axis="0 1 0"/>' + bob + "{}</body>"
    arm = gantries.gantry(link.format(0, "upper", link.format(-1, "lower", "")))
    np.testing.assert_allclose(modes(arm)[:, 0] ** 2, GRAVITY * (2.0 + np.array([-1.0, 1.0]) * np.sqrt(2.0)), rtol=1e-4)


def test_a_ball_swings_in_two_directions_and_turns_freely():
    ball = PassiveJoints(gantries.gantry(gantries.PENDULUM.replace('axis="0 1 0"', 'type="ball"')))
    expected = [np.sqrt(GRAVITY / gantries.LENGTH) / (2.0 * np.pi)] * 2
    np.testing.assert_allclose([mode.frequency for mode in ball.modes([0.0])], expected, rtol=1e-5)


def test_a_spring_bends_under_a_load_and_rests_there():
    spring = """<body><joint name="bend" type="slide" axis="0 0 1" stiffness="800" damping="8"/>
      <geom type="sphere" size="0.05" mass="2"/></body>"""
    arm = gantries.gantry(spring)
    passive = PassiveJoints(arm)
    assert passive.dofs.tolist() == [1]
    assert passive.sprung.all()
    assert not passive.bodies.any()
    assert passive.at_rest(arm.qpos([1.0])[None])[0, 1] == pytest.approx(-2.0 * GRAVITY / 800.0)
    np.testing.assert_allclose(modes(arm), [[20.0, 8.0 / (2.0 * np.sqrt(800.0 * 2.0))]], rtol=1e-5)


def test_rest_is_below_also_from_nearly_above():
    arm = gantries.gantry()
    passive = PassiveJoints(arm)
    rows = np.array([[0.0, 3.0], [1.0, -2.0], [2.0, 0.3]])
    np.testing.assert_allclose(passive.at_rest(rows)[:, 1], 0.0, atol=1e-6)


def test_a_slide_without_a_spring_rests_nowhere():
    arm = gantries.gantry('<body><joint name="falls" type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/></body>')
    with pytest.raises(NoSolutionError, match="falls"):
        PassiveJoints(arm).at_rest(arm.qpos([0.0])[None])


def test_another_load_weighs_and_hangs_as_asked_for():
    arm = gantries.gantry(damping=3.0)
    heavy, long = with_load(arm, mass=1.2), with_load(arm, length=1.5)
    assert heavy.model.body_mass[1:].tolist() == [100.0, pytest.approx(6.0)]
    np.testing.assert_allclose(heavy.model.body_inertia[1:], np.array([[1.0], [1.2]]) * arm.model.body_inertia[1:])
    assert modes(heavy)[0, 1] == pytest.approx(modes(arm)[0, 1] / 1.2, rel=1e-4)
    assert modes(long)[0, 0] == pytest.approx(np.sqrt(GRAVITY / 3.0), rel=1e-5)
    assert long.model.site("load").pos[2] == pytest.approx(-3.0)
    assert arm.model.body_mass[2] == 5.0


def test_driven_tied_and_free_joints_are_not_passive():
    crane = ls.Arm.load("telescopic_crane")
    joints = [crane.model.joint(name) for name in ("swing_along", "swing_across")]
    dofs = [joint.dofadr[0] for joint in joints]
    assert PassiveJoints(crane).dofs.tolist() == dofs
    # Nor is the boom, which nothing but a driven cylinder holds.
    slew = ls.Arm.of(crane.model, crane.data(), ["slew"], tip="boom")
    assert PassiveJoints(slew).dofs.tolist() == dofs
    model = mujoco.MjModel.from_xml_path(str(ls.arm.scene_path("telescopic_pr")))
    assert not PassiveJoints(ls.Arm.of(model, mujoco.MjData(model), [model.joint(0).name])).bodies.any()


def test_the_import_report_has_the_hook_s_oscillations():
    report = ls.Arm.load("telescopic_crane").import_report
    if report is None:  # an arm of the package; the same file as somebody else's has a report
        report = ls.Arm.load(ls.arm.scene_path("telescopic_crane"), tip="end_effector").import_report
    assert [mode.joint for mode in report.modes] == ["swing_along", "swing_across"]
    assert "oscillates: swing_along 0.665 Hz" in str(report)


@pytest.mark.parametrize("highest", [14, 30])
def test_a_load_meets_what_it_meets_by_the_filter_of_the_model_whatever_its_bits(highest):
    rng = np.random.default_rng(highest)
    boxes = "".join(f'<geom type="box" size=".1 .1 .1" pos="{x} 0 9"/>' for x in range(40))
    xml = gantries.xml(
        gantries.PENDULUM.replace('contype="0" conaffinity="0"/>', '/><geom size=".1"/><geom size=".2"/>')
    )
    model = mujoco.MjModel.from_xml_string(xml.replace('<body name="cart"', f'{boxes}<body name="cart"'))
    arm = ls.Arm.of(model, mujoco.MjData(model), ["cart"], tip="tip")
    for field in (arm.model.geom_contype, arm.model.geom_conaffinity):
        field[:] = 1 << rng.integers(highest - 4, highest + 1, arm.model.ngeom) | 1 << highest - 5
        field[rng.random(arm.model.ngeom) < 0.5] = 0
    hangs = PassiveJoints(arm).bodies[arm.model.geom_bodyid]
    still = arm.model.geom_bodyid == 0
    pairs = {tuple(p) for p in colliding_pairs(arm.model).tolist() if hangs[p].any() and still[p].any()}
    assert {*map(tuple, colliding_pairs(PassiveJoints(arm).load_model).tolist())} == pairs
    assert 10 < len(pairs) < 110
