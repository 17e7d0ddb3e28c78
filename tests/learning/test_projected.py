"""Algorithm 1 in its variants: what it must reach, and how it stops."""

from __future__ import annotations

import functools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import root

from lieednn_sim.budget import reporting
from lieednn_sim.errors import InputError
from lieednn_sim.learning import ALGORITHMS, StopReason, TrainingOptions, train
from lieednn_sim.learning.algorithms import ProjectedTraining
from lieednn_sim.learning.manifold import SE3Weights, block_view
from lieednn_sim.learning.sensitivity import EquilibriumSolver
from lieednn_sim.learning.training import TrainingProblem
from lieednn_sim.lie import adjoint, project_to_adjoint
from lieednn_sim.theory import group


def target(seed: int, neurons: int = 4, dimension: int = 6) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.8, 0.8, (neurons, dimension))


def test_tracked_learning_reaches_nearly_every_target_on_the_manifold():
    results = [trained(TrainingOptions.tracked(), seed) for seed in range(6)]
    assert sum(result.success for result in results) >= 5
    # Trials that were taken back leave gaps in the epochs, and no row.
    assert any(len(result.history) <= result.epochs for result in results)
    for history in (result.history for result in results):
        assert (np.abs(np.diff(history.equilibrium, axis=0)).max(axis=(1, 2)) > 0.0).all()
    for seed, result in enumerate(results):
        assert result.structure_error < 1e-12
        if not result.success:
            continue
        network = result.network
        assert network is not None
        # Afresh, by the network alone: the equilibrium next to the target, and the flow that stays there.
        found = network.equilibrium(target(seed))
        assert found.success
        assert found.spectral_abscissa < 0.0
        assert np.abs(found.xi - target(seed)).max() < 1e-5
        assert result.error == pytest.approx(np.abs(found.xi - target(seed)).max(), rel=1e-3)
        near = network.trajectory(target(seed) + 1e-3, 200.0)
        np.testing.assert_allclose(near.xi[-1], found.xi, atol=1e-5)


def test_repaired_algorithm_converges_where_the_printed_one_sticks():
    goal = target(4)
    repaired = train(goal, TrainingOptions(), seed=4)
    assert repaired.success
    assert repaired.reason is StopReason.CONVERGED
    assert repaired.history.accuracy[-1] == 1.0
    assert repaired.history.epoch[-1] == repaired.epochs
    assert repaired.epochs % 10 == 0
    printed = train(goal, TrainingOptions.literal(max_epochs=200), seed=4)
    assert not printed.success
    assert printed.reason is StopReason.EPOCHS_SPENT
    assert printed.error > 0.1
    # alpha never changes there, but the projected weights keep their structure.
    np.testing.assert_array_equal(printed.network.alpha, np.full((4, 4), 1.0 / 12.0))
    assert printed.structure_error < 1e-12


def test_ablation_reaches_the_target_and_loses_the_structure():
    result = train(target(5), TrainingOptions(projection="none"), seed=0)
    assert result.success
    assert result.network is None
    assert result.structure_error > 0.5
    assert np.abs(block_view(result.weight, 6)[..., :3, 3:]).max() > 0.01


def test_history_tells_what_happened():
    goal = target(5)
    history = train(goal, TrainingOptions(max_epochs=60), seed=0).history
    assert len(history) == 61
    np.testing.assert_array_equal(history.epoch, np.arange(61))
    delta = (history.equilibrium - goal).reshape(61, -1)
    np.testing.assert_allclose(history.error, np.linalg.norm(delta, axis=1), rtol=1e-12)
    np.testing.assert_array_equal(history.accuracy, (np.abs(delta) < 1e-5).mean(axis=1))
    fell = np.diff(history.error) < 0.0
    np.testing.assert_allclose(history.rate[1:-1] / history.rate[:-2], np.where(fell[:-1], 1.02, 0.9), rtol=1e-12)
    weight = train(goal, TrainingOptions(max_epochs=60), seed=0).weight
    assert history.one_norm[-1] == pytest.approx(np.linalg.norm(weight, 1))
    assert history.infinity_norm[-1] == pytest.approx(np.linalg.norm(weight, np.inf))


def test_rates_grow_and_shrink_within_their_bounds():
    least, most = 0.047, 0.052
    options = TrainingOptions(max_epochs=40, initial_rate=0.05, min_rate=least, max_rate=most)
    history, rate = train(target(5), options, seed=0).history, 0.05
    for error, before, found in zip(history.error[:-1], [np.inf, *history.error], history.rate[:-1], strict=False):
        rate = min(max(rate * (1.02 if error < before else 0.9), least), most)
        assert found == pytest.approx(rate, rel=1e-12)
    assert {least, most} < set(history.rate)


