"""Rival models: they follow what they were shown, and their constraints hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations import Demonstration, align
from lieednn_sim.learning.demonstrations.alignment import displacement
from lieednn_sim.learning.demonstrations.models import LinearAttractor, StableMixture, at_times, even_grid, run_field
from lieednn_sim.learning.demonstrations.primitives import DynamicPrimitive, ProbabilisticPrimitive
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.lie.se3 import twist_of
from lieednn_sim.synthesis import ShapingOptions


def test_linear_attractor_is_straight(posed):
    model = LinearAttractor.fit(posed)
    path = model.reproduce(posed.mean[0], np.array([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(path, posed.mean[0] * [[1.0], [0.1], [0.01]])


def test_runge_and_kutta_on_a_rotation():
    path = run_field(
        lambda x: x @ np.array([[0.0, 1.0], [-1.0, 0.0]]),
        np.array([[1.0, 0.0]]),
        even_grid(1.0, 0.1),
        np.array([0.0, 1.0]),
    )
    np.testing.assert_allclose(path[0, 1], [np.cos(1.0), np.sin(1.0)], atol=1e-6)


def test_a_primitive_without_forcing_is_critically_damped():
    # p'' = 25 (-6.25 p - p') from rest at 1: (1 + 12.5 t) e^(-12.5 t), which is 0.29 at a fifth of the duration.
    model = DynamicPrimitive(np.zeros((3, 6)), 2.0, 3)
    path = model.reproduce(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.4, 2.0]))
    np.testing.assert_allclose(path[:, 3], [1.0, 3.5 * np.exp(-2.5), 13.5 * np.exp(-12.5)], atol=2e-2)
    np.testing.assert_allclose(path[:, [0, 1, 2, 4, 5]], 0.0)


@pytest.mark.parametrize("name", ["planar", "posed"])
def test_a_primitive_follows_the_mean_in_time(name, request):
    shown = request.getfixturevalue(name)
    model = DynamicPrimitive.fit(shown, 60)
    assert model.n_parameters == 60
    t = np.linspace(0.0, shown.duration, 50)
    wanted = displacement(at_times(shown.mean[None], shown.t, t))[0]
    found = displacement(model.reproduce(shown.mean[0], t))
    np.testing.assert_allclose(found, wanted, atol=4e-3)
    # Another start is forgotten, and what was not shown stays as it is.
    other = shown.mean[0] + [0.0, 0.0, 0.0, 0.1, -0.1, 0.0]
    late = model.reproduce(np.stack([other, shown.mean[0]]), 3.0 * t)
    np.testing.assert_allclose(late[:, -1], 0.0, atol=1e-3)
    if name == "planar":
        np.testing.assert_array_equal(late[..., [0, 1, 2, 5]], 0.0)


@pytest.mark.parametrize("name", ["planar", "posed"])
def test_a_probabilistic_primitive_goes_from_any_start_as_the_demonstrations_would(name, request):
    shown = request.getfixturevalue(name)
    model = ProbabilisticPrimitive.fit(shown, 60)
    assert model.n_parameters == 60
    t = np.linspace(0.0, shown.duration, 50)
    paths = displacement(at_times(shown.twists, shown.t, t))
    found = displacement(model.reproduce(shown.twists[:, 0], t))
    # Each demonstration from its own start, though only their distribution was kept; ends are exact.
    np.testing.assert_allclose(found, paths, atol=1e-2)
    np.testing.assert_allclose(found[:, [0, -1]], paths[:, [0, -1]], atol=1e-9)
    # What was not shown stays as it is, and after the duration all rest.
    other = shown.mean[0] + [0.0, 0.0, 0.0, 0.1, -0.1, 0.0]
    late = model.reproduce(other, 3.0 * t)
    np.testing.assert_allclose(late[-30:], 0.0, atol=1e-9)
    if name == "planar":
        np.testing.assert_array_equal(late[..., [0, 1, 2, 5]], 0.0)


@pytest.mark.parametrize("name", ["planar", "posed"])
def test_a_stable_mixture_obeys_its_lyapunov_function_and_the_demonstrations(name, request):
    shown = request.getfixturevalue(name)
    model = StableMixture.fit(shown, 64 * 2)
    d = shown.dof
    assert model.n_parameters == (132 if d == 2 else 148)  # 13 components of 10 and 2 more, or 2 of 64 and 20 more
    for law in model.laws:
        falls = np.linalg.eigvalsh(model.lyapunov @ law + law.T @ model.lyapunov)
        assert falls.max() < -0.1
    x = np.random.default_rng(0).normal(size=(100, d))
    rate = np.einsum("ni,ij,nj->n", x, model.lyapunov, model.velocity(x))
    assert (rate < 0.0).all()
    np.testing.assert_allclose(model.velocity(np.zeros((1, d))), 0.0, atol=1e-15)
    # The least squares find what a straight line does not.
    t = np.linspace(0.0, 3.0 * shown.duration, 400)
    path = displacement(model.reproduce(shown.mean[0], t))
    wanted = displacement(shown.mean)
    off = np.linalg.norm(path[None, :, 3:] - wanted[:, None, 3:], axis=-1).min(axis=1)
    assert off.max() < 0.03
    np.testing.assert_allclose(path[-1], 0.0, atol=2e-2)


def test_the_mixture_is_fitted_along_its_gradient(planar):
    # With one component and no bend to follow the fit is a linear law, and the best one is known.
    line = planar.twists * 0.0
    line[..., 3] = 0.5 * np.exp(-3.0 * planar.t / planar.duration)
    line[..., 4] = 0.3 * np.exp(-3.0 * planar.t / planar.duration)
    model = StableMixture.fit(replace(planar, twists=line), 10)
    x = np.array([[1.0, 0.6]])
    np.testing.assert_allclose(model.velocity(x), -3.0 * x, rtol=3e-2)


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_a_shaped_network_follows_the_mean_and_forgets_the_start_as_fast_as_it_should(planar, rate):
    model = ShapedMotion.fit(planar, 2e-3, ShapingOptions(rate=rate), family=False)
    assert model.shaping.success
    assert model.network.certified
    t = np.linspace(0.0, planar.duration, 80)
    wanted = at_times(planar.mean[None], planar.t, t)[0]
    path = model.reproduce(np.stack([planar.mean[0], planar.mean[0] + np.eye(6)[3] * 0.1]), t)
    np.testing.assert_allclose(path[0], wanted, atol=8e-3)
    # What is off decays with the visible neurons' own rate: x' = -x + what does not depend on x.
    tau = np.interp(t, model.t, model.tau)
    np.testing.assert_allclose(path[1, :, 3] - path[0, :, 3], 0.1 * np.exp(-tau), atol=1e-5)
    for times, message in (([], "increasing"), ([1.0, 0.0], "increasing"), ([-1.0, 1.0], "got -1 to 1 s")):
        with pytest.raises(InputError, match=message):
            model.reproduce(planar.mean[0], times)
    with pytest.raises(InputError, match=f"t must be from 0 to {100 * planar.duration:g} s"):
        model.reproduce(planar.mean[0], [0.0, 101.0 * planar.duration])
    # The same by the integrator of the package.
    way = model.network.trajectory(model.network.start(planar.mean[:1]), tau[40])
    np.testing.assert_allclose(path[0, 40], model.network.visible(way.xi[-1])[0], atol=2e-5)


def test_a_turn_that_is_off_does_not_drag_the_position_along(posed):
    model = ShapedMotion.fit(posed, options=ShapingOptions(neurons=(2,)), family=False)
    off = np.array([0.4, -0.2, 0.3, 0.0, 0.05, -0.1])
    start = displacement(posed.mean[0])
    path = displacement(model.reproduce(twist_of(np.stack([start, start + off])), posed.t))
    np.testing.assert_allclose(path[1] - path[0], np.exp(-model.tau)[:, None] * off, atol=5e-5)


@pytest.mark.parametrize("half_turns", [0.7, 1.4, 1.75])
def test_turns_beyond_pi_are_made_as_shown_from_a_given_start(half_turns):
    """Its rotation alone does not tell which way round the frame turned."""
    s = np.linspace(0.0, 1.0, 100)
    turn = Rotation.from_rotvec(np.outer(s, half_turns * np.pi * np.array([0.6, 0.0, 0.8])))
    columns = np.column_stack([0.3 * (1.0 - s), 0.1 * np.sin(np.pi * s), 0.0 * s, turn.as_quat(scalar_first=True)])
    shown = align([Demonstration.from_samples(columns)])
    model = ShapedMotion.fit(shown, family=False)
    poses = model.poses()
    for goal in (None, poses[-1]):
        given = model.poses(poses[0], goal)
        assert (given.rotation * poses.rotation.inv()).magnitude().max() < 1e-5
        np.testing.assert_allclose(given.translation, poses.translation, atol=1e-6)
    # A primitive turns that way, too.
    t = np.linspace(0.0, shown.duration, 50)
    wanted = displacement(at_times(shown.mean[None], shown.t, t))[0]
    np.testing.assert_allclose(
        displacement(DynamicPrimitive.fit(shown, 90).reproduce(shown.mean[0], t)), wanted, atol=0.1
    )


def test_a_fit_does_not_depend_on_the_threads_of_blas(planar):
    fits = []
    for threads in (1, 2):
        with threadpool_limits(threads, "blas"):
            fits.append(ShapedMotion.fit(planar, options=ShapingOptions(neurons=(16,))).network)
    assert fits[0] == fits[1]
    # No start at all has no motion.
    assert ShapedMotion.fit(planar, family=False).reproduce(np.empty((0, 6)), planar.t).shape == (0, len(planar.t), 6)


def test_numbers_of_a_placed_switch_are_its_place_its_slope_and_a_vector(planar):
    model = ShapedMotion.fit(planar, options=ShapingOptions(neurons=(8,)), family=False)
    network = model.network
    hidden = slice(1, None)
    counted = np.count_nonzero(network.bias[hidden]) + np.count_nonzero(network.hidden_start)
    # In the plane two entries of the vector; the other four of each column are zero, or as good as.
    counted += np.count_nonzero(np.abs(network.weight[:6, 6:].reshape(6, 8, 6)[:, :, 3]) > 1e-9)
    assert model.n_parameters == counted == 4 * 8
