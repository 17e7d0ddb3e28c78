"""The command `library`: motions of runs are stored, blended, and made into runs again."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.cli import main
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.planning import MotionLibrary

pytestmark = pytest.mark.usefixtures("no_plots")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two runs, and a library with their motions."""
    made = tmp_path_factory.mktemp("library")
    for name, target in (("reach", "extended"), ("aside", "random:1")):
        words = ["plan", "--planner", "minimum-jerk", "--target", target, "--duration", "1.2"]
        assert main([*words, "--output", str(made / name)]) == 0
    assert main(["library", str(made / "motions.npz"), "add", str(made / "reach"), str(made / "aside")]) == 0
    return made


def motion_of(path):
    run = RunDirectory(path)
    return run.load_motion(*run.load_task())


def test_a_stored_motion_becomes_a_run_that_the_other_commands_take(folder, tmp_path, capsys):
    file, out = str(folder / "motions.npz"), str(tmp_path / "again")
    assert main(["library", file, "list"]) == 0
    shown = capsys.readouterr().out
    assert shown.index("reach") < shown.index("aside")
    assert main(["library", file, "run", "aside", "--duration", "1.2", "--output", out]) == 0
    arm, again, shown = Arm.load("telescopic_pr"), motion_of(out), motion_of(folder / "aside")
    np.testing.assert_allclose(again.q[[0, -1]], shown.q[[0, -1]], atol=1e-6)
    away = np.linalg.norm(arm.tip(again.q[::20])[:, None] - arm.tip(shown.q), axis=-1).min(axis=1)
    assert away.max() < 2e-3
    assert RunDirectory(out).load_task()[0].options["motion"] == "aside"
    assert main(["simulate", out, "--hold", "0"]) == 0
    assert main(["evaluate", out]) == 0


def test_a_blend_ends_between_the_targets_and_can_be_stored_too(folder, tmp_path):
    file, out = str(folder / "motions.npz"), str(tmp_path / "between")
    words = ["run", "reach", "--blend", "aside", "--fraction", "0.25", "--duration", "1.2", "--output", out]
    assert main(["library", file, *words]) == 0
    blended, *ends = (motion_of(path).xi_target for path in (out, folder / "reach", folder / "aside"))
    # Though no joint position has the blended poses.
    assert motion_of(out).gap_translation[-1].max() < 1e-6
    np.testing.assert_allclose(blended, 0.75 * ends[0] + 0.25 * ends[1], atol=0.02)
    assert np.abs(ends[1] - ends[0]).max() > 0.3
    other = str(tmp_path / "other.npz")
    assert main(["library", other, "add", out, "--name", "mixed"]) == 0
    assert MotionLibrary.load(other).names == ("mixed",)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("motions.npz run dance", "no name 'dance'; allowed: aside, reach"),
        ("motions.npz run reach --fraction 0.2", "--fraction needs --blend OTHER"),
        ("motions.npz run reach --blend aside --fraction 2", "fraction must be from 0 to 1, got 2"),
        ("motions.npz run reach --duration 0.1", "a duration of at least"),
        ("motions.npz add reach aside --name both", "each motion needs a name of its own"),
        ("motions.npz add nowhere", "holds no run"),
        ("none.npz list", "none.npz"),
        ("two.npz add reach", "the network has 2 visible neurons, arm 'telescopic_pr' has 4 links"),
        ("reach/motion.npz add aside", "motion.npz"),
    ],
)
def test_errors_say_what_is_wrong_and_change_nothing(folder, monkeypatch, capsys, words, message):
    monkeypatch.chdir(folder)
    MotionLibrary(2).save("two.npz")
    before = {path: path.read_bytes() for path in folder.rglob("*.npz")}
    assert main(["library", *words.split()]) == 2
    assert message in capsys.readouterr().err
    assert {path: path.read_bytes() for path in folder.rglob("*.npz")} == before
    assert not (folder / "results").exists()
