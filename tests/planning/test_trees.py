"""RRT-Connect with balanced trees in the plane, among walls that are looked up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.arm.collision import Collisions
from lieednn_sim.errors import PlanError
from lieednn_sim.planning import PLANNERS, RrtConnectOptions
from lieednn_sim.planning.baselines import sampling, trees
from lieednn_sim.planning.baselines.trees import connected
from lieednn_sim.planning.joint_space import ProblemClearance

from .test_planners import plan_with
from .test_rivals import POSTED, blocked

START, TARGET = np.array([0.05, 0.5]), np.array([0.9, 0.9])
seeds = st.integers(0, 2**32 - 1)


class World:
    """The unit square, solid left of 0.5 but for a passage around y = 0.5, which begins closed where it is so wide."""

    bounds, reach = np.array([[0.0, 1.0], [0.0, 1.0]]), 0.05

    def __init__(self, width: float, most: int = 100_000) -> None:
        self.width, self.most = width, most
        self.tested = list[np.ndarray]()
        self.accepted = 0

    def free(self, points: np.ndarray) -> np.ndarray:
        passage = np.abs(points[:, 1] - 0.5) < 0.5 * self.width
        return (points[:, 0] > 0.5) | passage | (np.linalg.norm(points - START, axis=1) < 1e-9)

    def clear(self, first: np.ndarray, second: np.ndarray) -> bool:
        self.tested.append(second)
        free = bool(self.free(first + np.linspace(0.0, 1.0, 200)[:, None] * (second - first)).all())
        self.accepted += free
        return free

    def path(self, seed: int, start: np.ndarray = START, target: np.ndarray = TARGET, **more) -> np.ndarray | None:
        world = {"bounds": self.bounds, "longest_edge": self.reach, "clear": self.clear, **more}
        return connected(start, target, **world, over=lambda: len(self.tested) >= self.most, seed=seed)


@given(seed=seeds, backwards=st.booleans())
@settings(max_examples=10)
def test_a_path_leads_from_start_to_target_over_clear_edges(seed, backwards):
    world = World(0.04)
    ends = (TARGET, START) if backwards else (START, TARGET)
    corners = world.path(seed, *ends)
    np.testing.assert_array_equal(corners[[0, -1]], ends)
    assert all(map(world.clear, corners[:-1], corners[1:]))
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    assert lengths.max() <= world.reach * (1.0 + 1e-9)
    assert lengths.min() > 0.0, "a corner is there twice"
    assert (np.abs(corners - 0.5) <= 0.5).all()


def test_the_same_seed_draws_the_same_path_and_another_one_another():
    first, again, other = (World(0.04).path(seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert first.shape != other.shape or not np.array_equal(first, other)


def test_the_straight_way_is_tried_first():
    world = World(2.0)
    np.testing.assert_array_equal(world.path(0), [START, TARGET])
    assert len(world.tested) == 1


def test_no_edge_goes_where_a_projection_leads_far_away():
    rng = np.random.default_rng(0)
    corners = World(2.0).path(0, onto=lambda point: point if rng.random() < 0.5 else 1.0 - point)
    assert np.linalg.norm(np.diff(corners, axis=0), axis=1).max() < 2.0 * World.reach


@pytest.mark.parametrize("closed", ["start", "target"])
def test_the_tree_in_the_open_waits_for_the_other_one(closed):
    """One end cannot be left: the other tree grows once, towards it, and then all work is done at the closed end."""
    world = World(0.0, most=2_000)
    ends = (START, TARGET) if closed == "start" else (TARGET, START)
    assert world.path(0, *ends) is None
    assert len(world.tested) >= world.most
    assert world.accepted <= 1 + np.linalg.norm(TARGET - START) / world.reach


class Box(World):
    """In four dimensions, around the origin and open at the far side."""

    bounds, reach = np.tile([-1.0, 1.0], (4, 1)), 0.1

    def free(self, points: np.ndarray) -> np.ndarray:
        wall = np.abs(np.abs(points).max(axis=1) - 0.225) < 0.025
        return ~wall | ((points[:, 0] < -0.2) & (np.abs(points[:, 1:]).max(axis=1) < 0.1))


def test_work_out_of_a_narrow_place_is_spent_where_it_helps(monkeypatch):
    """From within a box: else most samples are asked for through its wall."""

    def tests(seed: int) -> int:
        world = Box(0.0, most=3_000)
        world.path(seed, np.zeros(4), np.full(4, 0.8))
        return len(world.tested)

    with_domain = [tests(seed) for seed in range(3)]
    assert max(with_domain) < 2_000
    monkeypatch.setattr(trees, "_DOMAIN", np.inf)
    assert sum(with_domain) < 0.5 * sum(map(tests, range(3)))


def test_where_no_sample_is_near_the_nearest_counts(monkeypatch):
    """A domain that holds next to nothing slows the search down, and stops it not."""
    monkeypatch.setattr(trees, "_DOMAIN", 1e-6)
    assert World(0.2).path(0) is not None


@pytest.mark.skipif("rrt-connect" in PLANNERS.missing(), reason="OMPL simplifies its path")
def test_rrt_connect_finds_its_way_with_balanced_trees(monkeypatch):
    task, options = blocked(3), RrtConnectOptions(balanced=True)
    # It ends nearer to the post than it begins.
    task = replace(task, target=np.where(task.target == 2.6, 1.8, task.target))
    used = []

    def recorded(*ends, **more):
        used.append({**more, "ends": ends})
        return connected(*ends, **more)

    monkeypatch.setattr(sampling, "connected", recorded)
    motion = plan_with("rrt-connect", task, options=options)
    assert len(used) == 1
    assert min(Collisions(POSTED).clearance(q) for q in motion.q[::8]) > POSTED.clearance - 1e-6
    # From the other end it is the same search, which begins at the end that has less room.
    back = replace(task, start=task.target, target=task.start)
    search = sampling.balanced_search
    spaces = [(one, ProblemClearance(one, options.margin)) for one in (task, back)]
    there, home = (sampling.connecting_path(*one, options, search, 0) for one in spaces)
    for narrow, wide in (tree["ends"] for tree in used[-2:]):
        np.testing.assert_allclose(narrow * task.start, wide * task.target, atol=1e-12)
    for corners, one in ((there, task), (home, back)):
        np.testing.assert_array_equal(corners[[0, -1]], [one.start, one.target])
    again = sampling.connecting_path(task, ProblemClearance(task, options.margin), options, search, 0)
    np.testing.assert_array_equal(there, again)
    # The second attempt draws others; and who may do no work finds nothing.
    sampling.connecting_path(*spaces[0], options, search, 1)
    assert [used[0]["seed"].entropy, used[-1]["seed"].entropy] == [[task.seed, 0], [task.seed, 1]]
    with pytest.raises(PlanError, match="rrt-connect found no path free of contact"):
        plan_with("rrt-connect", task, options=replace(options, max_collision_checks=(1,)))
