"""Scenes: obstacles that leave home free, named and repeatable, and targets that need a way around them."""

import copy

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.scenes import GOAL_PREFIX, HOME_CLEARANCE
from lieednn_sim.arm.targets import OWN_CLEARANCE, TARGET_CLEARANCE, draw_target
from lieednn_sim.registry import SCENES

BARE = {name: Arm.load(name) for name in arm_names()}
CASES = [(name, scene) for name in BARE for scene in SCENES if scene != "free"]


def obstacles(arm):
    return [g for g in range(arm.model.ngeom) if arm.model.geom(g).name.startswith("obstacle_")]


@pytest.mark.parametrize("name", BARE)
def test_home_is_free_and_targets_are_behind_the_obstacles(name):
    blocked, cases = 0, [(scene, seed) for scene in SCENES if scene != "free" for seed in range(3)]
    for scene, seed in cases:
        arm = BARE[name].with_scene(scene, seed)
        collisions, home = Collisions(arm), arm.keyframe("home")
        assert collisions.is_free(home, HOME_CLEARANCE, own=0.0)
        target = draw_target(arm, seed)
        assert collisions.is_free(target, TARGET_CLEARANCE, own=OWN_CLEARANCE)
        assert arm.limit_excess(target).max() <= 0.0
        tip = arm.link_poses(target).translation[-1]
        assert any(inside(arm, site, tip) for site in goals(arm))
        ways = home + np.linspace(0.0, 1.0, 40)[:, None] * (target - home)
        blocked += not all(collisions.is_free(q) for q in ways)
        np.testing.assert_array_equal(home, BARE[name].keyframe("home"))
    assert 0 < blocked < len(cases), "neither trivial nor hopeless on the straight way"


def goals(arm):
    return [site for site in range(arm.model.nsite) if arm.model.site(site).name.startswith(GOAL_PREFIX)]


def inside(arm, site, point):
    data = mujoco.MjData(arm.model)
    mujoco.mj_kinematics(arm.model, data)
    local = data.site_xmat[site].reshape(3, 3).T @ (point - data.site_xpos[site])
    return bool((np.abs(local) <= arm.model.site_size[site] + 2e-3).all())


@pytest.mark.parametrize(("name", "scene"), CASES)
def test_obstacles_are_named_solid_and_repeatable(name, scene):
    arm, again, other = (BARE[name].with_scene(scene, seed) for seed in (4, 4, 5))
    model = arm.model
    assert model.body(f"obstacle_{scene}").id > 0
    for geom in obstacles(arm):
        # The wall is drawn as one, and its panels are not.
        assert model.geom_group[geom] == (3 if model.geom(geom).name.startswith("obstacle_wall_") else 2)
        assert model.mat(model.geom_matid[geom]).name.startswith("obstacle_")
    assert any(model.geom_contype[geom] for geom in obstacles(arm))
    np.testing.assert_array_equal(model.geom_pos, again.model.geom_pos)
    np.testing.assert_array_equal(model.geom_size, again.model.geom_size)
    assert not np.array_equal(
        model.geom_pos[obstacles(arm)], other.model.geom_pos[obstacles(other)][: len(obstacles(arm))]
    )
    np.testing.assert_array_equal(draw_target(arm, 7), draw_target(again, 7))


def test_the_wall_that_is_seen_is_the_wall_that_is_hit():
    arm = BARE["telescopic_pr"].with_scene("window", 4)
    model = copy.copy(arm.model)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    body = model.body("obstacle_window").id
    panels = [g for g in obstacles(arm) if model.geom(g).name.startswith("obstacle_wall_")]
    model.geom_group[:] = 5
    model.geom_group[panels], model.geom_group[model.geom("obstacle_wall").id] = 0, 1
    reach = 1.1 * (np.abs(model.geom_pos[panels]) + model.geom_size[panels]).max(axis=0)
    frame, origin = data.xmat[body].reshape(3, 3), data.xpos[body]
    rng, hit = np.random.default_rng(0), []
    for _ in range(200):
        place = rng.uniform((-0.5, -reach[1], 0.0), (-0.5, reach[1], reach[2]))
        heading = frame @ np.array([1.0, *rng.uniform(-0.05, 0.05, 2)])
        sight = model, data, origin + frame @ place, heading
        distances = [mujoco.mj_ray(*sight, np.arange(6) == group, 1, -1, np.zeros(1, np.int32)) for group in (0, 1)]
        assert distances[0] == pytest.approx(distances[1], abs=1e-6)
        hit.append(distances[0] >= 0)
    assert 20 < sum(hit) < 180


def test_free_targets_keep_the_law_of_the_comparisons():
    arm = BARE["telescopic_pr"]
    rng = np.random.default_rng(5)
    low, high = arm.position_limits.T
    inset = 0.05 * (high - low)
    first = rng.uniform(low + inset, high - inset)
    while arm.contacts(first):
        first = rng.uniform(low + inset, high - inset)
    np.testing.assert_array_equal(draw_target(arm, 5), first)
    spatial = BARE["telescopic_compound"]
    assert np.abs(spatial.encode(draw_target(spatial, 5))).max() <= 0.8 + 1e-9
