"""Synthesis of many networks at once: each is the one that would be made alone, whatever the others are."""

from __future__ import annotations

from itertools import count

import numpy as np
import pytest

from lieednn_sim import budget
from lieednn_sim.budget import time_limit
from lieednn_sim.errors import InputError, OutOfTimeError
from lieednn_sim.synthesis import BIAS_RULES, certified, synthesize, synthesize_many
from lieednn_sim.synthesis.problem import Problem, _log_scale
from lieednn_sim.synthesis.search import _least_norm, _linearised, _merit


def mixed_targets(count, neurons, seed=0):
    """Some turn far, some hardly, some with one neuron alone: both kinds of equations, and rows that depend."""
    rng = np.random.default_rng(seed)
    targets = rng.uniform(-0.8, 0.8, (count, neurons, 6))
    targets[::3, :, :3] *= 0.1
    targets[1::4, 1:, :3] = 0.0
    return targets


def assert_same(one, other):
    """All but the time it took, to the last bit."""
    assert one.network == other.network
    names = ("impossible", "message", "residual", "largest_translation", "attempts")
    assert all(getattr(one, name) == getattr(other, name) for name in names)


@pytest.mark.parametrize("rule", BIAS_RULES)
@pytest.mark.parametrize(("number", "neurons"), [(12, 2), (6, 4)])
def test_each_is_what_it_is_alone_to_the_last_bit(number, neurons, rule):
    targets = mixed_targets(number, neurons)
    options = {"bias": rule, "max_attempts": 3}
    many = synthesize_many(targets, seed=5, **options)
    alone = map(lambda xi, rng: synthesize(xi, seed=rng, **options), targets, np.random.default_rng(5).spawn(number))
    few = synthesize_many(targets[:5], seed=5, **options)
    for one, other in [*zip(many, alone, strict=True), *zip(many[:5], few, strict=True)]:
        assert_same(one, other)
    assert any(one.success for one in many)


def test_bias_and_its_magnitude_may_be_each_ones_own():
    target, magnitudes = mixed_targets(2, 4)[1], [0.125, 0.25, 0.5]
    many = synthesize_many([target] * 3, bias="sign-matched", bias_magnitude=magnitudes, seed=2)
    for one, magnitude, rng in zip(many, magnitudes, np.random.default_rng(2).spawn(3), strict=True):
        assert_same(one, synthesize(target, bias="sign-matched", bias_magnitude=magnitude, seed=rng))
    again = synthesize_many([target] * 3, bias=[one.unwrap().bias for one in many], seed=2)
    assert [one.network for one in again] == [one.network for one in many]


def test_what_cannot_be_made_says_why_and_leaves_the_others_alone():
    rng = np.random.default_rng(0)
    good = rng.uniform(0.1, 0.8, (4, 4, 6))
    targets = good.copy()
    targets[1] = -np.abs(targets[1]) - 0.1
    many, all_good = (synthesize_many(xi, seed=1) for xi in (targets, good))
    assert many[1].impossible
    assert "no diagonal Lyapunov matrix can exist" in many[1].message
    assert not many[1].success
    for k in (0, 2, 3):
        assert_same(many[k], all_good[k])
        assert many[k].network.certified
        assert np.abs(many[k].network.vector_field(targets[k])).max() < 1e-9


def test_what_is_left_is_searched_for_with_patience():
    """One that takes more than the quick attempts, beside one that does not."""
    targets = np.random.default_rng(0).uniform(-0.8, 0.8, (6, 2, 6))[[5, 0]]
    many = synthesize_many(targets, seed=0, max_attempts=8)
    assert many[0].attempts > 4
    assert many[0].success
    assert many[1].attempts <= 4
    for one, target, rng in zip(many, targets, np.random.default_rng(0).spawn(2), strict=True):
        assert_same(one, synthesize(target, seed=rng, max_attempts=8))


def task_of(target, offset=None):
    rates = {"gamma": 1.0, "mu": 1.0, "activation": "tanh"}
    offset = np.zeros_like(target) if offset is None else offset
    return certified._Task(target, np.tanh(target), offset, np.random.default_rng(0), rates, 0.0)


def test_only_a_network_with_the_very_target_is_taken():
    target = np.random.default_rng(1).uniform(0.1, 0.8, (4, 6))
    network = synthesize(target, seed=0).unwrap()
    for moved, taken in ((0.0, True), (1e-7, False)):
        task = task_of(target + moved)
        task.offer(network)
        assert (task.outcome is not None) == taken


def test_patience_tries_every_bound_for_every_kind_of_equations(monkeypatch):
    """Moderate weights first, for rotations and translations, then for rotations alone; then large ones; and again."""
    tried = []

    def given_up(problem, start, *, accept, quaternion_bound):
        tried.append((quaternion_bound, problem.inputs.shape[-1]))
        return None

    monkeypatch.setattr(certified, "smallest_eigenvalue_point", given_up)
    target = np.random.default_rng(1).uniform(0.1, 0.8, (2, 6))
    target[1, :3] = 0.0
    task = task_of(target)
    assert [len(choice) for choice in task.choices] == [2, 1]
    for _ in range(5):
        certified._patient_attempt(task)
    assert tried == [(3.0, 2), (3.0, 1), (60.0, 2), (60.0, 1), (3.0, 2)]
    assert task.attempts == 5


