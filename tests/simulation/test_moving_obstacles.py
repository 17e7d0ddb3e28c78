"""Obstacles that move in a simulation: when they touch, who is told, and what is refused."""

from dataclasses import asdict

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError
from lieednn_sim.planning import plan
from lieednn_sim.policies import MotionTracker
from lieednn_sim.simulation import Disturbances, MovingObstacle, Simulation, follow, simulate, simulate_many


@pytest.fixture(scope="module")
def beside(gantry):
    """The gantry, whose ball of 0.1 m is at x = 1 m, and another one of 0.2 m at x = 3 m."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="ball", pos=[3.0, 0.0, 0.0])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.2, 0.0, 0.0])
    return gantry.with_obstacles(spec, "ball")


# At 2 m/s from 0.5 s on.
COMING = MovingObstacle("obstacle_ball", (0.5, 1.5), ((3.0, 0.0, 0.0), (1.0, 0.0, 0.0)))


def test_an_obstacle_touches_when_it_comes(beside, travel):
    np.testing.assert_allclose([COMING.at(t)[0] for t in (0.0, 0.75, 9.0)], [3.0, 2.5, 1.0])
    still = np.zeros(4)
    changes = Disturbances(obstacles=(COMING,))
    for _ in range(2):
        rollout = simulate(beside, travel(beside, still, still, 0.02), hold=1.5, disturbances=changes)
        # It is 0.3 m from the centre of the arm's ball at x = 1.3 m, 0.85 s later.
        assert rollout.t[np.argmax(rollout.contacts > 0)] == pytest.approx(1.35, abs=0.011)
    assert not simulate(beside, travel(beside, still, still, 0.02), hold=1.5).contacts.any()
    assert Disturbances.from_json(asdict(changes)) == changes
    # A reset begins anew.
    simulation = Simulation(beside, disturbances=changes)
    simulation.advance(130)
    ball = simulation.model.body("obstacle_ball")
    assert ball.pos[0] == pytest.approx(3.0 - 2.0 * 0.79)
    simulation.reset(still)
    np.testing.assert_allclose(ball.pos, [3.0, 0.0, 0.0])


def test_controllers_do_not_push_against_where_it_was(beside, travel):
    """The arm has it where it passes after it has gone."""
    there = beside.with_moved_bodies({"obstacle_ball": (1.0, 1.0, 0.0)})
    gone = MovingObstacle("obstacle_ball", (0.0, 0.2), ((1.0, 1.0, 0.0), (3.0, 1.0, 0.0)))
    way = travel(there, np.zeros(4), np.array([0.0, 1.5, 0.0, 0.0]), 3.0)
    rollout = simulate(there, way, controller="inverse-dynamics", disturbances=Disturbances(obstacles=(gone,)))
    assert not rollout.contacts.any()
    assert np.abs(rollout.q - rollout.q_ref).max() < 1e-6


def test_the_policy_is_told_where_it_is(beside):
    told = []

    class Told(MotionTracker):
        def see(self, places):
            told.append(places["obstacle_ball"][0])

    motion = plan(beside, [0.1, 0.0, 0.0, 0.0], planner="minimum-jerk").motion
    follow(Told(beside, motion, 10.0), motion.q[-1], 1.0, disturbances=Disturbances(obstacles=(COMING,)))
    np.testing.assert_allclose(told, np.interp(0.1 * np.arange(11), (0.5, 1.5), (3.0, 1.0)), atol=1e-12)


def test_what_cannot_move_is_named(beside):
    there = ((0.0, 0.0, 0.0),)
    for name in ("wrist", "chair", "base"):
        changes = Disturbances(obstacles=(MovingObstacle(name, (0.0,), there),))
        with pytest.raises(
            InputError, match=f"no obstacle '{name}' can move; bodies that neither move nor carry an arm are: .*_ball"
        ):
            Simulation(beside, disturbances=changes)
    with pytest.raises(InputError, match="in one way only, got more than one for obstacle_ball"):
        Simulation(beside, disturbances=Disturbances(obstacles=(COMING, COMING)))
    with pytest.raises(InputError, match="times must hold at least one time, and increase, got"):
        MovingObstacle("obstacle_ball", (1.0, 1.0), there * 2)
    with pytest.raises(InputError, match="positions must"):
        MovingObstacle("obstacle_ball", (0.0, 1.0), there)
    motion = plan(beside, [0.1, 0.0, 0.0, 0.0], planner="minimum-jerk").motion
    with pytest.raises(InputError, match="obstacles move in single rollouts alone"):
        simulate_many(beside, [motion], disturbances=Disturbances(obstacles=(COMING,)))
