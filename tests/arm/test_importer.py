"""Foreign models made into arms: kinematics against the original, couplings, cuts, servos, and the error messages."""

import functools
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer import remarks
from lieednn_sim.errors import FileError, InputError, LieEDNNError
from lieednn_sim.evaluation import evaluate
from lieednn_sim.planning import plan
from lieednn_sim.simulation import simulate

EQUALITY = '<equality><joint name="belt" joint1="stage2" joint2="stage1" polycoef="0.01 0.8 0 0 0"/>'
ROBOT = """
<mujoco>
  <compiler angle="degree"/>
  <option integrator="implicitfast"/>
  <default><geom density="800"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <frame pos="0.3 0 0" euler="0 0 30">
    <body name="cart" pos="0 0 0.2" euler="0 0 10">
      <freejoint name="drive"/>
      <geom type="box" size="0.2 0.2 0.1"/>
      <body name="wheel" pos="0 0.23 -0.08"><joint name="wheel" axis="0 1 0"/><geom type="sphere" size="0.05"/></body>
      <body name="head" pos="0 0 0.9"><joint name="pan" range="-90 90"/><geom type="sphere" size="0.05"/>
        <frame pos="0.1 0 0"><body euler="0 20 0"><joint name="tilt" axis="0 1 0" range="-40 40"/>
          <geom type="sphere" size="0.03"/></body></frame></body>
      <body name="column" pos="0.1 0 0.11">
        <joint name="swing" axis="0 0 1" range="-100 100"/>
        <geom type="cylinder" size="0.04 0.2" pos="0 0 0.2"/>
        <body name="shoulder" pos="0 0 0.4" euler="0 90 0">
          <joint name="raise" axis="0 1 0" range="-30 60" ref="10"/>
          <geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.2"/>
          <body name="tube1" pos="0 0 0.1"><joint name="stage1" type="slide" range="0 0.3"/>
            <geom type="capsule" size="0.025" fromto="0 0 0 0 0 0.3"/>
            <body name="tube2" pos="0 0 0.1"><joint name="stage2" type="slide" range="0 0.2"/>
              <geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.3"/>
              <body name="wrist" pos="0 0 0.35"><joint name="wrist" axis="1 0 0" range="-250 120"/>
                <geom type="box" size="0.03 0.03 0.03"/><site name="tool" pos="0 0 0.08" euler="0 0 45"/>
                <body name="left" pos="0.03 0 0.05"><joint name="left" type="slide" axis="1 0 0" range="0 0.03"/>
                  <geom type="box" size="0.005 0.01 0.03"/></body>
                <body name="right" pos="-0.03 0 0.05"><joint name="right" type="slide" axis="-1 0 0" range="0 0.03"/>
                  <geom type="box" size="0.005 0.01 0.03"/></body>
              </body></body></body></body></body>
    </body></frame>
  </worldbody>
  <tendon><fixed name="extend"><joint joint="stage1" coef="1"/><joint joint="stage2" coef="0.5"/></fixed>
    <fixed name="grip"><joint joint="left" coef="1"/><joint joint="right" coef="1"/></fixed></tendon>
  COUPLING
  <actuator>
    <velocity name="roll" joint="wheel"/><position name="pan" joint="pan"/><position name="tilt" joint="tilt"/>
    <position name="swing" joint="swing" kp="900" kv="90" forcerange="-50 50"/>
    <motor name="raise" joint="raise" gear="40" ctrlrange="-1 1"/>
    <position name="extend" tendon="extend" gear="2" kp="3000" kv="300" forcerange="-100 100"/>
    <position name="wrist" joint="wrist" kp="50" kv="2"/><position name="grip" tendon="grip"/>
  </actuator>
  <sensor><jointpos joint="pan"/><actuatorfrc actuator="roll"/><framepos objtype="site" objname="tool"/></sensor>
  <keyframe><key name="home" qpos="1 2 0.3 0.9 0.1 0.2 0 0.7 0.4 -0.3 0 0.3 0.05 0.05 0.2 0.01 0.02"/></keyframe>
</mujoco>
"""
GRIPPER_EQUALITY = '<joint joint1="right" joint2="left"/></equality>'
BY_EQUALITY = ROBOT.replace("COUPLING", EQUALITY + GRIPPER_EQUALITY)
BY_TENDON = ROBOT.replace("COUPLING", "<equality>" + GRIPPER_EQUALITY)
BALL = """
<mujoco>
  <worldbody><body name="trunk" pos="0 0 1"><geom size="0.05"/>
    <body name="upper" pos="0 0.1 0" quat="1 1 0 0"><joint name="shoulder" type="ball" ACTIVE/>
      <geom type="capsule" size="0.03" fromto="0.05 0 0 0.3 0 0"/>
      <body name="fore" pos="0.35 0 0"><joint name="elbow" axis="0 0 1"/>
        <geom type="capsule" size="0.03" fromto="0.05 0 0 0.3 0 0"/></body></body></body></worldbody>
</mujoco>
"""
ON_SHOULDER = {"links": ["shoulder", "tool"]}
HINGE = '<body pos="0.3 0 0"><joint name="{}" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>'
HINGES = (
    f"<mujoco><option {{options}}/><worldbody>{''.join(map(HINGE.format, 'abc'))}{'</body>' * 3}</worldbody></mujoco>"
)


