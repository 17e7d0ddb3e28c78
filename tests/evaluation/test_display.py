"""What an evaluation sums up, and what a terminal shows of it, cell by cell."""

from __future__ import annotations

import contextlib
import dataclasses
import io

import numpy as np
import pytest

from lieednn_sim.cli.console import console
from lieednn_sim.evaluation.evaluation import Evaluation, FrameErrors, JointUse, MotionMetrics, Recovery
from lieednn_sim.simulation import Disturbances

EVALUATION = Evaluation(
    arm="an_arm",
    scene="poles",
    controller="mocap",
    reference_rate=100.0,
    disturbances=Disturbances(mass_scale=1.2, payload=0.5, position_noise=1e-3, velocity_noise=2e-3),
    hold=1.0,
    duration_s=5.0,
    motion_s=4.0,
    plan=MotionMetrics(4.0, 12.5, 3.5, 0.5, 0.25, 1.0, 2.0, 3.0, None, 1e-9),
    frames=(
        FrameErrors("link 1", 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.25),
        FrameErrors("end effector", 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, None),
    ),
    joints=(JointUse("turn", 0.5, 2.0, 30.0, 40.0, 7.5), JointUse("slide", 1.0, np.inf, 25.0, np.inf, 0.0)),
    path_m=2.5,
    displacement_m=1.25,
    clearance_mm=12.5,
    contacts=2,
    peak_contact_force_n=17.5,
    peak_weld_force_n=21.5,
    peak_weld_torque_n_m=22.5,
    force_fraction=0.75,
    recoveries=(Recovery("link 2", 0.5, 0.75, 8.125, 9.25, 0.375), Recovery("hand", 1.5, 2.0, 4.0, 5.0, None)),
    **{f"{what}_{kind}": 0 for what in ("position", "velocity", "acceleration") for kind in ("violations", "excess")},
)


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    """A terminal that is wide enough."""
    monkeypatch.setenv("COLUMNS", "200")


def cells(line: str) -> list[str]:
    """Cells are apart by two blanks or more."""
    return [cell.strip() for cell in line.split("  ") if cell.strip()]


def test_every_cell_is_under_its_heading():
    lines = [line for line in str(EVALUATION).splitlines() if line.strip(" ─━")]
    rows = [cells(line) for line in lines]
    assert lines[0] == "fails: 2 contacts at a time, a link ends 10 mm and 20 degrees off"
    assert lines[1].strip() == "tracking error, mocap"
    lines, rows = lines[1:], rows[1:]
    assert rows[1] == ["frame", "final mm", "deg", "RMS mm", "deg", "max mm", "deg", "settled s"]
    assert rows[2] == ["link 1", "1.5", "2.5", "3.5", "4.5", "5.5", "6.5", "7.25"]
    assert rows[3] == ["end effector", *map(str, (10, 20, 30, 40, 50, 60)), "never"]
    caption = "the end effector moves 1.25 m (path 2.50 m) in 4 s, then holds; contacts: 2; "
    assert caption + f"mechanism gap of the plan: 12.5 mm, {EVALUATION.plan.gap_deg:.3g} degrees" in " ".join(
        " ".join(lines).split()
    )
    assert ["joint", "peak velocity", "of limit", "peak force", "of limit", "constraints"] in rows
    assert ["turn", "0.5", "25%", "30", "75%", "7.5"] in rows
    assert ["slide", "1", "-", "25", "-", "0"] in rows
    assert ["body", "from s", "to s", "peak mm", "deg", "recovered after s"] in rows
    assert ["link 2", "0.5", "0.75", "8.12", "9.25", "0.38"] in rows
    assert ["hand", "1.5", "2", "4", "5", "never"] in rows
    conditions = "conditions: reference held at 100 Hz, masses times 1.2, payload 0.5 kg, position noise 0.001, "
    assert conditions + "velocity noise 0.002" in lines
    assert "contact force up to 17.5 N; welds up to 21.5 N and 22.5 N m; least clearance 12.5 mm at samples" in lines


