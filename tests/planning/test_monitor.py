"""Whether a run is inside its plan's proof, told while it goes on: against MuJoCo, and the run's own proof."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.evaluation import evaluate
from lieednn_sim.planning import plan
from lieednn_sim.planning.clearance import proved_clearance
from lieednn_sim.planning.monitor import ClearanceMonitor
from lieednn_sim.simulation import Disturbances, MovingObstacle, Push, Rollout, simulate


@pytest.fixture(scope="module")
def planned():
    arm = Arm.load("telescopic_pr", "window", 1)
    return arm, plan(arm, draw_target(arm, seed=1))


def pushed(arm, force):
    return Disturbances(pushes=(Push(arm.link_names[-1], (force, force, 0.0), 1.5, 0.3),))


def test_a_run_stops_at_the_first_instant_at_which_nothing_is_proved(planned):
    arm, made = planned
    whole = simulate(arm, made, hold=0.0, disturbances=pushed(arm, 300.0))
    with pytest.raises(SimulationError, match="the run leaves the proof of its plan's clearance at t = ") as stopped:
        simulate(arm, made, disturbances=pushed(arm, 300.0), stop_outside=True)
    run, message = stopped.value.rollout, str(stopped.value)
    last = len(run.t) - 1
    np.testing.assert_array_equal(run.q, whole.q[: last + 1])
    assert f"at t = {run.t[-1]:.3f} s: joint" in message
    assert 1.5 < run.t[-1] < 1.6
    # The run's own proof knows the errors of all instants.
    q, qd = made.motion.q[: last + 1], made.motion.qd[: last + 1]
    off = np.abs(run.q - q)
    steps = [slice(k, k + 2) for k in range(last)]
    steps = [slice(0, last - 5), *steps[last - 5 :]]
    proofs = [proved_clearance(arm, run.t[: len(q[k])], q[k], qd[k], off[k]).proved for k in steps]
    assert proofs == [True] * 5 + [False]
    # Of the whole run, the same instant and joint are told, and it is in a stretch that is not proved.
    assert whole.outside == message
    assert evaluate(whole).proof == f"{whole.clearance}; {message}"
    assert whole.clearance.unproved[0, 0] <= run.t[-1] <= whole.clearance.unproved[0, 1]
    # Without the error of the joint that is named, the arm would be as clear as without any other one's.
    collisions = Collisions(arm)
    clearer = [collisions.clearance(np.where(one, q[-1], run.q[-1])) for one in np.eye(arm.n_joints)]
    joint = arm.joint_names.index(re.findall("joint '([^']+)'", message)[0])
    assert clearer[joint] == pytest.approx(max(clearer), abs=1e-5)
    assert f"joint {arm.joint_names[joint]!r} is {off[-1, joint]:.3g} {arm.unit(joint)} off, and '" in message


@pytest.mark.parametrize("disturbances", [Disturbances(), Disturbances(mass_scale=1.5)])
def test_a_run_inside_does_not_stop(planned, disturbances):
    arm, made = planned
    how = {"hold": 0.0, "disturbances": disturbances}
    whole = simulate(arm, made, **how)
    np.testing.assert_array_equal(simulate(arm, made, **how, stop_outside=True).q, whole.q)
    assert whole.outside == ""
    assert evaluate(whole).proved


def test_no_error_that_is_allowed_touches(planned):
    """Errors as large as allowed, at random instants, in random directions and in that of the nearest geoms."""
    arm, made = planned
    motion, rng = made.motion, np.random.default_rng(0)
    monitor, collisions = ClearanceMonitor.of(arm, motion), Collisions(arm)
    spline, least = CubicHermiteSpline(motion.t, motion.q, motion.qd), np.inf
    assert monitor.allowed.max() > 0.01
    for at in rng.uniform(0.0, len(motion.t) - 1.0, 60):
        q = spline(motion.timestep * at)
        allowed = monitor.allowed[min(np.searchsorted(monitor.edges, at, "right") - 1, len(monitor.allowed) - 1)]
        near = collisions.distances(q, 0.3)
        for way in [rng.normal(size=arm.n_joints), *-near.jacobian[:3]]:
            beside = q + 0.999 * allowed * way / max(np.linalg.norm(way), 1e-9)
            least = min(least, collisions.clearance(beside))
            assert least > 0.0
            assert allowed == 0.0 or monitor.holds(beside)
    # As near as that it is sharp.
    assert least < 0.6 * made.clearance.bound
    assert not monitor.holds(motion.q[0] + 1.0)


def test_between_two_instants_the_larger_error_counts(planned):
    arm, made = planned
    monitor = ClearanceMonitor.of(arm, made.motion)
    roomy, none = int(monitor.allowed.argmax()), np.flatnonzero(monitor.allowed == 0.0)
    stretch = slice(none[none < roomy].max(initial=-1) + 1, none[none > roomy].min(initial=len(monitor.allowed)))
    narrow = stretch.start + int(monitor.allowed[stretch].argmin())
    first, last = monitor.edges[sorted((roomy, narrow))].astype(int)
    aside = 0.9 * monitor.allowed[roomy] * np.eye(arm.n_joints)[0]
    errors = (aside, 0.0 * aside) if roomy < narrow else (0.0 * aside, aside)
    assert monitor.holds(made.motion.q[first] + errors[0])
    assert monitor.holds(made.motion.q[last] + errors[1])
    said = monitor.left(first, made.motion.q[first] + errors[0]), monitor.left(last, made.motion.q[last] + errors[1])
    assert said[0] == ""
    assert "the run leaves the proof" in said[1]
    at_rest = ClearanceMonitor.of(arm, made.motion)
    assert [at_rest.left(k, made.motion.q[k]) for k in range(first, last + 1)] == [""] * (last - first + 1)


def test_what_is_no_proof_is_not_watched(planned):
    arm, made = planned
    other = next(arm.model.body(k).name for k in range(arm.model.nbody) if "obstacle" in arm.model.body(k).name)
    there = MovingObstacle(other, [0.0, 1.0], [[2.0, 2.0, 0.5], [2.0, 2.1, 0.5]])
    with pytest.raises(InputError, match="stop_outside needs a single motion, in a scene at rest"):
        simulate(arm, made, disturbances=Disturbances(obstacles=(there,)), stop_outside=True)
    elsewhere = Arm.load(arm.name, scene=arm.scene, seed=4)
    with pytest.raises(InputError, match="a proof that does not exist: not proved from"):
        simulate(elsewhere, made, stop_outside=True)


def test_what_moves_besides_the_arm_is_outside(planned):
    arm, made = planned
    monitor, q = ClearanceMonitor.of(arm, made.motion), made.motion.q[0]
    assert monitor.left(0, q, arm.qpos(q) + 1e-5) == ""
    told = "at t = 0.000 s: more has moved than the arm; if other joints sag, make the arm of a state at rest"
    assert monitor.left(0, q, arm.qpos(q) + 2e-3).endswith(told)


def test_what_other_joints_move_comes_off_the_clearance():
    """A boom turns 0.6 mm above a block, on a lift that is not part of the arm and sinks by 0.2 or 0.9 mm."""
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody>
        <geom name="block" type="box" size=".1 .1 .1" pos=".5 0 0"/><body>
        <joint name="lift" type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <body pos="0 0 .1106"><joint name="turn" axis="0 0 1" range="-60 60"/>
        <geom name="boom" type="capsule" size=".01" fromto="0 0 0 .5 0 0"/></body></body></worldbody></mujoco>""")
    arm = Arm.of(model, mujoco.MjData(model), ["turn"], clearance=1e-4)
    motion = plan(arm, [0.5], start=[-0.5], planner="minimum-jerk").motion
    middle = len(motion.t) // 2
    for sinks, left in ((2e-4, False), (9e-4, True)):
        qpos = arm.qpos(motion.q)
        qpos[:, 0] -= sinks * np.sin(np.pi * motion.t / motion.t[-1])
        said = ClearanceMonitor.of(arm, motion).left(middle, motion.q[middle], qpos[middle])
        assert bool(said) == left
        zeros = np.zeros((len(qpos), 1))
        rows = {"t": motion.t, "q": motion.q, "qd": motion.qd, "q_ref": motion.q, "qd_ref": motion.qd, "qpos": qpos}
        more = {"ctrl": zeros[:, :0], "force": zeros, "constraint_force": zeros, "contacts": zeros[:, 0]}
        poses = arm.link_poses(motion.q)
        frames = {"link_position": poses.translation, "link_quaternion": poses.rotation.as_quat(scalar_first=True)}
        run = Rollout(arm, **rows, **more, **frames, contact_force=zeros[:, 0], motion_end=4.0, motion=motion)
        assert run.clearance.proved != left
    assert "joints bring parts up to 1.8 mm nearer, and 'block' may touch 'boom'" in said