@pytest.mark.parametrize(("needed", "refused"), [(900.0, False), (1100.0, True)])
def test_weights_beyond_a_norm_of_a_thousand_are_not_searched_for(needed, refused):
    # One coordinate that is driven against its target, so that a certificate is not ruled out.
    target = np.zeros((2, 6))
    target[:, 0] = 1e-3
    offset = np.zeros((2, 6))
    offset[:, 0] = [1e-3, 1e-3 + needed * 1e-3 * np.sqrt(2.0)]
    task = task_of(target, offset)
    task.refuse()
    assert (task.outcome is not None) == refused
    if refused:
        assert not task.outcome.impossible
        assert "weights of norm 1.1e+03 gamma/mu" in task.outcome.message


def test_starts_spread_log_p_as_little_as_helps_by_hand():
    """With p = exp(s), exp(-s) of work -1, 1 it takes e^-2s <= 9 / 11, s = 0.1003; steps are 0.1.

    Where all work hinders, the largest spread is as good as any.
    """
    inputs = np.ones((2, 1, 3, 1))
    outputs = 0.9 + np.array([[[-1.0], [1.0], [0.0]], [[1.0], [1.0], [1.0]]])[:, None]
    np.testing.assert_allclose(_log_scale(inputs, outputs), [[0.1, -0.1, -0.1], [-1.45, -1.45, -1.45]])


def test_none_are_made_of_none():
    assert synthesize_many(np.zeros((0, 4, 6))) == []


def test_the_time_budget_is_kept(monkeypatch):
    """By a clock that moves on with every look at it: the stack looks at each of its steps."""
    looks = count()
    monkeypatch.setattr(budget, "cpu_time", lambda: float(next(looks)))
    with time_limit(3.0), pytest.raises(OutOfTimeError):
        synthesize_many(mixed_targets(10, 4), bias="sign-matched", max_attempts=1)
    assert next(looks) == 5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"xi": np.zeros((4, 6))}, r"xi must have shape \(B, N, 6\), got \(4, 6\)"),
        ({"bias": np.zeros((4, 6))}, r"bias must have shape \(3, 4, 6\), got \(4, 6\)"),
        ({"bias_magnitude": [0.1, 0.2]}, r"bias_magnitude must have shape \(3,\), got \(2,\)"),
        ({"bias_magnitude": [0.1, 0.2, 0.0]}, "bias_magnitude must be positive"),
    ],
)
def test_wrong_input_is_named(arguments, words):
    with pytest.raises(InputError, match=words):
        synthesize_many(**({"xi": mixed_targets(3, 4)} | arguments))


@pytest.fixture
def stack():
    rng = np.random.default_rng(1)
    signs = np.where(rng.random((3, 3, 3)) < 0.5, 1.0, -1.0)
    problem = Problem(rng.normal(size=(3, 3, 3, 2)), rng.normal(size=(3, 3, 3, 2)), signs)
    return problem, 0.7 * rng.normal(size=(3, problem.n_quaternion + problem.size))


def test_steps_of_the_search(stack):
    """Gradient by finite differences; the step and what it leaves by the dense normal equations."""
    problem, unknowns = stack
    point = problem.evaluate(unknowns)
    steps = 1e-6 * np.eye(unknowns.shape[-1])
    for k, linear in enumerate(_linearised(problem, point, 0.85)):
        gradient = linear.residual @ linear.jacobian
        around = [[_merit(problem.evaluate(unknowns + sign * h), 0.85)[k] for sign in (1, -1)] for h in steps]
        numeric = np.diff(np.array(around)[:, ::-1], axis=1)[:, 0] / 2e-6
        np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-5)
        step, left = linear.step(0.3)
        normal = linear.jacobian.T @ linear.jacobian + 0.3 * np.eye(len(gradient))
        np.testing.assert_allclose(step, -np.linalg.solve(normal, gradient), rtol=1e-8, atol=1e-10)
        half = 0.5 * np.sum((linear.residual + linear.jacobian @ step) ** 2)
        assert left == pytest.approx(half, rel=1e-9)


def test_least_norm_is_that_of_the_pseudo_inverse_where_rows_depend_too():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(6, 3, 8))
    rows[1, 2] = rows[1, 0]
    rows[2, 1] = 0.0
    rows[3, 1] *= 1e-9
    rows[4, 2] = rows[4, 1] + 1e-5 * rows[4, 0]
    error = rng.normal(size=(6, 3))
    expected = (np.linalg.pinv(rows, rcond=1e-10) @ error[..., None])[..., 0]
    np.testing.assert_allclose(_least_norm(rows, error), expected, rtol=1e-8)


def test_large_stacks_are_searched_in_parts_of_bounded_memory(monkeypatch):
    targets, parts = np.random.default_rng(5).uniform(-0.8, 0.8, (5, 3, 6)), []
    whole = synthesize_many(targets, bias="sign-matched", seed=3)
    attempt = certified._fast_attempt
    monkeypatch.setattr(certified, "_LARGEST_STACK", 2 * 9**4 // 4)
    monkeypatch.setattr(
        certified, "_fast_attempt", lambda stack, solved: parts.append(len(stack)) or attempt(stack, solved)
    )
    split = synthesize_many(targets, bias="sign-matched", seed=3)
    assert parts[:3] == [2, 2, 1]
    for one, other in zip(whole, split, strict=True):
        np.testing.assert_array_equal(one.unwrap().weight, other.unwrap().weight)
