"""Demonstrations of an arm's joints: what files may hold, and the network and motion that come of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.planning.demonstrated import JointDemonstrations, JointMotion
from lieednn_sim.planning.motion import check_motion
from lieednn_sim.policies import NetworkPolicy
from lieednn_sim.simulation import follow
from lieednn_sim.studies.demonstrations import joints as study
from lieednn_sim.studies.demonstrations import models as paths
from lieednn_sim.synthesis import ShapingOptions

S = np.linspace(0.0, 1.0, 200)
LAW = S**3 * (10.0 - 15.0 * S + 6.0 * S**2)
OPTIONS = ShapingOptions(neurons=(16,))


def bend(offset=0.0, end=0.0):
    """A way of the gantry's joints x, y, z, turn: y bends by 0.5, more by ``offset``; x ends ``end`` further."""
    bump = np.sin(np.pi * LAW)
    return np.column_stack([-0.5 + (1.0 + end) * LAW, (0.5 + offset) * bump, 0.3 * LAW, 1.0 - LAW])


@pytest.fixture
def files(tmp_path):
    """A way a file, 3, 4 and 5 s long: as an array, with a column of times, and with named columns in another order."""
    np.savez(tmp_path / "a.npz", positions=bend(-0.1), t=3.0 * S)
    np.save(tmp_path / "b.npy", np.column_stack([4.0 * S, bend()]))
    columns = np.column_stack([bend(0.1)[:, ::-1], S, 5.0 * S])
    np.savetxt(tmp_path / "c.csv", columns, delimiter=",", header="turn,z,Y,x,gripper,t", comments="")
    return [tmp_path / name for name in ("a.npz", "b.npy", "c.csv")]


@pytest.fixture(scope="module")
def learned(gantry, tmp_path_factory):
    path = tmp_path_factory.mktemp("shown") / "all.npy"
    np.save(path, [bend(offset) for offset in (-0.1, 0.0, 0.1)])
    shown = JointDemonstrations.load(gantry, [path], rate=50.0)
    return shown, JointMotion.fit(shown, 5e-3, OPTIONS)


def test_every_format_shows_the_same_joints(gantry, files):
    shown = JointDemonstrations.load(gantry, files, phase="time")
    np.testing.assert_allclose(shown.t, np.linspace(0.0, 4.0, 201), atol=1e-12)
    for q, offset in zip(shown.q, (-0.1, 0.0, 0.1), strict=True):
        wanted = [np.interp(np.linspace(0.0, 1.0, 201), S, column) for column in bend(offset).T]
        np.testing.assert_allclose(q, np.transpose(wanted), atol=1e-12)
    np.testing.assert_allclose(shown.mean[[0, -1]], [[-0.5, 0.0, 0.0, 1.0], [0.5, 0.0, 0.3, 0.0]], atol=1e-12)
    # y alone spreads, link 1's, by 0.1 sin(pi law) at most: sqrt(2 / 3) of it, in whatever metres a unit counts for.
    assert shown.spread.max() == pytest.approx(0.1 * np.sqrt(2.0 / 3.0), rel=1e-3)
    assert shown.spread[[0, -1]].max() < 1e-12
    # Metres for a radian of the wrist: its lever arm is the metre between the links.
    np.testing.assert_allclose(shown.units[1, :3], 1.0)


def test_what_is_no_motion_of_the_arm_says_why(gantry, files, tmp_path):
    def load(samples, *others):
        np.save(tmp_path / "wrong.npy", samples)
        return JointDemonstrations.load(gantry, [*others, tmp_path / "wrong.npy"])

    outside = bend()
    outside[7, 1] = 2.5
    for samples, message in (
        (bend()[:, :3], "4 columns, the joints x, y, z, turn, or the time and these; got 3"),
        (outside, r"in row 7 of wrong.npy joint 'y' would be at 2.5 m, its range is \[-2, 2\]"),
        # A gripper last: the first joint is no time, although x rises all the way.
        (np.column_stack([bend(), S]), "got 5, and the first is no time, .* such as a gripper, or name the columns"),
        (np.column_stack([bend()[::-1], S]), r"the first is no time, .*: row 1 has 0.49\d+ after 0.5;"),
        (np.tile(bend()[:1], (5, 1)), "wrong.npy does not move"),
        (bend()[:1], "at least two samples"),
        # The ball would be in the floor.
        (bend() - [0.0, 0.0, 1.0, 0.0], "the mean start is out of reach: 'world' would touch 'wrist'"),
    ):
        with pytest.raises(InputError, match=message):
            load(samples)
    with pytest.raises(
        InputError, match=r"must end at one goal: wrong.npy ends with joint 'x' at 0.6 m, .* 0.525; keep"
    ):
        load(bend(end=0.1), *files)
    # Within 2 % of the range, 4 cm, all end at their mean.
    assert load(bend(end=0.03), *files).mean[-1, 0] == pytest.approx(0.5075)
    (tmp_path / "named.csv").write_text("x,y,zed,turn\n0,0,0,0\n1,0,0,0\n")
    with pytest.raises(InputError, match="joints of gantry: x, y, z, turn; it lacks z, and names zed"):
        JointDemonstrations.load(gantry, [tmp_path / "named.csv"])
    with pytest.raises(FileError, match=r"absent\.npy"):
        JointDemonstrations.load(gantry, [tmp_path / "absent.npy"])


