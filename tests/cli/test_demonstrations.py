"""The command ``learn``: files in, a certified network, a report and two plots out."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from lieednn_sim.cli import demonstrations, main
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.motion import Motion
from lieednn_sim.studies.demonstrations import models as paths


@pytest.fixture
def hook(tmp_path):
    """Two demonstrations in centimetres and in a plane, a file each."""
    s = np.linspace(0.0, 1.0, 60)
    for k, name in enumerate(("a.csv", "b.csv")):
        path = np.column_stack([30.0 * (1.0 - s), (9.0 + k) * np.sin(np.pi * s)])
        np.savetxt(tmp_path / name, np.add(path, [100.0, 7.0 * k]), delimiter=",")
    return [str(tmp_path / name) for name in ("a.csv", "b.csv")]


@pytest.mark.usefixtures("drawing")
def test_learn(hook, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(paths, "SAMPLES", 60)
    monkeypatch.setattr("lieednn_sim.studies.demonstrations.plots._STARTS", 3)
    output = tmp_path / "learned"
    words = ["learn", *hook, "--unit", "cm", "--starts", "20", "--rivals", "dmp"]
    words += ["--deviation", "0.004", "--output", str(output)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    # 60 samples at 100 Hz.
    assert "2 demonstrations, positions in a plane, 0.3 m across, 0.59 s; " in printed
    assert "goals are up to 0.035 m from their mean, and aligned" in printed
    for word in ("lieednn-shaped", "dmp", "left out", "20/20", "globally stable for every bias"):
        assert word in printed
    network = LieEDNN.load(output / "network.npz")
    assert network.certified
    assert network.n_visible == 1
    report = json.loads((output / "report.json").read_text())
    # Goals at (1, 0) and (1, 0.07) m.
    np.testing.assert_allclose(report["goal_position_m"], [1.0, 0.035, 0.0])
    assert report["goal_quaternion_wxyz"] == [1.0, 0.0, 0.0, 0.0]
    assert (report["demonstrations"], report["dof"], report["lever_m"]) == (2, 2, 0.2)
    assert report["extent_m"] == pytest.approx(0.3)
    # They are 1 cm apart half way, and so half of that from their mean.
    assert report["spread_m"] == pytest.approx(0.005, rel=0.02)
    assert 1e-5 < report["network_deviation_m"] <= 0.004
    assert (report["t_s"][0], report["t_s"][-1]) == pytest.approx((0.0, 0.59))
    shaped, primitive = report["models"]
    assert shaped["mean"]["rms_mm"] < 4.0
    assert abs(shaped["n_parameters"] - primitive["n_parameters"]) <= 1
    assert shaped["attraction"] == {"starts": 20, "arrived": 20, "spurious": 0}
    # The network, its own time and the frame, as the report says, are the motion.
    way = network.trajectory(network.start([[0.0, 0.0, 0.0, 0.3, 0.0, 0.0]]), report["tau"][-1])
    places = network.visible(way(np.array(report["tau"])))[:, 0, 3:5]
    np.testing.assert_allclose(places[0], [0.3, 0.0], atol=1e-9)
    np.testing.assert_allclose(places[np.argmax(places[:, 1])], [0.15, 0.095], atol=1e-2)
    np.testing.assert_allclose(places[-1], [0.0, 0.0], atol=1e-5)
    for name in ("paths.png", "field.png"):
        with Image.open(output / name) as picture:
            assert min(picture.size) > 400
    assert 0.0 < report["family_deviation_m"] < 0.02
    words = [
        "learn",
        *hook,
        *["--unit", "cm", "--goals", "kept", "--deviation", "0.02", "--output"],
        str(tmp_path / "kept"),
    ]
    # To draw takes longer than all else.
    for plot in ("plot_field", "plot_paths"):
        monkeypatch.setattr(f"lieednn_sim.cli.demonstrations.{plot}", lambda *_: None)
    assert main([*words, "--starts", "2", "--rivals", "none", "--no-leave-one-out"]) == 0
    assert "and kept" in capsys.readouterr().out
    assert LieEDNN.load(tmp_path / "kept" / "network.npz").goal_gain is not None
    report = json.loads((tmp_path / "kept" / "report.json").read_text())
    assert (report["goals"], report["goal_distance_m"]) == ("kept", pytest.approx(0.035))
    assert report["models"][0]["training"]["goal_mm"] < 0.1


def test_learn_joints(gantry, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(paths, "SAMPLES", 60)
    s = np.linspace(0.0, 1.0, 60)
    law = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    files = []
    for k in range(2):
        columns = [1.5e3 * s, law - 0.5, (0.5 + 0.1 * k) * np.sin(np.pi * law), 0.3 * law, 1.0 - law]
        files.append(str(tmp_path / f"{k}.csv"))
        np.savetxt(files[-1], np.column_stack(columns), delimiter=",")
    run = tmp_path / "learned"
    words = ["learn", *files, "--arm", str(gantry.source), "--output", str(run), "--starts", "1", "--deviation", "0.02"]
    words += ["--no-leave-one-out", "--time-unit", "ms"]
    assert main(words) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for word in (
        "2 demonstrations of 4 joints of gantry",
        "training",
        "1 of 1 random starts arrive",
        "gantry, 1.5 s; ",
    ):
        assert word in printed
    report = json.loads((run / "report.json").read_text())
    assert report["network_certified"]
    assert report["limits_kept"]
    assert report["mean"]["effector"]["rms_mm"] < 20.0
    assert LieEDNN.load(run / "network.npz").n_visible == 2
    # x would be at 1.25 times its velocity limit, so that it takes longer.
    motion = Motion.load(run / "motion.npz")
    assert report["demonstrated_duration_s"] == 1.5
    assert report["duration_s"] == motion.t[-1] > 1.8
    assert f"limits and clearance: kept, in {motion.t[-1]:.3g} s" in printed
    # y is 10 cm apart half way.
    assert report["spread_m"] == pytest.approx(0.05, rel=0.05)
    assert report["mechanism_gap_mm"] == pytest.approx(1e3 * motion.gap_translation.max())
    assert report["mechanism_gap_deg"] == pytest.approx(np.rad2deg(motion.gap_rotation.max()))
    assert all((run / name).exists() for name in ("demonstrations.png", "starts.png"))
    # A run like any other, with the motion at hand.
    assert main(["simulate", str(run)]) == 0
    # Ten times as fast, no more than three times its duration keeps the limits.
    np.savetxt(tmp_path / "fast.csv", np.loadtxt(files[0], delimiter=",") * [0.1, 1.0, 1.0, 1.0, 1.0], delimiter=",")
    words = ["learn", str(tmp_path / "fast.csv"), *words[3:]]
    words[words.index(str(run))] = str(tmp_path / "hurried")
    assert main(words) == 0
    assert "limits: not kept, joint 'x'" in " ".join(capsys.readouterr().out.split())
    report = json.loads((tmp_path / "hurried" / "report.json").read_text())
    assert not report["limits_kept"]
    assert report["limit_broken"].startswith("joint 'x'")
    assert main(["learn", *files, "--arm", str(gantry.source), "--output", str(run), "--unit", "cm"]) == 2
    assert "--unit, --quaternion and --rivals are for positions and poses" in capsys.readouterr().err


def test_poses_start_elsewhere_more_often_than_joints(monkeypatch):
    starts = []
    for name in ("_learn_poses", "_learn_joints"):
        monkeypatch.setattr(demonstrations, name, lambda *_, **how: starts.append(how["starts"]))
    assert main(["learn", "a.csv"]) == main(["learn", "a.csv", "--arm", "telescopic_pr"]) == 0
    assert starts == [1000, 20]
