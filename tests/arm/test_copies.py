"""Copies of an arm: pickled for another process, and deep."""

from __future__ import annotations

import copy
import pickle
from dataclasses import fields, replace

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim.arm import arm as module
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.simulation import Simulation

MODEL = """<mujoco model="turner"><compiler angle="radian"/><option integrator="implicitfast"/><worldbody>
  <site name="base_frame"/><body name="arm" pos="0 0 {height}" gravcomp="1">
    <joint name="turn" axis="0 0 1" range="-2 2" damping="1"/><geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
    <site name="link1_frame" pos="0.3 0 0"/></body></worldbody>
  <actuator><position name="turn" joint="turn" kp="50" kv="5"/></actuator>
  <keyframe><key name="home" qpos="0"/><key name="aside" qpos="1"/></keyframe></mujoco>"""
SCENE = "obstacles: [{shape: box, size: [0.1, 0.1, 0.1], position: [1.0, 0.0, 0.5]}]"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory, with an arm and a scene; arms of other tests are forgotten."""
    (tmp_path / "turner.xml").write_text(MODEL.format(height=0.5))
    (tmp_path / "box.yaml").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    module._loaded.cache_clear()
    return tmp_path


@pytest.mark.parametrize("scene", ["free", "box.yaml", "poles"])
def test_an_unpickled_arm_is_the_arm_that_was_pickled(folder, monkeypatch, tmp_path_factory, scene):
    arm = ls.Arm.load("telescopic_pr" if scene == "poles" else "turner.xml", scene=scene, seed=3)
    limits = 0.5 * np.ones(arm.n_joints)
    changed = replace(arm, clearance=0.007, velocity_limits=limits)
    changed.model.dof_damping[:] += 0.25
    pickled = pickle.dumps(changed)
    # In another process nothing is known yet, and the files are found from anywhere.
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    module._loaded.cache_clear()
    copied = pickle.loads(pickled)
    for item in fields(arm):
        if item.name not in ("spec", "model", "space", "joints"):
            one, other = (np.asarray(getattr(a, item.name), dtype=object) for a in (changed, copied))
            assert str(one) == str(other), item.name
    assert copied.fingerprint == changed.fingerprint != arm.fingerprint
    assert copied.spec.to_xml() == changed.spec.to_xml()
    assert copied.clearance == 0.007
    # A payload is added to the spec.
    motion = ls.plan(
        arm, arm.keyframe("aside" if scene != "poles" else "home"), planner="minimum-jerk", duration=1.0
    ).motion
    runs = [ls.simulate(a, motion, hold=0.0, disturbances=ls.Disturbances(payload=0.1)) for a in (changed, copied)]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)


def test_import_options_are_remembered(folder):
    arm = ls.Arm.load("turner.xml", home={"turn": 0.3})
    copied = pickle.loads(pickle.dumps(arm))
    assert copied.import_report == arm.import_report is not None
    assert copied.spec.to_xml() == arm.spec.to_xml() != ls.Arm.load("turner.xml").spec.to_xml()
    np.testing.assert_array_equal(copied.keyframe("home"), [0.3])


def test_an_arm_whose_file_has_changed_is_refused(folder):
    pickled = pickle.dumps(ls.Arm.load("turner.xml"))
    (folder / "turner.xml").write_text(MODEL.format(height=0.6))
    with pytest.raises(FileError, match=r"turner\.xml, or a file that it uses, has changed since the arm was loaded"):
        pickle.loads(pickled)
    (folder / "turner.xml").unlink()
    with pytest.raises(FileError, match=r"there is no file .*turner\.xml|turner\.xml"):
        pickle.loads(pickled)


def test_what_is_changed_in_an_arm_of_the_package_is_in_no_other_one():
    arm, fresh = ls.Arm.load("telescopic_pr"), ls.Arm.from_xml(ls.arm.scene_path("telescopic_pr"))
    arm.position_limits[:] = arm.force_limits[:] = 0.0
    arm.model.body_mass[:] = 0.0
    arm.spec.delete(arm.spec.body("link1"))
    again = ls.Arm.load("telescopic_pr")
    assert again.with_payload(1.0).fingerprint == fresh.with_payload(1.0).fingerprint
    for limits in ("position_limits", "force_limits"):
        np.testing.assert_array_equal(getattr(again, limits), getattr(fresh, limits))


def test_an_arm_from_a_spec_says_that_it_cannot_be_pickled(folder):
    arm = ls.Arm.load("turner.xml")
    made = ls.Arm.from_spec(arm.spec.copy(), arm.source, "made")
    with pytest.raises(InputError, match=r"arm 'made' was made from a spec, which cannot be pickled: make the arm in"):
        pickle.dumps(made)
    copied = copy.deepcopy(made)
    copied.model.dof_damping[:] = 9.0
    assert made.model.dof_damping[0] == 1.0
    assert copied.spec is not made.spec
    assert copied.joint_names == made.joint_names == ("turn",)


def test_a_rollout_goes_to_another_process_with_its_arm(folder):
    arm = ls.Arm.load("turner.xml")
    rollout = ls.simulate(arm, ls.plan(arm, arm.keyframe("aside"), planner="minimum-jerk", duration=1.0))
    copied = pickle.loads(pickle.dumps(rollout))
    assert str(ls.evaluate(copied)) == str(ls.evaluate(rollout))
    assert not copied.q.flags.writeable


def test_a_simulation_is_not_copied(folder):
    """A copy would watch the velocities of the original for numbers that are not finite."""
    simulation = Simulation(ls.Arm.load("turner.xml"))
    for way in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(InputError, match="a Simulation, and what holds one, can neither be copied nor pickled"):
            way(simulation)