def spec_of(xml):
    return mujoco.MjSpec.from_string(xml)


def arm_of(xml, **options):
    arm = Arm.from_spec(spec_of(xml), **options)
    return arm, arm.import_report


def frame_poses(model, data, names):
    """Positions and axes of bodies or sites."""
    poses = []
    for name in names:
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        found = data.body(name) if body >= 0 else data.site(name)
        poses.append(np.concatenate([found.xpos, found.xmat]))
    return np.array(poses)


MODELS = [
    (BY_EQUALITY, {}),
    (BY_TENDON, {"links": ["tube2", "tool"]}),
    (BY_EQUALITY, {"links": ["column", "tube2", "tool"], "base": "cart"}),
    (BALL.replace("ACTIVE", 'range="0 2" limited="true"'), {}),
]


@functools.cache
def imported_and_original(number):
    xml, options = MODELS[number]
    return *arm_of(xml, **options), spec_of(xml).compile()


@pytest.mark.parametrize("number", range(len(MODELS)))
@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_link_frames_are_where_the_original_has_them(number, seed):
    arm, report, original = imported_and_original(number)
    before, after = mujoco.MjData(original), mujoco.MjData(arm.model)
    before.qpos[:] = original.key_qpos[0] if original.nkey else original.qpos0
    low, high = arm.position_limits.T
    q = np.random.default_rng(seed).uniform(low, high) / np.sqrt(3.0)  # a ball joint's three within its largest angle
    after.qpos[:] = arm.qpos(np.clip(q, low, high))
    for j in range(arm.model.njnt):
        name = arm.model.joint(j).name
        before.joint(name).qpos[:] = after.joint(name).qpos  # those that are not the arm's are at home as well
    mujoco.mj_kinematics(original, before)
    mujoco.mj_kinematics(arm.model, after)
    names = (report.base, *report.links)
    wanted = frame_poses(original, before, names)
    np.testing.assert_allclose(frame_poses(arm.model, after, names), wanted, atol=1e-9)
    np.testing.assert_allclose(arm.link_poses(arm.coordinates(after.qpos)).translation, wanted[1:, :3], atol=1e-9)


def test_the_arm_of_a_mobile_robot_is_found_cut_and_reduced():
    arm, report = arm_of(BY_EQUALITY)
    assert report.configuration == "keyframe 'home'"
    assert report.base == "cart"
    assert report.links == ("tube2", "wrist")
    assert report.groups == (("swing", "raise", "stage1", "stage2"), ("wrist",))
    assert set(report.others) == {"wheel", "pan", "tilt", "left", "right"}
    assert "note: 'cart', a free body that carries the arm, is fixed where it is at home" in str(report)
    (coupling,) = report.couplings
    assert (coupling.follower, coupling.leader, coupling.source) == ("stage2", "stage1", "equality")
    np.testing.assert_allclose([coupling.ratio, coupling.shift], [0.8, 0.01])
    # stage2 = 0.01 + 0.8 stage1 <= 0.2, and the wrist's 250 degrees are beyond half a turn from its reference.
    np.testing.assert_allclose(arm.position_limits[2:], [[0.0, 0.2375], np.deg2rad([-250, 120])])
    shared, _ = arm_of(BY_EQUALITY, **ON_SHOULDER)
    np.testing.assert_allclose(shared.position_limits[3], [-0.99 * np.pi, np.deg2rad(120)])
    assert arm.joint_names == tuple(servo.name for servo in report.servos)
    np.testing.assert_allclose(arm.keyframe("home"), [0.0, 0.3, 0.05, 0.2])
    assert arm.model.nsensor == 3
    text = str(report)
    assert "link 1: tube2, moved by swing, raise, stage1, stage2" in text
    assert "other joints: wheel, pan, tilt, left, right" in text


