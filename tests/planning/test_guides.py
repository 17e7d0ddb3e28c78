"""Guides of shaped networks, and the optimisation of motions."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.contact_slopes import ContactSlopes
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError, PlanError
from lieednn_sim.evaluation.metrics import motion_metrics
from lieednn_sim.planning import PLANNERS, GuideOptions, PlanningProblem, guide_optimisation, guides, plan
from lieednn_sim.planning.baselines.interpolation import minimum_jerk
from lieednn_sim.planning.guide_optimisation import GuideOptimisation
from lieednn_sim.planning.guides import followed, shortened
from lieednn_sim.planning.joint_space import sweeps
from lieednn_sim.planning.motion import check_motion, travelled

from .arms import coarse

FREE = coarse(timestep=0.005)
needs_ompl = pytest.mark.skipif("rrt-connect" in PLANNERS.missing(), reason="RRT-Connect needs OMPL")


def problem_of(scene, seed):
    arm = FREE.with_scene(scene, seed)
    return PlanningProblem(arm, arm.keyframe("home"), draw_target(arm, seed), seed=seed)


@pytest.fixture(scope="module")
def poles():
    return problem_of("poles", 0)


@pytest.fixture
def no_ompl(monkeypatch):
    def missing(_name):
        raise LieEDNNError("ompl is not installed")

    for module in ("sampling", "search_space"):
        monkeypatch.setattr(f"lieednn_sim.planning.baselines.{module}.optional_module", missing)


def best_guide(problem, options):
    """The guide that comes first."""
    return followed(problem, options, lambda guide: guide)


def optimisation(problem, **options):
    ends = min(map(Collisions(problem.arm).clearance, (problem.start, problem.target)))
    settings = {"weight": 0.1, "intervals": 8, "instants": 96, **options}
    return GuideOptimisation(problem, sweeps(problem.arm), ends, **settings)


@pytest.mark.parametrize("own", [False, True])
def test_slopes_of_contacts_are_those_of_the_distances(own, poles):
    arm = poles.arm
    q = poles.start + np.linspace(0.2, 0.8, 7)[:, None] * (poles.target - poles.start)
    slopes = ContactSlopes(arm, 0.1, own=own)
    index, distance, slope = slopes.along(q)
    collisions = Collisions(arm)
    of_arm = {tuple(pair) for pair in collisions.pairs[collisions.own].tolist()}
    compared = 0
    for k, position in enumerate(q):
        near = collisions.distances(position, 0.1)
        pairs = zip(near.distance, near.pairs.tolist(), strict=True)
        counted = [gap for gap, pair in pairs if own or tuple(pair) not in of_arm]
        # Depths of penetration are not defined alike.
        if counted and counted[0] > 0.0:
            assert distance[index == k].min() == pytest.approx(counted[0], abs=1e-6)
            compared += 1
    assert compared > 0
    # Against differences of the distances themselves; of several contacts of a pair only the nearest is exact.
    k = int(index[distance.argmax()])
    change = 1e-6 * np.arange(1, arm.n_joints + 1)
    moved = slopes.along(q[[k]] + change)[1] - slopes.along(q[[k]] - change)[1]
    np.testing.assert_allclose(moved, 2.0 * slope[index == k] @ change, rtol=0.03)


def test_without_obstacles_the_straight_motion_is_the_best_and_costs_two():
    problem = problem_of("free", 0)
    one = optimisation(problem)
    assert one.cost(one.straight) == pytest.approx(2.0, rel=1e-2)
    made, wanted = one.motion(problem, one.straight), plan(FREE, problem.target, planner="minimum-jerk").motion
    np.testing.assert_allclose(made.q, wanted.q, atol=2e-2)
    assert best_guide(problem, GuideOptions()).planner == "minimum-jerk"


def test_a_optimised_motion_is_no_worse_than_its_start_and_keeps_limits_and_clearance(poles):
    one = optimisation(poles)
    path = guides._Search(poles, GuideOptions()).path(0)
    guess = one.near(path)
    start = one.descend(guess, 0)
    measures = [start[0]]
    for steps in (1, 4, 12):
        measure, free, clear = one.descend(guess, steps)
        measures.append(measure)
    assert measures == sorted(measures, reverse=True)
    assert measures[-1] < measures[0] - 0.1
    assert clear
    motion = one.motion(poles, free)
    check_motion(poles.arm, motion)
    least = Collisions(poles.arm).clearance(motion.q)
    assert measure == pytest.approx(one.measure(free, least, one._effector_jerk(free)), abs=0.05)
    # A larger weight of clearance gives more of it, at the cost of length and jerk.
    wide = optimisation(poles, weight=1.0)
    wider = wide.motion(poles, wide.descend(free, 12)[1])
    assert Collisions(poles.arm).clearance(wider.q) > 1.1 * least
    assert wide.cost(wide.descend(free, 12)[1]) > one.cost(free)


def test_the_effectors_jerk_is_that_of_the_motion_and_a_larger_weight_gives_less(poles, monkeypatch):
    one = optimisation(poles)
    guess = one.near(guides._Search(poles, GuideOptions()).path(0))
    _, gradient, hessian = one._effector_jerk(guess)
    step = 1e-4 * np.random.default_rng(0).normal(size=guess.shape)
    ahead, behind = (one._effector_jerk(guess + side * step)[0] for side in (1.0, -1.0))
    assert 4.0 * gradient @ step.T.ravel() == pytest.approx(ahead - behind, rel=1e-3)
    assert (np.linalg.eigvalsh(hessian) > -1e-6).all()
    jerks = []
    for weight in (0.0, 0.3):
        monkeypatch.setattr(guide_optimisation, "_EFFECTOR", weight)
        free = one.descend(guess, 12)[1]
        jerks.append(one._effector_jerk(free)[0])
        # Also there, where a descent has led that may have found what a coarse value does not see.
        metres = motion_metrics(poles.arm, one.motion(replace(poles, duration=20.0), free)).jerk_effector * 20.0**3
        assert jerks[-1] == pytest.approx(metres**2 / 720.0, rel=0.03)
    assert jerks[1] < 0.9 * jerks[0]


def test_no_step_is_tried_twice(monkeypatch):
    problem, tried = problem_of("shelf", 5), []
    one = optimisation(problem, weight=0.15)
    step = one._step

    def noted(*given):
        tried.append(step(*given)[0])
        return step(*given)

    monkeypatch.setattr(one, "_step", noted)
    one.descend(one.straight, 40)
    assert 5 < len(tried) < 40
    assert all(np.abs(first - second).max() > 1e-6 for first, second in pairwise(tried))


@pytest.mark.parametrize("near_by", [0.0, 0.1])
def test_a_small_step_gains_what_it_expects_to(near_by, poles, monkeypatch):
    free = (one := optimisation(poles)).descend(one.near(guides._Search(poles, GuideOptions()).path(0)), 3)[1]
    monkeypatch.setattr(guide_optimisation, "_NEAR", near_by)
    one = optimisation(poles, weight=0.5)

    def seen(free):
        near, jerk = one._distances(free), one._effector_jerk(free)
        clearance = float(near[1].min())
        return near, jerk, clearance, one.measure(free, clearance, jerk)

    near, jerk, clearance, measure = seen(free)
    assert clearance < one._enough
    new, gain = one._step(free, near, jerk, clearance, 5e-4)
    assert measure - seen(new)[-1] == pytest.approx(gain, rel=0.03)


def test_of_very_many_broken_bounds_the_deepest_count_and_all_that_hold(poles, monkeypatch):
    one = optimisation(poles)
    rng, n = np.random.default_rng(0), poles.arm.n_joints
    deep, near = -rng.uniform(0.001, 0.2, 3000), rng.uniform(0.003, 0.01, 700)
    distance = rng.permutation(np.concatenate([deep, near]))
    given = rng.integers(0, 96, len(distance)), distance, np.full((len(distance), n), 1.0)
    taken, solve = [], guide_optimisation.daqp.solve

    def noted(hessian, pull, rows, upper, lower, sense, **settings):
        taken.append(lower[-len(rows) :])
        return solve(hessian, pull, rows, upper, lower, sense, **settings)

    monkeypatch.setattr(guide_optimisation.daqp, "solve", noted)
    new, _ = one._step(one.straight, given, one._effector_jerk(one.straight), float(deep.min()), 0.1)
    assert np.isfinite(new).all()
    kept = np.sort(guide_optimisation._TOUCHING - taken[0])
    np.testing.assert_allclose(kept, np.sort(np.concatenate([np.sort(deep)[: guide_optimisation._DEEPEST], near])))


def test_the_winner_has_the_least_measure_whatever_the_order(poles, monkeypatch):
    one = optimisation(poles, weight=GuideOptions().clearance_weight)
    guesses = [one.near(guides._Search(poles, GuideOptions()).path(k)) for k in range(2)]
    found = [one.descend(guess, steps) for guess, steps in zip(guesses, (12, 4), strict=True)]
    assert all(clear for _, _, clear in found)
    refined = (one.descend(free, GuideOptions().steps)[1] for _, free, _ in sorted(found, key=lambda each: each[0]))
    better, worse = (one.motion(poles, free) for free in refined)
    assert np.abs(better.q - worse.q).max() > 1e-5
    given = [(measure, "given", one, free) for measure, free, _ in found]
    for order in (given, given[::-1]):
        monkeypatch.setattr(guides._Search, "optimised", lambda _, order=order: iter(order))
        np.testing.assert_array_equal(best_guide(poles, GuideOptions()).motion.q, better.q)


def test_no_longer_way_is_chosen_for_its_clearance(monkeypatch):
    problem, lengths = problem_of("poles", 31), []
    for part in (guide_optimisation._ALONE, 1.0):
        monkeypatch.setattr(guide_optimisation, "_ALONE", part)
        lengths.append(travelled(best_guide(problem, GuideOptions()).motion.q / problem.arm.ranges)[-1])
    assert lengths[0] < 1.0 < 1.2 < lengths[1]


def test_a_guide_is_the_same_for_a_seed_and_needs_no_optional_library(poles, no_ompl):
    first, second = (best_guide(poles, GuideOptions()) for _ in range(2))
    assert first.planner == "rrt-connect, optimised"
    np.testing.assert_array_equal(first.motion.q, second.motion.q)
    other = best_guide(replace(poles, seed=1), GuideOptions())
    assert np.abs(other.motion.q - first.motion.q).max() > 1e-5
    with pytest.raises(LieEDNNError, match="ompl is not installed"):
        best_guide(poles, GuideOptions(optimised=False))


@needs_ompl
def test_without_a_guide_there_is_no_motion(poles, monkeypatch):
    monkeypatch.setattr("lieednn_sim.planning.baselines.sampling.connecting_path", lambda *_: None)
    with pytest.raises(PlanError, match=r"no guide finds a motion that .* follows; minimum-jerk: .*; rrt-connect: "):
        best_guide(poles, GuideOptions(collision_checks=1))


@pytest.mark.parametrize(("name", "found", "seeds"), [("a", True, 5), ("a", False, 1), ("minimum-jerk", True, 1)])
def test_other_seeds_are_tried_where_they_may_give_a_motion_that_can_be_followed(name, found, seeds, monkeypatch):
    problem, asked = problem_of("free", 0), []
    straight = minimum_jerk(problem)

    def refuse(why):
        raise PlanError(why)

    def motions(given, _options):
        asked.append(given.seed)
        yield name, lambda: straight if found else refuse("not found")

    monkeypatch.setattr(guides, "_motions", motions)
    with pytest.raises(PlanError, match="follows; .*: not followed" if found else "not found"):
        followed(problem, GuideOptions(), lambda _: refuse("not followed"), 5)
    assert asked == list(range(seeds))


def test_a_shortened_path_is_shorter_and_clear_by_hand():
    # Around a wall at x = 0 that ends at y = 1: the shortest path goes over its tip.
    corners = np.array([[-1.0, 0.0], [-1.0, 3.0], [1.0, 3.0], [1.0, 0.0]])

    def clear(first, second):
        fraction = -first[0] / (second[0] - first[0]) if first[0] * second[0] < 0.0 else None
        return fraction is None or first[1] + fraction * (second[1] - first[1]) > 1.0

    short = shortened(corners, clear, 60, np.random.default_rng(0))
    np.testing.assert_array_equal(short[[0, -1]], corners[[0, -1]])
    assert all(clear(*edge) for edge in pairwise(short))
    length = np.linalg.norm(np.diff(short, axis=0), axis=1).sum()
    assert 2.0 * np.sqrt(2.0) <= length < 3.2
    np.testing.assert_array_equal(shortened(corners, lambda *_: False, 60, np.random.default_rng(0)), corners)