def test_turns_of_a_joint_without_a_range_go_on(two_hinges, tmp_path):
    def wrapped(b):
        return np.column_stack([0.5 * LAW, (b + np.pi) % (2.0 * np.pi) - np.pi])

    def load(*recorded):
        np.save(tmp_path / "wound.npy", recorded)
        return JointDemonstrations.load(arm, [tmp_path / "wound.npy"]).q[..., 1]

    (tmp_path / "arm.xml").write_text(two_hinges.replace('axis="0 1 0" range="-90 90"', 'axis="0 1 0"'))
    arm = Arm.load(tmp_path / "arm.xml", floor="none")
    # From 2 rad forwards by 2.5 rad; the others, which end beside it on either side of half a turn, end there as well.
    way = 2.0 + (np.pi - 2.0) * LAW
    found = load(wrapped(2.0 + 2.5 * LAW))[0]
    assert (found[0], found[-1], np.abs(np.diff(found)).sum()) == pytest.approx((2.0, 4.5, 2.5))
    found = load(wrapped(way - 0.02 * LAW), wrapped(way + 0.02 * LAW), np.add(wrapped(way), [0.0, 2.0 * np.pi]))
    np.testing.assert_allclose(found[:, 0], 2.0)
    np.testing.assert_allclose(found[:, -1], np.pi + np.array([-0.02, 0.02, 0.0]))
    # 3 + 4 rad is beyond a turn, a turn back is within it.
    assert load(wrapped(3.0 + 4.0 * LAW))[0, [0, -1]] == pytest.approx([3.0 - 2.0 * np.pi, 7.0 - 2.0 * np.pi])


def test_a_joint_with_a_range_does_not_jump(gantry, tmp_path):
    wound = bend()
    wound[:, 3] = (2.5 + 1.5 * LAW + np.pi) % (2.0 * np.pi) - np.pi
    wound = np.clip(wound, -3.0, 3.0)
    k = int(np.argmax(np.abs(np.diff(wound[:, 3])))) + 1
    np.save(tmp_path / "a.npy", wound)
    with pytest.raises(InputError, match=rf"row {k} of a.npy joint 'turn', which has a range, jumps from 3 to -3 rad"):
        JointDemonstrations.load(gantry, [tmp_path / "a.npy"])


def test_the_network_does_what_was_shown(gantry, learned):
    shown, model = learned
    network = model.network
    assert network.certified
    assert network.n_visible == gantry.n_links
    # Demonstrations alike in time: the motion is at the mean's place at its time, not only on its path.
    motion, refusal = model.planned(shown.mean[0])
    assert refusal == ""
    check_motion(gantry, motion)
    wanted = np.transpose([np.interp(motion.t / motion.t[-1], S, column) for column in bend().T])
    np.testing.assert_allclose(motion.q, wanted, atol=0.02)
    np.testing.assert_allclose(motion.q[[0, -1]], wanted[[0, -1]], atol=1e-6)
    # Any network of the arm is followed online.
    following = follow(NetworkPolicy(gantry, network), shown.mean[-1], 0.1, start=shown.mean[0])
    assert following.rollout.arm is gantry


def test_a_start_of_its_own_has_the_bend_that_was_shown(gantry, tmp_path):
    # x starts further back where y bends more, so that one tells the other.
    np.save(tmp_path / "all.npy", [bend(k) - np.outer(1.0 - LAW, [k, 0.0, 0.0, 0.0]) for k in (-0.2, -0.1, 0.1, 0.2)])
    shown = JointDemonstrations.load(gantry, [tmp_path / "all.npy"], rate=50.0)
    family, fading = (JointMotion.fit(shown, 5e-3, OPTIONS, family=some) for some in (True, False))
    assert fading.network == fading.shaping.network
    assert family.network.certified
    for q in shown.q:
        found = [np.abs(model.run(q[0]).q[:, 1]).max() for model in (family, fading)]
        assert found[0] == pytest.approx(q[:, 1].max(), abs=0.02)
        assert found[1] == pytest.approx(0.5, abs=0.02)


