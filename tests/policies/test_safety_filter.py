"""The filter: limits and clearance kept whatever is wanted, and what is said when it blocks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.errors import InputError
from lieednn_sim.policies import FilterOptions, SafetyFilter, safety_filter
from lieednn_sim.policies.bounds import ApproachBounds, fastest

POLES = Arm.load("telescopic_pr", "poles", 0)
SPATIAL = Arm.load("telescopic_compound")
SEEDS = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("arm", [POLES, SPATIAL], ids=lambda arm: arm.name)
@given(seed=SEEDS)
@settings(max_examples=3)
def test_no_wanted_velocity_breaks_a_limit_or_touches(arm, seed):
    """Adversarial: full speed in a random direction, changed every 0.3 s; what is wanted never settles."""
    rng = np.random.default_rng(seed)
    filter_ = SafetyFilter(arm, 0.01)
    q, v = arm.keyframe("home"), np.zeros(arm.n_joints)
    filter_.allow(q)
    for k in range(120):
        if k % 30 == 0:
            wanted = 3.0 * arm.velocity_limits * rng.choice([-1.0, 1.0], arm.n_joints)
        step = filter_.step(q, v, wanted)
        assert (np.abs(step.velocity) <= arm.velocity_limits + 1e-12).all()
        assert (np.abs(step.velocity - v) <= 0.01 * arm.acceleration_limits + 1e-9).all()
        q, v = q + 0.005 * (v + step.velocity), step.velocity
        assert arm.limit_excess(q).max() <= 1e-6
        assert filter_.clearance.collisions.is_free(q)


def test_bad_settings_and_positions_that_touch_are_refused():
    with pytest.raises(InputError, match="margin must be positive, got 0"):
        FilterOptions(margin=0.0)
    folded = np.array([0.0, 0.0, -0.6, 0.45, 0.0, 0.4, -1.0, 0.3])
    with pytest.raises(InputError, match=r"touches '.*' at the start"):
        SafetyFilter(POLES, 0.01).allow(folded)


@pytest.mark.parametrize("arm", [POLES, Arm.load("telescopic_compound", "window", 0)], ids=lambda arm: arm.name)
@given(seed=SEEDS)
@settings(max_examples=5)
def test_no_pair_approaches_faster_than_its_bound(arm, seed):
    rng = np.random.default_rng(seed)
    low, high = arm.position_limits.T
    q = arm.keyframe("home") + 0.1 * rng.uniform(-1.0, 1.0, arm.n_joints) * (high - low)
    collisions, speeds = Collisions(arm), rng.uniform(0.1, 1.0, arm.n_joints)
    near = collisions.distances(q, 0.5)
    bounds = dict(zip(map(tuple, collisions.pairs), ApproachBounds(arm, collisions.pairs)(q, speeds), strict=True))
    most = np.abs(near.jacobian) @ speeds
    allowed = np.array([bounds[tuple(pair)] for pair in near.pairs])
    assert (most <= allowed + 1e-9).all()
    assert not len(most) or (most > 0.2 * allowed).any(), "the bounds say nothing"


def test_pairs_left_out_change_no_step(monkeypatch):
    rng = np.random.default_rng(0)
    home = POLES.keyframe("home")
    few, all_of_them = SafetyFilter(POLES, 0.01), SafetyFilter(POLES, 0.01)
    monkeypatch.setattr(all_of_them.clearance, "needed", lambda *_: all_of_them.clearance.cutoffs)
    q, v = home, np.zeros(POLES.n_joints)
    for k in range(120):
        if k % 30 == 0:
            wanted = POLES.velocity_limits * rng.choice([-1.0, 1.0], POLES.n_joints)
        step, full = few.step(q, v, wanted), all_of_them.step(q, v, wanted)
        np.testing.assert_allclose(step.velocity, full.velocity, atol=1e-9)
        assert step.blocking == full.blocking
        q, v = q + 0.005 * (v + step.velocity), step.velocity


def test_velocities_from_which_joints_can_brake_by_hand(gantry):
    """Limits of speed 1, 2, 4, 8 and of acceleration 10, 20, 40, 80, steps of 0.02 s."""
    filter_ = SafetyFilter(gantry, 0.02)
    h, a = 0.02, gantry.acceleration_limits
    distance, old = np.array([0.05, 0.1, 0.02, 0.5]), np.array([0.9, -1.0, 1.2, 7.0])
    most = fastest(distance - 0.5 * h * old, a, h)
    np.testing.assert_allclose(most**2 / (2.0 * a) + 0.5 * h * (old + most), distance, rtol=1e-12)
    # Where the next step leads beyond it: back to the limit within the step.
    assert fastest(0.001 - 0.01 * 0.3, 10.0, h) == pytest.approx(-0.2)
    # x brakes for its limit, y for its speed, z is at rest in the middle and turn is as fast as it may be.
    low, high, of_position = filter_._bounds(np.array([0.99, 0.0, 0.5, 0.0]), np.array([0.5, 1.9, 0.0, 8.0]))
    at_limit = fastest(0.01 - 0.01 * 0.5, 10.0, h)
    np.testing.assert_allclose(high, [max(at_limit, 0.5 - 0.2), 2.0, 0.8, 8.0])
    np.testing.assert_allclose(low, [0.3, 1.5, -0.8, 6.4])
    assert of_position.tolist() == [[False] * 4, [True, False, False, False]]


def test_the_filter_leaves_what_is_allowed_and_names_the_limit_that_is_not(gantry):
    filter_ = SafetyFilter(gantry, 0.02)
    home = gantry.keyframe("home")
    filter_.allow(home)
    # The nearest to the wanted and, by a weight of 0.05, to the present velocity.
    old, wanted = np.array([0.1, 0.0, 0.0, 0.0]), np.array([0.2, 0.3, -0.4, 0.5])
    step = filter_.step(home, old, wanted)
    np.testing.assert_allclose(step.velocity, (wanted + 0.05 * old) / 1.05, atol=1e-9)
    assert (step.braked, step.blocking) == (False, ())
    near = np.array([0.997, 0.0, 0.0, 0.0])
    step = filter_.step(near, np.zeros(4), np.array([1.0, 0.0, 0.0, 0.0]))
    distance = filter_.position_limits[0, 1] - 0.997
    assert step.velocity[0] ** 2 / 20.0 + 0.01 * step.velocity[0] == pytest.approx(distance)
    assert step.blocking == ("the position limit of joint 'x'",)
    # Limits are drawn in by what turns round within a step: a h^2 / 4, but not beyond what shall be reached.
    np.testing.assert_allclose(
        filter_.position_limits[:, 1] - gantry.position_limits[:, 1], [-1e-3, -2e-3, -4e-3, -8e-3]
    )
    filter_.allow(np.array([0.9995, 0.0, 0.0, -3.0]))
    np.testing.assert_allclose(filter_.position_limits[[0, 0, 3], [0, 1, 0]], [-0.999, 0.9995, -3.0])


def test_an_arm_that_brakes_names_what_it_violates_the_worst_first(gantry, monkeypatch):
    """From 1 m/s it gets down to 0.8; the first wall asks for less than 0.95, the others for 0.25 and 0.1."""
    filter_ = SafetyFilter(gantry, 0.02)
    walls = np.array([0.3, 0.05, 0.02]), np.tile([-1.0, 0.0, 0.0, 0.0], (3, 1))
    monkeypatch.setattr(filter_.clearance, "values", lambda *_: walls)
    monkeypatch.setattr(filter_.clearance, "name", lambda row: f"wall {row}")
    step = filter_.step(np.zeros(4), np.array([1.0, 0.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]))
    assert step.velocity[0] == pytest.approx(0.8)
    assert step.braked
    assert step.blocking == ("wall 2", "wall 1")


# Beads on a rail: rail -> ball joint -> rail, with a post beside the first one. At home the gaps are as in the test.
BEADS = """
<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
  <geom name="post" size="0.05" pos="0 0.2 0"/>
  <body name="base"><geom size="0.01" contype="0" conaffinity="0"/><site name="base_frame"/>
    <body name="a"><joint name="a" type="slide" axis="1 0 0" range="-1 1"/><geom name="first" size="0.05"/>
      <body name="b"><joint name="b" type="ball" range="0 0.5"/>
        <geom size="0.01" mass="1" contype="0" conaffinity="0"/><site name="link1_frame"/>
        <body name="c"><joint name="c" type="slide" axis="1 0 0" range="-1 1"/>
          <geom name="near" size="0.05" pos="0.2 0 0"/><geom name="far" size="0.05" pos="0.5 0 0"/>
          <site name="link2_frame"/>
        </body></body></body></body>
