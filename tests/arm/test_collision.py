"""Collision distances: against MuJoCo's contacts and its measuring of every pair, and derivatives numerically."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.errors import InputError

ARMS = {
    "poles": Arm.load("telescopic_pr", "poles", 3),
    "shelf": Arm.load("telescopic_compound", "shelf", 1),
    "window": Arm.load("telescopic_rrp", "window", 2),
}
COLLISIONS = {scene: Collisions(arm) for scene, arm in ARMS.items()}
SEEDS = st.integers(0, 2**32 - 1)


def posture(arm, seed):
    low, high = arm.position_limits.T
    q = np.random.default_rng(seed).uniform(low, high)
    for ball in arm.space.balls:
        q[ball] *= min(1.0, high[ball[0]] / np.linalg.norm(q[ball]))
    return q


def placed(arm, q):
    data = mujoco.MjData(arm.model)
    data.qpos[:] = arm.qpos(q)
    mujoco.mj_kinematics(arm.model, data)
    return data


@pytest.mark.parametrize("scene", ARMS)
@given(seed=SEEDS)
@settings(max_examples=12)
def test_a_posture_has_contacts_exactly_when_its_clearance_is_negative(scene, seed):
    arm, collisions = ARMS[scene], COLLISIONS[scene]
    q = posture(arm, seed)
    touching = bool(arm.contacts(q))
    assert (collisions.clearance(q) < 0.0) == touching
    assert collisions.is_free(q) != touching


@pytest.mark.parametrize("scene", ARMS)
@given(first=SEEDS, last=SEEDS, count=st.sampled_from([1, 7, 40]))
@settings(max_examples=6)
def test_the_least_along_a_path_is_that_of_all_its_postures(scene, first, last, count):
    arm, collisions = ARMS[scene], COLLISIONS[scene]
    path = np.linspace(posture(arm, first), posture(arm, last), count)
    # How deep geoms are in each other MuJoCo finds to a micrometre, which depends on how far it is asked to look.
    assert collisions.clearance(path) == pytest.approx(min(map(collisions.clearance, path)), abs=2e-6)


@pytest.mark.parametrize("before", [True, False])
def test_the_least_along_a_path_sees_what_turns_on_the_spot(before, tmp_path):
    """A bar about its middle comes upon a ball and is past it; the ball's id is below the bar's, or above it.

    All the while another ball is near the middle, 25 cm off.
    """
    ball = '<geom size="0.1" pos="0 0.95 0"/><geom size="0.1" pos="0 0 0.4"/>'
    bar = """<body><joint name="a" axis="0 0 1" range="-180 180"/><geom type="box" size="1 0.05 0.05"/>
      <site name="tool" pos="1 0 0"/></body>"""
    path = tmp_path / "bar.xml"
    path.write_text(f"<mujoco><worldbody>{ball + bar if before else bar + ball}</worldbody></mujoco>")
    collisions = Collisions(Arm.load(path, floor="none"))
    turn = np.deg2rad(np.arange(0.0, 136.0, 3.0))[:, None]
    # At right angles they are deepest: the face of the bar is 5 cm and that of the ball 10 cm from the ball's middle.
    assert collisions.clearance(turn) == pytest.approx(-0.15, abs=1e-3)
    assert collisions.clearance(turn[:10]) == pytest.approx(0.25)


def test_the_least_along_a_path_is_right_where_depths_jump(tmp_path):
    """By MuJoCo's measure that of a capsule in a box grows by more than the capsule moves."""
    capsule = '<joint type="slide" axis="1 0 0" range="-1 1"/><geom type="capsule" size="0.05 0.3"/><site name="tool"/>'
    body = f'<geom type="box" size="0.3 0.1 0.05"/><body euler="0 45 0">{capsule}</body>'
    (tmp_path / "capsule.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    collisions, path = Collisions(Arm.load(tmp_path / "capsule.xml", floor="none")), np.linspace(0.0, 0.5, 101)[:, None]
    assert collisions.clearance(path) == pytest.approx(min(map(collisions.clearance, path)), abs=2e-6)


@pytest.mark.parametrize("scene", ARMS)
@given(seed=SEEDS, cutoff=st.sampled_from([0.02, 0.1]))
@settings(max_examples=5)
def test_the_bounds_leave_out_no_pair(scene, seed, cutoff):
    arm, collisions = ARMS[scene], COLLISIONS[scene]
    q = posture(arm, seed)
    data = placed(arm, q)
    every = np.array([mujoco.mj_geomDistance(arm.model, data, *pair, 5.0, None) for pair in collisions.pairs.tolist()])
    found = collisions.distances(q, cutoff)
    np.testing.assert_allclose(found.distance, np.sort(every[every < cutoff]), atol=1e-12)
    each = np.random.default_rng(seed).uniform(0.0, 2.0 * cutoff, len(every)) + 1e-6
    found = collisions.distances(q, each)
    order = np.argsort(every, kind="stable")
    order = order[(every < each)[order]]
    np.testing.assert_allclose(found.distance, every[order], atol=1e-12)
    np.testing.assert_array_equal(found.pairs, collisions.pairs[order])
    nearest = collisions.clearance(q)
    assert nearest == pytest.approx(every.min(), abs=1e-12)
    margin = nearest + 1e-6
    assert not collisions.is_free(q, margin)
    assert collisions.is_free(q, nearest - 1e-6)


@pytest.mark.parametrize("scene", ARMS)
@given(seed=SEEDS)
@settings(max_examples=5)
def test_derivatives_agree_with_finite_differences(scene, seed):
    arm, collisions = ARMS[scene], COLLISIONS[scene]
    q = posture(arm, seed)
    way = np.random.default_rng(seed).normal(size=arm.n_joints)
    found = collisions.distances(q, 0.15)
    apart = found.distance > 1e-3
    h = 1e-6
    sides = []
    for sign in (-1.0, 1.0):
        data = placed(arm, q + sign * h * way)
        sides.append([mujoco.mj_geomDistance(arm.model, data, *pair, 5.0, None) for pair in found.pairs.tolist()])
    # Where two features are equally near the distance has a kink: both one-sided slopes bound the derivative.
    down, up = (np.array(side) - found.distance for side in sides)
    slopes = np.sort(np.stack([-down / h, up / h]), axis=0)
    exact = found.jacobian @ way
    tolerance = 2e-3 * np.linalg.norm(way)
    assert (exact >= slopes[0] - tolerance)[apart].all()
    assert (exact <= slopes[1] + tolerance)[apart].all()


@pytest.mark.parametrize("gap", [0.04, 1e-5, -1e-5, -0.03])
def test_a_ball_over_the_floor_comes_off_it_as_it_is_lifted(gap, gantry):
    """Also where it is just off, or in the floor."""
    found = Collisions(gantry).distances([0.3, -0.2, gap - 0.9, 0.5], 0.05)
    assert found.distance == pytest.approx([gap])
    np.testing.assert_allclose(found.jacobian, [[0.0, 0.0, 1.0, 0.0]], atol=1e-9)


@pytest.mark.parametrize("scene", ARMS)
def test_parts_of_the_arm_may_be_nearer_to_each_other_than_to_all_else(scene):
    arm, collisions = ARMS[scene], COLLISIONS[scene]
    data, q = placed(arm, arm.keyframe("home")), arm.keyframe("home")
    every = np.array([mujoco.mj_geomDistance(arm.model, data, *pair, 5.0, None) for pair in collisions.pairs.tolist()])
    own, other = every[collisions.own].min(), every[~collisions.own].min()
    for beyond_own, beyond_other in ((-1e-6, -1e-6), (1e-6, -1e-6), (-1e-6, 1e-6)):
        free = collisions.is_free(q, other + beyond_other, own=own + beyond_own)
        assert free == (beyond_own < 0.0 and beyond_other < 0.0)


def test_the_pairs_are_those_that_mujoco_lets_collide():
    names = {frozenset(COLLISIONS["poles"].names(pair)) for pair in COLLISIONS["poles"].pairs}
    assert frozenset({"floor", "link4_collision_palm"}) in names
    assert frozenset({"obstacle_pole0", "link4_collision_palm"}) in names
    # Neither things that stand still, nor what the model excludes, nor what only shows.
    assert frozenset({"obstacle_pole0", "floor"}) not in names
    assert frozenset({"link2_collision_tube", "link3_carrier_collision_tube"}) not in names
    assert not any("foot" in name for pair in names for name in pair)
    own = {frozenset(COLLISIONS["poles"].names(p)) for p in COLLISIONS["poles"].pairs[COLLISIONS["poles"].own]}
    assert not any("obstacle" in name or name == "floor" for pair in own for name in pair)
    assert own


def test_refusals_say_why():
    collisions = COLLISIONS["poles"]
    with pytest.raises(InputError, match="cutoff must be positive, got 0"):
        collisions.distances(ARMS["poles"].keyframe("home"), 0.0)
    with pytest.raises(InputError, match=r"q must have shape \(\.\.\., 8\)"):
        collisions.clearance(np.zeros(3))
    with pytest.raises(InputError, match="arm must be an Arm, got 'telescopic_pr'"):
        Collisions("telescopic_pr")


def test_what_has_nothing_to_collide_with_is_infinitely_clear(tmp_path, two_hinges):
    (tmp_path / "arm.xml").write_text(two_hinges)
    assert Collisions(Arm.load(tmp_path / "arm.xml", floor="none")).clearance([0.0, 0.0]) == np.inf
