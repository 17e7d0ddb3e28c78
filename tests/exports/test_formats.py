"""What all exports have in common: names, refusals, and files of others that stay as they are; and CSV."""

from __future__ import annotations

import csv
import tempfile

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim.cli import main
from lieednn_sim.errors import FileError, InputError, LieEDNNError
from lieednn_sim.exports import FORMATS, export


def test_csv_holds_every_number_with_its_name_and_unit(rollout, tmp_path):
    (path,) = export(rollout, tmp_path / "new", rate=20.0)
    assert path == tmp_path / "new" / "motion.csv"
    with path.open(newline="") as stream:
        header, *rows = csv.reader(stream)
    assert header[:5] == [
        *("time [s]", "turn planned position [rad]", "turn measured position [rad]"),
        *("turn planned velocity [rad/s]", "turn measured velocity [rad/s]"),
    ]
    assert header[5] == "lift planned position [m]"
    values = np.array(rows, dtype=float)
    columns = dict(zip(header, values.T, strict=True))
    np.testing.assert_array_equal(columns["time [s]"], rollout.t[::5])
    np.testing.assert_array_equal(columns["lift measured position [m]"], rollout.q[::5, 1])
    np.testing.assert_array_equal(columns["lift planned position [m]"], rollout.q_ref[::5, 1])
    tip = np.stack([columns[f"end effector {axis} [m]"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(tip, rollout.arm.tip(rollout.q[::5]), atol=1e-12)
    read = np.genfromtxt(path, delimiter=",", names=True)
    np.testing.assert_array_equal(read["end_effector_qw_1"], rollout.link_quaternion[::5, -1, 0])


def test_quaternions_do_not_jump_where_the_hand_turns_further_than_half_a_turn(tmp_path):
    body = '<body pos=".3 0 0"><joint name="{}" axis="0 0 1" range="-170 170"/><geom size=".05"/>{}</body>'
    (tmp_path / "arm.xml").write_text(
        f"<mujoco><worldbody>{body.format('a', body.format('b', ''))}</worldbody></mujoco>"
    )
    arm = ls.Arm.load(tmp_path / "arm.xml", floor="none")
    planned = ls.plan(arm, [2.9, 2.9], start=[0.4, 0.2], planner="minimum-jerk")
    (path,) = export(ls.simulate(arm, planned), tmp_path / "out")
    read = np.genfromtxt(path, delimiter=",", names=True)
    quaternion = np.stack([read[f"end_effector_q{axis}_1"] for axis in "wxyz"], axis=1)
    assert np.vecdot(quaternion[1:], quaternion[:-1]).min() > 0.0


@pytest.mark.parametrize(
    "name", [name for name, entry in FORMATS.items() if not entry.of_comparison and not entry.install]
)
def test_every_format_of_rollouts_writes_fewer_bytes_at_a_lower_rate(rollout, tmp_path, monkeypatch, name):
    # The system's temporary folder is often small, and read-only in some containers.
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    every, fewer = (
        sum(path.stat().st_size for path in export(rollout, tmp_path / f"{rate:g}", format=name, rate=rate))
        for rate in (100.0, 10.0)
    )
    assert 0 < fewer < every
    with pytest.raises(InputError, match="rate must divide the simulation's 100 Hz"):
        export(rollout, tmp_path / "30", format=name, rate=30.0)
    assert not (tmp_path / "30").exists()


def test_files_of_others_are_never_replaced(rollout, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "motion.csv").write_text("mine")
    with pytest.raises(FileError, match=r"holds files that no command of this package made \(motion\.csv\)"):
        export(rollout, tmp_path / "mine")
    assert [(path.name, path.read_text()) for path in (tmp_path / "mine").iterdir()] == [("motion.csv", "mine")]
    (path,) = export(rollout, tmp_path / "ours")
    length = path.stat().st_size
    export({"other": rollout, "motion": rollout}, tmp_path / "ours", rate=50.0)
    assert path.stat().st_size < length


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        ("rollout", {"format": "onnx"}, r"no format 'onnx'; allowed: csv, .*, by plan.network.to_onnx and to_c"),
        ("nowhere", {}, "is made from a rollout"),
        ({}, {}, "nothing to export"),
        ({"../out": "rollout"}, {}, "without folders"),
    ],
)
def test_bad_exports_are_refused_and_leave_nothing(rollout, tmp_path, source, options, message):
    given = dict.fromkeys(source, rollout) if isinstance(source, dict) else source
    with pytest.raises(InputError, match=message):
        ls.exports.export(rollout if source == "rollout" else given, tmp_path / "new", **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", [name for name, entry in FORMATS.items() if entry.library])
def test_a_missing_library_is_named_with_its_extra(rollout, tmp_path, monkeypatch, name):
    monkeypatch.setattr("lieednn_sim.registry.importlib.util.find_spec", lambda _: None)
    with pytest.raises(LieEDNNError, match=rf"pip install 'lieednn_sim\[{name}\]'"):
        export(rollout, tmp_path, format=name)


@pytest.mark.usefixtures("no_plots")
def test_the_command_exports_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["plan", "--planner", "minimum-jerk", "--target", "extended", "--duration", "1.2", "--output", "reach"]
    assert main(words) == 0
    assert main(["export", "reach", "--format", "csv"]) == 2
    assert "make it with: lieednn-sim simulate reach" in capsys.readouterr().err
    assert main(["simulate", "reach", "--hold", "0"]) == 0
    assert main(["export", "reach", "--format", "csv", "--rate", "100", "--output", "out"]) == 0
    assert "wrote out/reach.csv" in capsys.readouterr().out
    assert len((tmp_path / "out" / "reach.csv").read_text().splitlines()) == 1 + 121
    assert main(["export", "reach", "./reach", "--format", "csv"]) == 2
    assert "two of the directories are called 'reach'" in capsys.readouterr().err
    assert not (tmp_path / "results").exists()
