"""What robots brought by users broke: nested tubes, sizes, weak actuators, heavy tied booms, odd files."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer.collada import read_points
from lieednn_sim.arm.importer.loading import _package_name
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import FileError, InputError, NoSolutionError
from lieednn_sim.synthesis import synthesize

TELESCOPE = """
<mujoco><compiler angle="degree"/>
  <worldbody><geom name="floor" type="plane" size="9 9 1" pos="0 0 -1.7"/>
    <body name="mast"><joint name="pan" range="-90 90"/><geom name="mast" type="box" size=".06 .06 .06"/>
      <body name="tube1"><joint name="raise" axis="0 -1 0" range="-60 60"/>
        <geom name="tube1" type="box" size=".3 .05 .05" pos=".4 0 0"/>
        <body name="tube2"><joint name="s2" type="slide" axis="1 0 0" range="0 .5"/>
          <geom name="tube2" type="box" size=".3 .04 .04" pos=".42 0 0"/>
          <body name="tube3"><joint name="s3" type="slide" axis="1 0 0" range="0 .5"/>
            <geom name="tube3" type="box" size=".3 .03 .03" pos=".44 0 0"/>
            <body name="fork" pos=".8 0 0"><joint name="fold" axis="0 1 0" range="-170 170"/>
              <geom name="fork" type="box" size=".15 .02 .02" pos=".15 0 0"/></body></body></body></body></body>
  </worldbody>
  <contact><pair geom1="tube1" geom2="tube3"/><pair geom1="fork" geom2="floor"/></contact>
  <equality><joint joint1="s3" joint2="s2"/></equality>
</mujoco>
"""
# Tubes of tonnes, tied by MuJoCo's soft default, that a 20 Hz servo on the first one sets swinging.
CRANE = """
<mujoco><compiler angle="degree"/><option timestep=".005"/>
  <worldbody><body name="house"><joint name="slew" range="-150 150"/><geom type="box" size="1 1 .5" mass="8000"/>
    <body name="boom1" pos="0 0 1"><joint name="luff" axis="0 -1 0" range="0 80"/>
      <geom type="box" size="4 .4 .4" pos="4 0 0" mass="3000"/>
      <body name="boom2"><joint name="s2" type="slide" axis="1 0 0" range="0 6"/>
        <geom type="box" size="4 .3 .3" pos="4 0 0" mass="2000"/>
        <body name="boom3"><joint name="s3" type="slide" axis="1 0 0" range="0 5"/>
          <geom type="box" size="4 .2 .2" pos="4 0 0" mass="1500"/>
          <body name="boom4"><joint name="s4" type="slide" axis="1 0 0" range="0 3"/>
            <geom type="box" size="4 .1 .1" pos="4 0 0" mass="900"/></body></body></body></body></body></worldbody>
  <equality><joint joint1="s3" joint2="s2" polycoef="0 .8 0 0 0"/>
    <joint joint1="s4" joint2="s2" polycoef=".1 .45 0 0 0"/></equality>
  <actuator><motor joint="slew" gear="200000" ctrlrange="-1 1"/><motor joint="luff"/><motor joint="s2"/></actuator>
</mujoco>
"""
# A lift of 5 kg that carries an arm of 2 kg with nothing that could turn its inertia into another.
LIFT = """
<mujoco>
  <worldbody>
    <body name="lift" {compensation}>
      <joint name="lift" type="slide" axis="0 0 1" range="0 1" {joint}/><geom type="box" size=".1 .1 .1" mass="5"/>
      <body name="arm" pos=".3 0 0" {compensation}><joint name="reach" type="slide" axis="1 0 0" range="0 1"/>
        <geom type="box" size=".1 .1 .1" mass="2"/></body></body>
  </worldbody>
  <actuator><position joint="lift" kp="4000" kv="300" forcerange="-90 120"/>
    <position joint="reach" kp="2000" kv="90"/></actuator>
</mujoco>
"""
COLUMN = """
<mujoco><worldbody>
  <body name="column" pos="0 0 1"><geom size=".1"/><geom name="shelf" type="box" size=".2 .2 .01" pos=".35 0 -.5"/>
    <body name="turret"><joint name="pan" axis="0 0 1" range="-.3 .3"/><geom size=".01" pos="0 0 .095"/>
      <body name="arm"><joint name="raise" axis="0 1 0" range="-1 1.4"/><geom size=".05"/>
        <geom name="hand" size=".05" pos=".6 0 0" friction=".3" solref=".01 .9" condim="4"/></body></body></body>
