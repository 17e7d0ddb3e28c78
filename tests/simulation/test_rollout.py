"""Rollouts: exact determinism, alignment of the log, channels, failures."""

import dataclasses
import itertools

import numpy as np
import pytest

from lieednn_sim import io
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.budget import reporting
from lieednn_sim.errors import FileError, InputError, SimulationError
from lieednn_sim.planning import CertifiedOptions, plan
from lieednn_sim.policies import make_policy
from lieednn_sim.simulation import Channel, Disturbances, Push, Rollout, follow, simulate, tracking


@pytest.fixture(scope="module")
def arm():
    return Arm.load("telescopic_pr")


@pytest.fixture(scope="module")
def planned(arm):
    return plan(arm, arm.keyframe("extended"), options=CertifiedOptions(n_networks=6))


@pytest.fixture(scope="module")
def rollout(arm, planned):
    return simulate(arm, planned.motion)


def test_every_row_of_the_log_belongs_to_one_instant(arm, rollout):
    np.testing.assert_allclose(rollout.t, 0.002 * np.arange(len(rollout.t)), atol=1e-12)
    data = mujoco.MjData(arm.model)
    sites = [arm.model.site(f"link{i + 1}_frame").id for i in range(arm.n_links)]
    for k in (0, 700, len(rollout.t) - 1):
        data.qpos[:], data.qvel[:], data.ctrl[:] = rollout.q[k], rollout.qd[k], rollout.ctrl[k]
        mujoco.mj_forward(arm.model, data)
        np.testing.assert_allclose(rollout.link_position[k], data.site_xpos[sites], atol=1e-12)
        np.testing.assert_allclose(rollout.force[k], data.qfrc_actuator, atol=1e-6)
    poses = rollout.link_poses().as_matrix()
    np.testing.assert_allclose(poses, arm.link_poses(rollout.q).as_matrix(), atol=1e-9)


def test_divergence_stops_the_run_and_tells_it_up_to_there(arm, planned, tmp_path, monkeypatch):
    unstable = Arm.load(arm.name)
    unstable.model.dof_damping[:] = 1.5 * unstable.model.actuator_biasprm[:, 2]  # negative, stronger than the servo
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SimulationError, match=r"failed at t = \d\.\d+ s: ") as failed:
        simulate(unstable, planned.motion)
    assert not list(tmp_path.iterdir()), "MuJoCo's own log file is not left behind"
    failed.value.rollout.save("divergence.npz")
    dump = Rollout.load("divergence.npz", unstable, planned.motion)
    assert 0.0 < dump.t[-1] < planned.motion.t[-1]
    assert len(dump.q) == len(dump.t)


def test_progress_tells_the_steps_done_and_the_last_one(small_arms, travel, monkeypatch):
    """At 0.04 s a look at the clock every third step is told, two looks for each that is."""
    seconds = itertools.count(0.0, 0.04)
    monkeypatch.setattr(tracking.time, "monotonic", lambda: next(seconds))
    arm, told = small_arms["hanging"], []
    motion = travel(arm, np.zeros(6), np.full(6, 0.1), 0.02)
    with reporting(lambda *values: told.append(values)):
        simulate(arm, motion, controller="mocap", hold=0.008)
    assert told == [(3, 15), (6, 15), (9, 15), (12, 15), (15, 15)]


def test_bad_input(arm, planned):
    motion = planned.motion
    with pytest.raises(InputError, match=r"every 0\.004 s, the model steps every 0\.002 s"):
        simulate(arm, dataclasses.replace(motion, t=2.0 * motion.t))
    with pytest.raises(InputError, match="the motion has 3 coordinates, arm 'telescopic_pr' has 8"):
        simulate(arm, dataclasses.replace(motion, q=motion.q[:, :3], qd=motion.qd[:, :3]))
    with pytest.raises(InputError, match="hold"):
        simulate(arm, motion, hold=-1.0)


def test_a_rollout_knows_its_plan_and_is_loaded_with_its_own_arm_scene_and_motion(arm, planned, rollout, tmp_path):
    whole = simulate(arm, planned, hold=0.0)
    assert whole.motion is planned.motion
    np.testing.assert_array_equal(whole.target, planned.target)
    np.testing.assert_array_equal(rollout.target, planned.motion.q[-1])
    whole.save(tmp_path / "rollout.npz")
    for other, scene in ((Arm.load("telescopic_rrp"), "free"), (arm.with_scene("poles", 1), "poles")):
        with pytest.raises(
            FileError, match=f"is of arm 'telescopic_pr' in scene 'free' .*not of .* in scene '{scene}'"
        ):
            Rollout.load(tmp_path / "rollout.npz", other)
    with pytest.raises(FileError, match="the motion is another one than the rollout followed"):
        Rollout.load(tmp_path / "rollout.npz", arm, dataclasses.replace(planned.motion, q=planned.motion.q + 1e-9))
    with pytest.raises(InputError, match="target is out of reach"):
        simulate(arm, planned, target=planned.target + 100.0)


