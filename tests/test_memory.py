"""Memory is given back by counting references alone: with Python's search for cycles off, nothing outlives its use."""

from __future__ import annotations

import atexit
import gc
import weakref

import mujoco
import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim._mujoco import scratch_data
from lieednn_sim.errors import PlanError, SimulationError
from lieednn_sim.planning.tube import find_tube
from lieednn_sim.studies.comparison.case import Settings, run_case
from lieednn_sim.studies.comparison.rows import Case

# Where a straight motion from home would touch a pole.
BEHIND = np.array([1.829, 0.041, 0.613, 0.043, -0.731, 0.082, 0.008, 0.103])


@pytest.fixture(scope="module", autouse=True)
def old_things_stay():
    """To look through what other tests have left takes longer than all else."""
    gc.collect()
    gc.freeze()
    atexit.register(gc.unfreeze)  # bindings complain of what is left when Python ends


@pytest.fixture(autouse=True)
def collector_off():
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def loaded(scene):
    return ls.Arm.load("telescopic_pr", scene, seed=3)


def viewed(scene):
    arm = loaded(scene)
    joints = arm.model.dof_jntid[arm.space.own_rate_addresses]
    return ls.Arm.of(arm.model, arm.data(), [arm.model.joint(joint).name for joint in joints])


def used(arm, planner):
    """Weak references to what is made in a scene when a motion is planned, simulated, judged, and has a tube."""
    plan = ls.plan(arm, BEHIND, planner=planner)
    rollout = ls.simulate(arm, plan, hold=0.0)
    made = [plan, rollout, ls.evaluate(rollout), plan.clearance, arm, arm.without_visuals, arm.model, arm.geometry]
    if plan.network is not None:
        made += [find_tube(arm, plan), plan.network]
    return [weakref.ref(each) for each in made]


def refused(arm):
    """Likewise, where the planner finds no motion to one of two goals, or to the only one; and a simulation fails."""
    aside = np.append(-2.0, arm.keyframe("home")[1:])
    made = [arm, arm.model, ls.plan(arm, np.stack([BEHIND, aside]), planner="minimum-jerk")]
    assert made[-1].target[0] == -2.0
    with pytest.raises(PlanError):
        ls.plan(arm, BEHIND, planner="minimum-jerk")
    heavy = ls.Disturbances(pushes=[ls.Push("end effector", (1e12, 0.0, 0.0), 0.0, 0.1)])
    still = ls.plan(arm, "home", planner="minimum-jerk", duration=0.1)
    with pytest.raises(SimulationError):
        ls.simulate(arm, still, disturbances=heavy)
    return [weakref.ref(each) for each in made]


def alive(references):
    # Every thread keeps the data of the model that it last computed with.
    scratch_data(mujoco.MjModel.from_xml_string("<mujoco/>"))
    return [each for reference in references if (each := reference()) is not None]


@pytest.mark.parametrize(
    ("make", "scene", "planner"),
    [
        (loaded, "poles", "rrt-connect"),
        (loaded, "free", "lieednn-certified"),
        (viewed, "poles", "lieednn-shaped"),
    ],
)
def test_nothing_of_a_scene_is_left_after_its_use(make, scene, planner):
    references = used(make(scene), planner)
    assert alive(references) == []


def test_nothing_of_a_scene_is_left_after_a_refusal_or_a_failure():
    references = refused(loaded("poles"))
    assert alive(references) == []


def test_neither_search_nor_controllers_leave_reference_cycles():
    settings, case = Settings(duration=2.0, hold=0.0), Case("telescopic_pr", "poles", "rrt-connect", 0)
    names = ["inverse-dynamics", "computed-torque", "mocap"]
    run_case(case, names, settings)  # what is made once
    gc.collect()
    rows = run_case(case, names, settings)
    gc.set_debug(gc.DEBUG_SAVEALL)
    gc.collect()
    gc.set_debug(0)
    left = {type(thing).__module__ for thing in gc.garbage}
    gc.garbage.clear()
    assert [row.success for row in rows] == [True] * len(names)
    assert not {name for name in left if name.startswith(("lieednn_sim", "nanobind", "mujoco"))}
