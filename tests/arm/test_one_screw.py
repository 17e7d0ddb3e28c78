"""Links that move along one screw: the twist is the screw times its coordinate, beyond half a turn as well."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.kinematics import CompoundJoint, Factor
from lieednn_sim.errors import InputError
from lieednn_sim.lie import exp
from lieednn_sim.planning import plan

# A turntable, a lift, a wrist that turns twice around, and a drill whose feed is geared to its turn.
WRIST = """
<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
  <body name="table"><joint name="turn" axis="0 0 1" range="-4 5" ref=".3"/><geom size=".01"/>
    <body name="lift" pos=".1 0 0"><joint name="lift" type="slide" axis="0 .6 .8" range="-.5 .5"/><geom size=".01"/>
      <body name="wrist" pos="0 0 .4" euler=".3 0 .2"><joint name="wrist" axis="1 0 0" range="-13 13"/>
        <geom size=".01"/>
        <body name="drill" pos=".3 0 0"><joint name="spin" axis="0 1 0" range="-7 7"/><geom size=".01"/>
          <body name="bit" pos="0 .1 0"><joint name="feed" type="slide" axis="0 {y} {z}" range="-1 1"/>
            <geom size=".01"/></body></body></body></body></body></worldbody>
  <equality><joint joint1="feed" joint2="spin" polycoef="0 .05 0 0 0"/></equality>
</mujoco>
"""


def arm_of(xml: str, **options) -> Arm:
    arm = Arm.from_spec(mujoco.MjSpec.from_string(xml), floor="none", **options)
    return arm


@pytest.fixture(scope="module")
def arm() -> Arm:
    return arm_of(WRIST.format(y=1, z=0), links=["table", "lift", "wrist", "bit"])


def test_ranges_are_kept_whole_and_the_report_says_nothing_of_them(arm):
    # The drill would be the last but for its feed, which is a joint of the same link: that one shares its screw.
    np.testing.assert_allclose(arm.position_limits[[0, 2]], [[-4.0, 5.0], [-13.0, 13.0]])
    assert not any("narrowed" in note and "spin" not in note for note in arm.import_report.notes)


def test_a_twist_is_the_screw_times_the_coordinate(arm):
    xi = arm.encode([5.0, 0.4, -12.0, 2.0]) * arm.twist_units
    np.testing.assert_allclose(xi[0], [0.0, 0.0, 4.7, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(xi[1], [0.0, 0.0, 0.0, 0.0, 0.24, 0.32], atol=1e-12)
    np.testing.assert_allclose(xi[2], [-12.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(xi[3], [0.0, 2.0, 0.0, 0.0, 0.1, 0.0], atol=1e-12)


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1))
def test_its_exponential_is_the_pose_and_projection_gives_back_position_and_rate(arm, seed):
    rng = np.random.default_rng(seed)
    q, qd = rng.uniform(*arm.position_limits.T), rng.normal(size=4)
    xi = arm.encode(q)
    np.testing.assert_allclose(exp(xi * arm.twist_units).as_matrix(), arm.joint_poses(q).as_matrix(), atol=1e-12)
    # What is across the screw leaves a gap and moves nothing; rates are along the screw.
    unit = arm.encode(arm.joints.reference + 1.0)
    across = rng.normal(size=unit.shape)
    across -= (across * unit).sum(-1, keepdims=True) / (unit**2).sum(-1, keepdims=True) * unit
    found = arm.decode(xi + 0.1 * across, qd[:, None] * unit + across)
    np.testing.assert_allclose(found.q, q, atol=1e-12)
    np.testing.assert_allclose(found.qd, qd, atol=1e-12)
    assert (found.gap_rotation + found.gap_translation > 1e-3).all()
    assert (arm.decode(xi).gap_rotation < 1e-7).all()


@pytest.mark.parametrize("planner", ["lieednn-certified", "linear-attractor", "se3-geodesic", "minimum-jerk"])
def test_plans_turn_as_far_as_the_joints_do(arm, planner):
    start, target = np.array([-3.5, 0.3, 12.0, -1.0]), np.array([4.5, -0.3, -11.0, 2.0])
    made = plan(arm, target, start=start, planner=planner).motion
    np.testing.assert_allclose(made.q[[0, -1]], [start, target], atol=1e-7)
    # No jump by a whole turn on the way: positions are the integral of the rates.
    steps = np.diff(made.q, axis=0) - 0.5 * (made.qd[1:] + made.qd[:-1]) * np.diff(made.t)[:, None]
    assert np.abs(steps).max() < 1e-3


def test_joints_that_do_not_commute_have_no_screw_and_are_narrowed():
    """The feed crosses the drill's axis: the link's path is a helix's no more."""
    skew = arm_of(WRIST.format(y=0.6, z=0.8), links=["table", "lift", "wrist", "bit"])
    assert [joint.screw is None for joint in skew.joints.joints] == [False, False, False, True]
    np.testing.assert_allclose(skew.position_limits[3], [-0.99 * np.pi, 0.99 * np.pi])


