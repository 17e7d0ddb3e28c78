"""Bounds on pushes, lags and time steps: by hand, and never broken by runs of random networks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.lie import adjoint
from lieednn_sim.stability import find_certificate, find_contraction, robustness
from lieednn_sim.stability.guarantees import Guarantee, _lyapunov_step
from lieednn_sim.stability.robustness import Decay, Robustness

seeds = st.integers(0, 2**32 - 1)
GAMMA, MU = 1.5, 0.8
STILL = robustness(np.zeros((2, 2)), gamma=1.0, mu=1.0)


def twists(rng, margin):
    """W and W_R of two SE(3) neurons, scaled to a share of what is certified and of what is proved to contract."""
    rotation = Rotation.random(4, rng=rng).as_matrix().reshape(2, 2, 3, 3)
    blocks = rng.normal(size=(2, 2, 1, 1)) * adjoint(rotation, 0.5 * rng.normal(size=(2, 2, 3)))
    core = blocks[..., :3, :3].transpose(0, 2, 1, 3).reshape(6, 6)
    size = margin * GAMMA / MU / max(find_contraction(core).value, 0.2 * np.linalg.norm(core, 2))
    return size * blocks.transpose(0, 2, 1, 3).reshape(12, 12), size * core


def field(weight, x, equilibrium):
    return -GAMMA * (x - equilibrium) + MU * (np.tanh(x) - np.tanh(equilibrium)) @ weight.T


def stepped(weight, equilibrium, x, h, method):
    """The rows of ``x``, and where a step by the book leads from each."""
    a = field(weight, x, equilibrium)
    if method == "RK4":
        b = field(weight, x + 0.5 * h * a, equilibrium)
        c = field(weight, x + 0.5 * h * b, equilibrium)
        a = (a + 2.0 * b + 2.0 * c + field(weight, x + h * c, equilibrium)) / 6.0
    return np.array([x, x + h * a])


@settings(max_examples=4)
@given(seeds, st.booleans())
def test_no_push_and_no_moving_target_breaks_its_bound(seed, contracting):
    rng = np.random.default_rng(seed)
    weight, core = twists(rng, rng.uniform(0.5, 0.97))
    bounds = robustness(weight, gamma=GAMMA, mu=MU, rotational_weight=core)
    both = bounds.contracting
    chosen = tuple(g for g in bounds.guarantees if g.contracting is contracting)
    assert chosen
    assert both is not None
    part = replace(bounds, guarantees=chosen)
    equilibrium = rng.uniform(-1.0, 1.0, 12)
    times = np.linspace(0.0, 8.0 / GAMMA, 50)

    def run(function, start):
        return solve_ivp(function, (0.0, times[-1]), start, t_eval=times, method="DOP853", rtol=1e-10, atol=1e-12).y.T

    pushed, watched = rng.permutation(12)[: rng.integers(1, 13)], rng.permutation(12)[: rng.integers(1, 13)]
    push = np.zeros(12)
    push[pushed] = rng.normal(size=len(pushed)) * 10.0 ** rng.uniform(-2, 1)
    size = np.linalg.norm(push)
    still = run(lambda _, x: field(weight, x, equilibrium), equilibrium + push) - equilibrium
    moved = np.linalg.norm(still[:, watched], axis=1) / size
    assert moved.max() <= part.push_gain(pushed, watched)
    share = moved[25]
    assert (moved[times >= part.settling_time(share, pushed, watched)] <= share * (1.0 + 1e-6)).all()
    # In each guarantee's norm, at every time.
    for guarantee in chosen:
        bound = guarantee.overshoot * np.exp(-guarantee.rate * times) * np.linalg.norm(guarantee.factor @ push)
        assert (np.linalg.norm(still @ guarantee.factor.T, axis=1) <= bound * (1.0 + 1e-6) + 1e-9).all()
    # Contraction: on the way between any two motions as well.
    start = equilibrium + rng.normal(size=12)
    pair = run(lambda _, x: field(weight, x.reshape(2, 12), equilibrium).ravel(), np.concatenate([start, start + push]))
    apart = np.diff(pair.reshape(-1, 2, 12), axis=1)[:, 0, watched]
    assert np.linalg.norm(apart, axis=1).max() <= size * both.push_gain(pushed, watched)

    velocity = np.zeros(12)
    velocity[pushed] = rng.normal(size=len(pushed))
    behind = run(lambda t, x: field(weight, x, equilibrium + t * velocity), equilibrium)
    lag = np.linalg.norm((behind - equilibrium - times[:, None] * velocity)[:, watched], axis=1)
    assert lag.max() <= np.linalg.norm(velocity) * part.lag(pushed, watched)


def test_a_step_suits_what_no_push_reaches_too():
    # The second coordinate hears itself alone; where phi is steepest its slope is -4, and Euler's step is 2 / 4 there.
    bounds = robustness([[0.0, 0.1], [0.0, -3.0]], gamma=1.0, mu=1.0, pushed=[0])
    assert bounds.reached.tolist() == [0]
    assert bounds.largest_step("Euler") == pytest.approx(0.5, rel=1e-2)
    assert bounds.push_gain() == pytest.approx(1.0)


@settings(max_examples=4)
@given(seeds, st.sampled_from(["Euler", "RK4"]))
def test_up_to_the_largest_step_every_step_brings_two_runs_closer(seed, method):
    """Not with slopes of tanh alone: with those that one step meets at their worst."""
    rng = np.random.default_rng(seed)
    weight, core = twists(rng, rng.uniform(0.5, 0.97))
    bounds = robustness(weight, gamma=GAMMA, mu=MU, rotational_weight=core)
    equilibrium = rng.uniform(-1.0, 1.0, 12)
    for guarantee in bounds.guarantees:
        h = guarantee.euler_step if method == "Euler" else guarantee.rk4_step
        start = equilibrium + rng.normal(size=(60, 12)) * 10.0 ** rng.uniform(-2, 1, (60, 1))
        # One at the equilibrium: what is not contracting only speaks of that.
        start[-1] = equilibrium
        x = stepped(weight, equilibrium, start, rng.uniform(0.2, 1.0) * h, method)
        if guarantee.contracting:
            distance = np.linalg.norm((x[:, :-1] - x[:, 1:]) @ guarantee.factor.T, axis=2)
            assert (distance[1] <= distance[0] * (1.0 + 1e-12)).all()
            for slopes in rng.integers(0, 2, (20, 4, 12)).astype(float):
                change = step_matrix(weight, slopes, h, method)
                norm = np.linalg.norm(guarantee.factor @ change @ guarantee.inverse, 2)
                assert norm <= 1.0 + 1e-9
        else:
            value = lyapunov(guarantee, x, equilibrium)
            assert (value[1, :-1] < value[0, :-1]).all()


def step_matrix(weight, slopes, h, method):
    """Matrix of one step with the slopes ``(4, n)`` at the four stages."""
    one = np.eye(len(weight))
    a, b, c, d = (MU * weight * row - GAMMA * one for row in slopes)
    if method == "Euler":
        return one + h * a
    second = b @ (one + 0.5 * h * a)
    third = c @ (one + 0.5 * h * second)
    return one + h / 6.0 * (a + 2.0 * second + 2.0 * third + d @ (one + h * third))


def lyapunov(guarantee, x, equilibrium):
    """U of the module, eps from the overshoot."""
    eps = 1.0 / (guarantee.overshoot**2 - 1.0)
    p = np.diag(guarantee.factor) ** 2

    def log_cosh(s):
        return np.logaddexp(s, -s)

    v = log_cosh(x) - log_cosh(equilibrium) - np.tanh(equilibrium) * (x - equilibrium)
    return (v + 0.5 * eps * (x - equilibrium) ** 2) @ p


def test_the_largest_step_of_a_quadratic_form_by_hand():
    """With all 1 but a drive of 1/2: (1 - h) (1 - h / 4) = (1/4 + h / 2)^2, so that h = 0.625."""
    assert _lyapunov_step(1.0, 1.0, 1.0, 0.5, stages=1) == pytest.approx(0.625, rel=1e-6)


def test_by_hand():
    """x' = -2 x: what is pushed only falls, a target at speed 1 is 1/2 ahead, Euler is stable up to 2 / gamma = 1."""
    alone = robustness(np.zeros((2, 2)), gamma=2.0, mu=1.0)
    assert alone.push_gain() == pytest.approx(1.0, rel=1e-3)
    assert alone.push_gain([0], [1]) == pytest.approx(1.0, rel=1e-3)
    assert alone.settling_time(0.1) == pytest.approx(np.log(10.0) / 2.0, rel=1e-2)
    assert alone.settling_time(2.0) == 0.0
    assert alone.lag() == pytest.approx(0.5, rel=1e-2)
    assert alone.largest_step("Euler") == pytest.approx(1.0, rel=1e-2)
    # x' = -x + W tanh x with W = w I: the field's slopes are -1 to -(1 - w), so Euler halts growing below h = 2.
    some = robustness(0.6 * np.eye(2), gamma=1.0, mu=1.0)
    assert some.lag() == pytest.approx(2.5, rel=1e-2)
    assert 1.0 < some.largest_step("RK4") <= some.largest_step("Euler") <= 2.0


