"""Shaping: the cascade in closed form, its certificate for every parameter, and what comes out."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim import budget
from lieednn_sim.budget import time_limit
from lieednn_sim.errors import InputError, NotCertifiedError, OutOfTimeError
from lieednn_sim.network import ACTIVATIONS
from lieednn_sim.synthesis import ShapingOptions, shape
from lieednn_sim.synthesis.shaping import shaping
from lieednn_sim.synthesis.shaping.cascade import TAIL, Cascade, Parameters, assemble, clockwork, turns_to
from lieednn_sim.synthesis.shaping.curve import Curve, third_derivative
from lieednn_sim.synthesis.shaping.shaping import LARGEST_SLOPE, fit_switches

RATES = [1.0, 0.3, 0.1]
UNITS = np.repeat([0.5, 1.0], 3)


def drawn(rng, n=2, m=3, scale=1.0):
    a, c = np.clip(scale * rng.normal(size=(2, m, 6)), -LARGEST_SLOPE, LARGEST_SLOPE)
    rotation = Rotation.random(n * m, rng=rng).as_matrix().reshape(n, m, 3, 3)
    return Parameters(a, c, scale * rng.random((n, m)), rotation)


def bent(n=2, count=200):
    """A curve with a bend of half a turn in both halves of its twists, ``(K, N, 6)``."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    rng = np.random.default_rng(5)
    first, second, third = rng.uniform(-0.4, 0.4, (3, 6 * n))
    return (first + s * second + np.sin(np.pi * s) * third).reshape(count, n, 6)


@pytest.mark.parametrize("activation", sorted(ACTIVATIONS))
@pytest.mark.parametrize("rate", RATES)
def test_the_closed_form_is_the_networks_own_trajectory(rate, activation):
    rng = np.random.default_rng(1)
    start, target = rng.normal(size=(2, 2, 6))
    parameters = drawn(rng, scale=1.5)
    clock = clockwork(rate, activation=ACTIVATIONS[activation])
    network = assemble(parameters, rate, target, activation)
    way = network.trajectory(network.start(start), clock.t[-1], rtol=1e-10, atol=1e-12)
    *closed, last = Cascade(clock, start, target).states(parameters)
    np.testing.assert_allclose(network.visible(way(clock.t)), closed, atol=2e-5 * np.abs(closed).max())
    # The state ends as x_d + e^-t (A + B t) if the clock is as fast as the neurons, and the last row is x_d and B.
    ends = (np.array(closed)[-2:] - target) * np.exp(clock.t[-2:])[:, None, None]
    growth = (ends[1] - ends[0]) / (clock.t[-1] - clock.t[-2]) if rate == 1.0 else np.zeros((2, 6))
    np.testing.assert_allclose(last, target + TAIL * growth, atol=1e-3)


@pytest.mark.parametrize("rate", RATES)
def test_the_clock_falls_from_one_at_its_rate(rate):
    clock = clockwork(rate)
    assert clock.g[0] == 1.0
    assert (np.diff(clock.g) < 0.0).all()
    last = -np.diff(np.log(clock.g[-3:])) / np.diff(clock.t[-3:])
    np.testing.assert_allclose(last, rate, rtol=1e-4)


def test_a_foot_is_nearest_in_metres():
    """From (1, 0) to the line (s, s) with half a metre per unit of y: s = 1 / (1 + 0.25)."""
    samples = np.zeros((2, 1, 6))
    samples[1, 0, 3:5] = 1.0
    units = np.array([[1.0, 1.0, 1.0, 1.0, 0.5, 1.0]])
    point = np.eye(6)[None, 3:4]
    curve = Curve.through(samples, units)
    assert curve.length == pytest.approx(np.hypot(1.0, 0.5))
    feet = curve.feet(np.concatenate([point, point, point]), np.array([0.0, 0.75, 1.0]))
    np.testing.assert_allclose(feet, [0.0, 0.8, 1.0], atol=1e-9)


def line(*places):
    """Samples along straight lines through places (x, y)."""
    corners = np.array(places, dtype=float)
    s = np.linspace(0.0, len(corners) - 1.0, 201)
    samples = np.zeros((201, 1, 6))
    samples[:, 0, 3:5] = np.column_stack([np.interp(s, np.arange(len(corners)), column) for column in corners.T])
    return samples