</worldbody><keyframe><key name="home" qpos="0 1 0 0 0 0"/></keyframe></mujoco>"""


@pytest.fixture(scope="module")
def beads(tmp_path_factory):
    path = tmp_path_factory.mktemp("beads") / "beads.xml"
    path.write_text(BEADS)
    return Arm.from_xml(path, "beads")


def test_approach_bounds_by_hand(beads):
    """What turns counts by its reach and radius, what slides by 1, and what moves both geoms of a pair not at all."""
    post, first, near = (beads.model.geom(name).id for name in ("post", "first", "near"))
    bounds = ApproachBounds(beads, np.array([[post, first], [near, post], [first, near]]))
    for slid in (0.0, 0.75):
        turning, sliding = (0.2 + slid + 0.05) * (0.1 + 0.2 + 0.3), 2.0
        found = bounds(np.array([0.25, 0.0, 0.0, 0.0, slid]), np.array([0.5, 0.1, 0.2, 0.3, sliding]))
        np.testing.assert_allclose(found, [0.5, 0.5 + turning + sliding, turning + sliding], rtol=1e-12)


@pytest.mark.parametrize(("cutoff", "of_neighbours"), [(0.4, 0.04), (0.02, 0.02)])
def test_only_parts_of_the_arm_that_are_near_at_home_are_looked_at_from_nearer(beads, cutoff, of_neighbours):
    """Gaps of 0.1 m (first to near, post to first), 0.18 (post to near) and 0.4 (first to far)."""
    filter_ = SafetyFilter(beads, 0.01, FilterOptions(cutoff=cutoff))
    names = [set(filter_.clearance.collisions.names(pair)) for pair in filter_.clearance.collisions.pairs]
    assert len(names) == 5
    neighbours = [pair == {"first", "near"} for pair in names]
    assert sum(neighbours) == 1
    np.testing.assert_array_equal(filter_.clearance.cutoffs, np.where(neighbours, of_neighbours, cutoff))


@pytest.mark.parametrize(("angle", "limit"), [(0.0, 0.495), (0.3, 0.495), (0.498, 0.498), (0.5, 0.5)])
def test_the_angle_of_a_ball_joint_is_drawn_in_but_not_beyond_what_shall_be_reached(beads, angle, limit):
    filter_ = SafetyFilter(beads, 0.01)
    position = np.array([0.0, 0.0, 0.6 * angle, 0.8 * angle, 0.0])
    filter_.allow(position)
    np.testing.assert_allclose(filter_.angles.limits, [limit], atol=1e-15)


def test_pairs_are_looked_at_as_far_as_they_can_matter_by_hand(gantry):
    """The ball is moved by the slides and, around its own centre, by its radius of 0.1: rates of 7.8 and 0.78 m/s."""
    filter_ = SafetyFilter(gantry, 0.02, FilterOptions(cutoff=100.0))
    home, fast = np.zeros(4), gantry.velocity_limits
    # At full speed braking takes 0.1 s, and 1.1^2 0.1 / 0.3 is the longer time; at a tenth 1 / 5 + 0.02 is.
    longer = 1.21 * 0.1 / 0.3
    np.testing.assert_allclose(filter_.clearance.needed(home, home, fast), [0.01 + 7.8 * longer + 0.001])
    np.testing.assert_allclose(filter_.clearance.needed(home, home, 0.1 * fast), [0.01 + 0.78 * 0.22 + 0.001])
    np.testing.assert_allclose(filter_.clearance.needed(home, -fast, 0.1 * fast), [0.01 + 7.8 * longer + 0.001])
    np.testing.assert_allclose(SafetyFilter(gantry, 0.02).clearance.needed(home, home, fast), [0.4])


@pytest.mark.parametrize("flag", [0, -4])
def test_where_nothing_is_solved_the_arm_brakes_as_hard_as_it_may(gantry, monkeypatch, flag):
    filter_ = SafetyFilter(gantry, 0.02)
    monkeypatch.setattr(safety_filter.daqp, "solve", lambda *_, **__: (np.full(4, 0.7), 0.0, flag, {}))
    step = filter_.step(np.zeros(4), np.array([0.5, -1.0, 0.1, -8.0]), np.array([1.0, -2.0, 4.0, -8.0]))
    np.testing.assert_allclose(step.velocity, [0.3, -0.6, 0.0, -6.4], atol=1e-12)
    assert step.braked


def test_what_holds_the_arm_back_most_is_named_first(gantry):
    filter_ = SafetyFilter(gantry, 0.02)
    filter_.allow(gantry.keyframe("home"))
    # At the upper ends of x and y, and of the ball over the floor.
    q = np.array([*filter_.position_limits[:2, 1], -0.89, 0.0])
    names = [f"the position limit of joint {name!r}" for name in "xy"] + ["the clearance of 'floor' from 'ball'"]
    # Multipliers are what is wanted beyond, in shares of the limits, and over the floor a fourth of that.
    for shares, order in (
        ((0.2, 0.1, -0.05), [0, 1, 2]),
        ((0.1, 0.2, -0.05), [1, 0, 2]),
        ((0.01, 0.02, -0.2), [2, 1, 0]),
    ):
        step = filter_.step(q, np.zeros(4), np.array([*shares, 0.0]) * gantry.velocity_limits)
        assert step.blocking == tuple(names[j] for j in order)
