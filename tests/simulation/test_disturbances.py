"""Disturbances against statics: how far servos yield to a force, a weight, or what they measure."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.metrics import evaluate
from lieednn_sim.policies import make_policy
from lieednn_sim.simulation import Disturbances, Push, Simulation, follow, simulate, simulate_many

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def arm():
    return Arm.load("telescopic_pr")


@settings(max_examples=3)
@given(seed=seeds)
def test_servos_yield_to_a_payload_by_its_moment_over_their_stiffness(arm, travel, seed):
    rng = np.random.default_rng(seed)
    q = arm.keyframe("home") + 0.1 * rng.uniform(-1, 1, 8) * np.ptp(arm.position_limits, axis=1) * 0.3
    kilograms = float(rng.uniform(0.1, 2.0))
    rollout = simulate(arm, travel(arm, q, q, 0.01), hold=1.5, disturbances=Disturbances(payload=kilograms))
    moment = arm.jacobian(rollout.q[-1])[3:].T @ [0.0, 0.0, -9.81 * kilograms]
    np.testing.assert_allclose(rollout.q[-1] - q, moment / arm.model.actuator_gainprm[:, 0], rtol=1e-3, atol=1e-8)


def test_every_disturbance_has_its_words():
    given = [entry.name for entry in dataclasses.fields(Disturbances) if isinstance(entry.default, float)]
    assert len(Disturbances(**dict.fromkeys(given, 1.5)).conditions) == len(given)
    assert Disturbances().conditions == Disturbances().unknown_loads == []
    pushed = Disturbances(pushes=(Push("link 1", (0.0, 0.0, 1.0), 0.1, 1.0),), payload=0.5, velocity_noise=0.1)
    assert pushed.unknown_loads == ["payload 0.5 kg", "pushes"]


def test_a_push_acts_while_it_lasts_and_recovery_is_measured(arm, travel):
    q = arm.keyframe("home")
    hand = arm.model.body(arm.frames.bodies[-1]).name
    first, second = Push("end effector", (0.0, 40.0, 0.0), 0.1, 1.0), Push(hand, (0.0, 0.0, 30.0), 1.6, 0.1)
    rollout = simulate(arm, travel(arm, q, q, 0.02), hold=2.5, disturbances=Disturbances(pushes=(second, first)))
    moved = np.abs(rollout.q - q).max(axis=1)
    began = np.flatnonzero(moved > 1e-9)[0]
    assert rollout.t[began] == pytest.approx(0.102), "the force of the step that begins at 0.1 s moves the next state"
    # At rest under the force, the power of the servos' yield is the force's: sum(kp dq^2) = F . dx of a linear spring.
    k = np.searchsorted(rollout.t, 1.09)
    centre = arm.model.body(hand).ipos - arm.frames.positions[-1]
    frames = arm.link_poses(np.stack([rollout.q[k], q])).as_matrix()[:, -1]
    shift = np.subtract(*(frames @ [*centre, 1.0]))[:3]
    energy = (arm.model.actuator_gainprm[:, 0] * (rollout.q[k] - q) ** 2).sum()
    assert energy == pytest.approx(shift @ first.force, rel=1e-2)
    one, two = evaluate(rollout).recoveries
    assert (one.body, two.body) == ("end effector", hand)
    assert one.peak_deviation_mm > two.peak_deviation_mm > 0.0
    for recovery in (one, two):
        assert 0.0 < recovery.recovery_s < 0.4
    settled = rollout.t >= one.end_s + one.recovery_s - 1e-9
    still = settled & (rollout.t < two.start_s - 1e-9)
    distance = np.linalg.norm(rollout.link_position - arm.link_poses(q).translation, axis=-1).max(axis=1)
    assert distance[still].max() <= 1e-3
    # A rollout that ends under the push has not recovered.
    lasting = Disturbances(pushes=(dataclasses.replace(first, duration=9.0),))
    held = evaluate(simulate(arm, travel(arm, q, q, 0.02), hold=0.5, disturbances=lasting)).recoveries[0]
    assert held.recovery_s is None
    assert held.peak_deviation_mm == pytest.approx(one.peak_deviation_mm, rel=0.2)


@pytest.mark.parametrize("controller", ["position-servo", "inverse-dynamics", "computed-torque"])
def test_noise_is_white_seeded_and_reaches_the_feedback(arm, travel, controller):
    q = arm.keyframe("home")
    noisy = Disturbances(position_noise=1e-4, velocity_noise=2e-3, seed=5)
    runs = [
        simulate(arm, travel(arm, q, q, 0.02), controller=controller, hold=0.6, disturbances=changes)
        for changes in (noisy, noisy, dataclasses.replace(noisy, seed=6), Disturbances())
    ]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)
    assert np.abs(runs[0].q - runs[2].q).max() > 1e-6
    assert 1e-6 < np.abs(runs[0].q - q).max() < 1e-3
    if controller != "computed-torque":
        # White, with the variance that measurement and gains predict.
        error = runs[0].ctrl - runs[3].ctrl
        model = arm.model
        lead = -model.actuator_biasprm[:, 2] / model.actuator_gainprm[:, 0]
        expected = np.hypot(1e-4, 2e-3 * lead)
        np.testing.assert_allclose(error.std(axis=0), expected, rtol=0.2)
        assert np.abs((error[1:] * error[:-1]).mean(axis=0) / expected**2).max() < 0.25


def test_mocap_has_no_joint_feedback_to_disturb(arm, travel):
    q = arm.keyframe("home")
    still, noisy = (
        simulate(arm, travel(arm, q, q, 0.02), controller="mocap", hold=0.1, disturbances=changes)
        for changes in (None, Disturbances(position_noise=1e-2))
    )
    np.testing.assert_array_equal(still.q, noisy.q)


@pytest.mark.parametrize("lasts", [1e-9, 0.0009])
def test_a_push_that_would_never_act_is_refused(arm, lasts):
    push = Push("end effector", (0.0, 100.0, 0.0), 0.1001, lasts)
    with pytest.raises(InputError, match="no step of the simulation begins; make it at least one time step"):
        Simulation(arm, disturbances=Disturbances(pushes=(push,)))


@pytest.mark.parametrize("begin", [1200.0, 1.1995])  # in milliseconds; and no step of the run begins then
def test_a_push_after_the_end_is_refused(arm, travel, begin):
    home, late = arm.keyframe("home"), Disturbances(pushes=(Push("end effector", (0.0, 100.0, 0.0), begin, 100.0),))
    motion, policy = travel(arm, home, home, 0.2), make_policy("tracker", arm, home)
    for run in (
        lambda: simulate(arm, motion, disturbances=late),
        lambda: simulate_many(arm, [motion], disturbances=late),
        lambda: follow(policy, home, 1.2, disturbances=late),
    ):
        with pytest.raises(
            InputError, match=rf"'end effector' at {begin:g} s would begin when the run is over, at 1\.2 s"
        ):
            run()


def test_a_push_in_the_last_step_has_an_entry(arm, travel):
    home, push = arm.keyframe("home"), Push("end effector", (0.0, 100.0, 0.0), 1.197, 1.0)
    rollout = simulate(arm, travel(arm, home, home, 0.2), disturbances=Disturbances(pushes=(push,)))
    assert rollout.t[-1] == pytest.approx(1.2)
    assert [push.start_s for push in evaluate(rollout).recoveries] == [1.197]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Push("link 1", (1.0, 2.0), 0.0, 1.0), "force must be a tuple of 3"),
        (lambda: Push("link 1", (1.0, 2.0, 3.0), 0.0, 0.0), "duration must be positive"),
        (lambda: Disturbances(pushes=("link 1",)), r"pushes\[0\] must be a Push"),
        (lambda: Disturbances(payload=-1.0), "payload must not be negative"),
        (lambda: Disturbances(mass_scale=0.0), "mass_scale must be positive"),
        (lambda: Disturbances(position_noise=float("nan")), "position_noise must be finite"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(InputError, match=message):
        make()