@pytest.mark.parametrize(
    ("way", "curve"),
    [
        (line((0, 0), (1, 0.1)), line((0, 0), (1, 0))),
        # A spike, of the way or of the curve, counts in full; nearly all of the straight line is on the other one.
        (line((0, 0), (0.5, 0), (0.5, 0.1), (0.5, 0), (1, 0)), line((0, 0), (1, 0))),
        (line((0, 0), (1, 0)), line((0, 0), (0.5, 0), (0.5, 0.1), (0.5, 0), (1, 0))),
    ],
)
def test_the_deviation_is_the_largest_distance_of_either_from_the_other(monkeypatch, way, curve):
    """In units of 1 m along x and 2 m along y."""
    units = np.array([[1.0, 1.0, 1.0, 1.0, 2.0, 1.0]])
    drawn_way = Curve.through(way, units)

    class Trajectory:
        t = np.array([0.0, 1.0])

        def __call__(self, t):
            return drawn_way.at(np.cbrt(t))[0]

    network = SimpleNamespace(start=lambda x: x, trajectory=lambda *_, **__: Trajectory(), visible=lambda x: x)
    monkeypatch.setattr(shaping, "assemble", lambda *_: network)
    deviation, _ = shaping._measured(None, ShapingOptions(), Curve.through(curve, units))
    assert deviation == pytest.approx(0.2, rel=0.03)


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_the_outcome_is_told_in_millimetres_and_decided_by_the_deviation(rate):
    options = ShapingOptions(rate=rate, neurons=(2,))
    best = shape(bent(), 1e-9, units=UNITS, options=options)
    assert 1e-3 < best.deviation < 1.0
    off = f"{1e3 * best.deviation:.3g} mm off the curve with 2 hidden neurons"
    assert best.message == f"{off}, 1e-06 mm were asked for; ask for a larger deviation, or allow more neurons"
    with pytest.raises(NotCertifiedError, match="off the curve"):
        best.unwrap()
    for share, success in ((0.99, False), (1.01, True)):
        result = shape(bent(), share * best.deviation, units=UNITS, options=options)
        assert result.deviation == best.deviation
        assert (result.success, result.options.neurons) == (success, (2,))
    assert result.message == f"within {1e3 * best.deviation:.3g} mm of the curve with 2 hidden neurons"
    assert result.network.n_hidden == (2 if rate == 1.0 else 4)


@given(
    seed=st.integers(0, 2**32 - 1),
    rate=st.sampled_from([*RATES, 0.01]),
    n=st.integers(1, 3),
    m=st.integers(1, 5),
    scale=st.sampled_from([0.0, 1e-6, 1.0, LARGEST_SLOPE]),
)
def test_every_parameter_gives_a_certified_network_with_its_target(seed, rate, n, m, scale):
    rng = np.random.default_rng(seed)
    parameters = drawn(rng, n, m, scale)
    target = rng.normal(size=(n, 6))
    network = assemble(parameters, rate, target)
    assert network.certified
    assert network.certificate.lambda_max <= 1.0 - rate + 0.041
    assert (network.n_visible, network.n_clock) == (n, 2 if rate < 1.0 else 0)
    field = network.vector_field(network.goal(target))
    assert np.abs(field).max() <= 1e-12 * max(1.0, scale**3)
    # The proof and the target do not depend on each other.
    assert network.retarget(2.0 * target).certified


@pytest.mark.parametrize("rate", RATES)
def test_a_shaped_network_follows_its_curve(rate):
    samples = bent()
    result = shape(samples, 2e-3, units=UNITS, options=ShapingOptions(rate=rate))
    assert result.success, result.message
    assert result.network.certified
    network = result.network
    way = network.trajectory(network.start(samples[0]), 30.0 / rate)
    states = network.visible(way(way.t[-1] * np.linspace(0.0, 1.0, 4000) ** 3))
    off = np.linalg.norm(((states[:, None] - samples[None]) * UNITS).reshape(4000, len(samples), -1), axis=2)
    # Either is near the other, up to half the distance of two samples.
    spacing = np.linalg.norm((np.diff(samples, axis=0) * UNITS).reshape(len(samples) - 1, -1), axis=1).max()
    assert off.min(axis=1).max() <= result.deviation + 0.5 * spacing
    assert off.min(axis=0).max() <= result.deviation + 0.5 * spacing
    assert result.deviation <= 2e-3
    np.testing.assert_allclose(states[-1], samples[-1], atol=1e-5)
    # The first number that suffices is taken, and gives the same network at once.
    again = shape(samples, 2e-3, units=UNITS, options=result.options)
    assert np.array_equal(again.network.weight, network.weight)
    assert network.n_hidden - network.n_clock == result.options.neurons[0] < 64


@pytest.mark.parametrize("rate", [1.0, 0.1])
def test_switch_fit_are_the_best_linear_fit_and_come_nearer_with_their_number(rate):
    samples = bent()
    found = [shape(samples, 1e-7, units=UNITS, options=ShapingOptions(rate, (count,))) for count in (4, 16, 64)]
    deviations = [one.deviation for one in found]
    assert deviations[0] > 5.0 * deviations[1] > 5.0 * deviations[2]
    assert deviations[1] < (5e-3 if rate < 1.0 else 2e-3)
    assert all(one.network.certified for one in found)
    assert [one.network.n_hidden - one.network.n_clock for one in found] == [4, 16, 64]


