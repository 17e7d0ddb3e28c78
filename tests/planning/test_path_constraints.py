"""Regions in which the end effector stays on its way."""

from __future__ import annotations

import re

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.planning import GuideOptions, PlanningProblem
from lieednn_sim.planning.goals import candidates
from lieednn_sim.planning.guides import _Search
from lieednn_sim.planning.path_constraints import outside, projected

from .arms import coarse


@pytest.fixture(scope="module")
def arm():
    return coarse()


@pytest.fixture(scope="module")
def start(arm):
    return ls.draw_target(arm, seed=3)


def turned_by(arm, q, held):
    """Angles ``(K,)`` [rad] of the end effector's orientation from a rotation, by the trace of the difference."""
    turned = arm.link_poses(q).as_matrix()[:, -1, :3, :3] @ held.as_matrix().T
    return np.arccos(np.clip(0.5 * (np.trace(turned, axis1=1, axis2=2) - 1.0), -1.0, 1.0))


def off_line(arm, q, first, last):
    """Distances ``(K,)`` [m] of the end effector from a line, by the cross product."""
    return np.linalg.norm(np.cross(arm.tip(q) - first, last - first), axis=1) / np.linalg.norm(last - first)


def test_a_line_with_an_orientation_is_kept_by_a_certified_network_also_when_retimed(arm, start):
    first, held = arm.tip(start), arm.link_poses(start)[-1].rotation
    last = first + np.array([0.25, -0.2, 0.15])
    region = ls.TaskSpaceRegion.line(first, last, held)
    goal = ls.TaskSpaceRegion.box(last, last)
    made = ls.plan(arm, goal, start=start, path_constraint=region, fastest=True)
    q = made.motion.q
    assert made.planner == "lieednn-shaped"
    assert made.network.certified
    assert off_line(arm, q, first, last).max() < 5e-4
    assert turned_by(arm, q, held).max() < np.deg2rad(0.1)
    np.testing.assert_allclose(arm.tip(q[-1]), last, atol=1e-5)
    assert np.linalg.norm(arm.tip(q[len(q) // 2]) - first) > 0.1
    # Without the region the way is another one.
    free = ls.plan(arm, q[-1], start=start).motion.q
    assert off_line(arm, free, first, last).max() > 5e-3
    assert made.motion.t[-1] < 3.0


def test_an_upright_hand_finds_its_way_among_obstacles():
    arm = coarse("telescopic_pr", "poles", 5)
    held, place = arm.link_poses(arm.keyframe("home"))[-1].rotation, arm.tip(ls.draw_target(arm, seed=5))
    region = ls.TaskSpaceRegion.orientation(held, np.deg2rad(5.0), axis=[0.0, 0.0, 1.0])
    made = ls.plan(arm, ls.TaskSpaceRegion.box(place, place), path_constraint=region)
    assert made.motion.t[-1] == 4.0
    assert made.guide.planner == "rrt-connect, optimised"
    # The direction of the world's z in the hand turns with the tilt alone.
    down = arm.link_poses(made.motion.q).as_matrix()[:, -1, 2, :3]
    tilt = np.arccos(np.clip(down @ held.as_matrix()[2], -1.0, 1.0))
    assert np.deg2rad(0.5) < tilt.max() < np.hypot(*np.deg2rad([5.1, 5.1]))
    with pytest.raises(InputError, match="planner 'minimum-jerk' cannot keep a region on the way; planners that can: "):
        ls.plan(arm, made.target, planner="minimum-jerk", path_constraint=region)


@pytest.mark.parametrize("kind", ["line", "orientation"])
@pytest.mark.usefixtures("own_names")
def test_every_motion_is_checked_with_how_far_it_leaves_the_region_and_when(arm, start, kind):
    here = arm.link_poses(start)[-1]
    if kind == "line":
        last = here.translation + np.array([0.0, 0.0, 0.2])
        region = ls.TaskSpaceRegion.line(here.translation, last)
        goal = ls.TaskSpaceRegion.box(last, last)
    else:
        region = ls.TaskSpaceRegion.orientation(here.rotation)
        goal = ls.TaskSpaceRegion.box(here.translation + 0.2, here.translation + 0.2)
    target = next(candidates(arm, goal, start, path_constraint=region))

    @ls.register_planner("careless")
    def careless(problem):
        assert problem.path_constraint is region
        return ls.plan(arm, problem.target, start=problem.start, planner="minimum-jerk").motion

    with pytest.raises(PlanError, match="outside the region to keep at t = ") as caught:
        ls.plan(arm, target, start=start, planner="careless", path_constraint=region)
    said = [float(number) for number in re.findall(r"([\d.e-]+) (?:mm|degrees) ", str(caught.value))[:2]]
    q = ls.plan(arm, target, start=start, planner="minimum-jerk").motion.q
    if kind == "line":
        assert said == pytest.approx([1e3 * off_line(arm, q, here.translation, last).max(), 0.0], rel=0.01)
    else:
        assert said == pytest.approx([0.0, np.rad2deg(turned_by(arm, q, here.rotation).max())], rel=0.01)


def test_a_straight_motion_that_stays_in_the_region_is_taken(arm, start):
    """In the middle of a slab, also where nothing moves at all."""
    height = arm.tip(start)[2]
    slab = ls.TaskSpaceRegion.box([-np.inf, -np.inf, height - 0.2], [np.inf, np.inf, height + 0.2])
    target = start + 0.1 * (arm.keyframe("home") - start)
    for end in (start, target):
        made = ls.plan(arm, end, start=start, path_constraint=slab)
        assert made.guide.planner == "minimum-jerk"
        np.testing.assert_allclose(made.motion.q[-1], end, atol=1e-6)


def test_a_path_that_is_searched_for_has_all_corners_in_the_region(arm, start):
    """A straight shortcut would lead out of it."""
    here = arm.link_poses(start)[-1]
    region = ls.TaskSpaceRegion.orientation(here.rotation)
    goal = ls.TaskSpaceRegion.box(here.translation + 0.2, here.translation + 0.2)
    problem = PlanningProblem(
        arm, start, next(candidates(arm, goal, start, path_constraint=region)), path_constraint=region
    )
    corners = _Search(problem, GuideOptions()).path(0)
    assert outside(arm, region, corners[1:-1]) < 1e-6


def test_ends_outside_the_region_are_refused(arm, start):
    here = arm.tip(start)
    region = ls.TaskSpaceRegion.box(here, here + 1.0)
    with pytest.raises(InputError, match="at the target the end effector is outside the region to keep: by "):
        ls.plan(arm, "home", start=start, path_constraint=region)
    beside = ls.TaskSpaceRegion.box(here + np.array([0.5, 0.0, 0.0]), here + 1.0)
    with pytest.raises(InputError, match=r"at the start the end effector is outside .*: by 500 mm and 0"):
        ls.plan(arm, "home", start=start, path_constraint=beside)


def test_projections_onto_a_region_keep_the_joint_limits(arm, start):
    region = ls.TaskSpaceRegion.line(arm.tip(start), arm.tip(arm.keyframe("home")))
    rng = np.random.default_rng(0)
    q = rng.uniform(*arm.position_limits.T, (50, arm.n_joints))
    found = projected(arm, q, region)
    assert arm.limit_excess(found).max() <= 1e-12
    off = off_line(arm, found, arm.tip(start), arm.tip(arm.keyframe("home")))
    assert np.mean(off < 1e-9) > 0.9
    np.testing.assert_array_equal(projected(arm, found[off < 1e-12], region), found[off < 1e-12])
