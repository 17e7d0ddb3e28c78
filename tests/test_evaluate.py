"""Metrics against cases whose answer is known."""

import csv
import dataclasses
import json

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.evaluate import evaluate
from lieednn_sim.simulate import Rollout


@pytest.fixture
def arm():
    return Arm.load("telescopic_pr")


@pytest.fixture
def perfect(arm):
    """A rollout that follows exactly, from home to extended in 1 s, then holds for 1 s."""
    t = np.linspace(0.0, 2.0, 201)
    share = np.clip(t, 0.0, 1.0)[:, None]
    q = (1.0 - share) * arm.keyframe("home") + share * arm.keyframe("extended")
    poses = arm.link_poses(q)
    return Rollout(
        arm=arm.name,
        t=t,
        q=q,
        qd=np.gradient(q, t, axis=0),
        q_ref=q,
        qd_ref=np.gradient(q, t, axis=0),
        ctrl=q,
        force=np.ones_like(q),
        constraint_force=np.zeros_like(q),
        link_position=poses.translation,
        link_quaternion=poses.rotation.as_quat(scalar_first=True),
        contacts=np.zeros(len(t), dtype=int),
        motion_end=1.0,
    )


def test_a_perfect_rollout_has_no_error(arm, perfect):
    result = evaluate(arm, perfect, arm.keyframe("extended"))
    for frame in result.frames:
        assert frame.final_translation_mm < 1e-9
        assert frame.max_translation_mm < 1e-9
        assert frame.max_rotation_deg < 1e-5
        assert 0.9 < frame.settling_time <= 1.0
    tips = arm.link_poses(np.stack([arm.keyframe("home"), arm.keyframe("extended")])).translation[:, -1]
    assert result.displacement == pytest.approx(np.linalg.norm(tips[1] - tips[0]))
    assert result.travel >= result.displacement
    assert result.max_gap_translation_mm is None


def test_a_known_offset_is_measured(arm, perfect):
    shifted = perfect.link_position.copy()
    shifted[:, -1, 2] += 3e-3
    result = evaluate(arm, dataclasses.replace(perfect, link_position=shifted), arm.keyframe("extended"))
    tip = result.end_effector
    assert (tip.rms_translation_mm, tip.max_translation_mm, tip.final_translation_mm) == pytest.approx((3.0, 3.0, 3.0))
    assert tip.settling_time is None
    assert result.frames[0].max_translation_mm < 1e-9


def test_json_and_csv_hold_the_same_numbers(arm, perfect, tmp_path):
    result = evaluate(arm, perfect, arm.keyframe("extended"))
    result.save_json(tmp_path / "metrics.json")
    result.save_csv(tmp_path / "metrics.csv")
    frames = json.loads((tmp_path / "metrics.json").read_text())["frames"]
    with (tmp_path / "metrics.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert (
        [row["name"] for row in rows] == [f["name"] for f in frames] == ["link 1", "link 2", "link 3", "end effector"]
    )
    assert float(rows[-1]["settling_time"]) == frames[-1]["settling_time"]


def test_rollouts_of_another_arm_are_refused(arm, perfect):
    with pytest.raises(InputError, match="of arm 'other'"):
        evaluate(arm, dataclasses.replace(perfect, arm="other"), arm.keyframe("extended"))
