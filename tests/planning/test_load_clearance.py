"""How near a swinging load comes to things: bounds against MuJoCo's simulation, plans that are refused or slowed."""

from dataclasses import replace

import gantries
import numpy as np
import pytest
import task_cases

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.errors import PlanError, TooFastError
from lieednn_sim.planning.swing_model import SwingModel
from lieednn_sim.planning.time_laws import TimedCurve

JOINTS = task_cases.Crane.joints


def crane_before_a_wall(normal, at, start):
    """The crane of the task with its load at rest, and a wall through ``at * normal`` [m] that only its load meets."""
    spec, turn = mujoco.MjSpec.from_file(str(task_cases.ASSETS / "crane/scene.xml")), np.zeros(4)
    mujoco.mju_quatZ2Vec(turn, normal)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    place = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": [0, 0, 1], "pos": at * normal, "quat": turn}
    spec.worldbody.add_geom(name="wall", contype=8, conaffinity=8, **place)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:4] = data.ctrl[:] = start
    data.qpos[:] = PassiveJoints(ls.Arm.of(model, data, JOINTS, tip="tip")).at_rest(data.qpos[None])[0]
    return ls.Arm.of(model, data, JOINTS, tip="tip")


def nearest(run):
    """Least distance of a run's load from the wall [m]."""
    return Collisions(replace(run.arm, collision_model=PassiveJoints(run.arm).load_model)).nearest_at(run.qpos)[0]


def test_the_bound_is_never_above_the_simulated_distance_and_little_below():
    """Random motions of a crane, whose load swings by up to 20 degrees, past walls that it nearly touches."""
    rng = np.random.default_rng(0)
    swings = []
    for _ in range(3):
        start, goal = rng.uniform([-2.0, 0.2, -1.9, 0.1], [2.0, 0.9, -1.2, 1.5], (2, 4))
        normal, duration = rng.normal(size=3), rng.uniform(3.0, 9.0)
        normal *= np.sign(normal[2]) / np.linalg.norm(normal)
        at, how = -50.0, {"start": start, "planner": "minimum-jerk", "duration": duration}
        for _ in range(2):
            arm = crane_before_a_wall(normal, at, start)
            plan = ls.plan(arm, 0.5 * (start + goal), **how)
            run = ls.simulate(arm, plan, hold=2.0)
            at += nearest(run) - 0.05
        bound, curve = plan.load_clearance, TimedCurve(arm, plan.motion)
        *_, off = SwingModel([arm], curve.q).swing(curve.own, 0.005, 2.0)
        passive, some = PassiveJoints(arm), run.qpos[::20]
        away = passive.away(some, passive.at_rest(arm.qpos(run.q[::20])))
        swings.append(np.linalg.norm(away[:, ~passive.sprung], axis=1).max())
        assert nearest(run) == pytest.approx(0.05, abs=1e-3)
        if bound.proved:
            assert bound.pair == ("wall", "log")
            assert bound.bound <= nearest(run)
        # What is not known of the swing, at the end of a log of 1.6 m below a rope of 1.4 m and a boom.
        slack = 4.0 * off.max()
        assert (bound.bound if bound.proved else 0.0) > nearest(run) - 0.01 - slack
    assert np.rad2deg(max(swings)) > 20.0


def below_a_plate(gap):
    """A gantry whose load passes below a plate between home and 3 m, with so much room when it hangs still [m]."""
    height = 5.0 - gantries.LENGTH + 0.001 + gap + 0.02
    spec = mujoco.MjSpec.from_string(gantries.xml())
    box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "pos": [1.5, 0.0, height], "size": [1.2, 0.5, 0.02]}
    spec.worldbody.add_geom(name="plate", **box)
    model = spec.compile()
    return ls.Arm.of(model, mujoco.MjData(model), ["cart"], tip="tip")


def test_a_load_that_would_lift_against_a_plate_is_carried_slower():
    how = {"planner": "minimum-jerk", "settle": "least-energy"}
    plain, calm = (ls.plan(below_a_plate(gap), [3.0], duration=4.0, **how) for gap in (0.5, 0.012))
    assert calm.t[-1] > 1.05 * plain.t[-1]
    assert calm.load_clearance.bound >= 0.002
    near = ls.evaluate(ls.simulate(calm.arm, calm)).load
    assert near.nearest[1] == "plate"
    assert 1e3 * calm.load_clearance.bound <= near.clearance_mm < 12.0
    with pytest.raises(TooFastError, match=r"'a geom of .*', which hangs, would come within 2 mm of 'plate' at t = "):
        ls.plan(below_a_plate(0.012), [3.0], duration=(4.0, 4.1), **how)


def test_a_load_that_touches_even_at_rest_needs_another_way():
    with pytest.raises(PlanError, match="even at rest") as caught:
        ls.plan(below_a_plate(0.0015), [3.0], planner="minimum-jerk", duration=6.0, settle="zv")
    assert not isinstance(caught.value, TooFastError)


def test_of_two_loads_the_nearer_one_counts_and_balls_swing_too():
    ball = gantries.PENDULUM.replace('axis="0 1 0"', 'type="ball"')
    other = ball.replace('"swing"', '"second"').replace(f"-{gantries.LENGTH}", "-4.95").replace('"load"', '"low"')
    arm = gantries.gantry(ball + other)
    bound = ls.plan(arm, [1.0], planner="minimum-jerk", duration=6.0, settle="zv").load_clearance
    assert bound.proved
    assert 0.046 < bound.bound < 0.049


def test_where_nothing_hangs_there_is_no_such_bound():
    arm = ls.Arm.load("telescopic_pr")
    assert ls.plan(arm, "extended", planner="minimum-jerk").load_clearance is None


def test_where_it_cannot_be_bounded_the_reason_is_said():
    unnamed = gantries.gantry(gantries.PENDULUM.replace('name="swing" ', ""))
    bound = ls.plan(unnamed, [1.0], planner="minimum-jerk", duration=6.0, settle="zv").load_clearance
    assert not bound.proved
    assert "hangs, needs a name" in str(bound)
