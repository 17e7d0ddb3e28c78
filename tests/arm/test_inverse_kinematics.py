"""Inverse kinematics: few steps, near the start, to the limits; `test_arm.py` has its messages."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

import lieednn_sim as ls
from lieednn_sim.arm import Arm, TaskSpaceRegion, ik_candidates
from lieednn_sim.arm.inverse_kinematics import _Search
from lieednn_sim.errors import NoSolutionError


@pytest.fixture(scope="module", params=["telescopic_compound", "telescopic_crane", "telescopic_pr", "telescopic_rrp"])
def arm(request):
    return Arm.load(request.param)


def test_a_solution_takes_few_steps(arm, monkeypatch):
    """Convergence is quadratic: with turning, sliding, ball and dependent joints, and the slopes of regions."""
    steps, evaluate, taken = [], _Search._evaluate, []
    monkeypatch.setattr(_Search, "_evaluate", lambda search: steps.append(1) or evaluate(search))
    for seed in range(5):
        pose = arm.link_poses(ls.draw_target(arm, seed))[-1]
        region = TaskSpaceRegion(pose, np.zeros(6), np.zeros(6))
        steps.clear()
        found = [ls.solve_ik(arm, pose.translation, pose.rotation)]
        taken.append(len(steps))
        found += ik_candidates(arm, region)
        assert max(np.max(region.distance(arm.link_poses(q)[-1])) for q in found) < 2e-6
    assert np.median(taken) <= 8
    assert len(steps) <= 32 * 12


def test_of_many_solutions_one_that_is_near_the_start_is_found():
    """Against SciPy's nearest one, from there."""
    arm, excess = Arm.load("telescopic_compound"), []
    home = arm.keyframe("home")
    for seed in range(5):
        pose = arm.link_poses(ls.draw_target(arm, seed))[-1]
        region = TaskSpaceRegion(pose, np.zeros(6), np.zeros(6))
        found = ls.solve_ik(arm, pose.translation, pose.rotation)
        nearest = scipy.optimize.minimize(
            lambda q: np.square((q - home) / arm.ranges).sum(),
            found,
            jac=lambda q: 2.0 * (q - home) / arm.ranges**2,
            bounds=arm.position_limits,
            constraints={
                "type": "eq",
                "fun": lambda q, region=region: region.excess(arm.link_poses(q)[-1]),
                "jac": lambda q, region=region: region.excess_slopes(arm.link_poses(q)[-1]) @ arm.jacobian(q),
            },
        )
        assert nearest.success
        excess.append(np.linalg.norm((found - home) / arm.ranges) / np.sqrt(nearest.fun) - 1.0)
    assert max(excess) < 0.03


def test_poses_at_the_limits_of_joints_are_reached(arm):
    """A third of the coordinates at a limit, and ball joints at their largest angles."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        at = np.where(
            rng.random(arm.n_joints) < 0.33,
            arm.position_limits[:, rng.integers(2)],
            rng.uniform(*arm.position_limits.T),
        )
        q = arm.within_angles(at)
        if arm.near_contacts(q) or arm.limit_excess(q).max() > 0.0:
            continue
        pose = arm.link_poses(q)[-1]
        arm.check_reachable(ls.solve_ik(arm, pose.translation, pose.rotation))


def test_what_is_far_away_is_refused_at_a_joint_limit(gantry):
    """Though the damping grows with the squared error."""
    with pytest.raises(NoSolutionError, match=r"found is 998 m away, with 'x' at the limit$"):
        ls.solve_ik(gantry, [1000.0, 0.0, 0.0])