def test_causes_follow_the_error_of_the_worst_frame():
    turned = dataclasses.replace(EVALUATION, frames=EVALUATION.frames[::-1], causes=("the wind", "the rain"))
    assert str(turned).splitlines()[-3:] == ["final error 10 mm and 20 degrees:", "- the wind", "- the rain"]


def test_what_did_not_happen_is_not_shown():
    plain = dataclasses.replace(
        EVALUATION,
        scene="free",
        reference_rate=None,
        disturbances=Disturbances(),
        plan=None,
        recoveries=(),
        contacts=0,
        peak_weld_force_n=0.0,
        peak_weld_torque_n_m=0.0,
    )
    for word in ("pushes", "conditions", "contact force", "welds", "clearance", "mechanism gap"):
        assert word in str(EVALUATION)
        assert word not in str(plain)


def test_what_is_printed_is_what_the_command_line_prints(monkeypatch):
    # As wide as the one console was made.
    monkeypatch.setenv("COLUMNS", str(console.width))
    stream = io.StringIO()
    with contextlib.redirect_stdout(stream):
        console.print(EVALUATION)
    assert stream.getvalue() == f"{EVALUATION}\n"


def frame(name, *values, settled=1.0):
    return FrameErrors(name, *values, settling_s=settled)


def test_an_evaluation_takes_the_worst_link_the_effector_and_the_hardest_joint():
    # In each column another frame is the worst; the effector is the last.
    frames = (
        frame("link 1", 9.0, 1.0, 3.0, 60.0, 50.0, 6.0, settled=1.25),
        frame("link 2", 1.0, 8.0, 70.0, 4.0, 5.0, 90.0, settled=1.75),
        frame("end effector", 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, settled=1.5),
    )
    joints = (JointUse("x", 1.0, 2.0, 9.0, 10.0, 0.0), JointUse("turn", 3.0, 4.0, 1.0, np.inf, 0.0))
    expected = {
        "velocity_fraction": 0.75,
        "settling_s": 1.75,
        "final_effector_mm": 2.0,
        "final_effector_deg": 3.0,
        "final_worst_mm": 9.0,
        "final_worst_deg": 8.0,
        "tracking_rms_mm": 70.0,
        "tracking_rms_deg": 60.0,
        "tracking_max_mm": 50.0,
        "tracking_max_deg": 90.0,
    }
    found = dataclasses.replace(EVALUATION, frames=frames, joints=joints)
    assert {name: getattr(found, name) for name in expected} == pytest.approx(expected)
    frames = (*frames[:2], frame("end effector", 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, settled=None))
    assert dataclasses.replace(EVALUATION, frames=frames, joints=joints).settling_s is None


def test_success_needs_every_link_within_both_bounds_and_no_contact():
    def shortfall(*frames, contacts=0):
        return dataclasses.replace(EVALUATION, frames=frames, contacts=contacts).shortfall

    good = frame("link 1", 1.0, 0.1, 9.0, 9.0, 9.0, 9.0)
    far = frame("link 2", 1.001, 0.0, 0.0, 0.0, 0.0, 0.0)
    skew = frame("link 2", 5.6e-14, 0.1001, 0.0, 0.0, 0.0, 0.0)
    away = frame("link 2", 1234.5, 1.9e-14, 0.0, 0.0, 0.0, 0.0)
    assert shortfall(good, good) == ""
    assert shortfall(good, far, good) == "arrival: link 2 ends 1 mm and 0 deg off"
    assert shortfall(good, skew) == "arrival: link 2 ends 0 mm and 0.1 deg off"
    assert shortfall(good, away) == "arrival: link 2 ends 1234 mm and 0 deg off"
    assert shortfall(far, contacts=3) == "contact: up to 3 at a time"
    # In a sequence a grasp is contact.
    grasped = dataclasses.replace(EVALUATION, frames=(good,), contacts=3, sequence=True)
    assert (grasped.shortfall, grasped.arrival[:14]) == ("", "arrives after ")
    assert "3 contacts at a time, ends 1 mm" in grasped.arrival
    assert "contacts: 3, grasps too" in str(grasped)
