"""Links of three hinges: a pose has two postures, a way of poses one branch, and some postures have no pose alone."""

from dataclasses import replace

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.kinematics import least_singular_value
from lieednn_sim.arm.singularities import NEARLY_SINGULAR, singularity_margin
from lieednn_sim.environments.expert import planned
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.planning import default_planner, plan

WRIST = """
<mujoco><compiler angle="radian"/><worldbody><body name="shoulder"><joint name="lift" axis="0 1 0" range="-1 1"/>
  <geom size=".02"/><body pos=".4 0 0"><joint name="roll" range="-3 3"/><geom size=".02"/>
    <body><joint name="bend" axis="0 1 0" range="-1.5 1.5"/><geom size=".02"/>
      <body name="hand"><joint name="turn" range="-3 3"/><geom size=".02" pos=".1 0 .1"/></body></body></body></body>
  </worldbody>
  <keyframe><key name="home" qpos="0 .3 {bend} .2"/></keyframe></mujoco>
"""


def wrist(bend):
    arm = Arm.from_spec(mujoco.MjSpec.from_string(WRIST.format(bend=bend)), links=["shoulder", "hand"], floor="none")
    return arm


def test_a_way_of_states_is_followed_on_the_branch_on_which_it_begins():
    """A wrist has two postures for each pose, (a, b, c) and (a + pi, -b, c + pi); the way is on the one off home."""
    arm, s = wrist(0.8), np.linspace(0.0, 1.0, 300)[:, None]
    way = (1.0 - s) * [0.1, 0.3, 0.9, 0.2] + s * [0.5, 2.9, 0.2, -2.8]
    for ends in (way, way * [1.0, 1.0, -1.0, 1.0], way[::-1]):
        xi = arm.encode(ends)
        rates = np.gradient(ends, axis=0)
        xi_dot = (arm.encode(ends + 1e-6 * rates) - arm.encode(ends - 1e-6 * rates)) / 2e-6
        found = arm.decode(xi, xi_dot, start=ends[0])
        np.testing.assert_allclose(found.q, ends, atol=1e-9)
        np.testing.assert_allclose(found.qd, rates, atol=1e-6)
        # Several ways side by side.
        pair = arm.decode(np.stack([xi, xi], axis=1), start=ends[0])
        np.testing.assert_allclose(pair.q[:, 1], ends, atol=1e-9)
        # From guesses, those next to them.
        guessed = arm.decode(xi, xi_dot, start=ends + 1e-2)
        np.testing.assert_allclose(guessed.q, ends, atol=1e-9)
        np.testing.assert_allclose(guessed.qd, rates, atol=1e-6)
    with pytest.raises(InputError, match="start must have shape"):
        arm.decode(xi, start=ends[1:])
    assert np.abs(arm.decode(arm.encode(way * [1.0, 1.0, -1.0, 1.0])).q[:, 2] + way[:, 2]).max() > 0.1


def test_postures_that_poses_hardly_tell_apart_are_known_by_the_least_singular_value():
    rng = np.random.default_rng(1)
    jacobian = rng.normal(size=(500, 12, 3))
    jacobian[:, :, 2] = jacobian[:, :, 0] + rng.uniform(0.0, 0.5, (500, 1)) * jacobian[:, :, 2]
    least, share = least_singular_value(jacobian) / NEARLY_SINGULAR, singularity_margin(jacobian)
    vague = least < 1.0
    assert 50 < vague.sum() < 450
    np.testing.assert_allclose(share[vague], least[vague], rtol=1e-12)
    assert (share[~vague] >= 1.0).all()


