"""Every arm: kinematics against MuJoCo's own, encoding, retraction, and the contract of the model files."""

import dataclasses
import itertools
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm, solve_ik
from lieednn_sim.budget import reporting
from lieednn_sim.errors import FileError, InputError, NoSolutionError
from lieednn_sim.registry import DEFAULT_ARMS


@pytest.fixture(scope="module", params=DEFAULT_ARMS)
def arm(request):
    return Arm.load(request.param)


def random_positions(arm, count, seed=0):
    # Three quarters of a ball joint's box have a rotation vector that is too long: half the box is inside.
    low, high = (0.57 if len(arm.space.balls) else 1.0) * arm.position_limits.T
    return np.random.default_rng(seed).uniform(low, high, (count, arm.n_joints))


def test_link_poses_equal_mujocos_kinematics(arm):
    data = mujoco.MjData(arm.model)
    positions = random_positions(arm, 100)
    poses = arm.link_poses(positions).as_matrix()
    sites = [arm.model.site(f"link{i + 1}_frame").id for i in range(arm.n_links)]
    for q, pose in zip(positions, poses, strict=True):
        data.qpos[:] = arm.qpos(q)
        mujoco.mj_kinematics(arm.model, data)
        np.testing.assert_allclose(pose[:, :3, 3], data.site_xpos[sites], atol=1e-9)
        np.testing.assert_allclose(pose[:, :3, :3].reshape(-1, 9), data.site_xmat[sites], atol=1e-9)
    np.testing.assert_allclose(arm.tip(positions), poses[:, -1, :3, 3], atol=1e-12)
    np.testing.assert_allclose(arm.tip(positions[0]), poses[0, -1, :3, 3], atol=1e-12)
    for k in range(1, arm.n_links):
        seen = np.linalg.solve(poses[:, k - 1], poses[:, -1, :, 3:])[:, :3, 0]
        np.testing.assert_allclose(arm.tip_in_frames(positions)[:, k], seen, atol=1e-12)


def test_jacobian_is_the_derivative_of_the_pose(arm):
    h = 1e-6
    positions = random_positions(arm, 10)
    positions[0], positions[1] = 0.0, 1e-9
    jacobians = np.stack([arm.jacobian(positions.reshape(2, 5, -1), link) for link in range(arm.n_links)], axis=-3)
    assert jacobians.shape == (2, 5, arm.n_links, 6, arm.n_joints)
    np.testing.assert_array_equal(arm.jacobian(positions[3]), jacobians[0, 3, -1])
    for q, jacobian in zip(positions, jacobians.reshape(10, arm.n_links, 6, -1), strict=True):
        after, before = (arm.link_poses(q + sign * h * np.eye(arm.n_joints)) for sign in (1.0, -1.0))
        turn = (after.rotation * before.rotation.inv()).as_rotvec()
        numeric = np.concatenate([turn, after.translation - before.translation], axis=-1) / (2.0 * h)
        np.testing.assert_allclose(jacobian, np.moveaxis(numeric, 0, -1), atol=1e-8)
    with pytest.raises(InputError, match="link must be at most"):
        arm.jacobian(positions, arm.n_links)


def test_encoding_and_retraction_are_inverse_on_the_joints_set(arm):
    positions = random_positions(arm, 200).reshape(2, 100, -1)
    decoded = arm.decode(arm.encode(positions))
    np.testing.assert_allclose(decoded.q, positions, atol=1e-9)
    assert decoded.gap_translation.shape == (2, 100, arm.n_links)
    assert decoded.gap_translation.max() < 1e-9
    assert decoded.gap_rotation.max() < 1e-7


@pytest.mark.parametrize("size", [0.0, 1e-3, 0.2])
def test_retracted_rates_agree_with_finite_differences(arm, size):
    rng = np.random.default_rng(1)
    xi = arm.encode(random_positions(arm, 8)) + size * rng.normal(size=(8, arm.n_links, 6))
    rate = rng.normal(size=xi.shape)
    h = 1e-5
    numeric = (arm.decode(xi + h * rate).q - arm.decode(xi - h * rate).q) / (2 * h)
    np.testing.assert_allclose(arm.decode(xi, rate).qd, numeric, atol=2e-7 * (1.0 + np.abs(numeric).max()))


def test_rates_and_velocities_are_mujocos_own(arm):
    rng = np.random.default_rng(2)
    for q in random_positions(arm, 10):
        qd = rng.normal(size=arm.n_joints)
        qvel = arm.qvel(q, qd)
        np.testing.assert_allclose(arm.rates(q, qvel), qd, atol=1e-9)
        numeric = np.zeros(arm.model.nv)
        h = 1e-6
        mujoco.mj_differentiatePos(arm.model, numeric, 2 * h, arm.qpos(q - h * qd), arm.qpos(q + h * qd))
        np.testing.assert_allclose(qvel, numeric, atol=1e-7)
        np.testing.assert_allclose(arm.coordinates(arm.qpos(q)), q, atol=1e-12)