@pytest.mark.parametrize("direction", ["gradient", "gauss-newton"])
def test_strengths_change_by_their_part_of_the_step(direction):
    """A slope along the block of a unit strength; of the step itself, what is nearest to it along that block."""
    options = TrainingOptions(direction=direction)
    training = ProjectedTraining(TrainingProblem(target(0), target(1), 1.0, 1.0, "tanh", SE3Weights(), 0), options)
    now = training.initial(training.problem.initial_weight(0))
    then, _ = training._step(now)
    along = np.einsum("ijab,ijab->ij", block_view(now.weight - then.weight, 6), now.point.adjoints)
    size = (now.point.adjoints**2).sum(axis=(2, 3)) if direction == "gauss-newton" else 1.0
    np.testing.assert_allclose(now.alpha - then.alpha, along / size, rtol=1e-9)


def test_the_printed_algorithm_stops_where_every_coordinate_is_near():
    options = TrainingOptions.literal(projection="none", equilibrium="newton", period=1, tolerance=0.1)
    result = train(target(0, 2), options, seed=0)
    near = np.abs(result.history.equilibrium - target(0, 2)).max(axis=(1, 2)) < 0.1
    assert result.reason is StopReason.CONVERGED
    # It makes one more step.
    assert near.argmax() == result.epochs - 1
    assert result.history.error[near.argmax()] > 0.1