</worldbody></mujoco>
"""
TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
URDF = """
<robot name="derrick">
  <link name="foot"/><link name="post">{mass}</link><link name="tube1">{mass}</link><link name="tube2">{mass}</link>
  <joint name="turn" type="continuous"><parent link="foot"/><child link="post"/><axis xyz="0 0 1"/></joint>
  <joint name="out1" type="prismatic"><parent link="post"/><child link="tube1"/><origin xyz=".3 0 .4"/>
    <axis xyz="1 0 0"/><limit lower="0" upper=".4" effort="100" velocity="1"/></joint>
  <joint name="out2" type="prismatic"><parent link="tube1"/><child link="tube2"/><axis xyz="1 0 0"/>
    <limit lower="0" upper=".4" effort="100" velocity="1"/><mimic joint="out1" multiplier=".5" offset=".01"/></joint>
</robot>
""".replace(
    "{mass}",
    '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>',
)


def arm_of(xml, **options):
    arm = Arm.from_spec(mujoco.MjSpec.from_string(xml), name="robot", **options)
    return arm, arm.import_report


def test_nested_tubes_may_overlap_and_all_else_still_collides():
    original = mujoco.MjSpec.from_string(TELESCOPE).compile()
    data = mujoco.MjData(original)
    mujoco.mj_forward(original, data)
    assert data.ncon  # as the model stands, no motion could start

    arm, report = arm_of(TELESCOPE)
    low, high = arm.position_limits.T
    for extension in (low[2], high[2]):
        assert arm.near_contacts([0.0, 0.0, extension, 0.0]) == []
    assert any("'tube1' and 'tube3' (80 mm deep): stages of a telescope" in note for note in report.notes)
    # Folded back the fork meets the tubes that it is no part of, and pointing down the floor, by the model's own pair.
    folded = arm.contacts([0.0, 0.0, 0.0, np.deg2rad(170)])
    assert {frozenset(pair) for pair in folded} == {frozenset(("fork", "tube1")), frozenset(("fork", "tube2"))}
    down = [0.0, -np.deg2rad(60), high[2], 0.0]
    assert {frozenset(pair) for pair in arm.contacts(down)} == {frozenset(("fork", "world"))}


def test_home_is_moved_off_parts_that_collide_there_and_the_world_stays_an_obstacle():
    """Nobody designed a mast that stands in a tube: with the tube lowered or raised they are apart."""
    xml = TELESCOPE.replace('size=".06 .06 .06"', 'size=".06 .06 .06" pos=".4 0 .08"')
    arm, report = arm_of(xml)
    collide = "'mast' and 'tube2' (20 mm deep), 'mast' and 'tube3' (10 mm deep)"
    assert f"home moved, since {collide} collide there: raise from 0 to -0.0838" in report.notes
    home = arm.keyframe("home")
    assert arm.near_contacts(home) == []
    assert {frozenset(pair) for pair in arm.contacts(home * [1, 0, 1, 1])} == {
        frozenset(("mast", tube)) for tube in ("tube2", "tube3")
    }
    post = '<geom type="box" size=".01 .01 .5" pos=".9 0 0"/><body name="mast">'
    blocked, report = arm_of(xml.replace('<body name="mast">', post))
    assert ("world", "fork") in blocked.contacts(blocked.keyframe("home"))
    assert any("touch at home" in note for note in report.notes)


@pytest.mark.parametrize("priority", ["0", "1"])
def test_what_overlaps_in_every_posture_is_ignored_geom_by_geom(priority):
    """The shoulder's ball sits in the column's whatever the arm does; the hand comes down on the column's shelf."""
    xml = COLUMN.replace('name="hand"', f'name="hand" priority="{priority}"')
    arm, report = arm_of(xml)
    always = "contacts ignored between 'arm' and 'column' (150 mm deep): they overlap in every configuration"
    assert always in report.notes
    assert (
        "contacts ignored between 'column' and 'turret' (15 mm deep): neighbours that overlap at home" in report.notes
    )
    assert arm.near_contacts([0.0, 0.0]) == []
    assert ("arm", "column") in arm.contacts([0.0, 1.1])
    # What becomes an explicit pair touches as it did before.
    touching = []
    for model in (arm.model, mujoco.MjSpec.from_string(xml).compile()):
        data = mujoco.MjData(model)
        data.qpos[:] = 0.0, 1.1
        mujoco.mj_forward(model, data)
        contacts = [c for c in data.contact if {model.geom(g).name for g in c.geom} == {"hand", "shelf"}]
        touching.append([(c.dim, c.dist, *c.friction, *c.solref, *c.solimp) for c in contacts])
    assert touching[0] == touching[1] != []