def test_stages_on_a_tendon_share_its_length_by_its_coefficients():
    arm, report = arm_of(BY_TENDON.replace('"stage1" type="slide"', '"stage1" type="slide" ref="0.02"'))
    (coupling,) = report.couplings
    assert (coupling.follower, coupling.leader, coupling.ratio) == ("stage2", "stage1", 0.5)
    assert coupling.source == "tendon 'extend'"
    data = arm.data()
    stages = arm.model.jnt_qposadr[[arm.model.joint(f"stage{k}").id for k in (1, 2)]]
    first, second = before = data.qpos[stages].copy()
    assert second == pytest.approx(0.5 * (first - 0.02)), "both are at their references together"
    # The servo's length is twice the tendon's, of the first stage's way and half of the second's.
    data.actuator("extend").ctrl += 2.0 * (1.0 + 0.5 * 0.5) * 0.1
    mujoco.mj_step(arm.model, data, 1000)
    np.testing.assert_allclose(data.qpos[stages] - before, [0.1, 0.05], atol=1e-3)


KEYFRAMES = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="one"><joint name="a" axis="0 0 1" range="-2 2" ref=".5"/>
    <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>
    <body name="two" pos=".3 0 0"><joint name="b" axis="0 1 0" range="-2 2"/><geom size=".02"/>
      <body name="grip"><joint name="c" type="slide" axis="0 0 1" range="0 .1"/><geom size=".01" pos=".1 0 0"/></body>
    </body></body></worldbody>
  <actuator><position joint="a" kp="50" kv="9"/><position joint="b" kp="50" kv="9"/></actuator>
  <keyframe>KEYS<key name="stow" qpos="1 -1 .02"/><key name="still" ctrl=".5 0"/></keyframe>