X, Y, Z = np.eye(3)


def hinge(axis, anchor=(0.0, 0.0, 0.0)):
    return Factor("hinge", np.asarray(axis, dtype=float)[:, None], np.array(anchor), np.array([0]))


def slide(axis, ratio=1.0):
    return Factor("slide", np.asarray(axis, dtype=float)[:, None], np.zeros(3), np.array([0]), ratio)


@pytest.mark.parametrize(
    ("joints", "screw"),
    [
        # Twice about one axis, which is off the origin: v = -omega x anchor.
        ([hinge(Z, (1.0, 2.0, 3.0)), hinge(Z, (1.0, 2.0, -1.0))], [0.0, 0.0, 2.0, 4.0, -2.0, 0.0]),
        ([hinge(Z), slide(Z, 0.5)], [0.0, 0.0, 1.0, 0.0, 0.0, 0.5]),
        ([slide(X), slide(Y, 0.5)], [0.0, 0.0, 0.0, 1.0, 0.5, 0.0]),
        ([hinge(Z), hinge(Z, (1.0, 0.0, 0.0))], None),
        ([hinge(Z, (1.0, 0.0, 0.0)), hinge(Z)], None),
        ([hinge(Y), hinge(Z)], None),
        ([hinge(Z), hinge(Y)], None),
        ([hinge(Z), slide(X)], None),
        ([slide(X), hinge(Z)], None),
        # In line up to a thousandth.
        ([hinge(Z), slide([1e-3, 0.0, 1.0])], None),
    ],
)
def test_joints_share_a_screw_where_their_lie_bracket_vanishes(joints, screw):
    """omega_1 x omega_2 = 0 and omega_1 x v_2 + v_1 x omega_2 = 0, whichever comes first."""
    found = CompoundJoint(tuple(joints)).screw
    assert (found is None) == (screw is None)
    if screw is not None:
        np.testing.assert_allclose(found, screw, atol=1e-12)


def test_a_screw_in_any_direction_is_one_up_to_rounding():
    for axis in Rotation.random(50, rng=np.random.default_rng(0)).apply(Z):
        assert CompoundJoint((hinge(axis, 3.0 * axis[::-1]), slide(axis, 0.7))).screw is not None


def chain(*axes, limit=1):
    """MJCF of hinges in a row, on the bodies b0, b1, ..."""
    bodies = "".join(
        f'<body name="b{i}" pos="0 0 .2"><joint axis="{axis}" range="-{limit} {limit}"/><geom size=".01"/>'
        for i, axis in enumerate(axes)
    )
    return f'<mujoco><compiler angle="radian"/><worldbody>{bodies}{"</body>" * len(axes)}</worldbody></mujoco>'


def test_coordinates_that_no_pose_tells_apart_are_refused():
    xml = chain("0 0 1", "0 1 0", "1 0 0", "0 1 0", "0 0 1", "0 1 0", "1 0 0")
    assert arm_of(xml, links=["b5"]).n_joints == 6
    with pytest.raises(InputError, match=r"link 1 of arm .* is moved by 7 coordinates, but a pose determines six"):
        arm_of(xml, links=["b6"])
    with pytest.raises(InputError, match=r"link 1 of arm .* is moved by 3 coordinates that are not independent"):
        arm_of(xml.replace("0 1 0", "0 0 1"), links=["b4"], base="b1")


def test_hinges_of_other_links_are_decoded_within_half_a_turn():
    """Of three hinges in one link the search went on to postures that are turns away."""
    arm = arm_of(chain("0 0 1", "0 1 0", "0 1 0", limit=3), links=["b2"])
    xi = 3.0 * np.random.default_rng(0).normal(size=(50, 1, 6))
    assert np.abs(arm.decode(xi).q).max() <= np.pi