def test_an_arm_without_room_for_a_target_is_told_what_it_touches():
    box = '<geom type="box" size="3 3 .3" pos="0 0 0"/><body name="column"'
    arm, _ = arm_of(COLUMN.replace('<body name="column"', box).replace("0 0 1", "0 0 .1"))
    with pytest.raises(
        NoSolutionError, match="400 random configurations, contacts: 'turret' and 'world' in 400, 'arm'"
    ):
        draw_target(arm, 0)


def test_a_crane_is_encoded_in_units_of_its_size_and_can_be_certified():
    arm, report = arm_of(CRANE)
    rng = np.random.default_rng(0)
    q = rng.uniform(*arm.position_limits.T, (200, arm.n_joints))
    assert 0.9 < np.abs(arm.encode(q)[..., 3:]).max() < 1.1
    np.testing.assert_allclose(arm.decode(arm.encode(q)).q, q, atol=1e-9)
    assert f"unit of length in the network's coordinates: {arm.length_scale:g} m, the furthest" in str(report)
    assert "ties of s3, s4 made stiff, with solref 0.01 s" in str(report)  # two time steps
    certified = [
        synthesize(arm.encode(x), bias="sign-matched", bias_magnitude=0.5, seed=0).network is not None for x in q[:10]
    ]
    assert sum(certified) >= 9
    assert arm_of(TELESCOPE)[0].length_scale == 1.0


def test_servos_of_heavy_tied_stages_come_to_rest():
    arm, _ = arm_of(CRANE, servos="design")
    home = arm.keyframe("home")
    goal = home + np.array([0.0, 0.0, 0.05])
    data = arm.data()
    data.ctrl[:] += goal - home  # from what holds home against gravity
    mujoco.mj_step(arm.model, data, round(1.0 / arm.model.opt.timestep))
    # Of the stages that follow as well, which no servo acts on.
    np.testing.assert_allclose(data.qpos, arm.qpos(goal), atol=1e-4)


def test_dry_friction_makes_no_servo_faster_and_the_report_says_what_it_costs():
    """At rest friction holds what would swing, so that servos were judged by it to be as fast as without soft ties."""
    plain = arm_of(CRANE)[1].servos
    _, report = arm_of(CRANE.replace('name="s', 'frictionloss="400" name="s'))
    assert report.servos == plain
    _, report = arm_of(LIFT.format(compensation="", joint='frictionloss="8"'))
    found = [note for note in report.notes if "dry friction" in note]
    helps = "designed servos (servos='design', --servos design) or the controller inverse-dynamics"
    assert found == [f"dry friction may hold servos off by: lift 2 mm; what helps: {helps}"]


def test_soft_ties_between_stages_are_made_stiff_unless_somebody_chose_a_stiffness():
    light = TELESCOPE.replace('size=".3 .03 .03"', 'size=".3 .03 .03" mass=".1"').replace(
        '.02 .02"', '.02 .02" mass=".1"'
    )
    chosen = light.replace('joint2="s2"', 'joint2="s2" solref="-100 -20"')
    lag = {}
    for xml in (light, chosen):
        arm, report = arm_of(xml)
        data = mujoco.MjData(arm.model)
        home = arm.keyframe("home")
        data.qpos[:], data.ctrl[:] = arm.qpos(home), home
        data.xfrc_applied[arm.model.body("tube3").id, 0] = 5.0
        mujoco.mj_step(arm.model, data, round(2.0 / arm.model.opt.timestep))
        lag[xml] = data.joint("s3").qpos[0] - data.joint("s2").qpos[0]
        assert any("ties of s3 made stiff" in note for note in report.notes) == (xml == light)
    assert abs(lag[light]) < 1e-3 < 0.01 < lag[chosen]


def test_accelerations_are_limited_by_the_force_that_is_left():
    bare, report = arm_of(LIFT.format(compensation="", joint=""))
    # Of 90 N, 7 kg of weight leave half for 7 kg.
    np.testing.assert_allclose(bare.acceleration_limits, [0.5 * (90.0 - 7.0 * 9.81) / 7.0, np.inf])
    assert "acceleration limits [rad/s^2, m/s^2]: lift 1.52" in report.notes
    # Half compensated by the model itself: so much more is left, but not where the joint's range limits it as well.
    ranged = 'actuatorgravcomp="true" actuatorfrclimited="true" actuatorfrcrange="-90 120"'
    for joint, weight in (("", 0.5), ('actuatorgravcomp="true"', 0.5), (ranged, 1.0)):
        own, _ = arm_of(LIFT.format(compensation='gravcomp=".5"', joint=joint))
        np.testing.assert_allclose(own.acceleration_limits, [0.5 * (90.0 - weight * 7.0 * 9.81) / 7.0, np.inf])
    _, report = arm_of(LIFT.format(compensation="", joint="").replace("-90 120", "-60 120"))
    assert "lift: needs 68.67 at home, more than its force limits allow" in report.notes