</mujoco>
"""
COMMANDED = KEYFRAMES.replace("KEYS", '<key name="home" ctrl=".5 .3"/>')


def test_home_is_taken_from_a_keyframe_and_given_joints():
    arm, report = arm_of(COMMANDED, links=["one", "two"], keyframe="still", home={"b": -0.25, "c": 0.03})
    assert report.configuration == "keyframe 'still', with b, c as given"
    np.testing.assert_allclose(arm.keyframe("home"), [0.5, -0.25])
    np.testing.assert_allclose(arm.keyframe("stow"), [1.0, -1.0])
    assert arm.qpos(arm.keyframe("home"))[2] == 0.03, "the gripper stays there"
    assert arm.import_report is report
    assert arm.with_scene("poles").import_report is report


def test_a_keyframe_of_controls_alone_is_no_posture_unless_they_hold_the_one_it_has():
    """MuJoCo takes such a keyframe for the reference position, where b is 0; its servo would move b to 0.3."""
    _, report = arm_of(COMMANDED, links=["one", "two"])
    assert report.configuration == "keyframe 'stow'"
    assert any(note.startswith("keyframes left out: home; they have controls") for note in report.notes)
    assert not any("left out" in note for note in arm_of(KEYFRAMES.replace("KEYS", ""))[1].notes)
    with pytest.raises(InputError, match="no keyframe 'home' with positions; keyframes of the model: 'stow', 'still'"):
        arm_of(COMMANDED, keyframe="home")


def test_kept_servos_push_as_the_original_ones_and_force_limits_are_referred_to_the_joints():
    arm, report = arm_of(BY_EQUALITY)
    swing, raised, stage, wrist = report.servos
    assert all(servo.kept for servo in report.servos)
    assert raised.kp == 0.0
    assert swing.force_range == (-50.0, 50.0)
    assert raised.force_range == (-40.0, 40.0)
    # Tendon length 2 (stage1 + 0.5 stage2) moves by 2 (1 + 0.5 * 0.8) per metre of stage1.
    np.testing.assert_allclose([stage.kp, stage.kv, stage.force_range[1]], [3000 * 2.8**2, 300 * 2.8**2, 280])
    assert (wrist.kp, wrist.kv, wrist.force_range) == (50.0, 2.0, (-np.inf, np.inf))
    np.testing.assert_allclose(arm.force_limits, [50, 40, 280, np.inf])


def test_designed_servos_have_20_hz_and_critical_damping_on_the_inertia_held():
    arm, report = arm_of(BY_EQUALITY.replace('<motor name="raise" joint="raise" gear="40" ctrlrange="-1 1"/>', ""))
    (made,) = (servo for servo in report.servos if not servo.kept)
    index = arm.joint_names.index(made.name)
    data = mujoco.MjData(arm.model)
    data.qpos[:] = arm.qpos(arm.keyframe("home"))
    mujoco.mj_forward(arm.model, data)
    rates = arm.qvel(arm.keyframe("home"), np.eye(arm.n_joints))
    inertia = np.zeros((arm.n_joints, arm.model.nv))
    for row, rate in zip(inertia, rates, strict=True):
        mujoco.mj_mulM(arm.model, data, row, rate)
    held = (inertia @ rates.T)[index, index]
    # The largest over several postures counts, and home is one of them.
    assert held * (40 * np.pi) ** 2 <= made.kp * (1.0 + 1e-9) < 10.0 * held * (40 * np.pi) ** 2
    np.testing.assert_allclose(made.kv, made.kp / (20.0 * np.pi))


def test_servos_of_axes_in_line_are_not_weak():
    """Twice about z and twice about y: at home the first two, and the last two, turn against each other freely."""
    names = "zzyy"
    bodies = "".join(
        f'<body pos="0 0 .2"><joint name="j{i}" axis="0 {int(a == "y")} {int(a == "z")}" range="-2 2"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 .2" size=".03" contype="0" conaffinity="0"/>'
        for i, a in enumerate(names)
    )
    xml = f'<mujoco><compiler angle="radian"/><worldbody>{bodies}{"</body>" * len(names)}</worldbody></mujoco>'
    _, report = arm_of(xml)
    assert min(servo.kp for servo in report.servos) > 0.01 * max(servo.kp for servo in report.servos)


@pytest.mark.parametrize("xml", [BY_EQUALITY, BY_TENDON, BALL.replace("ACTIVE", ""), HINGES.format(options="")])
def test_the_imported_arm_holds_its_home_under_gravity(xml):
    arm, _ = arm_of(xml, servos="design")
    home = arm.keyframe("home")
    data = arm.data()
    data.qvel[arm.dofs] = 0.01  # a small push, so that an unstable servo shows
    mujoco.mj_step(arm.model, data, round(2.0 / arm.model.opt.timestep))
    assert np.abs(arm.coordinates(data.qpos) - home).max() < 1e-3
    assert not any(warning.number for warning in data.warning)


def test_locking_makes_no_bodies_touch_that_could_not_before():
    # The cart was the shoulder's carrier, now it is a fixed part of the world, which may touch everything.
    xml = BY_EQUALITY.replace('name="column" pos="0.1 0 0.11"', 'name="column" pos="0.1 0 0.05"')
    arm, _ = arm_of(xml)
    assert arm.contacts(arm.keyframe("home")) == []
    original = spec_of(xml).compile()
    before = mujoco.MjData(original)
    mujoco.mj_resetDataKeyframe(original, before, 0)
    mujoco.mj_forward(original, before)
    touching = {original.geom_bodyid[g] for g in before.contact.geom.ravel()}
    assert original.body("column").id not in touching


def test_a_house_arm_is_imported_as_it_is():
    house = Arm.load("telescopic_pr")
    arm = Arm.from_spec(house.spec, floor="none")
    report = arm.import_report
    assert report.links == ("link1_frame", "link2_frame", "link3_frame", "link4_frame")
    assert all(servo.kept for servo in report.servos)
    q = house.keyframe("extended")
    np.testing.assert_allclose(arm.link_poses(q).as_matrix(), house.link_poses(q).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(arm.velocity_limits, house.velocity_limits)
    # Two compound joints of four joints each: the sites of the old link frames must not pass for the new ones.
    assert Arm.from_spec(house.spec, links=["link2_frame", "link4_frame"]).n_links == 2


def test_a_chain_without_actuators_is_an_arm_of_single_joints():
    arm, report = arm_of(HINGES.format(options='timestep="0.01"'))
    assert report.groups == (("a",), ("b",), ("c",))
    assert "new servos for a, b, c: there was no actuator" in report.notes
    assert "the servos would be unstable with the model's integrator; it is implicitfast now" in report.notes
    assert arm.model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def bad(xml, *replacements):
    for old, new in replacements:
        assert old in xml
        xml = xml.replace(old, new)
    return xml


@pytest.mark.parametrize(
    ("xml", "options", "message"),
    [
        (BY_EQUALITY, {"links": ["elbow"]}, r"no body or site 'elbow'; bodies: .*'cart'.*; sites: 'tool'"),
        (BY_EQUALITY, {"links": ["tube2", "head"]}, "'head' does not descend from 'tube2'"),
        (BY_EQUALITY, {"links": ["wrist", "tool"]}, "no joint is between 'wrist' and 'tool'"),
        (BY_EQUALITY, {"links": ["wrist", "wrist"]}, "'wrist' and 'wrist' are the same frame"),
        (BY_EQUALITY, {"links": ["cart"]}, "no hinge, slide or ball joint moves 'cart'"),
        (BY_EQUALITY, {"links": ["wrist"], "base": "world"}, "joint 'drive' between 'world' and 'wrist' is free"),
        (BY_EQUALITY, {"links": ["tube1", "tube2"]}, "'stage2' moves link 2 and follows joint 'stage1'"),
        (BY_EQUALITY, {"keyframe": "fold"}, "no keyframe 'fold'; keyframes of the model: 'home'"),
        (BY_EQUALITY, {"home": ["wrist"]}, "home must be a dictionary, got a list of 1"),
        (BY_EQUALITY, {"home": {"hip": 0.0}}, "no joint of the home configuration 'hip'; allowed: .*, pan, "),
        (BY_EQUALITY, {"home": {"pan": 2.0}}, r"home position 2 of joint 'pan' is outside of \[-1.571, 1.571\]"),
        (BY_EQUALITY, {"home": {"stage2": 0.1}}, "'stage2' of the home configuration follows joint 'stage1'"),
        (bad(BY_EQUALITY, ("0.01 0.8 0 0 0", "0 1 2 0 0")), {}, "through a closed loop or a curve"),
        (bad(BY_EQUALITY, ('joint2="stage1" ', "")), {}, "'stage2' is fixed by equality 'belt'"),
        (bad(BY_TENDON, ('type="slide" range="0 0.3"', 'type="slide"'), ('"0 0.2"', '"0 0"')), {}, "no range"),
        (
            bad(BY_EQUALITY, ('range="-250 120"', 'range="200 250"')),
            ON_SHOULDER,
            r"'wrist' with range .* ref inside its range",
        ),
        (
            bad(BY_EQUALITY, ("<equality>", '<equality><weld name="w" body1="wrist" body2="cart"/>')),
            {},
            r"equality 'w' \(weld\) stays open by 0.0498",
        ),
        ("<mujoco><worldbody><body><geom size='1'/></body></worldbody></mujoco>", {}, "no hinge, slide or ball joint"),
    ],
)
def test_errors_say_what_to_do(xml, options, message):
    with pytest.raises(LieEDNNError, match=message):
        Arm.from_spec(spec_of(xml), **options)


def test_two_equal_arms_are_listed():
    arms = "".join(
        f'<body name="{side}" pos="0 {y} 0"><joint range="-1 1"/><geom size="0.1"/></body>'
        for side, y in (("port", -1), ("starboard", 1))
    )
    xml = f"<mujoco><worldbody>{arms}</worldbody></mujoco>"
    with pytest.raises(InputError, match="2 chains have 1 joints each, they end in 'port', 'starboard'"):
        Arm.from_spec(spec_of(xml))
    report = Arm.from_spec(spec_of(xml), links=["starboard"]).import_report
    assert (report.base, len(report.others)) == ("world", 1)


FIVE_BAR = """<mujoco><compiler angle="radian"/><default><geom size=".02"/></default><worldbody>
<body><joint name="c1" axis="0 -1 0" range="-3 3"/><geom/><body name="rod1" pos=".3 0 0">
  <joint name="r1" axis="0 -1 0"/><geom/><site name="t1" pos=".4 0 0"/></body></body>
