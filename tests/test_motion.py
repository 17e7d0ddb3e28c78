"""From network to joint trajectory: rest at both ends, consistent derivatives, limits."""

import dataclasses

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.errors import FileError, InputError, PlanError
from lieednn_sim.lie import exp
from lieednn_sim.motion import RESIDUAL, Motion, check_motion, make_motion
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import plan
from lieednn_sim.synthesis import synthesize


@pytest.fixture(scope="module")
def arm():
    return Arm.load("telescopic_pr")


@pytest.fixture(scope="module")
def network(arm):
    return synthesize(arm.encode(arm.keyframe("extended")), bias="sign-matched", bias_magnitude=0.25).unwrap()


@pytest.fixture(scope="module")
def motion(arm, network):
    return make_motion(arm, network, arm.keyframe("home"), 4.0, 0.002)


def test_the_motion_goes_from_rest_to_rest_in_the_stated_time(arm, motion):
    assert motion.t[0] == 0.0
    assert motion.t[-1] == pytest.approx(4.0, abs=1e-12)
    np.testing.assert_allclose(motion.q[0], arm.keyframe("home"), atol=1e-9)
    np.testing.assert_allclose(motion.q[-1], arm.keyframe("extended"), atol=10 * RESIDUAL)
    assert motion.residual <= 2 * RESIDUAL
    np.testing.assert_array_equal(motion.qd[[0, -1]], 0.0)
    # Minimum jerk: the acceleration vanishes at both ends too.
    assert np.abs(motion.qd[[1, -2]]).max() < 1e-3 * np.abs(motion.qd).max()


def test_velocities_are_the_derivative_of_positions(motion):
    numeric = np.gradient(motion.q, motion.t, axis=0, edge_order=2)
    np.testing.assert_allclose(motion.qd[2:-2], numeric[2:-2], atol=2e-4 * np.abs(motion.qd).max())


def test_the_path_is_the_networks_own(arm, network, motion):
    # The time law changes when, never where: states lie on the trajectory in the network's own time.
    assert (np.diff(motion.tau) >= 0.0).all()
    trajectory = network.trajectory(arm.encode(arm.keyframe("home")), motion.tau[-1], method="DOP853")
    np.testing.assert_allclose(trajectory(motion.tau), motion.xi, atol=1e-6)


def test_gap_is_the_distance_between_decoded_and_feasible_poses(arm, motion):
    difference = arm.joint_poses(motion.q).inv() * exp(motion.xi)
    np.testing.assert_allclose(motion.gap_translation, np.linalg.norm(difference.translation, axis=-1), atol=1e-9)
    np.testing.assert_allclose(motion.gap_rotation, difference.rotation.magnitude(), atol=1e-7)
    assert motion.gap_translation.max() > 1e-3, "a mechanism of two freedoms cannot follow se(3) exactly on the way"
    assert motion.gap_translation[-1].max() < 10 * RESIDUAL


def test_a_motion_to_where_the_arm_is_stays_there(arm):
    home = arm.keyframe("home")
    still = make_motion(arm, synthesize(arm.encode(home), bias="sign-matched").unwrap(), home, 1.0, 0.002)
    np.testing.assert_allclose(still.q, np.broadcast_to(home, still.q.shape), atol=1e-9)
    np.testing.assert_array_equal(still.qd, 0.0)


def test_limits_are_checked_with_joint_value_bound_and_remedy(arm, network, motion):
    check_motion(arm, motion)
    fast = make_motion(arm, network, arm.keyframe("home"), 0.3, 0.002)
    with pytest.raises(PlanError, match=r"would accelerate at .*its limit is .*a duration of at least") as refused:
        check_motion(arm, fast)
    enough = float(str(refused.value).split("at least ")[1].split(" s")[0])
    check_motion(arm, make_motion(arm, network, arm.keyframe("home"), enough + 0.02, 0.002))
    beyond = motion.q.copy()
    beyond[900, 3] = 0.6
    with pytest.raises(
        PlanError, match=r"at t = 1\.80 s joint 'extend1' would be at 0\.6 m, its range is \[0, 0\.45\]"
    ):
        check_motion(arm, dataclasses.replace(motion, q=beyond))


def test_contact_on_the_way_is_refused(arm, motion):
    down = motion.q.copy()
    down[:, 2], down[:, 6], down[:, 3], down[:, 5], down[:, 7], down[:, 4] = -0.6, -1.0, 0.45, 0.4, 0.3, 0.0
    down[:, 1] = 0.0
    with pytest.raises(PlanError, match="would come within 2 mm of"):
        check_motion(arm, dataclasses.replace(motion, q=down))


def test_bad_input(arm, network):
    home = arm.keyframe("home")
    for duration in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="duration"):
            make_motion(arm, network, home, duration, 0.002)
    with pytest.raises(InputError, match="between 2 and 1000000 time steps"):
        make_motion(arm, network, home, 0.001, 0.002)
    with pytest.raises(InputError, match=r"start must have shape \(8\)"):
        make_motion(arm, network, home[:3], 1.0, 0.002)
    small = synthesize(np.full((2, 6), 0.3), bias="sign-matched").unwrap()
    with pytest.raises(InputError, match=r"2 neurons.*4 links"):
        make_motion(arm, small, home, 1.0, 0.002)


def test_a_network_that_does_not_arrive_is_refused(arm):
    n = arm.n_links
    rotation = np.broadcast_to(np.eye(3), (n, n, 3, 3))
    rising = LieEDNN(alpha=4.0 * np.eye(n), rotation=rotation, translation=np.zeros((n, n, 3)), bias=np.zeros((n, 6)))
    with pytest.raises(PlanError, match=r"does not arrive|cannot be used"):
        make_motion(arm, rising, arm.keyframe("home"), 1.0, 0.002)


def test_save_and_load(motion, tmp_path):
    motion.save(tmp_path / "motion.npz")
    loaded = Motion.load(tmp_path / "motion.npz")
    for name, value in vars(motion).items():
        np.testing.assert_array_equal(getattr(loaded, name), value)
    (tmp_path / "motion.npz").write_bytes(b"PK not a zip")
    with pytest.raises(FileError, match="not a readable motion file"):
        Motion.load(tmp_path / "motion.npz")


def test_plans_are_reproducible_and_keep_the_limits(arm):
    first, second = (plan(arm, arm.keyframe("extended"), candidates=6, seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.motion.q, second.motion.q)
    assert first.network.certified
    check_motion(arm, first.motion)
    other = plan(arm, arm.keyframe("extended"), candidates=6, seed=4)
    assert not np.array_equal(first.network.alpha, other.network.alpha)


def test_plan_reports_progress_and_refuses_bad_targets(arm):
    seen = []
    plan(arm, arm.keyframe("extended"), candidates=3, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 3), (2, 3), (3, 3)]
    beyond = arm.keyframe("home")
    beyond[3] = 3.0
    with pytest.raises(InputError, match="target is out of reach: joint 'extend1' would be at 3 m"):
        plan(arm, beyond)
    with pytest.raises(InputError, match="candidates must be at least 1"):
        plan(arm, arm.keyframe("extended"), candidates=0)
    with pytest.raises(InputError, match="no bias rule 'none'; allowed: sign-matched, solved, uniform"):
        plan(arm, arm.keyframe("extended"), bias="none")
    with pytest.raises(PlanError, match="a duration of at least"):
        plan(arm, arm.keyframe("extended"), duration=0.2, candidates=3)
