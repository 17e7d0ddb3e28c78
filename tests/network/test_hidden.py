"""Hidden neurons: what a network is with them, where it rests, how it is retargeted, and the file that keeps it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.network.stepping import RungeKuttaStepper

seeds = st.integers(0, 2**32 - 1)
sizes = st.tuples(st.integers(1, 3), st.integers(0, 3), st.integers(0, 3)).filter(lambda sizes: sizes[2] <= sizes[1])


def random_network(seed: int, n_visible: int, n_hidden: int, n_clock: int, *, layered: bool) -> LieEDNN:
    """Weak enough that the equilibrium is unique, whoever listens to whom."""
    rng, n = np.random.default_rng(seed), n_visible + n_hidden
    alpha = rng.uniform(-0.8, 0.8, (n, n)) / n
    if layered:
        alpha[n_visible:, :n_visible] = 0.0
    return LieEDNN(
        alpha,
        Rotation.random(n * n, rng=rng).as_matrix().reshape(n, n, 3, 3),
        0.3 * rng.normal(size=(n, n, 3)),
        rng.normal(size=(n, 6)),
        gamma=1.3,
        mu=0.9,
        hidden_start=3.0 * rng.normal(size=(n_hidden, 6)),
        n_clock=n_clock,
    )


@settings(max_examples=20)
@given(seeds, sizes, st.booleans())
def test_retargeting_is_exact_for_the_visible_and_leaves_the_bias_of_the_hidden(seed, sizes, layered):
    network = random_network(seed, *sizes, layered=layered)
    visible = sizes[0]
    target = np.random.default_rng(seed).uniform(-3.0, 3.0, (visible, 6))
    moved = network.retarget(target)
    assert np.array_equal(moved.bias[visible:], network.bias[visible:])
    assert np.array_equal(moved.hidden_start, network.hidden_start)
    goal = moved.goal(target)
    assert np.array_equal(moved.visible(goal), target)
    assert np.abs(moved.vector_field(goal)).max() < 1e-9
    found = moved.equilibrium(moved.start(np.zeros((visible, 6))))
    assert found.success
    np.testing.assert_allclose(found.xi, goal, atol=1e-9)
    if layered:
        # Hidden neurons that hear no visible ones rest where they rested.
        assert np.array_equal(goal[visible:], network.goal(-target)[visible:])


@settings(max_examples=10)
@given(seeds, sizes)
def test_a_start_may_depend_on_the_visible_one(tmp_path_factory, seed, sizes):
    network, rng = random_network(seed, *sizes, layered=True).try_certify(), np.random.default_rng(seed)
    visible, hidden = sizes[0], network.n_hidden
    gain, reference = rng.normal(size=(6 * hidden, 6 * visible)), rng.normal(size=(visible, 6))
    family = network.with_start(2.0 * network.hidden_start, gain, reference)
    # The same as made from its parts; the network itself is as it was.
    parts = {"hidden_start": 2.0 * network.hidden_start, "start_gain": gain, "start_reference": reference}
    assert family == dataclasses.replace(network, **parts)
    assert network.start_gain is None
    assert family.certificate == network.certificate
    xi = rng.normal(size=(visible, 6))
    wanted = 2.0 * network.hidden_start.ravel() + gain @ (xi - reference).ravel()
    np.testing.assert_allclose(family.start(xi)[visible:].ravel(), wanted, atol=1e-12)
    np.testing.assert_array_equal(family.start(reference)[visible:], family.hidden_start)
    np.testing.assert_allclose(family.goal(xi), network.goal(xi), atol=1e-9)
    # A code is a start that does not depend on the visible one.
    code = family.start(xi)[visible:]
    np.testing.assert_array_equal(family.with_start(code).start(reference)[visible:], code)
    path = tmp_path_factory.mktemp("file") / "n.npz"
    family.save(path)
    assert LieEDNN.load(path) == family
    # With a gain of the goal the code moves with the target, in one step or in two.
    there = network.visible(network.goal(xi))
    family = family.retarget(there).with_start(family.hidden_start, gain, reference, goal_gain := 0.1 * gain[::-1])
    family.save(path)
    assert LieEDNN.load(path) == family
    shift = rng.normal(size=(2, visible, 6))
    for moved in (family.retarget(there + shift[0]), family.retarget(there + shift[1]).retarget(there + shift[0])):
        wanted = family.hidden_start.ravel() + goal_gain @ shift[0].ravel()
        np.testing.assert_allclose(moved.hidden_start.ravel(), wanted, atol=1e-8)
        assert moved.certificate == network.certificate
    with pytest.raises(InputError, match="goal_gain needs both"):
        network.with_start(network.hidden_start, goal_gain=gain)
    with pytest.raises(InputError, match="start_gain and start_reference must be given together, or neither"):
        network.with_start(network.hidden_start, gain)
    with pytest.raises(InputError, match=r"start_gain must have shape \(\d+, \d+\), got \(1, 1\)"):
        network.with_start(network.hidden_start, np.zeros((1, 1)), reference)


def test_a_motion_moves_with_its_target(cascade):
    rng = np.random.default_rng(2)
    network = cascade(np.full((2, 6), 0.3))
    gain, reference = 0.3 * rng.normal(size=(6 * network.n_hidden, 12)), np.zeros((2, 6))
    family = network.with_start(network.hidden_start, gain, reference)
    begin, shift = rng.normal(size=(2, 2, 6))
    # In two steps, the second of which does not search for where it comes from.
    moved = family.retarget(network.visible(network.goal(np.full((2, 6), 0.3))) + 0.4 * shift).retarget(0.3 + shift)
    np.testing.assert_allclose(moved.start_reference, shift, atol=1e-12)
    paths = [
        one.visible(one.trajectory(one.start(x), 9.0, rtol=1e-10, atol=1e-12)(np.linspace(0.0, 9.0, 20)))
        for one, x in ((family, begin), (moved, begin + shift), (family, begin + 0.1))
    ]
    np.testing.assert_allclose(paths[1], paths[0] + shift, atol=1e-8)
    # Another start is another motion, not one that fades into the first as e^-t.
    fading = 0.1 * np.exp(-np.linspace(0.0, 9.0, 20))[:, None, None]
    assert np.abs(paths[2] - paths[0] - fading).max() > 1e-3


def test_a_cascade_by_hand(cascade):
    target = np.linspace(-0.5, 0.6, 12).reshape(2, 6)
    network = cascade(target)
    assert repr(network) == (
        "<LieEDNN: 5 neurons (2 visible, 2 hidden, 1 of the clock) of 6 coordinates, gamma 1, mu 1, certified>"
    )
    assert network.assess().globally_stable
    # At rest the clock is at zero, and so the hidden neurons at their bias.
    rest = np.array([[-0.5] * 6, [0.4] * 6, [0.0] * 6])
    np.testing.assert_allclose(network.goal(target), [*target, *rest], atol=1e-12)
    pushed = network.blocks[:2, 2] @ np.tanh(rest[0]) + network.blocks[:2, 3] @ np.tanh(rest[1])
    np.testing.assert_allclose(network.bias[:2], target - pushed, atol=1e-12)
    # The proof is handed over, and holds for the start of every neuron.
    elsewhere = network.retarget(-target)
    assert elsewhere.certificate is network.certificate
    ended = elsewhere.trajectory(elsewhere.start(target), 100.0, rtol=1e-10, atol=1e-12).xi[-1]
    np.testing.assert_allclose(ended, [*-target, *rest], atol=1e-7)


@settings(max_examples=5)
@given(seeds, st.sampled_from([1.0, 0.3, 0.1]))
def test_a_cascade_of_steep_switches_is_certified_by_the_slowest_layer(seed, rate):
    """Blocks of size 60 from the clock to the hidden neurons and of size 5 on from them; the clock decays at a rate."""
    rng = np.random.default_rng(seed)
    alpha = np.zeros((7, 7))
    alpha[:2, 2:6], alpha[2:6, 6], alpha[6, 6] = 5.0 * rng.normal(size=(2, 4)), rng.uniform(-60.0, 60.0, 4), 1.0 - rate
    rotation = Rotation.random(49, rng=rng).as_matrix().reshape(7, 7, 3, 3)
    rotation[6, 6] = np.eye(3)
    start = rng.uniform(-60.0, 60.0, (5, 6))
    network = LieEDNN(alpha, rotation, rng.normal(size=(7, 7, 3)), np.zeros((7, 6)), hidden_start=start, n_clock=1)
    certificate = network.certify().certificate
    assert certificate.lambda_max == pytest.approx(1.0 - rate, abs=0.02)


def test_a_trajectory_ends_though_a_saturated_neuron_is_known_less_well_than_the_distance():
    """The integrator keeps a state of size 30 to 30 rtol only; what the neuron sends on is as good as ever."""
    turn, still = np.tile(np.eye(3), (2, 2, 1, 1)), np.zeros((2, 2, 3))
    bias = np.array([np.full(6, 0.3), np.full(6, -30.0)])
    network = LieEDNN([[0.0, 0.7], [0.0, 0.0]], turn, still, bias, hidden_start=[np.full(6, 30.0)])
    goal = network.equilibrium().xi
    trajectory = network.trajectory(network.start(np.ones((1, 6))), 60.0, until=goal, distance=1e-8)
    assert trajectory.t[-1] < 30.0
    assert np.abs(network.visible(trajectory.xi[-1] - goal)).max() <= 1.01e-8


def test_hidden_neurons_without_rest_are_refused():
    network = random_network(5, 1, 2, 0, layered=False)
    wild = dataclasses.replace(network, alpha=30.0 * network.alpha)
    with pytest.raises(InputError, match="hidden neurons do not come to rest while the visible ones are at xi"):
        wild.retarget(np.ones((1, 6)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"hidden_start": np.zeros((2, 3))}, r"hidden_start must have shape \(M, 6\), got \(2, 3\)"),
        ({"hidden_start": np.zeros((3, 6))}, "hidden_start must hold fewer neurons than the network, which has 3 "),
        ({"n_clock": 3}, "n_clock must be at most 2, the number of hidden neurons, got 3"),
        ({"n_clock": 0.5}, r"n_clock must be a whole number, got 0\.5"),
    ],
)
def test_wrong_parts_are_named(change, words):
    with pytest.raises(InputError, match=words):
        dataclasses.replace(random_network(0, 1, 2, 1, layered=True), **change)


def test_neurons_without_inputs_are_the_same_as_ever():
    """By the formulas with the whole W, whose rows of zeros a network leaves out."""
    full = random_network(5, 2, 4, 0, layered=True)
    alpha = full.alpha.copy()
    alpha[2:] = 0.0
    network, rng = dataclasses.replace(full, alpha=alpha), np.random.default_rng(6)
    assert network.n_driven == 2
    assert network.driven_weight.shape == (12, 36)
    x, weight = rng.normal(size=(3, 6, 6)), network.weight
    flat = x.reshape(3, -1)
    rate = -1.3 * flat + 0.9 * (np.tanh(flat) @ weight.T + network.bias.ravel())
    np.testing.assert_allclose(network.vector_field(x).reshape(3, -1), rate, atol=1e-12)
    np.testing.assert_allclose(network.flat_vector_field(flat[0]), rate[0], atol=1e-12)
    slopes = 0.9 * weight * (1.0 - np.tanh(flat[0]) ** 2) - 1.3 * np.eye(36)
    np.testing.assert_allclose(network.jacobian(x[0]), slopes, atol=1e-12)
    found = network.equilibrium()
    assert found.success
    assert np.abs(network.vector_field(found.xi)).max() < 1e-11
    assert found.spectral_abscissa == pytest.approx(np.linalg.eigvals(network.jacobian(found.xi)).real.max())
    np.testing.assert_allclose(network.goal(found.xi[:2]), found.xi, atol=1e-12)
    stepper = RungeKuttaStepper(network)
    np.testing.assert_allclose(stepper.drive(flat[0]), 0.9 / 1.3 * weight @ np.tanh(flat[0]), atol=1e-12)
    # Visible neurons that inhibit themselves decay faster than the others, which then are the slowest.
    fast = LieEDNN(np.diag([-0.5, 0.0]), np.tile(np.eye(3), (2, 2, 1, 1)), np.zeros((2, 2, 3)), np.zeros((2, 6)))
    assert fast.n_driven == 1
    assert fast.equilibrium().spectral_abscissa == pytest.approx(-1.0)
    pull = 0.9 / 1.3 * network.bias.ravel()
    after, _ = stepper.step(flat[0], stepper.drive(flat[0]), pull, 0.13)
    by_field = runge_kutta_step(network.flat_vector_field, flat[0], 0.1)
    np.testing.assert_allclose(after, by_field, atol=1e-12)
