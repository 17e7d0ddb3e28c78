"""Compound joints of any make: kinematics, coupled stages, and the retraction where it has no closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mechanisms import ODD_ARM
from scipy.optimize import least_squares

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.kinematics import CompoundJoint, CompoundJoints, Factor
from lieednn_sim.arm.local_retraction import LocalRetraction
from lieednn_sim.arm.nearest import NearestPose
from lieednn_sim.arm.projection import Retractor
from lieednn_sim.errors import InputError
from lieednn_sim.lie import exp


def make(tmp_path, xml=ODD_ARM):
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
    # out2 - 0.02 = 0.01 + out1 must stay below 0.18.
    np.testing.assert_allclose(arm.position_limits[3], [0.0, 0.17], atol=1e-12)
    q = positions(arm, 1)[0]
    data = mujoco.MjData(arm.model)
    data.qpos[:] = arm.qpos(q)
    out2, out3 = data.joint("out2").qpos[0], data.joint("out3").qpos[0]
    assert (out2, out3) == pytest.approx((q[3] + 0.03, 0.05 - 0.5 * (out2 - 0.02)))
    # MuJoCo's own equality constraints are kept, exactly.
    mujoco.mj_forward(arm.model, data)
    np.testing.assert_allclose(data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY], 0.0, atol=1e-12)


def link(begin, axis=(0.0, 0.0, 1.0), anchor=(0.0, 0.0, 0.0), ratio=1.0, kind="hinge", order=(0, 1, 2)):
    """A hinge, another one or a slide along y, and a slide along x; of the coordinates from ``begin`` on."""
    parts = (
        ("hinge", axis, anchor, ratio),
        (kind, (0.0, 1.0, 0.0), np.zeros(3), 1.0),
        ("slide", [1, 0, 0], [0] * 3, 1.0),
    )
    return CompoundJoint(
        tuple(
            Factor(kind, np.array(axis, float)[:, None], np.array(anchor, float), np.array([begin + k]), ratio)
            for (kind, axis, anchor, ratio), k in zip(parts, order, strict=True)
        )
    )


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 8.0])
def test_twists_are_principal_logarithms_of_the_poses(arm, size):
    """Of a ball and slides behind it; of hinges with slides before, behind and on both sides, off the axis; of two."""
    slides = link(0, kind="slide", order=(1, 0, 2)), link(3, anchor=[0.1, 0.2, 0.0], kind="slide", ratio=2.0)
    between = replace(slides[1], factors=tuple(slides[1].factors[k] for k in (1, 0, 2)))
    first, second, slide = link(6).factors
    around = CompoundJoint((slide, *(replace(hinge, anchor=np.array([0.1, 0.2, 0.3])) for hinge in (first, second))))
    for joints in (arm.joints, CompoundJoints((*slides, between, link(6), around), np.zeros(9))):
        rng, n = np.random.default_rng(0), len(joints.reference)
        q = joints.reference + size * rng.uniform(-1.0, 1.0, (200, n))
        xi = joints.twists(q)
        np.testing.assert_allclose(exp(xi).as_matrix(), joints.poses(q).as_matrix(), atol=1e-12 * max(size, 1.0))
        turning = [k for k, joint in enumerate(joints.joints) if joint.screw is None]
        assert np.linalg.norm(xi[:, turning, :3], axis=-1).max() < np.pi + 1e-12
        np.testing.assert_array_equal(joints.twists(q[3]), joints.twists(q[3:4])[0])


@pytest.mark.parametrize(
    "second",
    [
        {},
        {"axis": [0.0, 0.6, 0.8]},
        {"axis": [0.0, 0.0, -1.0]},
        {"anchor": [0.1, 0.1, 0.0]},
        {"ratio": 2.0},
        {"kind": "slide"},
        {"order": (1, 0, 2)},
    ],
    ids=str,
)
def test_links_are_retracted_each_by_its_own_joints(second):
    """Between two that are built alike one that is too, or is not; from poses alone, and along a path of them."""
    joints, rng = CompoundJoints((link(0), link(3, **second), link(6)), np.zeros(9)), np.random.default_rng(2)
    retract, q = Retractor(joints, 1.0), rng.uniform(-0.5, 0.5, (4, 9))
    np.testing.assert_allclose(retract(joints.twists(q)).q, q, atol=1e-9)
    aside = 0.1 * rng.normal(size=(3, 6)) * np.linspace(0.0, 1.0, 200)[:, None, None]
    path = joints.twists(np.linspace(q[0], q[1], 200)) + aside
    poses, followed = exp(path), retract(path, np.gradient(path, axis=0), q[0])
    for k, joint in enumerate(joints.joints):
        alone = NearestPose([joint], joint.indices, 9, 1.0)
        mine = poses.rotation.as_matrix()[:, [k]], poses.translation[:, [k]]
        np.testing.assert_allclose(followed.q[:, joint.indices], alone.follow(*mine, q[0, joint.indices])[0], atol=1e-9)
    np.testing.assert_allclose(followed.qd[1:-1], np.gradient(followed.q, axis=0)[1:-1], atol=1e-4)


def test_the_gap_of_half_a_turn_is_half_a_turn(gantry):
    """The chord is a diameter, up to a rounding that no arc sine may see."""
    axes = np.random.default_rng(0).normal(size=(20, 3))
    xi = np.zeros((20, 2, 6))
    xi[:, 0, :3] = np.pi * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    np.testing.assert_allclose(gantry.decode(xi).gap_rotation[:, 0], np.pi, atol=1e-7)


def distance(arm, q, xi):
    """What the least squares minimise, by another way: angles and distances of the poses apart."""
    given_poses, found = exp(xi), arm.joint_poses(q)
    angle = (found.inv() * given_poses).rotation.magnitude()
    shift = found.translation - given_poses.translation
    return (4.0 * np.sin(0.5 * angle) ** 2).sum(axis=-1) + (shift**2).sum(axis=(-2, -1))


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.0, 1e-9, 1e-4, 0.1]))
def test_feasible_poses_are_met_and_others_to_the_nearest(arm, seed, size):
    rng = np.random.default_rng(seed)
    q = positions(arm, 3, seed)
    xi = arm.encode(q) + size * rng.normal(size=(3, arm.n_links, 6))
    decoded = arm.decode(xi)
    if size == 0.0:
        np.testing.assert_allclose(decoded.q, q, atol=1e-9)
    assert (distance(arm, decoded.q, xi) <= distance(arm, q, xi) + 1e-15).all()


def test_the_distance_is_stationary_at_what_is_found(arm):
    rng, h = np.random.default_rng(8), 1e-5
    xi = arm.encode(positions(arm, 40)) + 0.3 * rng.normal(size=(40, arm.n_links, 6))
    q = arm.decode(xi).q
    for direction in h * np.eye(arm.n_joints):
        slope = distance(arm, q + direction, xi) - distance(arm, q - direction, xi)
        np.testing.assert_allclose(slope / (2.0 * h), 0.0, atol=1e-8)


TURN, SLIDE = np.linspace(-np.pi, np.pi, 17)[:-1], np.linspace(-2.4, 2.4, 9)
# A universal joint and a slide, and two links that share a slide.
UNIVERSAL, SHARED = (TURN, TURN, SLIDE), (TURN, SLIDE)


@pytest.mark.parametrize(("spread", "count"), [(1e-6, 2), (0.1, 2), (0.8, 6)])
@pytest.mark.parametrize(
    ("name", "links", "indices", "axes"),
    [
        ("telescopic_rrp", [1], [3, 4, 5], UNIVERSAL),
        ("odd", [1], [4, 5, 6], UNIVERSAL),
        ("odd", [2, 3], [7, 8], SHARED),
    ],
    ids=["universal joint", "off its axis", "shared slide"],
)
def test_no_posture_of_a_dense_search_is_nearer_than_the_retraction(arm, name, links, indices, axes, spread, count):
    """A grid over angles and slides, its best polished; the same metric, from the joints' poses alone."""
    arm = arm if name == "odd" else Arm.load(name)

    def poses(x):
        offset = np.zeros((len(x), arm.n_joints))
        offset[:, indices] = x
        pairs = [arm.joints.joints[link].pose(offset) for link in links]
        return stacked(*(np.stack(parts, axis=1) for parts in zip(*pairs, strict=True)))

    def stacked(rotation, translation):
        flat = np.concatenate([rotation * np.sqrt(0.5), translation[..., None] / arm.length_scale], axis=-1)
        return flat.reshape(len(flat), -1)

    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, len(axes))
    values = poses(grid)
    rng = np.random.default_rng(5)
    low, high = 0.57 * arm.position_limits.T
    xi = arm.encode(rng.uniform(low, high, (count, arm.n_joints))) + spread * rng.normal(size=(count, arm.n_links, 6))
    found = poses(arm.decode(xi).q[:, indices] - arm.joints.reference[indices])
    goals = exp(xi[:, links])
    goals = stacked(goals.rotation.as_matrix(), np.asarray(goals.translation))
    for goal, mine in zip(goals, found, strict=True):
        best = grid[((values - goal) ** 2).sum(axis=1).argmin()]
        polished = least_squares(lambda x, goal=goal: poses(x[None])[0] - goal, best, method="lm", max_nfev=100)
        brute = 2.0 * polished.cost
        assert ((mine - goal) ** 2).sum() <= brute + 1e-9 * (brute + spread**2)


