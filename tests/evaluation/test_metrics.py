"""Metrics against cases whose answer is known."""

import csv
import dataclasses
import json

import numpy as np
import pytest
from rollouts import make_rollout

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation import evaluate, evaluate_following
from lieednn_sim.planning import plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.simulation import Disturbances, Following, MovingObstacle, Push, simulate


@pytest.fixture
def arm():
    return Arm.load("telescopic_pr")


@pytest.fixture
def perfect(arm):
    """A rollout that follows exactly, from home to extended in 1 s, then holds for 1 s."""
    t = np.linspace(0.0, 2.0, 201)
    share = np.clip(t, 0.0, 1.0)[:, None]
    q = (1.0 - share) * arm.keyframe("home") + share * arm.keyframe("extended")
    return make_rollout(arm, q, t=t, qd=np.gradient(q, t, axis=0), force=np.ones_like(q), motion_end=1.0)


def test_a_perfect_rollout_settles_at_its_end_and_is_displaced_as_its_end_effector(arm, perfect):
    result = evaluate(perfect)
    assert all(0.9 < frame.settling_s <= 1.0 for frame in result.frames)
    tips = arm.link_poses(np.stack([arm.keyframe("home"), arm.keyframe("extended")])).translation[:, -1]
    assert result.displacement_m == pytest.approx(np.linalg.norm(tips[1] - tips[0]))
    assert result.path_m >= result.displacement_m
    assert result.plan is None


def test_a_rollout_of_another_arm_or_motion_cannot_be_made(gantry, perfect):
    with pytest.raises(InputError, match=r"q must have shape \(201, 4\)"):
        dataclasses.replace(perfect, arm=gantry)
    rest = still(gantry, 5)
    zeros = np.zeros((3, 4))
    planned = Motion(rest.t[:3], rest.t[:3], np.zeros((3, 2, 6)), np.zeros((2, 6)), zeros, zeros, *np.zeros((2, 3, 2)))
    assert evaluate(dataclasses.replace(rest, motion=planned)).plan.gap_mm == 0.0
    with pytest.raises(InputError, match="the motion is another one"):
        dataclasses.replace(rest, motion=dataclasses.replace(planned, q=zeros + 1e-9))


