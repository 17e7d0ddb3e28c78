"""Compound joints of any make: kinematics, coupled stages, and the retraction where it has no closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.lie import exp

# A ball shoulder with a telescope of three coupled stages, a universal joint with an off-axis slide, and two links
# whose slides share one coordinate.
ARM = """
<mujoco model="odd">
  <compiler angle="radian" autolimits="true"/>
  <default><geom type="sphere" size="0.01" contype="0" conaffinity="0" mass="1"/></default>
  <worldbody>
    <site name="base_frame" pos="0.1 0 0.2" euler="0.3 0 0.1"/>
    <body name="shoulder" pos="0 0 0.4" euler="0.2 0.4 -0.3">
      <joint name="shoulder" type="ball" range="0 2"/><geom/>
      <body name="tube" pos="0 0 0.1">
        <joint name="out1" type="slide" axis="0 0 1" range="0 0.2"/><geom/>
        <body name="tube2" pos="0 0 0.1">
          <joint name="out2" type="slide" axis="0 0 1" range="0 0.2"/><geom/>
          <body name="tube3" pos="0 0 0.1">
            <joint name="out3" type="slide" axis="0 0 1" range="-0.5 0.5" ref="0.05"/><geom/>
            <site name="link1_frame" pos="0 0 0.1" euler="0 0.5 0"/>
            <body name="cross" pos="0.1 0 0">
              <joint name="yaw" type="hinge" axis="0 0 1" range="-1 1"/><geom/>
              <body name="fork" pos="0 0.05 0">
                <joint name="pitch" type="hinge" axis="0 1 0" range="-1 1.2" ref="0.1"/><geom/>
                <joint name="boom" type="slide" axis="0.8 0 0.6" range="0 0.3"/>
                <site name="link2_frame" pos="0.2 0 0"/>
                <body name="left" pos="0.2 0 0">
                  <joint name="roll" type="hinge" axis="1 0 0" range="-1 1"/>
                  <joint name="left" type="slide" axis="1 0 0" range="0 0.3"/><geom/>
                  <site name="link3_frame"/>
                  <body name="right" pos="0.2 0 0">
                    <joint name="right" type="slide" axis="0 1 0" range="-1 1"/><geom/>
                    <site name="link4_frame"/>
                  </body>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
    <body name="elsewhere"><joint name="wheel" type="hinge" axis="0 0 1"/><geom/></body>
  </worldbody>
  <equality>
    <joint joint1="out2" joint2="out1" polycoef="0.01 1 0 0 0"/>
    <joint joint1="out3" joint2="out2" polycoef="0 -0.5 0 0 0"/>
    <joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/>
  </equality>
</mujoco>
"""


def make(tmp_path, xml=ARM):
    path = tmp_path / "scene.xml"
    path.write_text(xml)
    return Arm.from_xml(path, "odd")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return make(tmp_path_factory.mktemp("odd"))


def positions(arm, count, seed=0):
    low, high = 0.57 * arm.position_limits.T
    return np.random.default_rng(seed).uniform(low, high, (count, arm.n_joints))


def test_coupled_stages_share_a_coordinate_whose_limits_are_the_strictest(arm):
    assert arm.joint_names == ("shoulder_x", "shoulder_y", "shoulder_z", "out1", "yaw", "pitch", "boom", "roll", "left")
    assert [arm.unit(j) for j in range(9)] == [*["rad"] * 3, "m", "rad", "rad", "m", "rad", "m"]
    # out2 = out1 + 0.01 must stay below 0.2.
    np.testing.assert_allclose(arm.position_limits[3], [0.0, 0.19], atol=1e-12)
    q = positions(arm, 1)[0]
    data = mujoco.MjData(arm.model)
    data.qpos[:] = arm.qpos(q)
    out2, out3 = data.joint("out2").qpos[0], data.joint("out3").qpos[0]
    assert (out2, out3) == pytest.approx((q[3] + 0.01, 0.05 - 0.5 * out2))
    # MuJoCo's own equality constraints are kept, exactly.
    mujoco.mj_forward(arm.model, data)
    np.testing.assert_allclose(data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY], 0.0, atol=1e-12)


def test_link_poses_equal_mujocos_kinematics(arm):
    data = mujoco.MjData(arm.model)
    for q in positions(arm, 50):
        data.qpos[:] = arm.qpos(q)
        mujoco.mj_kinematics(arm.model, data)
        poses = arm.link_poses(q).as_matrix()
        np.testing.assert_allclose(poses[:, :3, 3], data.site_xpos[arm.site_ids], atol=1e-12)
        np.testing.assert_allclose(poses[:, :3, :3].reshape(-1, 9), data.site_xmat[arm.site_ids], atol=1e-12)


def distance(arm, q, xi):
    """What the least squares minimise, by another way: angles and distances of the poses apart."""
    given_poses, found = exp(xi), arm.joint_poses(q)
    angle = (found.inv() * given_poses).rotation.magnitude()
    shift = found.translation - given_poses.translation
    return (4.0 * np.sin(0.5 * angle) ** 2).sum(axis=-1) + (shift**2).sum(axis=(-2, -1))


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.0, 1e-9, 1e-4, 0.1]))
def test_feasible_poses_are_met_and_others_to_the_nearest(arm, seed, size):
    rng = np.random.default_rng(seed)
    q = positions(arm, 3, seed)
    xi = arm.encode(q) + size * rng.normal(size=(3, arm.n_links, 6))
    decoded = arm.decode(xi)
    if size == 0.0:
        np.testing.assert_allclose(decoded.q, q, atol=1e-9)
    best = distance(arm, decoded.q, xi)
    assert (best <= distance(arm, q, xi) + 1e-15).all()
    for direction in 1e-4 * np.vstack([np.eye(arm.n_joints), -np.eye(arm.n_joints)]):
        assert (best <= distance(arm, decoded.q + direction, xi) + 1e-12).all()


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.0, 1e-6, 0.1]))
def test_rates_are_the_derivative_of_the_retraction(arm, seed, size):
    rng = np.random.default_rng(seed)
    xi = arm.encode(positions(arm, 1, seed)[0]) + size * rng.normal(size=(arm.n_links, 6))
    rate, h = rng.normal(size=xi.shape), 1e-5
    numeric = (arm.decode(xi + h * rate).q - arm.decode(xi - h * rate).q) / (2.0 * h)
    np.testing.assert_allclose(arm.decode(xi, rate).qd, numeric, atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('polycoef="0 -0.5 0 0 0"', 'polycoef="0 1 2 0 0"', "'out3'.*polycoef 'a0 a1 0 0 0'"),
        ('joint1="out2" joint2="out1"', 'joint1="out2" joint2="wheel"', "'out2'.*its chain"),
        ('joint1="out2" joint2="out1"', 'joint1="out2" joint2="out3"', "in a circle"),
        ('type="ball" range="0 2"', 'type="ball" range="0 4"', "may turn by 4 rad"),
        ('name="left" type="slide" axis="1 0 0" range="0 0.3"', 'name="left" type="slide"', "no position limits"),
        ('<site name="link4_frame"/>', '<site name="link4_frame"/><site name="link5_frame"/>', "link 5.*no joint"),
    ],
)
def test_what_cannot_be_an_arm_is_refused_with_the_reason(old, new, words, tmp_path):
    assert old in ARM
    with pytest.raises(InputError, match=words):
        make(tmp_path, ARM.replace(old, new))
