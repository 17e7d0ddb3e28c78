"""How far joints may be from a configuration without contact: by hand, and by random deviations."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.arm.clearance_bounds import ClearanceBounds
from lieednn_sim.arm.collision import Collisions

NOTHING = np.zeros((2, 4))


def at(bounds, *given, most):
    """The scales and the geoms at one configuration."""
    whole, there, pairs = bounds(*(value[None] for value in given), most)
    return whole[0], there[0], pairs[0]


def test_a_ball_over_a_floor_by_hand(gantry):
    """The ball of radius 0.1 is 1 m over the floor: only z brings it nearer, by what it moves."""
    bounds = ClearanceBounds(gantry, [(np.array([i]), np.ones(1)) for i in range(4)], margin=0.2)
    home, still = np.zeros(4), np.zeros(4)
    x, z, turn = np.eye(4)[[0, 2, 3]]
    for spread, path, rest, expected in (
        (2.0 * z, still, NOTHING, (0.35, 0.35)),
        (2.0 * z + x + turn, still, NOTHING, (0.35, 0.35)),
        (x + turn, still, NOTHING, (0.6, 0.6)),
        (2.0 * z, -0.1 * z + 0.5 * turn, NOTHING, (0.3, 0.35)),
        (2.0 * z, still, np.stack([0.3 * z, 0.2 * z]), (0.2, 0.25)),
        (2.0 * z, 0.9 * z, NOTHING, (0.0, 0.35)),
    ):
        whole, there, _ = at(bounds, home, path, rest, spread, most=0.6)
        assert (whole, there) == pytest.approx(expected, abs=1e-9)
    assert bounds.names(at(bounds, home, still, NOTHING, z, most=1.0)[2]) == ("floor", "ball")


@pytest.mark.parametrize(("name", "scene"), [("telescopic_pr", "poles"), ("telescopic_compound", "window")])
def test_within_the_scale_nothing_comes_nearer_than_the_margin(name, scene):
    """Corners of the set, where the distance is measured by MuJoCo; large turns show the terms of second order."""
    arm = Arm.load(name, scene, 0)
    rng, margin = np.random.default_rng(0), 0.002
    groups = arm.retractor.groups
    bounds, collisions = ClearanceBounds(arm, groups, margin), Collisions(arm)
    home, least, largest = arm.keyframe("home"), np.inf, 0.0
    for _ in range(4):
        q = home + 0.02 * rng.uniform(-1.0, 1.0, arm.n_joints)
        path, spread = 0.002 * rng.uniform(-1.0, 1.0, arm.n_joints), rng.uniform(0.5, 2.0, len(groups))
        rest = np.full((2, arm.n_joints), 1e-3)
        scale, there, _ = at(bounds, q, path, rest, spread, most=0.3)
        assert scale <= there
        largest = max(largest, scale)
        for _ in range(60):
            off = np.zeros(arm.n_joints)
            for size, (indices, weights) in zip(spread, groups, strict=True):
                way = rng.standard_normal(len(indices))
                off[indices] = scale * size * way / np.linalg.norm(way) / weights
            shift = rng.choice([-1.0, 1.0]) * path + rest[0] * rng.choice([-1.0, 1.0], arm.n_joints)
            least = min(least, collisions.clearance(q + shift + off))
    assert margin <= least < 0.1
    assert largest > 0.005


ELBOW = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="wall" pos="1.35 0 0"><geom size="0.1"/></body>
  <body name="upper"><joint name="a" axis="0 0 1" range="-1 1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <body name="lower" pos="0.6 0 0"><joint name="b" axis="0 0 1" range="-1 1"/><geom size="0.05" pos="0.4 0 0"/></body>
  </body></worldbody></mujoco>
"""


def test_turns_count_to_second_order_by_hand(tmp_path):
    """The tip of a stretched arm moves across the normal: s^2 (1 m / 2), and 0.4 m (s^2 / 2 + s^2) by the elbow."""
    path = tmp_path / "elbow.xml"
    path.write_text(ELBOW)
    bounds = ClearanceBounds(Arm.load(path, floor="none"), [(np.array([i]), np.ones(1)) for i in range(2)])
    for spread, bent in (([1.0, 0.0], 0.5), ([0.0, 1.0], 0.2), ([1.0, 1.0], 1.1)):
        scale, _, _ = at(bounds, np.zeros(2), np.zeros(2), np.zeros((2, 2)), np.array(spread), most=2.0)
        assert scale == pytest.approx(np.sqrt(0.2 / bent), rel=1e-6)


@pytest.mark.parametrize(
    ("geom", "reach"),
    [
        ('type="sphere" size="0.05 0.1 0.2"', 0.05),
        ('type="capsule" size="0.05 0.1"', 0.15),
        ('type="cylinder" size="0.05 0.1"', 0.1),
        ('type="cylinder" size="0.05 0.1" euler="0 1.5707963 0.2617994"', 0.05),
        ('type="box" size="0.05 0.1 0.2"', 0.2),
        ('type="ellipsoid" size="0.05 0.1 0.2"', 0.2),
    ],
)
def test_geoms_reach_as_far_as_they_do_by_hand(tmp_path, geom, reach):
    """Over a floor 1 m below, lowered by a slide."""
    path = tmp_path / "lift.xml"
    path.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><geom name="floor" type="plane" size="1 1 1"/>'
        f'<body name="hand" pos="0 0 1"><joint name="z" type="slide" axis="0 0 1" range="-1 1"/><geom {geom}/></body>'
        "</worldbody></mujoco>"
    )
    bounds = ClearanceBounds(Arm.load(path), [(np.array([0]), np.ones(1))])
    scale, _, _ = at(bounds, np.zeros(1), np.zeros(1), np.zeros((2, 1)), np.ones(1), most=2.0)
    assert scale == pytest.approx(1.0 - reach, abs=1e-6)