<body pos=".2 0 0"><joint name="c2" axis="0 -1 0" range="-3 3"/><geom/><body name="rod2" pos=".3 0 0">
  <joint name="r2" axis="0 -1 0"/><geom/><site name="t2" pos=".4 0 0"/></body></body>
</worldbody><equality><connect site1="t1" site2="t2"/></equality>
<actuator><motor joint="c1"/><motor joint="c2"/></actuator>
<keyframe><key name="home" qpos="2 -1 1.14 1"/></keyframe></mujoco>"""


def test_a_parallel_robot_is_told_to_be_none_but_one_of_its_chains_may_be(monkeypatch):
    monkeypatch.setattr(remarks, "_PATHS", 2)  # on which loops are closed, which takes long
    told = r"is parallel: loops close its 2 chains, which end in 'rod1', 'rod2', but an arm is .*; name the tip"
    with pytest.raises(InputError, match=told):
        Arm.from_spec(spec_of(FIVE_BAR))
    arm, _ = arm_of(FIVE_BAR, tip="rod1", servos="none")
    assert arm.joint_names == ("c1", "r1")


def test_missing_and_broken_files_are_named(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        Arm.load(tmp_path / "arm.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody>")
    with pytest.raises(FileError, match="cannot read"):
        Arm.load(broken)
    mesh = '<compiler meshdir="meshes"/><asset><mesh file="tube.obj"/><mesh file="fork.obj"/></asset>'
    body = '<worldbody><body><joint/><geom type="mesh" mesh="tube"/></body></worldbody>'
    broken.write_text(f"<mujoco>{mesh}{body}</mujoco>")
    with pytest.raises(FileError, match=r"files of the model are missing: .*meshes/tube\.obj, .*meshes/fork\.obj"):
        Arm.load(broken)
    other = tmp_path / os.fsdecode(b"caf\xe9.xml")
    shutil.copy(broken, other)
    with pytest.raises(FileError, match=r"bytes in its path that are not UTF-8: '.*caf\\udce9\.xml'"):
        Arm.load(other)
    with pytest.raises(InputError, match="spec must be a MjSpec of mujoco, got 3"):
        Arm.from_spec(3)


def test_a_path_with_accents_is_found_in_every_locale(tmp_path):
    """Python's paths are bytes there, in UTF-8 or not."""
    folder = tmp_path / "é"
    folder.mkdir()
    (folder / "arm.xml").write_text(BALL.replace("ACTIVE", ""))
    code = "import sys, lieednn_sim as ls; print(ascii(sys.argv[1][-10:]), ls.Arm.load(sys.argv[1]).n_joints)"
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-c", code, folder / "arm.xml"]
    done = subprocess.run(command, env=os.environ | locale, capture_output=True, text=True, check=False)
    assert done.stdout == "'\\udcc3\\udca9/arm.xml' 4\n", done.stderr