@pytest.mark.parametrize(("seed", "count"), [(0, 300), (1, 600), (3, 600)])
def test_a_way_past_aligned_hinges_goes_straight_on(seed, count):
    """Poses a hair beside a way through bend = 0, where the pose tells roll + turn alone: to stay on them exactly both
    would turn about by half a turn at once, or by large angles there and back."""
    arm, s = wrist(0.8), np.linspace(0.0, 1.0, count)[:, None]
    start, end = np.array([0.1, 0.3, 0.9, 0.2]), np.array([0.5, 1.4, -0.6, -0.9])
    share = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    way = start + share * (end - start)
    aside = 3e-4 * np.random.default_rng(seed).normal(size=(2, 6))
    xi = arm.encode(way)
    xi[:, 1] += np.sin(np.pi * s) ** 2 * aside[0] + np.sin(3.0 * np.pi * s) ** 2 * aside[1]
    rates = np.gradient(xi, axis=0)
    found = arm.decode(xi, rates, start=start)
    np.testing.assert_allclose(found.q[[0, -1]], [start, end], atol=1e-8)
    assert np.abs(found.q - way).max() < 0.008
    # As fast and as smooth as the way itself, up to a little.
    np.testing.assert_allclose(np.diff(found.q, 2, axis=0), np.diff(way, 2, axis=0), atol=20.0 / count**2)
    np.testing.assert_allclose(found.qd[2:-2], np.gradient(found.q, axis=0)[2:-2], atol=0.01 / count)
    assert found.gap_rotation.max() < 2e-3
    # Where the hinges are well bent the poses are met as well as they can be: no posture beside is nearer.
    for k in np.flatnonzero(np.abs(way[:, 2]) > 0.25)[::20]:
        np.testing.assert_allclose(arm.decode(xi[k : k + 1], start=found.q[k]).q[0], found.q[k], atol=1e-9)


def test_links_whose_pose_does_not_tell_their_joints_apart_are_told_before_planning():
    def told(bend):
        return [note for note in wrist(bend).import_report.notes if note.startswith("link 2: ")]

    (note,) = told(0.0)  # roll and turn are about one line
    assert note.startswith("link 2: 64 of 64 straight paths from home pass near configurations at which its pose")
    assert "does not determine roll, bend, turn" in note
    # From a bent wrist only ways to the other side pass there.
    (note,) = told(0.9)
    assert 10 < int(note.split()[2]) < 54
    assert default_planner(wrist(0.9)) == ("lieednn-shaped", "the default where three or more hinges move a link")


def test_the_other_posture_with_the_same_poses_is_not_the_target():
    arm = wrist(0.8)
    beyond, other = [0.1, 1.5, -0.6, -0.5], [0.1, 1.5 - np.pi, 0.6, np.pi - 0.5]
    assert np.abs(arm.encode(beyond) - arm.encode(other)).max() < 1e-12
    with pytest.raises(
        PlanError,
        match=r"another configuration with the target's poses: joint '(roll' at -1.64|turn' at 2.64)",
    ):
        plan(arm, beyond, planner="linear-attractor")
    assert plan(arm, [0.1, 0.5, 0.6, 0.4], planner="linear-attractor").motion.q[-1] == pytest.approx(
        [0.1, 0.5, 0.6, 0.4]
    )


def test_an_expert_has_the_default_planner_of_such_an_arm():
    arm = replace(wrist(0.8), velocity_limits=np.ones(4), acceleration_limits=np.full(4, 5.0))
    motion, certificate = planned(arm, [0.1, 0.5, 0.6, 0.4])
    assert motion(motion.x[-1]) == pytest.approx([0.1, 0.5, 0.6, 0.4], abs=1e-6)
    assert certificate.startswith("globally stable")


@pytest.mark.parametrize("target", [[0.549, 1.663, 0.041, -1.157], [-0.81, 0.034, 0.052, -1.268]])
def test_joints_that_settle_after_their_poses_do_not_swing(target):
    """Near bend = 0 the pose hardly tells roll from turn; a spline through them swung by 30 to 300 rad at the end."""
    motion = plan(wrist(0.9), target, planner="lieednn-shaped", duration=10.0, seed=5).motion
    np.testing.assert_allclose(motion.q[-1], target, atol=1e-6)
    assert np.abs(motion.q).max() < 1.8
    assert np.abs(motion.qd).max() < 1.0