def test_a_chain_that_fits_one_joint_makes_two_neurons():
    tail = TELESCOPE.index('<body name="fork"')
    xml = TELESCOPE[:tail] + TELESCOPE[TELESCOPE.index("</body></body></body></body></body>") + len("</body>") :]
    xml = xml.replace('<pair geom1="fork" geom2="floor"/>', "")
    _, report = arm_of(xml)
    assert report.groups == (("pan",), ("raise", "s2", "s3"))
    _, report = arm_of(xml, links=["tube3"])
    assert report.groups == (("pan", "raise", "s2", "s3"),)
    assert any("single neuron" in note for note in report.notes)


@pytest.mark.parametrize(("joint", "body"), [("Gripper", "tool"), ("j3", "moving_jaw")])
def test_a_gripper_of_one_joint_is_no_link(joint, body):
    tool = f'<body name="{body}" pos=".2 0 0"><joint name="{joint}" range="0 1"/><geom size=".01"/></body>'
    xml = COLUMN.replace('condim="4"/>', f'condim="4"/>{tool}').replace('"arm"', '"fixed_jaw"')
    arm, report = arm_of(xml)
    assert (arm.joint_names, report.links[-1]) == (("pan", "raise"), "fixed_jaw")
    assert f"taken for a gripper, and no part of the arm: {joint}; name the links to move it" in report.notes
    arm, _ = arm_of(xml, links=["turret", "fixed_jaw", body])
    assert arm.joint_names == ("pan", "raise", joint)
    # The wrist that carries a hand is none.
    assert arm_of(xml.replace(joint, "roll").replace(body, "gripper_link"))[0].n_joints == 3


def test_an_urdf_with_mimic_joints_is_an_arm(tmp_path):
    path = tmp_path / "derrick.urdf"
    path.write_text(URDF)
    arm = Arm.load(path, home={"turn": 0.5, "out1": 0.1})
    assert arm.name == "derrick"
    np.testing.assert_allclose(arm.keyframe("home"), [0.5, 0.1])
    assert arm.joint_names == ("turn", "out1")
    tip = arm.link_poses([0.5 * np.pi, 0.2]).translation[-1]
    np.testing.assert_allclose(tip, [0.0, 0.3 + 0.2 + 0.5 * 0.2 + 0.01, 0.4], atol=1e-12)


def test_faults_that_drawings_leave_in_an_urdf_are_named(tmp_path):
    path = tmp_path / "derrick.urdf"
    path.write_text(URDF.replace('name="out2"', 'name="turn"'))
    with pytest.raises(InputError, match="several joints of the URDF have one name: 'turn'; give each its own"):
        Arm.load(path)
    path.write_text(URDF.replace('<parent link="foot"/>', '<parent link="tube2"/>'))
    with pytest.raises(InputError, match=r"derrick\.urdf: links carry each other in a circle: .*tube2.*; take out one"):
        Arm.load(path)
    for old, new, message in (
        ('<child link="tube2"/>', '<child link="tube1"/>', "link 'tube1' is the child of several joints, a loop"),
        ('<parent link="foot"/>', '<parent link="feet"/>', "joint 'turn' is of a link 'feet' that is not there"),
    ):
        assert old in URDF
        path.write_text(URDF.replace(old, new))
        with pytest.raises(InputError, match=message):
            Arm.load(path)
    path.write_text(URDF.replace('xyz=".3 0 .4"', 'xyz="300 0 400"'))
    assert any("m large: are its lengths in millimetres?" in remark for remark in Arm.load(path).import_report.remarks)


def test_an_arm_that_cannot_be_seen_or_touched_says_so(tmp_path):
    def notes(xml: str) -> list[str]:
        path = tmp_path / ("derrick.urdf" if "<robot" in xml else "robot.xml")
        path.write_text(xml)
        report = Arm.load(path, servos="design").import_report
        return [note for note in report.notes if "invisible" in note or "passes through" in note]

    shape = '<{0}><geometry><box size=".1 .1 .1"/></geometry></{0}></link>'
    keeps = '<mujoco><compiler discardvisual="false"/></mujoco></robot>'
    seen = URDF.replace("</link>", shape.format("visual"), 1)
    assert [note.split(":")[0] for note in notes(URDF)] == ["no moving body has a geom"]
    assert notes(seen) == notes(URDF)
    assert [note.split(":")[0] for note in notes(seen.replace("</robot>", keeps))] == [
        "no geom of a moving body can collide"
    ]
    assert notes(URDF.replace("</link>", shape.format("collision"), 1)) == notes(COLUMN) == []