def test_a_push_on_the_last_layer_of_a_cascade_meets_that_layer_alone():
    weight = np.zeros((4, 4))
    weight[:2, 2:], weight[2:, 2:] = 80.0, [[0.9, 0.0], [-70.0, 0.9]]
    last = robustness(weight, gamma=1.0, mu=1.0, pushed=[0, 1])
    assert last.reached.tolist() == [0, 1]
    assert last.push_gain() == pytest.approx(1.0, rel=1e-3)
    assert last.lag(watched=[2, 3]) == last.push_gain(watched=[3]) == last.settling_time(0.1, watched=[3]) == 0.0
    first = robustness(weight, gamma=1.0, mu=1.0, pushed=[2])
    assert first.reached.tolist() == [0, 1, 2, 3]
    assert first.push_gain([2], [0]) > 10.0


def test_without_contraction_the_certificate_itself_bounds_pushes():
    weight = np.array([[0.5, 30.0], [-3.0, 0.5]])
    bounds = robustness(weight, gamma=1.0, mu=1.0)
    assert bounds.contracting is None
    assert "away from the equilibrium" in str(bounds)
    assert bounds.push_gain() > 1.0
    assert 0.0 < bounds.largest_step("RK4") < bounds.largest_step("Euler") < 0.1
    # eps = 4 k (gamma - c/2) / (mu s)^2 with c = k = 0.25 and s = |M|: the middle of the three rates.
    certificate = find_certificate(weight)
    root = np.sqrt(certificate.lyapunov_diagonal)
    s = np.linalg.norm(root[:, None] * weight / root, 2)
    middle = bounds.guarantees[1]
    assert middle.overshoot == pytest.approx(np.sqrt(1.0 + s**2 / (4.0 * 0.25 * 0.875)), rel=1e-3)
    assert middle.rate == pytest.approx(0.125, rel=1e-3)
    assert middle.delay == pytest.approx(2.0 / 0.25 * middle.overshoot**2, rel=1e-3)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: robustness(3.0 * np.eye(2), gamma=1.0, mu=1.0), NotCertifiedError, "without a certificate"),
        (lambda: robustness(np.eye(2), gamma=1.0, mu=2.0, pushed=[2]), InputError, "coordinates from 0 to 1"),
        (lambda: robustness(np.eye(2), gamma=1.0, mu=2.0, pushed=[]), InputError, "coordinates from 0 to 1"),
        (lambda: robustness(np.zeros((2, 2)), gamma=1.0, mu=1.0, pushed=[0]).push_gain([1]), InputError, "name some"),
        (lambda: robustness(np.zeros((2, 2)), gamma=1.0, mu=1.0, pushed=[True, False]), InputError, "whole numbers"),
        (lambda: STILL.push_gain("x"), InputError, "numbers, got 'x'"),
        (lambda: STILL.lag(watched=[-1]), InputError, "watched must .* from 0 to 1 by"),
        (lambda: STILL.settling_time(0.0), InputError, "fraction must be positive"),
        (lambda: STILL.largest_step("RK45"), InputError, "no method 'RK45'; allowed: Euler, RK4"),
    ],
)
def test_wrong_input_is_named(call, error, words):
    with pytest.raises(error, match=words):
        call()