def test_every_number_of_an_evaluation_by_hand(gantry, tmp_path):
    """Errors that are known, in every unit: what the JSON file and the CSV file hold, to the last entry."""
    rollout = by_hand(gantry)
    motion = Motion(
        t=rollout.t,
        tau=rollout.t,
        xi=np.full((5, 2, 6), 0.25),
        xi_target=np.full((2, 6), 0.125),
        q=rollout.q,
        qd=rollout.qd,
        gap_translation=np.array([[0.001, 0.003], [0.002, 0.007], [0.004, 0.001], [0.0, 0.0], [0.0, 0.0]]),
        gap_rotation=np.deg2rad([[1.0, 2.0], [5.0, 3.0], [4.0, 1.0], [0.0, 0.0], [0.0, 0.0]]),
    )
    result = evaluate(dataclasses.replace(rollout, motion=motion, target=[0.0, 0.0, 0.008, np.deg2rad(7.0)]))
    result.save_json(tmp_path / "metrics.json")
    found = json.loads((tmp_path / "metrics.json").read_text())
    assert (found["plan"]["gap_mm"], found["plan"]["network_residual"]) == pytest.approx((7.0, 0.125))
    expected = {
        "frames": [
            {
                "name": name,
                "final_mm": final_mm,
                "final_deg": final_deg,
                "tracking_rms_mm": rms_mm,
                "tracking_rms_deg": rms_deg,
                "tracking_max_mm": max_mm,
                "tracking_max_deg": max_deg,
                "settling_s": None,
            }
            for name, final_mm, final_deg, rms_mm, rms_deg, max_mm, max_deg in (
                ("link 1", 8.0, 0.0, 5.0, 0.0, 10.0, 0.0),
                ("end effector", 8.0, 7.0, 2.0, 30.0, 4.0, 60.0),
            )
        ],
        "joints": [
            {
                "name": name,
                "peak_velocity": velocity,
                "velocity_limit": fastest,
                "peak_force": force,
                "force_limit": strongest,
                "peak_constraint_force": constraint,
            }
            for name, velocity, fastest, force, strongest, constraint in (
                ("x", 0.5, 1.0, 11.0, 60.0, 0.25),
                ("y", 0.75, 2.0, 12.0, 15.0, 0.0),
                ("z", 0.0, 4.0, 13.0, 40.0, 1.5),
                ("turn", 3.0, 8.0, 14.0, None, 0.0),
            )
        ],
        "path_m": 0.008,
        "displacement_m": 0.0,
        "contacts": 2,
        "peak_contact_force_n": 9.0,
        "peak_weld_force_n": 21.0,
        "peak_weld_torque_n_m": 22.0,
        "motion_s": 0.02,
        "duration_s": 0.04,
        "hold": 0.02,
        "clearance_mm": 900.0,
        "final_worst_mm": 8.0,
        "velocity_fraction": 0.5,
        "force_fraction": 0.8,
        "controller": "mocap",
        "success": False,
        "reason": "contact: up to 2 at a time",
    }
    assert flat({name: found[name] for name in expected}) == {
        path: leaf if leaf is None or isinstance(leaf, str) else pytest.approx(leaf, rel=1e-9, abs=1e-9)
        for path, leaf in flat(expected).items()
    }
    result.save_csv(tmp_path / "metrics.csv")
    with (tmp_path / "metrics.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [list(row) for row in rows] == [list(frame) for frame in expected["frames"]]
    assert [list(row.values()) for row in rows] == [
        ["" if value is None else str(value) for value in frame.values()] for frame in found["frames"]
    ]


def by_hand(arm):
    """Five instants of the gantry, whose reference stays at zero: errors of both frames in x, y, z and about z."""
    zeros = np.zeros((5, 4))
    position = np.zeros((5, 2, 3))
    # Of link 1 the root of the mean of 0, 100, 25, 0, 0 is 5 mm; of the end effector that of 16, 0, 4, 0, 0 is 2 mm.
    position[:, 0] = 1e-3 * np.array([[0, 0, 0], [6, 8, 0], [0, 3, 4], [0, 0, 0], [0, 0, 0]])
    position[:, 1] = [1.0, 0.0, 0.0] + 1e-3 * np.array([[0, 0, 0], [0, 2.4, 3.2], [0, 1.2, 1.6], [0, 0, 0], [0, 0, 0]])
    # The root of the mean of 900, 3600, 0, 0, 0 is 30 degrees.
    half = 0.5 * np.deg2rad([30.0, -60.0, 0.0, 0.0, 0.0])
    quaternion = np.zeros((5, 2, 4))
    quaternion[:, 0, 0] = 1.0
    quaternion[:, 1, 0], quaternion[:, 1, 3] = np.cos(half), np.sin(half)
    rates = zeros.copy()
    rates[1], rates[2] = [-0.5, 0.75, 0.0, -2.0], [0.25, 0.5, 0.0, 3.0]
    forces = zeros.copy()
    forces[0], forces[3] = [-11.0, 1.0, 13.0, 1.0], [1.0, 12.0, -2.0, -14.0]
    pulls = zeros.copy()
    pulls[4] = [-0.25, 0.0, 1.5, 0.0]
    return make_rollout(
        arm,
        zeros,
        qd=rates,
        qd_ref=zeros,
        force=forces,
        constraint_force=pulls,
        link_position=position,
        link_quaternion=quaternion,
        contacts=np.array([0, 1, 2, 1, 0]),
        contact_force=np.array([0.0, 9.0, 4.0, 1.0, 0.0]),
        channels={
            "weld_force": np.array([[1.0, 21.0], [2.0, 3.0], [0.0, 0.0], [0.0, 0.0], [5.0, 0.0]]),
            "weld_torque": np.array([[22.0, 1.0], [2.0, 3.0], [0.0, 0.0], [0.0, 0.0], [5.0, 0.0]]),
        },
        channel_units={"weld_force": "N", "weld_torque": "N m"},
        motion_end=0.02,
        controller="mocap",
    )


def flat(value, name=""):
    """Leaves of nested dictionaries and lists by their path."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return {path: leaf for key, part in items for path, leaf in flat(part, f"{name}/{key}").items()}
    return {name: value}


def still(arm, steps, timestep=0.01):
    """A rollout of the gantry at rest at zero, to put errors into."""
    return make_rollout(arm, np.zeros((steps, arm.n_joints)), t=timestep * np.arange(steps))


def turned(rollout, row, link, degrees):
    """A copy with a link turned about z at an instant."""
    quaternion = rollout.link_quaternion.copy()
    half = 0.5 * np.deg2rad(degrees)
    quaternion[row, link] = [np.cos(half), 0.0, 0.0, np.sin(half)]
    return dataclasses.replace(rollout, link_quaternion=quaternion)


def moved(rollout, row, link, millimetres):
    """A copy with a link moved along x at an instant."""
    position = rollout.link_position.copy()
    position[row, link, 0] += 1e-3 * millimetres
    return dataclasses.replace(rollout, link_position=position)


def test_the_time_of_settling_is_of_the_worse_of_distance_and_angle(gantry):
    rollout = still(gantry, 10)
    assert [frame.settling_s for frame in evaluate(rollout).frames] == [0.0, 0.0]
    for change, size in ((moved, 1.0), (turned, 0.1)):
        # Within the bound at 0.03 s, beyond it before and at 0.05 s: settled at the instant after.
        touched = change(change(rollout, 3, 1, 0.99 * size), 5, 1, 1.01 * size)
        assert [frame.settling_s for frame in evaluate(touched).frames] == [0.0, pytest.approx(0.06)]
        within = change(rollout, 3, 1, 0.99 * size)
        assert evaluate(within).end_effector.settling_s == 0.0
        never = change(rollout, 9, 0, 1.01 * size)
        assert evaluate(never).frames[0].settling_s is None


def test_recovery_from_pushes_by_hand(gantry):
    """Pushes at 0.1 to 0.12 s and 0.2 to 0.23 s; the third begins after the end."""
    pushes = tuple(
        Push(body, (1.0, 0.0, 0.0), start, duration)
        for body, start, duration in (("link 1", 0.1, 0.02), ("end effector", 0.2, 0.03), ("link 1", 0.5, 0.1))
    )
    rollout = dataclasses.replace(still(gantry, 31), disturbances=Disturbances(pushes=pushes))
    rollout = moved(moved(moved(rollout, 9, 0, 50.0), 11, 0, 4.0), 15, 1, 2.0)
    rollout = turned(turned(rollout, 12, 1, 8.0), 19, 0, 0.09)
    # The second push: 30 degrees while it lasts, 3 mm at its last instant and in the last step.
    rollout = turned(moved(rollout, 22, 0, 3.0), 20, 1, 30.0)
    first, second = evaluate(rollout).recoveries
    assert dataclasses.astuple(first) == pytest.approx(("link 1", 0.1, 0.12, 4.0, 8.0, 0.04))
    assert dataclasses.astuple(second) == pytest.approx(("end effector", 0.2, 0.23, 3.0, 30.0, 0.0))
    late = evaluate(moved(rollout, 30, 1, 6.0)).recoveries[1]
    assert (late.peak_deviation_mm, late.recovery_s) == (pytest.approx(6.0), None)
    # One that lasts beyond the end has a deviation, too.
    lasting = Disturbances(pushes=(Push("link 1", (1.0, 0.0, 0.0), 0.15, 9.0),))
    (only,) = evaluate(dataclasses.replace(rollout, disturbances=lasting)).recoveries
    assert (only.peak_deviation_deg, only.recovery_s) == (pytest.approx(30.0), None)


def test_pushes_that_begin_together_share_their_recovery(gantry):
    pushes = tuple(Push(body, (1.0, 0.0, 0.0), 0.1, 0.02) for body in ("link 1", "end effector"))
    rollout = moved(moved(still(gantry, 31), 11, 0, 4.0), 15, 1, 2.0)
    one, other = evaluate(dataclasses.replace(rollout, disturbances=Disturbances(pushes=pushes))).recoveries
    assert dataclasses.astuple(one)[1:] == dataclasses.astuple(other)[1:] == pytest.approx((0.1, 0.12, 4.0, 0.0, 0.04))
    # Less than a step apart: the first has no instant of its own.
    pushes = (pushes[0], dataclasses.replace(pushes[1], start=0.101))
    changed = dataclasses.replace(rollout, disturbances=Disturbances(pushes=pushes))
    first, second = evaluate(changed).recoveries
    assert (first.peak_deviation_mm, first.peak_deviation_deg, first.recovery_s) == (0.0, 0.0, None)
    assert second.peak_deviation_mm == pytest.approx(4.0)


def test_following_errors_by_hand(gantry):
    """A target that runs along x at 0.5 m/s, jumps at 0.05 s and is followed 20 ms late."""
    t, lag = 0.01 * np.arange(21), 0.02
    target = np.zeros((21, 4))
    target[:, 0] = 0.5 * t + np.where(t > 0.095, 0.1, 0.0)
    rollout = still(gantry, 21)
    position = rollout.link_position.copy()
    # After the jump both links are where they shall be from 0.13 s on, but for one instant of link 1.
    position[:, :, 0] += (target[:, 0] - 0.5 * lag)[:, None]
    position[10:13, :, 0] -= 0.05
    position[13:, :, 0] += 0.5 * lag
    position[15, 0, 1] += 0.07
    rollout = dataclasses.replace(rollout, link_position=position)
    rollout = turned(turned(rollout, 4, 1, 21.0), 2, 0, 33.0)
    following = Following(rollout, target, np.zeros((11, 2, 6)), 2, np.zeros(11))
    assert following.jumps == pytest.approx((0.1,))
    errors = evaluate_following(following)
    # Ten instants 10 mm behind, three 60 mm.
    assert errors.rms_mm == pytest.approx(np.sqrt((10 * 10.0**2 + 3 * 60.0**2) / 21))
    assert errors.rms_deg == pytest.approx(21.0 / np.sqrt(21.0))
    assert errors.worst_mm == pytest.approx(70.0), "of link 1"
    assert errors.worst_deg == pytest.approx(33.0)
    # Of the steps without the jump nine are 10 mm late, two 60 mm and eight on time, all at 0.5 m/s.
    assert errors.lag_s == pytest.approx((9 * 0.01 + 2 * 0.06) * 0.5 / (19 * 0.25))
    assert errors.settling_s == (pytest.approx(0.06),)
    assert errors.arrives_s == pytest.approx(0.16)
    # Before the next jump nothing stays there; after it all does.
    later = np.where(t > 0.155, 0.1, 0.0)[:, None] * np.eye(4)[0]
    there = dataclasses.replace(rollout, link_position=rollout.link_position + later[:, None, :3])
    twice = dataclasses.replace(following, target=target + later, rollout=there)
    assert twice.jumps == pytest.approx((0.1, 0.16))
    assert evaluate_following(twice).settling_s == (None, pytest.approx(0.0, abs=1e-12))
    away = moved(rollout, 20, 0, 1.5)
    assert evaluate_following(dataclasses.replace(following, rollout=away)).settling_s == (None,)
    rest = dataclasses.replace(following, target=np.zeros((21, 4)))
    assert evaluate_following(rest).lag_s is None
    assert str(evaluate_following(rest)).startswith("never arrives; on the way, end effector ")


@pytest.mark.parametrize(
    ("controller", "disturbances"),
    [
        ("position-servo", Disturbances(mass_scale=1.5)),
        ("feedback-linearisation", Disturbances(pushes=(Push("end effector", (0.0, 900.0, 0.0), 1.5, 0.8),))),
    ],
)
def test_a_run_is_inside_its_proof_or_it_is_said_when_it_is_not(controller, disturbances):
    arm = Arm.load("telescopic_pr", "shelf", 1)
    planned = plan(arm, draw_target(arm, 1))
    rollout = simulate(arm, planned, controller=controller, disturbances=disturbances)
    result, collisions = rollout.clearance, Collisions(arm)
    # Between samples MuJoCo's steps are straight.
    times = np.sort(np.random.default_rng(0).uniform(0.0, rollout.t[-1], 300))
    q = np.stack([np.interp(times, rollout.t, joint) for joint in rollout.q.T], axis=1)
    outside = ((times[:, None] > result.unproved[:, 0]) & (times[:, None] < result.unproved[:, 1])).any(axis=1)
    assert result.bound <= collisions.clearance(q[~outside]) + 1e-9
    touching = rollout.t[rollout.contacts > 0]
    assert all(((result.unproved[:, 0] <= time) & (time <= result.unproved[:, 1])).any() for time in touching)
    evaluation = evaluate(rollout)
    assert evaluation.proved == result.proved
    assert str(evaluation).splitlines()[0].startswith(f"{evaluation.arrival}; clearance {result}")
    assert dataclasses.replace(rollout, motion=None).clearance is None


def test_what_moves_besides_the_arm_is_in_no_proof():
    arm = Arm.load("telescopic_pr", "poles", 1)
    planned = plan(arm, draw_target(arm, 1))
    assert evaluate(simulate(arm, planned)).proved
    name = next(arm.model.body(k).name for k in range(arm.model.nbody) if "pole" in arm.model.body(k).name)
    there = MovingObstacle(name, [0.0, 1.0], [[2.0, 2.0, 0.5], [2.0, 2.1, 0.5]])
    moved = simulate(arm, planned, disturbances=Disturbances(obstacles=(there,)))
    assert moved.clearance is None
    assert not evaluate(moved).proved