def test_literal_is_algorithm_1_transcribed():
    """Line by line from the paper, entry by entry, with the equilibrium from the careful solver."""
    goal, period, rate = target(0, 2), 4, 0.02
    options = TrainingOptions.literal(max_epochs=10, period=period, initial_rate=rate)
    result = train(goal, options, seed=7)
    weight = np.random.default_rng([7, 0]).uniform(-1.0, 1.0, (12, 12))
    weight = weight / (1e-12 + np.linalg.norm(weight, 1))
    alpha, bias, xi_d, errors = np.full((2, 2), 1.0 / 6.0), np.full(12, 0.125), goal.ravel(), [np.inf]
    for k in range(1, 11):
        x = root(lambda y, w=weight: y - w @ np.tanh(y) - bias, np.zeros(12), tol=1e-13).x
        delta = x - xi_d
        errors.append(np.linalg.norm(delta))
        rate = np.clip(rate * (1.02 if errors[-1] < errors[-2] else 0.9), 0.002, 0.2)
        inverse = np.linalg.inv(np.eye(12) - weight * (1.0 - np.tanh(x) ** 2))
        step = np.zeros((12, 12))
        for i in range(12):
            for j in range(12):
                step[i, j] = np.tanh(x[j]) / errors[-1] * delta @ inverse @ np.eye(12)[i]
        weight = weight - rate * step
        if k % period == 0:
            for i in range(2):
                for j in range(2):
                    block = (slice(6 * i, 6 * i + 6), slice(6 * j, 6 * j + 6))
                    weight[block] = alpha[i, j] * adjoint(*project_to_adjoint(weight[block] / alpha[i, j]))
    # What is left after epoch 10 is not on the manifold: the result is the last projection, of the weights then.
    np.testing.assert_allclose(result.history.error[:10], errors[1:], rtol=1e-4)
    assert result.history.one_norm[0] == pytest.approx(1.0, abs=1e-9)
    assert result.history.rate[9] == pytest.approx(rate, rel=1e-12)
    for i in range(2):
        for j in range(2):
            block = weight[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
            last = alpha[i, j] * adjoint(*project_to_adjoint(block / alpha[i, j]))
            np.testing.assert_allclose(result.weight[6 * i : 6 * i + 6, 6 * j : 6 * j + 6], last, atol=1e-4)


@pytest.mark.parametrize("algorithm", ["literal", "repaired", "tracked"])
def test_same_seed_same_result_and_other_seed_another(algorithm):
    options = ALGORITHMS[algorithm].load()(max_epochs=60)
    one, two, other = (train(target(1, 2), options, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.weight, two.weight)
    assert one.history == two.history
    assert (one.reason, one.epochs) == (two.reason, two.epochs)
    assert not np.array_equal(one.weight, other.weight)


@functools.cache
def trained(options, seed):
    return train(target(seed), options, seed=seed)


# In most epochs from 55 to 75 Newton's method fails here, and the network is run instead.
SETTLING = TrainingOptions(max_epochs=150, period=1)


def test_where_newton_steps_find_no_equilibrium_the_network_is_run():
    """The jump is far, so the one from which training goes on must attract: checked by a fresh network."""
    result = trained(SETTLING, 0)
    assert result.reason is StopReason.EPOCHS_SPENT
    assert result.epochs == 150
    # Without it this training ended as lost at epoch 55; after it the equilibrium has jumped by more than 1.
    jumps = np.abs(np.diff(result.history.equilibrium, axis=0)).max(axis=(1, 2))
    assert jumps[:50].max() < 0.5 < 1.0 < jumps[54:76].max()
    # From zero as well: the last point of the history is an equilibrium of the last weights.
    found = result.network.equilibrium(result.history.equilibrium[-1])
    assert found.success
    np.testing.assert_allclose(found.xi, result.history.equilibrium[-1], atol=1e-5)
    assert found.spectral_abscissa < 0.0


def test_a_network_without_rest_is_given_up():
    """A rotation in the plane of gain 3 has its only equilibrium at zero, and that repels: a limit cycle remains."""
    turning = 3.0 * np.array([[1.0, -1.0], [1.0, 1.0]])
    solver = EquilibriumSolver(np.full(2, 1e-3), 1.0, "tanh")
    assert not solver.settled(turning, np.array([0.5, 0.0])).success
    still = solver.settled(0.1 * turning, np.array([50.0, -50.0]))
    assert still.success
    np.testing.assert_allclose(still.x, 0.1 * turning @ np.tanh(still.x) + 1e-3, atol=1e-12)
    # Weights beyond all measure: neither a hang nor a false find.
    assert not solver.settled(1e100 * turning, np.array([0.5, 0.0])).success


def test_lost_equilibrium_and_instability_stop_the_training_with_their_reason():
    wild = {"initial_rate": 5.0, "min_rate": 5.0, "max_rate": 5.0, "max_epochs": 500}
    assert train(target(0), TrainingOptions(**wild), seed=0).reason is StopReason.LOST_EQUILIBRIUM
    unstable = TrainingOptions(initial_rate=0.5, min_rate=0.5, max_rate=0.5, stability_interval=10)
    results = [train(target(seed), unstable, seed=seed) for seed in range(6)]
    assert StopReason.UNSTABLE in {result.reason for result in results}
    assert not any(result.success for result in results if result.reason is StopReason.UNSTABLE)
    vanished = TrainingOptions.tracked(max_jump=1e-9, restarts=0)
    result = train(target(0), vanished, seed=0)
    assert result.reason is StopReason.STEP_VANISHED
    assert result.message.startswith("step vanished after 10 epochs: ")  # of half the rate each, from 1 to below 1e-3


def test_it_stops_where_the_equilibrium_bifurcates_and_is_not_content_with_one_that_repels(monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(EquilibriumSolver, "sensitivity", lambda *_: SimpleNamespace(singular=True))
        assert train(target(0), TrainingOptions(), seed=0).reason is StopReason.LOST_EQUILIBRIUM
    monkeypatch.setattr(ProjectedTraining, "stable", lambda *_: False)
    options = TrainingOptions.tracked(stability_interval=10**6, restarts=0)
    assert train(target(0), options, seed=0).reason is StopReason.UNSTABLE


def test_a_trial_that_loses_its_equilibrium_is_repeated_and_the_network_not_run(monkeypatch):
    newton = EquilibriumSolver.newton

    def lost(self, weight, x, nearby=None, **options):
        return newton(self, weight, x, nearby, **options)._replace(success=nearby is None)

    monkeypatch.setattr(EquilibriumSolver, "newton", lost)
    monkeypatch.setattr(EquilibriumSolver, "settled", None)
    assert train(target(0), TrainingOptions.tracked(restarts=0), seed=0).reason is StopReason.STEP_VANISHED


def test_restarts_are_counted_and_their_epochs_too():
    hopeless = TrainingOptions.tracked(restarts=3, max_start_epochs=5, max_epochs=20, tolerance=1e-12)
    result = train(target(0), hopeless, seed=0)
    assert (result.starts, result.epochs, result.reason) == (4, 20, StopReason.EPOCHS_SPENT)
    # The history is that of the last start, without the trials that were taken back.
    assert 1 < len(result.history) <= 6
    assert result.history.epoch[0] >= 15
    assert result.history.epoch[-1] == 20


@pytest.mark.parametrize(("name", "neurons"), [("SO(3)", 4), ("SE(2)", 4), ("SU(2)", 4), ("H^x", 2)])
def test_learning_runs_on_other_groups(name, neurons):
    chosen = group(name)
    goal = target(4, neurons, chosen.dimension)
    result = train(goal, TrainingOptions.tracked(max_epochs=2000), group=chosen, seed=1)
    assert result.success
    assert result.structure_error < 1e-9
    assert result.network.group is chosen
    assert np.abs(result.network.equilibrium(goal).xi - goal).max() < 1e-5


@pytest.mark.parametrize("name", ["SE(3)", "SU(3)"])
def test_learning_gets_closer_where_the_projection_is_slow(name):
    chosen = group(name)
    goal = target(3, 2, chosen.dimension)
    result = train(goal, TrainingOptions.tracked(max_epochs=12), group=chosen, seed=1)
    assert result.history.error[-1] < 0.8 * result.history.error[0]
    assert result.structure_error < 1e-9


def test_other_rates_and_activation():
    result = train(target(4), TrainingOptions.tracked(), gamma=2.0, mu=0.5, activation="arctan", bias=0.3, seed=2)
    assert result.success
    assert (result.network.gamma, result.network.mu, result.network.activation) == (2.0, 0.5, "arctan")


def test_a_strong_bias_puts_the_first_equilibrium_far_away():
    result = train(10.0 + target(0), TrainingOptions.tracked(restarts=0, max_epochs=200), bias=10.0, seed=0)
    assert np.abs(result.history.equilibrium[0]).min() > 8.0
    assert result.history.error[-1] < 0.5 * result.history.error[0]


def test_first_weights_can_be_chosen():
    given = np.random.default_rng(0).normal(size=(24, 24)) / 100.0
    first = train(target(0), TrainingOptions(max_epochs=1), initial_weight=given, seed=1).history
    assert first.one_norm[0] == pytest.approx(np.linalg.norm(given, 1))
    # Learning goes on from a network that is near: the equilibrium is already there.
    learned = trained(TrainingOptions.tracked(), 0)
    again = train(target(0), TrainingOptions.tracked(), initial_weight=learned.weight, seed=1)
    assert again.success
    assert again.epochs <= 2
    nearby = train(target(0) + 1e-3, TrainingOptions.tracked(), initial_weight=learned.weight, seed=1)
    assert nearby.epochs < learned.epochs


def test_progress_is_reported():
    calls: list[tuple[int, int]] = []
    with reporting(lambda done, total: calls.append((done, total))):
        train(target(0), TrainingOptions(max_epochs=35))
    assert calls == [(10, 35), (20, 35), (30, 35), (35, 35)] + [(35, 35)] * (len(calls) - 4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"direction": "up"}, "no direction 'up'; allowed: gauss-newton, gradient"),
        ({"projection": "best"}, "no projection 'best'; allowed: block-wise, exact, none, scaled"),
        ({"period": 0}, "period must be at least 1"),
        ({"tolerance": -1.0}, "tolerance must be positive"),
        ({"initial_rate": 1.0}, "initial_rate must be from min_rate 0.002 to max_rate 0.2"),
        ({"shrink": 1.5}, "shrink must be below 1"),
        ({"restarts": -1}, "restarts must be at least 0"),
    ],
)
def test_options_say_what_is_wrong(change, message):
    with pytest.raises(InputError, match=message):
        TrainingOptions(**change)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"target": np.zeros((4, 5))}, r"target must have shape \(N, 6\)"),
        ({"target": np.zeros((0, 6))}, "N >= 1"),
        ({"target": np.full((1, 6), np.nan)}, "target must be finite"),
        ({"bias": np.zeros((3, 6))}, r"bias must have shape \(4, 6\)"),
        ({"gamma": 0.0}, "gamma must be positive"),
        ({"activation": "relu"}, "no activation 'relu'"),
        ({"group": "SE(3)"}, "group must be a MatrixLieGroup or"),
        ({"seed": -1}, "seed must be a whole number >= 0"),
        ({"bias": 0.0}, "bias must not be zero"),
        ({"initial_weight": np.zeros((6, 6))}, r"initial_weight must have shape \(24, 24\)"),
        ({"options": {"period": 3}}, "options must be TrainingOptions or RiemannianOptions, got a dict"),
    ],
)
def test_bad_input_is_named(arguments, message):
    with pytest.raises(InputError, match=message):
        train(**{"target": target(0), **arguments})