def test_ripples_that_the_deviation_hides_are_damped(monkeypatch):
    s = np.linspace(0.0, 1.0, 400)[:, None, None]
    before, after = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 1, 2, 6))
    # A corner, rounded over 2 % of the way.
    curve = Curve.through(s * before + np.hypot(s - 0.6, 0.02) * after, np.tile(UNITS, (2, 1)))
    cascade = Cascade(clockwork(1.0), curve.points[0], curve.points[-1])
    w = 1.0 - cascade.clock.g
    looks = np.unique(np.abs(w[:, None] - np.linspace(0.0, 0.99, 120)).argmin(axis=0))
    matrix = third_derivative(w[looks])
    # Exact for cubics, also between uneven instants.
    np.testing.assert_allclose(matrix @ (w[looks, None] ** [3, 2]), np.tile([6.0, 0.0], (len(matrix), 1)), atol=1e-7)
    middle = (w[looks][1:-2] > 0.1) & (w[looks][1:-2] < 0.85)
    ripples = []
    for weight in (shaping._RIPPLE, 1e-6):
        monkeypatch.setattr(shaping, "_RIPPLE", weight)
        states = cascade.states(fit_switches(cascade, curve, 64))[:-1]
        error = states - curve.at(shaping._pace(curve)(w))[0]
        assert np.abs(error).max() < 1e-5
        ripples.append(np.sqrt(np.mean(np.tensordot(matrix, error[looks], 1)[middle] ** 2)))
    assert ripples[0] < 0.2 * ripples[1]


def test_switch_fit_keep_axes_and_halves_that_rest():
    s = np.linspace(0.0, 1.0, 100)
    samples = np.zeros((100, 2, 6))
    axes = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]])
    samples[:, :, :3] = np.stack([np.sin(2.0 * s), s**2], axis=1)[:, :, None] * axes
    curve = Curve.through(samples, np.ones((2, 6)))
    cascade = Cascade(clockwork(1.0), curve.points[0], curve.points[-1])
    parameters = fit_switches(cascade, curve, 12)
    # All neurons turn, since nothing is shifted.
    assert (parameters.c[:, 0] > 0.0).all()
    assert not parameters.c[:, 1:].any()
    states = cascade.states(parameters)[:-1]
    along = np.einsum("knj,nj->kn", states[..., :3], axes)[..., None] * axes
    assert np.abs(states[..., :3] - along).max() < 1e-12
    assert not states[..., 3:].any()


def test_e_x_is_turned_to_any_direction():
    vectors = np.concatenate([np.random.default_rng(0).normal(size=(9, 3)), np.diag([2.0, 1.0, 1.0]), -np.eye(3)])
    turns = turns_to(vectors)
    sizes = np.linalg.norm(vectors, axis=1, keepdims=True)
    np.testing.assert_allclose(sizes * turns[..., 0], vectors, atol=1e-14)
    np.testing.assert_allclose(turns @ turns.swapaxes(1, 2), np.tile(np.eye(3), (len(turns), 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)
    np.testing.assert_array_equal(turns_to(np.zeros((1, 3))), np.eye(3)[None])


def test_the_search_keeps_a_time_budget(monkeypatch):
    looks = itertools.count()
    monkeypatch.setattr(budget, "cpu_time", lambda: float(next(looks)))
    with pytest.raises(OutOfTimeError), time_limit(3.0):
        shape(bent(), 1e-9)


@pytest.mark.parametrize(
    ("curve", "named", "message"),
    [
        (np.zeros((5, 2, 6)), {}, "must move"),
        (bent()[:1], {}, "at least two samples"),
        (np.zeros((5, 2, 5)), {}, "shape"),
        (bent(n=0), {}, "at least one neuron"),
        ([bent(), bent()], {}, "shape"),
        (bent(), {"deviation": 0.0}, "deviation must be positive"),
        (bent(), {"units": -1.0}, "units must be positive"),
        (bent(), {"units": np.ones(5)}, "units"),
        (3.0, {}, "curve"),
        (bent() * np.nan, {}, "finite"),
    ],
)
def test_bad_curves_are_refused(curve, named, message):
    with pytest.raises(InputError, match=message):
        shape(curve, **named)


@pytest.mark.parametrize(
    "options", [{"rate": 0.0}, {"rate": 1.5}, {"neurons": ()}, {"neurons": (1,)}, {"neurons": (257,)}]
)
def test_bad_options_are_refused(options):
    with pytest.raises(InputError):
        ShapingOptions(**options)