def test_what_comes_near_on_straight_ways_is_counted_in_one_order_of_names(monkeypatch):
    # From x = 0.424 to 0.776 of -1 to 1 the ball touches both posts: in 17.5 % of postures; to 11.2 % it passes them.
    posts = "".join(
        f'<body name="{name}" pos=".6 {y} 0"><geom size=".1"/></body>' for name, y in (("b", -0.1), ("a", 0.1))
    )
    hand = '<body name="hand"><joint type="slide" axis="1 0 0" range="-1 1"/><geom size=".1"/></body>'
    monkeypatch.setattr(remarks, "_PATHS", 256)
    told = arm_of(f"<mujoco><worldbody>{posts}{hand}</worldbody></mujoco>")[1].notes
    at_end, before = (note for note in told if "within 2 mm of contact" in note)
    assert "between 'a' and 'hand' (51), 'b' and 'hand' (51): these cannot be targets" in at_end
    assert at_end.startswith("51 of 256 random configurations")
    assert "between 'a' and 'hand' (24), 'b' and 'hand' (24): there planners fail" in before
    assert before.startswith("24 of 205 straight paths")


def test_servos_can_all_be_designed_anew_and_follow_a_step():
    _, kept = arm_of(BY_TENDON)
    arm, designed = arm_of(BY_TENDON, servos="design")
    assert any(servo.kept for servo in kept.servos)
    assert not any(servo.kept for servo in designed.servos)
    data, q = arm.data(), arm.keyframe("home")
    goal = np.clip(q + 0.03, *arm.position_limits.T)
    for name, change in zip(arm.joint_names, goal - q, strict=True):
        data.actuator(name).ctrl += change  # from what holds home against gravity
    for _ in range(round(3.0 / arm.model.opt.timestep)):
        mujoco.mj_step(arm.model, data)
    assert not data.warning.number.any()
    np.testing.assert_allclose(arm.coordinates(data.qpos), goal, atol=2e-3)


def test_rk4_is_replaced_with_a_note_and_refused_where_nothing_may_be_replaced():
    rk4 = mujoco.mjtIntegrator.mjINT_RK4
    own = spec_of(HINGES.format(options='integrator="RK4"'))
    arm = Arm.from_spec(own)
    assert arm.model.opt.integrator != rk4
    assert own.option.integrator == rk4, "the model that was given stays as it was"
    assert any("implicitfast in place of RK4" in note for note in arm.import_report.notes)
    assert not any("RK4" in note for note in arm_of(HINGES.format(options=""))[1].notes)
    model = own.compile()
    with pytest.raises(InputError, match=r"arm 'arm' asks for the integrator RK4, .* to implicitfast"):
        Arm.of(model, mujoco.MjData(model), ["a", "b", "c"])


@pytest.mark.parametrize("servos", ["keep", "design"])
def test_models_with_delays_activations_or_sleep_are_imported(servos):
    """MuJoCo linearises neither delays nor sleep, and activations of keyframes must be those of the actuators."""
    more = """<actuator><position joint="a" kp="90" kv="9" timeconst=".1" {0}/></actuator>
        <sensor><jointpos joint="a" {0}/></sensor>
        <keyframe><key name="posed" qpos=".1 .2 .3" act=".1"/></keyframe></mujoco>"""
    asleep = HINGES.format(options="").replace("<worldbody>", '<option><flag sleep="enable"/></option><worldbody>', 1)
    for xml, delay in ((HINGES.format(options=""), 'delay=".02" nsample="9"'), (asleep, "")):
        arm = Arm.from_spec(spec_of(xml.replace("</mujoco>", more.format(delay))), servos=servos)
        np.testing.assert_allclose(arm.model.key("posed").qpos, [0.1, 0.2, 0.3])