def test_the_model_keeps_its_contract(arm):
    model = arm.model
    for kind in ("body", "joint", "site", "camera", "actuator", "light", "mat"):
        count = getattr(
            model, {"body": "nbody", "joint": "njnt", "actuator": "nu", "camera": "ncam"}.get(kind, f"n{kind}")
        )
        assert all(getattr(model, kind)(i).name for i in range(count)), f"every {kind} has a name"
    assert model.nv == model.nu == arm.n_joints
    assert model.actuator_trnid[:, 0].tolist() == sorted(model.actuator_trnid[:, 0]), "actuators in the joints' order"
    assert np.isfinite(arm.acceleration_limits).all()
    assert (model.body_gravcomp[1:][model.body_dofnum[1:] > 0] == 1.0).all()
    assert np.isfinite(arm.velocity_limits).all()
    assert np.isfinite(arm.force_limits).all()
    for key in range(model.nkey):
        q = arm.keyframe(model.key(key).name)
        np.testing.assert_allclose(model.key_ctrl[key], q, atol=1e-9)
        arm.check_position(q)
        assert arm.contacts(q) == []
    home = arm.keyframe("home")
    low, high = arm.position_limits.T
    assert ((home - low) > 0.05 * (high - low)).all()


def test_gains_follow_from_the_stated_natural_frequency(arm):
    model, data = arm.model, mujoco.MjData(arm.model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    effective = 1.0 / np.diag(np.linalg.inv(inertia))
    frequency = 2.0 * np.pi * model.numeric("natural_frequency").data[0]
    stiffness, damping = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
    np.testing.assert_allclose(stiffness, effective * frequency**2, rtol=1e-3)
    np.testing.assert_allclose(damping, 2.0 * np.sqrt(stiffness * effective), rtol=1e-3)  # dampratio 1


def test_the_home_posture_holds_under_noise_without_warnings(arm):
    data = mujoco.MjData(arm.model)
    rng = np.random.default_rng(0)
    home = arm.keyframe("home")
    data.qpos[:] = arm.qpos(home)
    low, high = arm.position_limits.T
    for _ in range(1000):
        data.ctrl[:] = np.clip(home + 0.02 * rng.normal(size=home.shape), low, high)
        mujoco.mj_step(arm.model, data)
    assert not data.warning.number.any()
    assert np.abs(arm.coordinates(data.qpos) - home).max() < 0.05


def test_reach_puts_the_end_effector_where_it_is_asked(arm, monkeypatch):
    wanted = arm.link_poses(arm.keyframe("extended"))[-1]
    q = solve_ik(arm, wanted.translation, wanted.rotation)
    found = arm.link_poses(q)[-1]
    np.testing.assert_allclose(found.translation, wanted.translation, atol=1e-5)
    assert (found.rotation.inv() * wanted.rotation).magnitude() < 1e-5
    arm.check_position(q)
    # No further start helps where nothing reaches.
    monkeypatch.setattr(sys.modules["lieednn_sim.arm.inverse_kinematics"], "_ATTEMPTS", 2)
    with pytest.raises(NoSolutionError, match=r"cannot reach \(9, 0, 0\) m.* m away"):
        solve_ik(arm, [9.0, 0.0, 0.0])


def test_reach_says_how_close_the_best_of_its_attempts_comes(gantry, monkeypatch):
    """The end effector is at x + 1: attempts end at -0.5, 0 and 0.75 in turn; x is at most 1."""
    found = ((np.array([x, 0.0, 0.0, 0.0]), 4.0 - x) for x in itertools.cycle([-0.5, 0.0, 0.75]))
    monkeypatch.setattr("lieednn_sim.arm.inverse_kinematics._Search._descend", lambda *_: next(found))
    with pytest.raises(NoSolutionError, match=r"\(5, 0, 0\) m: the closest configuration found is 3 m away, with 'x'"):
        solve_ik(gantry, [5.0, 0.0, 0.0], Rotation.identity())
    with pytest.raises(NoSolutionError, match=r"with this orientation: .* 0 m and 30 degrees away"):
        solve_ik(gantry, [1.75, 0.0, 0.0], Rotation.from_rotvec([0.0, 0.0, np.pi / 6.0]))


def test_a_position_is_said_to_be_out_of_reach_only_if_it_is():
    """A search for it alone that ends early is millimetres off."""
    arm, place = Arm.load("telescopic_pr"), [0.58, -0.58, 2.15]
    np.testing.assert_allclose(arm.tip(solve_ik(arm, place)), place, atol=1e-5)
    with pytest.raises(NoSolutionError, match=r"cannot reach \(0\.58, -0\.58, 2\.15\) m with this orientation"):
        solve_ik(arm, place, Rotation.from_rotvec([3.0, 0.0, 0.0]))


def test_reach_says_what_touches_where_the_pose_is_met(gantry):
    """The ball is in the floor there, whatever the angle."""
    found = r"cannot reach \(1, 0, -0\.{}\) m; at the solutions found '.*' {} '.*'$"
    with pytest.raises(NoSolutionError, match=found.format(95, "touches")):
        solve_ik(gantry, [1.0, 0.0, -0.95])
    with pytest.raises(NoSolutionError, match=found.format(87, "is nearer than the clearance of 60 mm to")):
        solve_ik(dataclasses.replace(gantry, clearance=0.06), [1.0, 0.0, -0.87])


def test_reach_names_the_joints_that_end_at_their_limits_and_can_be_ended(gantry):
    with pytest.raises(NoSolutionError, match=r"configuration found is 3 m away, with 'x' at the limit$"):
        solve_ik(gantry, [5.0, 0.0, 0.0])
    asked = []

    def end(done, total):
        asked.append((done, total))
        if done == 2:
            raise TimeoutError

    with pytest.raises(TimeoutError), reporting(end):
        solve_ik(gantry, [5.0, 0.0, 0.0])
    assert asked == [(0, 32), (1, 32), (2, 32)]


@pytest.mark.parametrize(("keys", "rest"), [("", 0.25), ('<key name="a" qpos="0 0.5"/>', 0.25), ("{home}", 0.75)])
def test_joints_that_are_no_part_of_the_arm_stay_at_home(tmp_path, keys, rest):
    """At the keyframe ``home``, the first or another, else at the reference position of 0.25."""
    home = '<key name="home" qpos="0 0.75"/>'
    for number, keyframes in enumerate((keys.format(home=home), '<key name="b" qpos="0 1"/>' + keys.format(home=home))):
        path = tmp_path / f"{number}.xml"
        path.write_text(f"""
            <mujoco><compiler angle="radian" autolimits="true"/><worldbody>
              <body name="base"><geom size="0.01"/><site name="base_frame"/>
                <body><joint name="turn" type="hinge" axis="0 0 1" range="-3 3"/><geom size="0.1"/>
                  <site name="link1_frame"/></body></body>
              <body pos="0 3 0"><joint name="door" type="hinge" axis="0 0 1" ref="0.25"/><geom size="0.1"/></body>
            </worldbody><keyframe>{keyframes}</keyframe></mujoco>""")
        np.testing.assert_array_equal(Arm.from_xml(path, "arm").qpos(np.array([0.5])), [0.5, rest])


def test_errors_name_what_is_allowed(arm, tmp_path):
    with pytest.raises(InputError, match=r"the text of a model: Arm.from_spec\(mujoco.MjSpec.from_string\(text\)\)"):
        Arm.load("\n<mujoco><worldbody/></mujoco>")
    with pytest.raises(InputError, match="no arm 'nonsense'; allowed: telescopic_compound, telescopic_crane"):
        Arm.load("nonsense")
    with pytest.raises(InputError, match=r"no keyframe 'away'.*home"):
        arm.keyframe("away")
    beyond = arm.keyframe("home")
    beyond[1] = 99.0
    with pytest.raises(InputError, match=rf"{arm.joint_names[1]}.*99.*range"):
        arm.check_position(beyond)
    with pytest.raises(InputError, match="NaN"):
        arm.encode(np.full(arm.n_joints, np.nan))
    with pytest.raises(FileError, match="no such file"):
        Arm.from_xml(tmp_path / "missing.xml")
    broken = tmp_path / "scene.xml"
    broken.write_text("<mujoco><worldbody><geom/></worldbody>")
    with pytest.raises(FileError, match="cannot read"):
        Arm.from_xml(broken)
    broken.write_text("<mujoco><worldbody/></mujoco>")
    with pytest.raises(InputError, match="no hinge, slide or ball joint"):
        Arm.from_xml(broken)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        # With either, a plan went through a wall, and no limit held.
        ({"clearance": -1.0}, "clearance must not be negative, got -1"),
        ({"clearance": np.nan}, "clearance must be finite, got nan"),
        ({"start_tolerance": -1e-3}, "start_tolerance must not be negative"),
        ({"velocity_limits": np.full(4, np.nan)}, "velocity_limits must be finite"),
        ({"acceleration_limits": -np.ones(4)}, "acceleration_limits must not be negative"),
        ({"force_limits": np.ones(3)}, r"force_limits must have shape \(4,\), got \(3,\)"),
        ({"position_limits": np.array([[1.0, -1.0]] * 4)}, "position_limits must have lower limits that are not above"),
    ],
)
def test_what_would_let_an_arm_go_anywhere_is_refused(gantry, changes, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(gantry, **changes)


def test_limits_of_the_gantry(gantry):
    """Forces -30 to 50 with gear 2, -50 to 30 with gear 1/2, -40 to 40, the smaller end counts; the last has none."""
    np.testing.assert_array_equal(gantry.force_limits, [60.0, 15.0, 40.0, np.inf])
    np.testing.assert_array_equal(gantry.velocity_limits, [1.0, 2.0, 4.0, 8.0])
    np.testing.assert_array_equal(gantry.acceleration_limits, [10.0, 20.0, 40.0, 80.0])
    np.testing.assert_array_equal(gantry.position_limits, [[-1.0, 1.0], [-2.0, 2.0], [-2.0, 3.0], [-3.0, 3.0]])