def two_hinges(second, ratio=1.0):
    """A link with two hinges, one about z and one about another axis."""
    axes = np.array([[0.0, 0.0, 1.0], np.asarray(second, float) / np.linalg.norm(second)])
    ratios = (ratio, 1.0)
    factors = [Factor("hinge", axes[i][:, None], np.zeros(3), np.array([i]), ratios[i]) for i in range(2)]
    joint = CompoundJoint(tuple(factors))
    return joint, NearestPose([joint], np.arange(2), 2, 1.0)


def test_a_coupled_hinge_is_not_the_same_a_turn_further():
    """At half the pace of its coordinate a turn of that is half a turn."""
    joint, problem = two_hinges([0.0, 1.0, 0.0], ratio=0.5)
    goal = [part[:, None] for part in joint.pose(np.array([[4.0, 0.7]]))]
    np.testing.assert_allclose(problem.solve(*goal), [[4.0, 0.7]], atol=1e-9)


def test_what_is_nearest_weighs_shifts_by_the_length():
    """Turned by q about (-1, 0, 0): 2 - 2 cos q + (2 - 2 cos q - 2 s sin q + s^2) / l^2 is least at s / (l^2 + 1)."""
    hinge = Factor("hinge", np.array([[0.0], [0.0], [1.0]]), np.array([-1.0, 0.0, 0.0]), np.array([0]))
    problem = NearestPose([CompoundJoint((hinge,))], np.arange(1), 1, 0.5)
    found = problem.solve(np.eye(3)[None, None], np.array([[[0.0, 1.0, 0.0]]]))
    np.testing.assert_allclose(np.tan(found), 1.0 / (0.5**2 + 1.0))