def test_efforts_and_velocities_of_an_urdf_are_limits(tmp_path):
    """Moved by out1 are 1 kg as fast and 1 kg 1.5 times as fast: 3.25 kg, gravity compensated, 100 N, half of it."""
    path = tmp_path / "derrick.urdf"
    for slow, velocity in (("1", 1.0), (".3", 0.6), ("0", 1.0)):
        out1, out2 = URDF.split('<joint name="out2"')
        path.write_text(f'{out1}<joint name="out2"' + out2.replace('velocity="1"', f'velocity="{slow}"'))
        arm = Arm.load(path)
        np.testing.assert_allclose(arm.velocity_limits, [np.inf, velocity])
        np.testing.assert_allclose(arm.force_limits, [np.inf, 100.0])
        np.testing.assert_allclose(arm.acceleration_limits, [np.inf, 0.5 * 100.0 / 3.25])
        assert f"velocity limits of the URDF [rad/s, m/s]: turn none, out1 {velocity:.3g}" in arm.import_report.notes
    # Those of URDF 1.2; out2 is half as fast as out1.
    out1, out2 = URDF.split('<joint name="out2"')
    out1 = out1.replace('velocity="1"', 'acceleration="3" deceleration="2" jerk="9"')
    path.write_text(f'{out1}<joint name="out2"' + out2.replace('velocity="1"', 'acceleration="1.5" jerk="4"'))
    arm = Arm.load(path)
    np.testing.assert_allclose([arm.acceleration_limits, arm.jerk_limits], [[np.inf, 2.0], [np.inf, 8.0]])
    assert "jerk limits of the URDF [rad/s^3, m/s^3]: turn none, out1 8" in arm.import_report.notes
    path.write_text(URDF.replace('effort="100" velocity="1"', 'effort="0" velocity="0"'))
    arm = Arm.load(path)
    assert np.isinf([arm.velocity_limits, arm.force_limits, arm.acceleration_limits]).all()
    path.write_text(URDF.replace('velocity="1"', 'velocity="fast"'))
    notes = Arm.load(path).import_report.notes
    assert "velocity limits, if there are any, could not be read: could not convert string to float: 'fast'" in notes


TURN = 'type="{}"><parent link="foot"/><child link="post"/><axis xyz="0 0 1"/>{}</joint>'
LIMITS = 'lower="0" upper=".4"'


@pytest.mark.parametrize(
    ("limit", "angle", "told"),
    [
        ('lower=".4" upper=".4"', 0.4, "locked by equal limits in the URDF: turn at 0.4"),
        ('lower="0" upper="0"', 0.0, "locked by equal limits in the URDF: turn at 0"),
        ('lower="-inf" upper="inf"', None, "turn: range [-inf, inf] taken for none"),
        ('lower="-1e16" upper="1e16"', None, "turn: range [-1e+16, 1e+16] taken for none"),
        ("", None, "turn: revolute, but without limits in the URDF"),
    ],
)
def test_limits_of_an_urdf_that_lock_a_joint_or_are_none(limit, angle, told, tmp_path):
    path = tmp_path / "derrick.urdf"
    path.write_text(URDF.replace(TURN.format("continuous", ""), TURN.format("revolute", f"<limit {limit}/>")))
    arm = Arm.load(path)
    assert told in arm.import_report.notes
    if angle is None:
        np.testing.assert_allclose(arm.position_limits[0], [-2.0 * np.pi, 2.0 * np.pi])
        assert arm.continuous[0]
    else:
        assert arm.joint_names == ("out1",)
        # 0.3 + 0.2 + 0.5 * 0.2 + 0.01 m from the axis.
        tip = [0.61 * np.cos(angle), 0.61 * np.sin(angle), 0.4]
        np.testing.assert_allclose(arm.link_poses([0.2]).translation[-1], tip, atol=1e-12)


def test_what_follows_a_locked_joint_is_locked_and_limits_the_wrong_way_round_are_refused(tmp_path):
    path = tmp_path / "derrick.urdf"
    path.write_text(URDF.replace(LIMITS, 'lower=".1" upper=".1"', 1))
    arm = Arm.load(path, tip="tube2")
    assert "locked by equal limits in the URDF: out1 at 0.1, out2 at 0.06" in arm.import_report.notes
    path.write_text(URDF.replace('mimic joint="out1"', 'mimic joint="out"'))
    assert "out2: moves by itself: the URDF has no joint 'out' to mimic" in Arm.load(path).import_report.notes
    np.testing.assert_allclose(arm.link_poses([0.0]).translation[-1], [0.3 + 0.1 + 0.06, 0.0, 0.4], atol=1e-12)
    for limits, message in (
        ('lower="0" upper="0"', r"lock all of its joints: out1 at 0, out2 at 0\.01; correct them"),
        ('lower=".4" upper="0"', r"'out1' of the URDF has the lower limit 0\.4 above the upper one, 0"),
    ):
        path.write_text(URDF.replace("continuous", "fixed").replace(LIMITS, limits))
        with pytest.raises(InputError, match=message):
            Arm.load(path)