def test_channels_are_saved_and_files_without_them_are_refused(small_arms, travel, tmp_path):
    arm, path = small_arms["hanging"], tmp_path / "rollout.npz"
    pushes = Push("end effector", (0, 0, 9), 0.008, 0.01), Push("base", (1, 0, 0), 0.0, 0.01)
    changes = Disturbances(pushes=pushes, mass_scale=1.125, payload=1.0, position_noise=1e-4, seed=3)
    motion = travel(arm, np.zeros(6), np.full(6, 0.1), 0.02)
    rollout = simulate(arm, motion, controller="mocap", hold=0.0, reference_rate=100.0, disturbances=changes)
    assert rollout.disturbances == changes
    assert rollout.channel_units == {"weld_force": "N", "weld_torque": "N m", "push_force": "N"}
    # Of the bodies in the order in which they are pushed first, at the steps that begin within a push.
    pushed = np.zeros((11, 2, 3))
    pushed[:5, 0, 0], pushed[4:9, 1, 2] = 1.0, 9.0
    np.testing.assert_array_equal(rollout.channels["push_force"], pushed)
    assert rollout.channels["weld_force"].shape == rollout.channels["weld_torque"].shape == (11, 1)
    assert rollout.channels["weld_force"].min() > 1.0
    rollout.save(path)
    assert Rollout.load(path, arm, motion) == rollout
    assert Rollout.load(path, arm).motion is None
    arrays, meta = io.load_arrays(path, "rollout")
    del meta["channel_units"]
    io.save_arrays(path, "rollout", arrays, meta)
    with pytest.raises(FileError, match="is not a valid rollout: 'channel_units'"):
        Rollout.load(path, arm)
    with pytest.raises(InputError, match="channels and channel_units must have the same names"):
        dataclasses.replace(rollout, channel_units={})
    with pytest.raises(InputError, match=r"push_force must have shape \(11, 2, 3\), got \(10, 2, 3\)"):
        dataclasses.replace(rollout, channels={**rollout.channels, "push_force": pushed[1:]})


def test_channels_of_one_s_own_are_logged_for_each_instant_and_saved(small_arms, travel, tmp_path):
    arm, seen = small_arms["hanging"], []
    motion = travel(arm, np.zeros(6), np.full(6, 0.1), 0.02)

    def site(data):
        seen.append(data.time)
        return data.site_xpos  # a view, which the next step overwrites

    log = [Channel("site", "m", site), Channel("weight", "N", lambda data: data.qfrc_bias[0])]
    rollout = simulate(arm, motion, controller="mocap", hold=0.0, log=log)
    assert list(rollout.channel_units.items()) == [
        *(("weld_force", "N"), ("weld_torque", "N m"), ("site", "m"), ("weight", "N"))
    ]
    sites = [arm.model.site(f"link{i + 1}_frame").id for i in range(arm.n_links)]
    np.testing.assert_allclose(rollout.channels["site"][:, sites], rollout.link_position, rtol=0.0, atol=1e-14)
    assert rollout.channels["weight"].shape == (11,) == (len(seen),)
    bare = simulate(arm, motion, controller="mocap", hold=0.0)
    same = {"channels": bare.channels, "channel_units": bare.channel_units}
    assert dataclasses.replace(rollout, **same) == bare
    rollout.save(tmp_path / "rollout.npz")
    assert Rollout.load(tmp_path / "rollout.npz", arm, motion) == rollout


def test_following_logs_channels_beside_those_of_the_policy(gantry):
    policy = make_policy("fabric", gantry, gantry.keyframe("home"), rate=50.0)
    com = Channel("centre of mass", "m", lambda data: data.subtree_com[0])
    rollout = follow(policy, gantry.keyframe("home"), 0.1, log=[com]).rollout
    assert set(rollout.channel_units) == {*policy.channel_units, "centre of mass"}
    assert rollout.channels["centre of mass"].shape == (len(rollout.t), 3)


@pytest.mark.parametrize(
    ("log", "message"),
    [
        ([Channel("x", "m", abs), Channel("x", "1", abs)], "a name of its own, there are several of x"),
        ([Channel("weld_force", "N", lambda data: 0.0)], "several of weld_force"),
        ([abs], "a quantity to log must be a Channel, got <built-in function abs>"),
        ([Channel("x", "m", lambda data: data.nothing)], "channel 'x' failed: AttributeError"),
        ([Channel("x", "m", lambda data: np.nan)], "channel 'x' must be finite"),
        ([Channel("x", "m", lambda data: np.zeros(int(500 * data.time)))], r"of x must have one shape, got \(1,\) and"),
    ],
)
def test_channels_that_cannot_be_logged_are_refused(small_arms, travel, log, message):
    arm = small_arms["hanging"]
    with pytest.raises(InputError, match=message):
        simulate(arm, travel(arm, np.zeros(6), np.full(6, 0.1), 0.02), controller="mocap", hold=0.0, log=log)
    with pytest.raises(InputError, match="a channel needs a name and a unit, got 'x' and ''"):
        Channel("x", "", abs)