def test_a_base_that_is_fixed_may_have_been_asleep():
    """MuJoCo compiles a policy of sleep for moving bodies only."""
    asleep = BY_EQUALITY.replace("<worldbody>", '<option><flag sleep="enable"/></option><worldbody>', 1)
    asleep = asleep.replace('name="cart"', 'name="cart" sleep="init"')
    assert "'cart', a free body that carries the arm, is fixed where it is at home" in str(arm_of(asleep)[1])


def test_actuators_with_several_controls_are_refused_by_name():
    xml = HINGES.format(options="").replace("</mujoco>", '<actuator><pid name="turn" joint="a"/></actuator></mujoco>')
    model = mujoco.MjModel.from_xml_string(xml)
    for make in (lambda: Arm.from_spec(spec_of(xml)), lambda: Arm.of(model, mujoco.MjData(model), ["a", "b", "c"])):
        with pytest.raises(InputError, match=r"actuator 'turn' has 2 controls; .* put a <position> or <motor> in its"):
            make()


@pytest.mark.parametrize(("half", "told"), [(179, True), (150, False)])
def test_a_compound_joint_that_comes_near_half_a_turn_is_told(half, told):
    """Among 65 postures one turns by more than 0.95 pi where the limits allow 0.99 pi; slides do not count."""
    report = Arm.from_spec(
        spec_of(f"""
<mujoco><compiler angle="degree"/><worldbody>
  <body name="still" pos="0 0 1"><joint name="a" range="-9 9"/><geom size="0.05"/>
    <body name="sliding"><joint name="b" type="slide" range="-9 9"/><geom size="0.05"/>
      <body name="turning" pos="0.3 0 0"><joint name="c" range="-{half} {half}"/><geom size="0.05" pos="0.2 0 0"/>
</body></body></body></worldbody></mujoco>"""),
        links=["still", "turning"],
    ).import_report
    notes = [note for note in report.notes if "may turn by" in note]
    assert [note[: len("link 2 may turn by 3")] for note in notes] == ["link 2 may turn by 3"] * told


def test_stages_that_cancel_each_other_are_refused_in_one_line():
    stage = (
        '<body pos=".1 0 0"><joint name="{}" type="slide" axis="1 0 0" range="-0.3 0.3"/><geom size=".03"/>{}</body>'
    )
    hand = '<body pos=".1 0 0"><joint name="wrist" axis="0 1 0" range="-80 80"/><geom size=".03"/></body>'
    tie = '<equality><joint joint1="out2" joint2="out1" polycoef="0 -1 0 0 0"/></equality>'
    bodies = stage.format("out1", stage.format("out2", hand))
    with pytest.raises(InputError, match="'out1' moves nothing, since 'out2', which follows it, undoes its motion"):
        Arm.from_spec(spec_of(f"<mujoco><worldbody>{bodies}</worldbody>{tie}</mujoco>"))


def test_moving_links_without_an_inertia_get_a_small_one(tmp_path):
    path = tmp_path / "slider.urdf"
    path.write_text("""
<robot name="slider"><link name="world_link"/><link name="basex"/>
<link name="hand"><inertial><mass value="2"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
</link>
<joint name="x" type="prismatic"><parent link="world_link"/><child link="basex"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="50" velocity="1"/></joint>
<joint name="turn" type="revolute"><parent link="basex"/><child link="hand"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="50" velocity="1"/></joint></robot>""")
    arm = Arm.load(path)
    assert arm.model.body("basex").mass == 0.01
    assert not any("named like a tool" in note for note in arm.import_report.notes)
    assert "links without <inertial> got a mass of 10 g: basex" in arm.import_report.notes
    # Drawing tools write links without a material with a mass of zero.
    path.write_text(path.read_text().replace('<mass value="2"/><inertia ixx=".1"', '<mass value="0"/><inertia ixx="0"'))
    arm = Arm.load(path)
    assert "hand: a mass of zero is taken as no <inertial>" in arm.import_report.notes
    assert arm.model.body("hand").mass == 0.01