def test_words_are_of_contraction_where_there_is_one_and_of_the_best_proof():
    """Of three guarantees in the same norm, the least push gain and lag, and the largest steps; ln(30) / 0.5 = 6.8."""

    def proof(contracting, overshoot, rate, delay, euler, rk4):
        numbers = {"overshoot": overshoot, "rate": rate, "delay": delay, "euler_step": euler, "rk4_step": rk4}
        return Guarantee(contracting=contracting, factor=np.eye(2), inverse=np.eye(2), **numbers)

    both = np.arange(2)
    proofs = (
        proof(True, 3.0, 0.5, 7.0, 0.25, 0.75),
        proof(True, 2.0, 0.25, 9.0, 0.5, 1.5),
        proof(False, 1.0, 9.0, 6.0, 0.1, 0.2),
    )
    told = str(Robustness(both, both, proofs))
    assert "at most 2 away from any motion, and less than 0.1 after 6.8 of the network's time" in told
    assert "followed at a distance of at most 6\n" in told
    assert "up to 0.5 (Euler) or 1.5 (RK4)" in told
    assert "at most 1 away from the equilibrium, and less than 0.1 after 0.256 of the network's" in str(
        Robustness(both, both, proofs[2:])
    )


def test_the_distance_left_is_bounded_at_all_times_and_sharply_without_weights():
    decay = Decay(robustness(np.zeros((4, 4)), gamma=GAMMA, mu=MU), 2)
    begun = decay.begin([3.0, 4.0, 0.0, 0.0])
    # Without weights e = e(0) exp(-gamma t); the proof gives up a thousandth of the rate.
    assert 5.0 * np.exp(-2.0 * GAMMA) <= decay.bound(begun, 2.0) <= 5.01 * np.exp(-1.998 * GAMMA)
    assert decay.bound(decay.begin(np.zeros(4)), 1.0) == 0.0
    rng = np.random.default_rng(5)
    weight, core = twists(rng, 0.4)
    decay = Decay(robustness(weight, gamma=GAMMA, mu=MU, rotational_weight=core), 6)
    start, rest = rng.normal(size=12), rng.normal(size=12)
    times = np.linspace(0.0, 6.0, 30)
    run = solve_ivp(lambda _, x: field(weight, x, rest), (0.0, 6.0), start, t_eval=times, rtol=1e-9, atol=1e-12)
    left = np.linalg.norm((run.y.T - rest)[:, :6], axis=1)
    begun = decay.begin(start - rest)
    bounds = [decay.bound(begun, time) for time in times]
    assert (left <= bounds).all()
    assert bounds[-1] < 0.05 * bounds[0]
    cascade = np.array([[0.0, 0.5], [0.0, 0.0]])
    with pytest.raises(InputError, match="reach all coordinates"):
        Decay(robustness(cascade, gamma=GAMMA, mu=MU, pushed=[0]), 1)


def test_coordinates_without_inputs_take_the_steps_of_one():
    weight = np.zeros((12, 12))
    weight[:2] = np.random.default_rng(1).normal(size=(2, 12)) * 0.3
    whole = robustness(weight, gamma=1.2, mu=0.9, pushed=[0, 1])
    assert whole.others is not None
    assert whole.others.reached.tolist() == list(range(10))
    alone = robustness(np.zeros((10, 10)), gamma=1.2, mu=0.9)
    for method in ("Euler", "RK4"):
        assert whole.others.largest_step(method) == pytest.approx(alone.largest_step(method), rel=1e-9)
    assert whole.push_gain(watched=[11]) == 0.0
