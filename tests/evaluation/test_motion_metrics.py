"""Numbers of plans and rollouts by hand, in the units that the columns name."""

import dataclasses

import numpy as np
import pytest
from rollouts import make_rollout

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.metrics import evaluate, motion_metrics, rms_curvature, violations
from lieednn_sim.planning.motion import Motion


def motion_of(arm, t, q, qd):
    zeros = np.zeros((len(t), arm.n_links))
    return Motion(t, t, np.zeros((len(t), 2, 6)), np.zeros((2, 6)), q, qd, zeros, zeros)


def rollout_of(arm, q, qd, contacts=None):
    return make_rollout(arm, q, qd=qd, contacts=np.zeros(len(q), dtype=int) if contacts is None else contacts)


def test_a_cubic_has_its_jerk_length_and_gaps(gantry):
    """x, y, z = (1, 2, -2) t^3 in ranges of 2, 4, 5: a jerk of 6 times these, the effector's 18 m/s^3 at all times."""
    t = 0.01 * np.arange(61)
    rates = np.array([1.0, 2.0, -2.0, 0.0])
    motion = motion_of(gantry, t, np.outer(t**3, rates), np.outer(3.0 * t**2, rates))
    gaps = np.zeros((2, 61, 2))
    gaps[0, 20], gaps[0, -1] = [0.004, 0.009], [0.002, 0.001]
    gaps[1, 30], gaps[1, -1] = np.deg2rad([11.0, 5.0]), np.deg2rad([0.5, 0.7])
    motion = dataclasses.replace(motion, gap_translation=gaps[0], gap_rotation=gaps[1])
    found = dataclasses.asdict(motion_metrics(gantry, motion))
    assert found.pop("network_residual") == 0.0
    assert found.pop("curvature") == pytest.approx(0.0, abs=1e-6)
    assert found == pytest.approx(
        {
            "motion_s": 0.6,
            "gap_mm": 9.0,
            "gap_deg": 11.0,
            "gap_end_mm": 2.0,
            "gap_end_deg": 0.7,
            "path_ranges": 0.6**3 * np.sqrt(0.5**2 + 0.5**2 + 0.4**2),
            "jerk_joints": 6.0 * np.sqrt((0.5**2 + 0.5**2 + 0.4**2 + 0.0) / 4.0),
            "jerk_effector": 18.0,
        },
        rel=1e-6,
    )


def test_a_circle_has_the_curvature_of_its_radius(gantry):
    t = 0.01 * np.arange(101)
    angle = 2.0 * t
    q, qd = np.zeros((101, 4)), np.zeros((101, 4))
    q[:, 0], q[:, 1] = 0.5 * np.cos(angle), 0.5 * np.sin(angle)
    qd[:, 0], qd[:, 1] = -np.sin(angle), np.cos(angle)
    found = motion_metrics(gantry, motion_of(gantry, t, q, qd))
    assert found.curvature == pytest.approx(2.0, rel=1e-3)
    assert found.jerk_effector == pytest.approx(0.5 * 2.0**3, rel=1e-3)
    still = motion_of(gantry, t, np.zeros((101, 4)), np.zeros((101, 4)))
    assert motion_metrics(gantry, still).curvature is None
    # Three samples have a curvature, here |(1, 0) x (0, 2)| / 1, and no third difference.
    assert rms_curvature([[-0.1, 0.1, 0.0], [0.0, 0.0, 0.0], [0.1, 0.1, 0.0]], 0.1) == pytest.approx(20.0)
    assert rms_curvature(np.zeros((2, 3)), 0.1) is None
    with pytest.raises(InputError, match="path must have shape"):
        rms_curvature(np.ones((50, 2)), 0.01)
    short = motion_metrics(gantry, motion_of(gantry, t[:3], q[:3], qd[:3]))
    assert short.jerk_effector == 0.0


def test_curvature_is_weighted_by_the_way_where_the_path_is_not_slow():
    """At (0, 0) |(1, 0) x (0, 20)| / 1 with 1 m/s; at (0.1, 0.1) none, as fast as the last point is far."""
    bend, diagonal = [[-0.1, 0.1, 0.0], [0.0, 0.0, 0.0], [0.1, 0.1, 0.0]], np.array([1.0, 1.0, 0.0])
    for speed, expected in ((4.0, np.sqrt(20.0**2 / 5.0)), (19.0, np.sqrt(20.0**2 / 20.0)), (21.0, 0.0)):
        path = [*bend, speed * 0.2 / np.sqrt(2.0) * diagonal]
        assert rms_curvature(path, 0.1) == pytest.approx(expected, abs=1e-12)
    # Whatever the pace, down to a nanometre in a second.
    assert rms_curvature(bend, 5e7) == pytest.approx(20.0)
    assert rms_curvature(bend, 2e8) is None


def test_jerk_and_curvature_are_the_last_link_s(gantry):
    """The wrist alone turns, by t^3 with half a metre of a lever: the first link stays where it is."""
    spec = gantry.spec.copy()
    spec.site("link2_frame").pos = (0.5, 0.0, 0.0)
    arm = Arm.from_spec(spec, gantry.source, "lever")
    t, turn = 1e-3 * np.arange(101), np.array([0.0, 0.0, 0.0, 1.0])
    found = motion_metrics(arm, motion_of(arm, t, np.outer(t**3, turn), np.outer(3.0 * t**2, turn)))
    assert found.jerk_effector == pytest.approx(0.5 * 6.0, rel=1e-4)
    assert found.curvature == pytest.approx(2.0, rel=1e-3)


def test_clearance_is_looked_at_every_fifth_sample_and_at_contacts(gantry):
    q = np.zeros((12, 4))
    q[:, 2] = 0.1 * np.arange(12) + 1.0
    q[5, 2], q[7, 2], q[8, 2] = -0.25, -0.75, -1.0
    assert evaluate(rollout_of(gantry, q, np.zeros_like(q))).clearance_mm == pytest.approx(650.0)
    touching = np.zeros(12, dtype=int)
    touching[8] = 3
    # The motion is looked at, not what it should have been.
    rollout = dataclasses.replace(rollout_of(gantry, q, np.zeros_like(q), touching), q_ref=np.zeros_like(q))
    assert evaluate(rollout).clearance_mm == pytest.approx(-100.0)


def test_violations_by_hand(gantry):
    q, qd = np.zeros((6, 4)), np.zeros((6, 4))
    # Beyond ranges of 2, 4, 5 by less than a micron, by 2 microns and by a quarter of the range; twice in one sample.
    q[0, 0], q[1, 0], q[2, 1], q[2, 2] = 1.0 + 9e-7, 1.0 + 2e-6, -3.0, 3.5
    # Limits are 1, 2, 4, 8 and 10, 20, 40, 80 with steps of 0.01 s.
    qd[:, 0], qd[3:, 1] = 1.0009, -2.5
    found = violations(rollout_of(gantry, q, qd))
    assert found == pytest.approx(
        {
            "position_violations": 2,
            "position_excess": 0.25,
            "velocity_violations": 3,
            "velocity_excess": 0.25,
            "acceleration_violations": 1,
            "acceleration_excess": 250.0 / 20.0 - 1.0,
        }
    )