def test_no_motor_has_to_hold_a_mass_that_mujoco_guesses_from_a_shape(tmp_path):
    """A ball of 0.3 m in radius would weigh 1.1 kN: spherised models have no inertias, but the efforts of the robot."""
    path = tmp_path / "lift.urdf"
    path.write_text("""
<robot name="lift"><link name="base"/>
<link name="cage"><collision><geometry><sphere radius=".3"/></geometry></collision></link>
<joint name="up" type="prismatic"><parent link="base"/><child link="cage"/><axis xyz="0 0 1"/><origin xyz="0 0 1"/>
<limit lower="0" upper="1" effort="450" velocity="1"/></joint></robot>""")
    arm = Arm.load(path)
    assert arm.model.body("cage").mass > 100.0
    assert "links without <inertial> got the inertia of their shapes, but no weight: cage" in arm.import_report.notes
    assert evaluate(simulate(arm, plan(arm, [0.5]))).final_worst_mm < 0.1


def test_geoms_that_collide_in_explicit_pairs_alone_are_seen():
    xml = """
<mujoco><worldbody><body name="post" pos=".5 .3 0"><geom name="post" size=".1" contype="0" conaffinity="0"/></body>
<body name="a"><joint name="turn" axis="0 0 1" range="-90 90"/>
<geom name="a" type="capsule" fromto="0 0 0 .5 0 0" size=".03" contype="0" conaffinity="0"/></body></worldbody>
<contact><pair geom1="a" geom2="post"/></contact></mujoco>"""
    arm, report = arm_of(xml, floor="none")
    assert not any("can collide" in note for note in report.notes)
    assert arm.near_contacts([np.arctan2(0.3, 0.5)]) == [("post", "a")]


def test_a_frame_named_like_a_tool_is_told_with_the_option_that_chooses_it():
    hand = (
        '<body name="hand" pos=".3 0 0"><geom size=".02"/><site name="grip_tcp" pos=".1 0 0"/><site name="eye"/></body>'
    )
    xml = f'<mujoco><worldbody><body name="a"><joint name="a"/><geom size=".05"/>{hand}</body></worldbody></mujoco>'
    told = (
        "the end effector is 'a'; tip='grip_tcp' (--tip) would choose that, of the frames named like a tool: grip_tcp"
    )
    assert told in arm_of(xml, floor="none")[1].notes
    assert arm_of(xml, floor="none", tip="grip_tcp")[1].links == ("grip_tcp",)


def test_an_option_that_no_import_has_is_refused(tmp_path, two_hinges):
    (tmp_path / "arm.xml").write_text(two_hinges)
    with pytest.raises(InputError, match=r"no option 'tool' of an import; allowed: base, .*, tip"):
        Arm.load(tmp_path / "arm.xml", tool="tool0")


def test_limits_that_may_be_degrees_are_told(tmp_path, two_hinges):
    wide = two_hinges.replace("<mujoco>", '<mujoco><compiler angle="radian"/>')
    notes = arm_of(wide, floor="none")[1].notes
    assert "a may turn 28.6 times about: are its limits in degrees?" in notes
    assert not any("degrees?" in note for note in arm_of(two_hinges, floor="none")[1].notes)
    narrow = arm_of(two_hinges.replace('range="-90 90"', 'range="-1.57 1.57"', 1), floor="none")[1].notes
    assert "a may turn by 3.14 degrees: are its limits in radians, the file in degrees?" in narrow
    backwards = arm_of(two_hinges.replace('range="-90 90"', 'range="90 -90"', 1), floor="none")[1].notes
    assert "a: had no range and got [-6.283, 6.283] rad" in backwards
    slide = two_hinges.replace('<joint name="a" range="-90 90"', '<joint name="a" type="slide" range="0 200"')
    assert "a may move by 200 m: are its limits in millimetres?" in arm_of(slide, floor="none")[1].notes
    quarter = '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>' + (
        '<child link="b"/><origin rpy="0 {} 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint></robot>'
    )
    for angle, told in ((90, True), (1.5708, False)):
        (tmp_path / "r.urdf").write_text(quarter.format(angle))
        said = Arm.load(tmp_path / "r.urdf").import_report.notes
        assert (f"an origin of the URDF has rpy='0 {angle} 0': are its angles in degrees?" in said) == told


def test_a_joint_that_lacks_an_actuator_is_said_to_be_left_out(two_hinges):
    servo = '<actuator><position joint="a" kp="100" kv="10"/></actuator></mujoco>'
    xml = two_hinges.replace("</mujoco>", servo)
    arm, report = arm_of(xml, floor="none")
    assert arm.joint_names == ("a",)
    assert "without an actuator, and so no part of the arm: b; name the joints to move it" in report.notes
    assert not any("no part" in note for note in arm_of(xml, floor="none", joints=["a", "b"])[1].notes)