@pytest.mark.parametrize(("limit", "span"), [('upper=".4"', [0.0, 0.4]), ('lower="-.3"', [-0.3, 0.0])])
def test_a_limit_that_an_urdf_leaves_out_is_zero(limit, span, tmp_path):
    path = tmp_path / "derrick.urdf"
    path.write_text(URDF.replace(LIMITS, limit, 1).replace("<mimic", "<none"))
    np.testing.assert_allclose(Arm.load(path).position_limits[1], span)


def test_a_continuous_joint_of_an_urdf_has_no_limits_even_where_the_file_gives_some(tmp_path):
    """ROS ignores them, MuJoCo does not; ends the wrong way round are no mistake either."""
    path = tmp_path / "derrick.urdf"
    path.write_text(URDF)
    without = Arm.load(path)
    for limits in ('lower="-1" upper="1"', 'lower="1" upper="-1"'):
        path.write_text(URDF.replace(TURN.format("continuous", ""), TURN.format("continuous", f"<limit {limits}/>")))
        arm = Arm.load(path)
        np.testing.assert_array_equal(arm.position_limits, without.position_limits)
        np.testing.assert_array_equal(arm.continuous, without.continuous)
        assert arm.continuous[0]
        assert not arm.model.joint("turn").limited
        assert "turn: continuous, so that its limits in the URDF do not count" in arm.import_report.notes


def test_quaternions_of_an_urdf_which_mujoco_ignores_are_refused(tmp_path):
    path = tmp_path / "derrick.urdf"
    path.write_text(URDF.replace('xyz=".3 0 .4"', 'xyz=".3 0 .4" quat_xyzw="0 0 1 0"'))
    with pytest.raises(
        InputError, match="an origin of the URDF has 'quat_xyzw', which MuJoCo ignores; write it as rpy"
    ):
        Arm.load(path)


def test_a_planar_base_of_an_urdf_is_held(tmp_path):
    path = tmp_path / "derrick.urdf"
    path.write_text(URDF.replace(TURN.format("continuous", ""), TURN.format("planar", "")))
    arm = Arm.load(path)
    assert arm.joint_names == ("out1",)
    assert any("planar joints, which have no ranges, are held: turn;" in note for note in arm.import_report.notes)
    assert "new servos for turn_TX, turn_TY, turn_RZ: to hold" in arm.import_report.notes
    with pytest.raises(InputError, match=r"slide 'turn_TX' has no range; .* or leave it out of the arm's joints"):
        Arm.load(path, joints=["turn_TX", "out1"])


def test_an_urdf_loads_as_shipped_with_its_packages_and_its_sloppy_inertias(tmp_path):
    """Meshes are in a package beside the file's own, inertias break A + B >= C or are no more than a diagonal entry."""
    mesh = '<collision><geometry><mesh filename="package://hands/{}.obj"/></geometry></collision></link>'
    head, *links = URDF.split("</link>")
    shapes = [mesh.format(name) for name in ("post", "tube", "tube")]
    xml = head + "".join(shape + rest for shape, rest in zip(shapes, links, strict=True))
    xml = xml.replace('ixx=".1" iyy=".1" izz=".1"', 'ixx=".002" iyy="0" izz="0"', 1)
    path = tmp_path / "ws" / "derrick" / "robots" / "derrick.urdf"
    path.parent.mkdir(parents=True)
    path.write_text(xml)
    with pytest.raises(FileError, match=r"package://hands/post.obj \(no folder 'hands' beside .*robots"):
        Arm.load(path)
    for folder in ("ws/hands", "ws/derrick/hands"):
        (tmp_path / folder).mkdir()
        for name in ("post", "tube"):
            (tmp_path / folder / f"{name}.obj").write_text(TETRAHEDRON)
        arm = Arm.load(path)
        assert "physically impossible inertias made larger: post" in arm.import_report.notes
        least, _, most = np.sort(arm.model.body("post").inertia)
        assert most == pytest.approx(0.002)
        assert least == pytest.approx(0.001, rel=1e-3)
        assert arm.model.nmesh == 2
        shutil.rmtree(tmp_path / folder)


