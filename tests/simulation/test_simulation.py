"""The stepping core: exact determinism, the log's two ways, measurements."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.planning.motion import steps_of_rate
from lieednn_sim.simulation import Disturbances, Log, Push, Simulation
from lieednn_sim.simulation.reference import Reference

seeds = st.integers(0, 2**32 - 1)
CHANGES = Disturbances(
    pushes=(Push("end effector", (3.0, 0.0, 1.0), 0.05, 0.02),), payload=0.3, position_noise=1e-3, velocity_noise=1e-3
)


def run(simulation: Simulation, q, steps: int = 60) -> np.ndarray:
    simulation.reset(q, 0.1 * np.ones_like(q))
    log = Log(simulation)
    for _ in range(steps):
        simulation.data.ctrl[:] = simulation.measured()[0][: simulation.model.nu].sum()
        log.step()
    seen = log.rollout(*np.zeros((2, steps, len(q))), motion_end=0.0)
    return np.column_stack([seen.t, seen.q, seen.qd, seen.force, seen.link_position[:, -1]])


@settings(max_examples=5)
@given(seed=seeds, name=st.sampled_from(["compound", "telescope"]))
def test_a_run_is_bit_identical_after_any_other_run(small_arms, seed, name):
    arm, rng = small_arms[name], np.random.default_rng(seed)
    q, other = (0.3 * rng.uniform(*arm.position_limits.T) for _ in range(2))
    simulation = Simulation(arm, disturbances=CHANGES)
    first = run(simulation, q)
    run(simulation, other, steps=7)
    np.testing.assert_array_equal(run(simulation, q), first)
    np.testing.assert_array_equal(run(Simulation(arm, disturbances=CHANGES), q), first)


def test_steps_without_a_record_and_looks_in_between_change_nothing(small_arms):
    arm = small_arms["compound"]
    q = 0.2 * arm.position_limits[:, 1]
    recorded, plain = (Simulation(arm, disturbances=CHANGES) for _ in range(2))
    for simulation in (recorded, plain):
        simulation.reset(q, np.ones_like(q))
    log = Log(recorded)
    for _ in range(40):
        log.step()
        mujoco.mj_kinematics(recorded.model, recorded.data)
    plain.advance(40)
    np.testing.assert_array_equal(recorded.data.qpos, plain.data.qpos)
    assert recorded.time == plain.time == pytest.approx(0.08)


def test_rates_are_those_of_the_coordinates(small_arms):
    """Of a ball joint MuJoCo's velocity is no rate of the rotation vector."""
    arm = small_arms["compound"]
    simulation = Simulation(arm)
    q, qd = 0.4 * arm.position_limits[:, 1], np.linspace(-1.0, 1.0, arm.n_joints)
    simulation.reset(q, qd)
    np.testing.assert_allclose(simulation.qd, qd, atol=1e-12)
    assert np.abs(simulation.data.qvel - qd).max() > 0.05
    simulation.model.opt.timestep = 1e-6
    simulation.advance()
    np.testing.assert_allclose((simulation.q - q) / 1e-6, simulation.qd, atol=1e-3)


@settings(max_examples=10)
@given(seed=seeds)
def test_discrete_rates_land_on_every_position(small_arms, seed):
    arm, rng = small_arms["compound"], np.random.default_rng(seed)
    q = np.cumsum(0.02 * rng.normal(size=(30, arm.n_joints)), axis=0)
    simulation, reference = Simulation(arm), Reference.of(arm, q, np.zeros_like(q))
    velocity, h = np.zeros(arm.model.nv), reference.timestep
    qpos = reference.qpos[0].copy()
    for k in range(29):
        now, acceleration = reference.rates_at(np.array([k]))[:, 0]
        np.testing.assert_allclose(now, velocity, atol=1e-9)
        velocity = velocity + h * acceleration
        mujoco.mj_integratePos(simulation.model, qpos, velocity, h)
        np.testing.assert_allclose(arm.coordinates(qpos), q[k + 1], atol=1e-9)


def test_references_ahead_of_what_is_known_go_straight_on(small_arms):
    arm = small_arms["telescope"]
    t = 0.002 * np.arange(11)
    reference = Reference(arm, 11)
    q, qd = np.outer(t**3, [1.0, 2.0]), np.outer(3.0 * t**2, [1.0, 2.0])
    reference.extend(q[:6], qd[:6])
    # A cubic is interpolated exactly.
    between = arm.coordinates(reference.ahead(range(1, 2), 0.0053)[0])
    np.testing.assert_allclose(between, np.array([1.0, 2.0]) * 0.0073**3, atol=1e-15)
    np.testing.assert_allclose(
        arm.coordinates(reference.ahead(range(4, 5), 0.006)[0]), q[5] + 0.004 * qd[5], atol=1e-15
    )
    held = Reference.of(arm, q, qd, hold=4)
    assert [held.row(k) for k in range(9)] == held.row(np.arange(9)).tolist() == [0, 0, 0, 0, 4, 4, 4, 4, 8]


def test_control_periods_are_whole_numbers_of_steps():
    assert steps_of_rate("reference_rate", 100.0, 0.002) == 5
    with pytest.raises(InputError, match=r"reference_rate must divide the simulation's 500 Hz, got 150 Hz; for exam"):
        steps_of_rate("reference_rate", 150.0, 0.002)


@pytest.mark.parametrize("timestep", [0.002, 0.003, 0.0007, 1.0 / 240.0, 1e-4])
def test_a_rate_that_is_suggested_is_taken(timestep):
    for rate in (7.3, 33.0, 61.0, 99.0):
        with pytest.raises(InputError, match="for example") as raised:
            steps_of_rate("rate", rate, timestep)
        suggested = float(str(raised.value).split()[-2])
        assert steps_of_rate("rate", suggested, timestep) == round(1.0 / (rate * timestep))


def test_failures_name_the_time(small_arms):
    simulation = Simulation(small_arms["telescope"])
    simulation.advance(3)
    simulation.data.qvel[:] = 1e12
    with pytest.raises(SimulationError, match=r"'telescope' failed at t = 0\.0060 s"):
        simulation.advance()
    with pytest.raises(InputError, match=r"no body to push 'hand'; allowed: ball, base"):
        Simulation(small_arms["telescope"], disturbances=Disturbances(pushes=(Push("hand", (1, 0, 0), 0, 1),)))


def test_a_start_beyond_the_limits_is_not_moved(small_arms):
    """A real arm may be there, too; what it does then is for the joint limits' forces."""
    for arm in small_arms.values():
        q = arm.position_limits[:, 1] + 0.1
        simulation = Simulation(arm)
        simulation.reset(q)
        np.testing.assert_array_equal(simulation.data.qpos, arm.qpos(q))


def test_each_step_takes_a_row_of_controls(small_arms):
    arm = small_arms["telescope"]
    at_once, one_by_one = Simulation(arm), Simulation(arm)
    controls = np.linspace(0.0, 0.1, 6)[:, None] * np.ones(at_once.model.nu)
    at_once.advance(6, controls)
    for row in controls:
        one_by_one.data.ctrl[:] = row
        one_by_one.advance()
    np.testing.assert_array_equal(at_once.data.qvel, one_by_one.data.qvel)
    assert at_once.steps == one_by_one.steps == 6
    controls[2] = 1e99
    at_once.model.actuator_ctrllimited[:] = at_once.model.actuator_forcelimited[:] = 0
    with pytest.raises(SimulationError, match=r"'telescope' failed at t = 0\.0160 s"):
        at_once.advance(6, controls)