def test_the_local_retraction_follows_slides_of_which_one_is_coupled(tmp_path):
    """The second link is moved by 0.4 of the first one's slide, the other way, and by a slide of its own."""
    arm = make(
        tmp_path,
        """
        <mujoco><default><geom type="sphere" size="0.01" contype="0" conaffinity="0" mass="1"/></default><worldbody>
          <site name="base_frame"/>
          <body><joint name="a" type="slide" axis="1 0 0" range="0 1"/><geom/><site name="link1_frame"/>
            <body><joint name="b" type="slide" axis="0 1 0" range="-1 1"/><geom/>
              <body><joint name="c" type="slide" axis="0 0 1" range="-1 1"/><geom/><site name="link2_frame"/></body>
            </body></body></worldbody>
          <equality><joint joint1="b" joint2="a" polycoef="0 -0.4 0 0 0"/></equality></mujoco>
        """,
    )
    q = np.array([[0.2, 0.3], [0.25, 0.35]])
    retraction = LocalRetraction(arm, q[0])
    found, qd = retraction(arm.encode(q[1]), arm.encode(q[1]) - arm.encode(q[0]))
    np.testing.assert_allclose(found, q[1], atol=1e-9)
    np.testing.assert_allclose(qd, [0.05, 0.05], atol=1e-8)
    # By hand: b is at -0.4 a, and what is carried along is no part of the second link.
    np.testing.assert_allclose(arm.encode(q[1])[:, 3:], [[0.25, 0.0, 0.0], [0.0, -0.1, 0.35]], atol=1e-12)


def test_a_fast_way_is_followed_turn_by_turn():
    joint, problem = two_hinges([0.0, 1.0, 0.0])
    q = np.stack([0.5 * np.arange(130), np.full(130, 0.7)], axis=1)
    found, bridged = problem.follow(*(part[:, None] for part in joint.pose(q)), q[0])
    np.testing.assert_allclose(found, q, atol=1e-9)
    assert not bridged.any()


def test_coordinates_that_poses_do_not_tell_apart_share_what_they_have_to_do():
    _, problem = two_hinges([1e-6, 0.0, 1.0])
    still = np.zeros((1, 1, 3))
    rates = problem.rates(np.zeros((1, 2)), np.eye(3)[None, None], still, np.array([[[0.0, 0.0, 1.0]]]), still)
    np.testing.assert_allclose(rates, [[0.5, 0.5]], atol=1e-5)