def test_meshes_of_one_name_in_several_folders_are_several_meshes(tmp_path):
    """TALOS's gripper was its torso, since their files have one name; and what is seen was what collides."""
    mesh = '<{0}><geometry><mesh filename="{1}.obj" scale="1 {2} 1"/></geometry></{0}>'
    post = mesh.format("visual", "seen/part", 1) + mesh.format("collision", "post/part", 1)
    shapes = (
        post + mesh.format("collision", "part1", 1),
        mesh.format("collision", "tube/part", 1),
        mesh.format("collision", "tube/part", -1),  # MuJoCo names the second scale of a mesh part1
    )
    keeps = '<mujoco><compiler discardvisual="false"/></mujoco></robot>'
    head, *links = URDF.replace("</robot>", keeps).split("</link>")
    path = tmp_path / "derrick.urdf"
    path.write_text(head + "".join(f"{shape}</link>{rest}" for shape, rest in zip(shapes, links, strict=True)))
    for file, edge in (("post/part", ".1"), ("part1", ".2"), ("tube/part", ".4"), ("seen/part", ".7")):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / f"{file}.obj").write_text(TETRAHEDRON.replace(".1", edge))
    model = Arm.load(path, overlaps="keep", floor="none").model
    for body, edges in (("post", [0.1, 0.2, 0.7]), ("tube1", [0.4]), ("tube2", [0.4])):
        centres = model.geom_pos[model.geom_bodyid == model.body(body).id]
        # The centre of a tetrahedron is at a quarter of its edges.
        assert sorted(4.0 * centres[:, 2]) == pytest.approx(edges)
        assert np.sign(centres[:, 1]) == pytest.approx(-1.0 if body == "tube2" else 1.0)


def test_a_file_named_relative_to_a_folder_that_is_left_is_compiled_again(tmp_path, monkeypatch):
    shape = '<collision><geometry><mesh filename="post.obj"/></geometry></collision></link>'
    (tmp_path / "derrick.urdf").write_text(URDF.replace("</link>", shape, 1))
    (tmp_path / "post.obj").write_text(TETRAHEDRON)
    monkeypatch.chdir(tmp_path)
    arm = Arm.load("derrick.urdf")
    monkeypatch.chdir(tmp_path.parent)
    assert arm.with_payload(0.1).model.nmesh == 1


def test_a_package_is_known_by_its_manifest_and_by_where_ros_looks(tmp_path, monkeypatch):
    shape = '<collision><geometry><mesh filename="package:///hands/meshes/post.obj"/></geometry></collision></link>'
    path = tmp_path / "checkout" / "robots" / "derrick.urdf"
    path.parent.mkdir(parents=True)
    path.write_text(URDF.replace("</link>", shape, 1))
    elsewhere = tmp_path / "ros" / "hands" / "meshes"
    for folder in (path.parents[1] / "meshes", elsewhere):
        folder.mkdir(parents=True)
        (folder / "post.obj").write_text(TETRAHEDRON)
    with pytest.raises(FileError, match=r"no folder 'hands' beside .*, nor in ROS_PACKAGE_PATH, holds it"):
        Arm.load(path)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'none'}:{tmp_path / 'ros'}")
    assert Arm.load(path).model.nmesh == 1
    path.write_text(path.read_text().replace("package:///", "model://"))
    assert Arm.load(path).model.nmesh == 1
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    _package_name.cache_clear()
    (path.parents[1] / "package.xml").write_text("<package><name>hands</name></package>")
    assert Arm.load(path).model.nmesh == 1
    # What Git keeps elsewhere is no mesh. MuJoCo caches files by name and time, in steps longer than the test.
    mesh = path.parents[1] / "meshes" / "post.obj"
    mesh.write_text("version https://git-lfs.github.com/spec/v1\nsize 9\n")
    os.utime(mesh, (0, 0))
    with pytest.raises(FileError, match=r"Git LFS pointers .*`git lfs pull`: .*post.obj$"):
        Arm.load(path)


# A tetrahedron of 100 units of a centimetre, shown twice: as it is, and turned about z and shifted by 2 units along x.
COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="centimetre" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
  <library_geometries><geometry id="g"><mesh>
    <source id="p"><float_array id="a" count="12">0 0 0 100 0 0 0 50 0 0 0 25</float_array></source>
    <source id="n"><float_array id="b" count="3">9 9 9</float_array></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="1"><input semantic="VERTEX" source="#v"/><input semantic="NORMAL" source="#n"/></triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene><node><instance_geometry url="#g"/>
    <node><translate>200 0 0</translate><rotate>0 0 2 90</rotate><instance_geometry url="#g"/></node>
  </node></visual_scene></library_visual_scenes>