def test_goals_that_are_kept_decide_the_bend(gantry, tmp_path):
    # x ends further where y bends more.
    np.save(tmp_path / "all.npy", [bend(2.0 * k, k) for k in (-0.1, -0.05, 0.05, 0.1)])
    shown = JointDemonstrations.load(gantry, [tmp_path / "all.npy"], rate=50.0, goals="kept")
    model = JointMotion.fit(shown, 5e-3, OPTIONS)
    assert model.network.certified
    for q in shown.q:
        found = model.toward(q[-1]).run(q[0]).q
        np.testing.assert_allclose(found[-1], q[-1], atol=1e-5)
        np.testing.assert_array_equal(model.toward(q[-1]).goal, q[-1])
        assert np.abs(found[:, 1]).max() == pytest.approx(q[:, 1].max(), abs=0.02)
    # The errors that are reported are to each goal of its own.
    assert study.study_joints(shown, model, starts=1, leave_one_out=False)[0].training.effector.goal_mm < 0.1


def test_a_pause_is_kept_and_speed_that_no_joint_has_takes_longer(gantry, tmp_path):
    # Half the way in 4 s, a pause of 4 s, and the other half.
    t = np.concatenate([4.0 * S, 8.0 + 4.0 * S])
    way = np.concatenate([0.5 * LAW, 0.5 + 0.5 * LAW])
    positions = np.column_stack([way - 0.5, 0.3 * way, 0.3 * way, 1.0 - way])
    np.savez(tmp_path / "pause.npz", positions=positions, t=t)
    shown = JointDemonstrations.load(gantry, [tmp_path / "pause.npz"])
    model = JointMotion.fit(shown, 5e-3, OPTIONS)
    motion, _ = model.planned(shown.mean[0])
    assert motion.t[-1] == pytest.approx(12.0)
    resting = motion.q[(motion.t > 3.5) & (motion.t < 8.5)]
    assert np.ptp(resting, axis=0).max() < 0.06
    # In a third of the time y and z, and x above all, would be too fast, in a ninth no slower motion is slow enough.
    hurried, refused = (replace(model, duration=12.0 / times).planned(shown.mean[0]) for times in (8.0, 40.0))
    assert hurried[0].t[-1] > 1.6
    assert hurried[1] == ""
    assert refused[0].t[-1] == pytest.approx(0.3)
    assert "its limit is" in refused[1]


def test_noise_makes_no_way_of_a_pause(gantry, tmp_path):
    rng, paused = np.random.default_rng(0), np.repeat(bend(), [300] + [1] * 199, axis=0)
    for name, q in (("a", bend()), ("b", bend()), ("c", paused)):
        np.save(tmp_path / f"{name}.npy", q + 5e-4 * rng.normal(size=q.shape))
    shown = JointDemonstrations.load(gantry, [tmp_path / f"{name}.npy" for name in "abc"])
    assert shown.mean[:, 1].max() == pytest.approx(0.5, abs=2e-3)


def test_errors_by_hand(gantry):
    shown = bend()[::4]
    # 10 cm beside in z all the way, which is 2 % of its range of 5; the effector is as far off.
    found = study.joint_errors(gantry, np.add(shown, [0.0, 0.0, 0.1, 0.0]), shown, (2e-3, np.deg2rad(3.0)))
    np.testing.assert_allclose(found.joints_rms, [0.0, 0.0, 0.1, 0.0], atol=1e-12)
    assert found.worst_percent == pytest.approx(2.0)
    assert found.effector.goal_mm == pytest.approx(100.0)
    assert found.effector.rms_mm == pytest.approx(100.0, rel=2e-2)
    assert (found.gap_mm, found.gap_deg) == pytest.approx((2.0, 3.0))


def test_what_is_left_out_was_not_seen(learned, monkeypatch):
    shown, model = learned
    seen = []
    monkeypatch.setattr(paths, "SAMPLES", 150)
    monkeypatch.setattr(JointMotion, "fit", lambda some, **_: seen.append(some.q[:, 100, 1]) or model)
    found, ways = study.study_joints(shown, model, starts=2)
    bends = shown.q[:, 100, 1]
    for k, others in enumerate(seen):
        np.testing.assert_array_equal(others, np.delete(bends, k))
    assert len(seen) == 3
    # The mean bends by 0.5, two of three by 0.1 more or less, and errors grow from nothing to that and back.
    assert found.mean.joints_rms[1] < 0.01
    assert 0.03 < found.training.joints_rms[1] < 0.07
    assert found.left_out == found.training
    assert (found.starts, found.arrived) == (2, 2)
    for way in ways:
        np.testing.assert_allclose(way[-1], model.goal, atol=1e-6)