# A rod through a wall, of which MuJoCo finds no contact; and two ellipsoids that are 36 mm apart, or 92 mm by MuJoCo
# after two steps of its solver.
MISTAKEN = """
<mujoco><option ccd_iterations="2"/><worldbody>
  <geom type="box" size=".013 .51 .473"/>
  <body pos="-.005 -.074 -.021" quat="-.331 -.481 -.711 -.392"><joint name="rod" type="slide" range="-1 1"/>
    <geom type="capsule" size=".18426 .71865"/></body>
  <geom type="ellipsoid" size=".1 .3 .2" euler="-54 79 -24" pos="5 0 0"/>
  <body pos="5 0 .6" euler="-71 23 76"><joint name="egg" type="slide" range="-1 1"/>
    <geom type="ellipsoid" size=".3 .1 .2"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(("name", "apart"), [("rod", -0.18), ("egg", 0.0358)])
def test_a_distance_that_mujoco_finds_too_large_proves_no_more_than_is_so(name, apart):
    model = mujoco.MjModel.from_xml_string(MISTAKEN)
    arm = Arm.of(model, mujoco.MjData(model), [name])
    bounds = ClearanceBounds(arm, [(np.zeros(1, int), np.ones(1))])
    for cutoff in (0.2, max(apart, 0.001)):
        assert bounds.least(*np.zeros((2, 1, 1)), np.zeros((1, 2, 1)), cutoff)[0] <= apart


def test_boxes_are_in_contact_where_mujoco_lets_them_push_each_other():
    """They are 222 mm apart; MuJoCo takes the largest distance along one of their normals, 189 mm, in the margin."""
    one = '<geom type="box" size=".1 .1 .1" margin=".1"/>'
    other = f'<body pos=".32 .26 .34" euler="40 59 85"><joint type="slide" range="-1 1"/>{one}</body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{one}{other}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.nefc > 0
    bounds = ClearanceBounds(Arm.of(model, data, [model.joint(0).name]), [(np.zeros(1, int), np.ones(1))])
    assert bounds.least(*np.zeros((2, 1, 1)), np.zeros((1, 2, 1)), 0.1)[0] <= 0.0


def test_a_floor_does_not_end():
    ball = '<body pos="9000 0 1"><joint type="slide" range="-2 2"/><geom size=".1"/></body>'
    floor = '<mujoco><worldbody><geom type="plane" size="1 1 1"/>'
    model = mujoco.MjModel.from_xml_string(f"{floor}{ball}</worldbody></mujoco>")
    arm = Arm.of(model, mujoco.MjData(model), [model.joint(0).name])
    bounds, still = ClearanceBounds(arm, [(np.zeros(1, int), np.ones(1))]), np.zeros((1, 1))
    assert bounds.least(still, still + 0.5, np.zeros((1, 2, 1)), 2.0)[0] == pytest.approx(0.4)


HILLS = """
<mujoco><asset><hfield name="ground" nrow="9" ncol="9" size="1 1 .3 .01" elevation="{heights}"/></asset><worldbody>
  <geom type="hfield" hfield="ground"/>
  <body pos="0 0 .25"><joint type="slide" axis="1 0 0" range="-1 1"/><geom size=".05"/></body>
</worldbody></mujoco>"""


def test_a_height_field_is_not_convex():
    """Between hills of 0.3 m a ball at a height of 0.25 m is far from the ground, and runs into the next hill."""
    heights = " ".join("1" if column % 4 == 0 else "0" for _ in range(9) for column in range(9))
    model = mujoco.MjModel.from_xml_string(HILLS.format(heights=heights))
    arm = Arm.of(model, mujoco.MjData(model), [model.joint(0).name])
    bounds, collisions, largest = ClearanceBounds(arm, [(np.zeros(1, int), np.ones(1))]), Collisions(arm), 0.0
    for place in np.linspace(-0.6, 0.6, 13):
        for half in (0.01, 0.05, 0.2, 0.4):
            (least,), (there,), _ = bounds.least(*np.array([[[place]], [[half]]]), np.zeros((1, 2, 1)), 0.5)
            reached = collisions.clearance(np.linspace(place - half, place + half, 41)[:, None])
            assert least <= max(reached, 0.0) + 1e-9
            assert max(there, 0.0) == pytest.approx(max(collisions.clearance(np.full((1, 1), place)), 0.0), abs=1e-9)
            largest = max(largest, float(least))
    assert largest > 0.1


def test_the_nearest_of_many_hills_counts_however_far_one_looks():
    """Within 3 m there are 3,200 prisms, of which MuJoCo looks at 50; the ball is 0.2 m over a plain with one peak."""
    heights = " ".join("1" if k == 820 else "0" for k in range(1600))
    hills = HILLS.replace('"9"', '"40"').replace("1 1 .3 .01", "1 1 .1 .01")
    model = mujoco.MjModel.from_xml_string(hills.format(heights=heights))
    collisions = Collisions(Arm.of(model, mujoco.MjData(model), [model.joint(0).name]))
    near, far = (collisions.distances([0.0], cutoff).distance for cutoff in (0.2, 3.0))
    assert far == pytest.approx(near)
    assert 0.09 < far < 0.11