</COLLADA>"""


def test_meshes_in_collada_are_their_points(tmp_path):
    shape = '<collision><geometry><mesh filename="post.dae" scale="2 1 1"/></geometry></collision></link>'
    (tmp_path / "derrick.urdf").write_text(URDF.replace("</link>", shape, 1))
    (tmp_path / "post.dae").write_text(COLLADA)
    once = np.array([[0, 0, 0], [1, 0, 0], [0, 0.5, 0], [0, 0, 0.25]])
    both = np.concatenate([once, once[:, [1, 0, 2]] * [-1, 1, 1] + [2, 0, 0]])
    np.testing.assert_allclose(read_points(tmp_path / "post.dae"), both, atol=1e-12)
    arm = Arm.load(tmp_path / "derrick.urdf")
    assert arm.model.nmesh == 1
    assert "meshes in COLLADA taken as the convex hulls of their points: post.dae" in arm.import_report.notes
    for broken in (COLLADA.replace("<translate>", "<skew>").replace("</translate>", "</skew>"), "<COLLADA/>", "solid"):
        (tmp_path / "post.dae").write_text(broken)
        with pytest.raises(FileError, match=r"post.dae cannot be read as COLLADA: .*; convert it to .stl or .obj"):
            Arm.load(tmp_path / "derrick.urdf")


def test_macros_of_ros_are_to_be_expanded_first(tmp_path):
    with pytest.raises(InputError, match=r"ROS macros: make it a URDF with `xacro ur10.urdf.xacro -o robot.urdf`"):
        Arm.load("ur10.urdf.xacro")
    path, call = tmp_path / "derrick.urdf", '<xacro:arm prefix="left_"/>'
    left = (call, call.replace("/>", "></xacro:arm>"), '<link name="${prefix}hand"/>', '<x y="$(find hands)/a.stl"/>')
    for name in ("robot", 'robot xmlns:xacro="http://www.ros.org/wiki/xacro"'):
        for text in left:
            path.write_text(URDF.replace("<robot", f"<{name}").replace("</robot>", f"{text}</robot>"))
            with pytest.raises(InputError, match=r"derrick\.urdf holds ROS macros: make it a URDF with `xacro "):
                Arm.load(path)
        path.write_text(URDF.replace("<robot", f"<!-- by xacro {call} --><{name}"))
        assert Arm.load(path).n_joints == 2


def test_missing_meshes_behind_an_include_are_said_to_be_where_mujoco_looks(tmp_path):
    (tmp_path / "parts").mkdir()
    asset = '<asset><mesh name="a" file="a.obj"/></asset>'
    body = '<body><joint range="-1 1" limited="true"/><geom type="mesh" mesh="a"/></body>'
    inner = f'<mujoco><compiler meshdir="meshes"/>{asset}<worldbody>{body}</worldbody></mujoco>'
    (tmp_path / "parts" / "arm.xml").write_text(inner)
    (tmp_path / "robot.xml").write_text('<mujoco><include file="parts/arm.xml"/></mujoco>')
    with pytest.raises(FileError) as refused:
        Arm.load(tmp_path / "robot.xml")
    missing = Path(str(refused.value).removeprefix("files of the model are missing: "))
    missing.parent.mkdir()
    missing.write_text(TETRAHEDRON)
    assert Arm.load(tmp_path / "robot.xml").n_joints == 1


def test_a_site_by_the_name_of_a_link_frame_alone_makes_no_house_arm(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(TELESCOPE.replace('<geom name="fork"', '<site name="link1_frame"/><geom name="fork"'))
    arm = Arm.load(str(path))
    assert arm.import_report is not None


def test_wrong_files_and_names_are_refused():
    # MuJoCo's copy of a spec leaves the broken equality out, and would compile.
    broken = mujoco.MjSpec.from_string(TELESCOPE.replace('joint1="s3" joint2="s2"', 'joint1="s3" joint2="s3"'))
    with pytest.raises(FileError, match="repeated in equality"):
        Arm.from_spec(broken)
    nan = TELESCOPE.replace("</mujoco>", '<keyframe><key name="home" qpos="0 nan 0 0 0"/></keyframe></mujoco>')
    with pytest.raises(InputError, match="keyframe 'home' holds NaN"):
        arm_of(nan)
    with pytest.raises(InputError, match=r"the pos of body 'tube2' of the model is \[ 0.  0. nan\]; write numbers"):
        arm_of(TELESCOPE.replace('<body name="tube2">', '<body name="tube2" pos="0 0 nan">'))
    scale = TELESCOPE.replace("<worldbody>", '<custom><numeric name="length_scale" data="-1"/></custom><worldbody>')
    with pytest.raises(InputError, match="'length_scale' of arm 'robot' must be positive, got -1"):
        arm_of(scale)