@settings(max_examples=6)
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
        ('joint1="out2" joint2="out1"', 'joint1="out2" joint2="wheel"', "'wheel'.*its chain"),
        ('joint1="out2" joint2="out1"', 'joint1="out2" joint2="out3"', "because of the .* of 'out3' and 'out2'"),
        ('type="ball" range="0 2"', 'type="ball" range="0 4"', "may turn by 4 rad"),
        ('axis="1 0 0" range="-1 1"', 'axis="1 0 0" range="-6 6"', "may turn by 6 rad"),
        ('name="left" type="slide" axis="1 0 0" range="0 0.3"', 'name="left" type="slide"', "no position limits"),
        ('<site name="link4_frame"/>', '<site name="link4_frame"/><site name="link5_frame"/>', "no joint is between"),
    ],
)
def test_what_cannot_be_an_arm_is_refused_with_the_reason(old, new, words, tmp_path):
    assert old in ODD_ARM
    with pytest.raises(InputError, match=words):
        make(tmp_path, ODD_ARM.replace(old, new))


@pytest.mark.parametrize("name", ["telescopic_pr", "telescopic_rrp", "telescopic_compound"])
def test_the_local_retraction_is_the_nearest_posture_near_the_last_one(name):
    arm, rng = Arm.load(name), np.random.default_rng(4)
    first = arm.within_angles(arm.keyframe("home") + 0.1 * rng.normal(size=arm.n_joints))
    retraction = LocalRetraction(arm, first)
    xi = arm.encode(first) + np.cumsum(2e-3 * rng.normal(size=(20, arm.n_links, 6)), axis=0)
    rate = rng.normal(size=xi.shape)
    found = [(*retraction(*each), retraction.gap) for each in zip(xi, rate, strict=True)]
    exact = arm.decode(xi, rate)
    q, qd, gap = map(np.array, zip(*found, strict=True))
    np.testing.assert_allclose(q, exact.q, atol=3e-4)
    np.testing.assert_allclose(qd, exact.qd, atol=0.02 * np.abs(exact.qd).max())
    np.testing.assert_allclose(gap[..., 1], exact.gap_translation, atol=3e-5)
    np.testing.assert_allclose(gap[..., 0], exact.gap_rotation, atol=1e-4)


@pytest.mark.parametrize("name", ["telescopic_rrp", "telescopic_compound", "of all kinds"])
def test_the_local_retraction_meets_feasible_poses_to_rounding(name, request):
    arm = request.getfixturevalue("arm") if name == "of all kinds" else Arm.load(name)
    home = positions(arm, 1, 3)[0]
    way = home + np.linspace(0.0, 0.05, 6)[:, None] * np.cos(np.arange(arm.n_joints))
    retraction, h = LocalRetraction(arm, home), 1e-5
    rates = (arm.encode(way + h) - arm.encode(way - h)) / (2.0 * h)
    for q, xi, rate in zip(way, arm.encode(way), rates, strict=True):
        found, qd = retraction(xi, rate)
        np.testing.assert_allclose(found, q, atol=1e-7)
        np.testing.assert_allclose(qd, 1.0, atol=2e-5)
        np.testing.assert_allclose(retraction.gap, 0.0, atol=1e-7)


def test_the_local_retraction_finds_back_from_afar(arm):
    """By more than a radian in all, which takes more than two steps."""
    q = positions(arm, 1, 3)[0]
    retraction = LocalRetraction(arm, q + 0.3 * np.cos(np.arange(arm.n_joints)))
    found, _ = retraction(arm.encode(q), np.zeros((arm.n_links, 6)))
    np.testing.assert_allclose(found, q, atol=1e-7)


def test_gaps_of_the_local_retraction_are_in_metres_and_radians(gantry):
    """A link that slides and is given a turn of 0.01 rad, one that turns and is given 2 cm, in units of 2 m."""
    retraction = LocalRetraction(replace(gantry, length_scale=2.0), np.zeros(4))
    xi = np.zeros((2, 6))
    xi[0, 2], xi[1, 4] = 0.01, 0.01
    retraction(xi, np.zeros((2, 6)))
    np.testing.assert_allclose(retraction.gap, [[0.01, 0.0], [0.0, 0.02]], rtol=1e-4, atol=1e-12)
