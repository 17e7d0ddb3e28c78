"""The command line as a user meets it: the whole road, one-line errors, exit code 2, no half-written file."""

import errno
import io
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.cli import commands, main
from lieednn_sim.errors import RenderingUnavailableError
from lieednn_sim.evaluation import figure_layout, plots
from lieednn_sim.learning import algorithms
from lieednn_sim.planning import Motion

FAST = ["--option", "n_networks=3", "--duration", "2"]
MAIN = "import sys; from lieednn_sim.cli import main; sys.exit(main())"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run directory up to the rollout."""
    directory = tmp_path_factory.mktemp("run")
    assert main(["plan", "--target", "extended", "--output", str(directory), *FAST]) == 0
    assert main(["simulate", str(directory), "--hold", "0.5"]) == 0
    return directory


@pytest.mark.usefixtures("laid_out")
def test_the_demo_without_video_meets_its_bounds(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(figure_layout, "_DPI", 20)
    save = figure_layout.save_figure

    def save_few(figure, path):
        """Not the joints' figure, whose many axes take as long as all others; `test_plots.py` draws a smaller one."""
        path.write_bytes(b"a picture") if len(figure.axes) > 20 else save(figure, path)

    monkeypatch.setattr(figure_layout, "save_figure", save_few)
    directory = tmp_path / "demo"
    begun = time.perf_counter()
    assert main(["demo", "--no-video", "--output", str(directory)]) == 0
    taken = time.perf_counter() - begun
    metrics = json.loads((directory / "metrics.json").read_text())
    tip = metrics["frames"][-1]
    assert metrics["displacement_m"] > 1.0
    assert metrics["motion_s"] == pytest.approx(4.0)
    assert tip["final_mm"] < 1.0
    assert tip["final_deg"] < 0.1
    assert tip["tracking_rms_mm"] < 1.0
    assert tip["tracking_rms_deg"] < 0.1
    expected = {"task.json", "network.npz", "motion.npz", "rollout.npz", "metrics.json", "metrics.csv"}
    expected |= {"network.png", "tracking.png", "joints.png", "clearance.png", "motion.html"}
    assert (directory / "motion.html").stat().st_size < 1.5e6
    assert {path.name for path in directory.iterdir()} == {*expected, "lieednn_sim.json"}
    printed = capsys.readouterr().out
    # The verdict comes first, and conditions that fail beside the one that holds are not shown unasked.
    verdict = r"certified; at least [\d.]+ mm clear, proved; arrives after [\d.]+ s, ends \S+ mm and \S+ degrees off\n"
    assert re.match(verdict, printed)
    assert "fails" not in printed
    assert len(printed.splitlines()) < 12
    files = re.search(f"^wrote in {directory}: (.*)$", printed, re.MULTILINE)[1].split(", ")
    assert {*files, "motion.html"} == expected
    assert f"wrote {directory / 'motion.html'}" in printed
    # To a tenth of a second.
    assert 0.0 < float(re.search(r"^done in (\d+\.\d) s; ", printed, re.MULTILINE)[1]) <= taken + 0.05


@pytest.mark.usefixtures("no_plots")
def test_a_learned_network_goes_the_same_road(tmp_path, capsys):
    directory = tmp_path / "learned"
    assert main(["train", "--target", "extended", "--duration", "2", "--output", str(directory)]) == 0
    printed = capsys.readouterr().out
    assert "converged after" in printed
    assert "globally stable by the" in printed
    assert {path.name for path in directory.iterdir()} == {
        "lieednn_sim.json",
        "task.json",
        "network.npz",
        "motion.npz",
        "history.npz",
        "training.png",
    }
    assert main(["simulate", str(directory), "--hold", "0.5"]) == 0
    assert main(["evaluate", str(directory)]) == 0
    tip = json.loads((directory / "metrics.json").read_text())["frames"][-1]
    assert tip["final_mm"] < 0.1
    assert tip["final_deg"] < 0.01
    # The next network must not inherit the history of this one.
    assert main(["plan", "--target", "extended", "--output", str(directory), *FAST]) == 0
    assert {path.name for path in directory.iterdir()} == {"lieednn_sim.json", "task.json", "network.npz", "motion.npz"}


@pytest.mark.usefixtures("no_plots")
def test_candidates_are_tried_until_a_motion_keeps_the_limits(tmp_path, capsys):
    """The first seed learns this target, but its network overruns a joint; a later one does not."""
    directory = tmp_path / "learned"
    target = "-0.383,0.148,0.411,0.016,0.134,0.065,0.795,0.012"
    arguments = ["train", "--target", target, "--algorithm", "stability-aware", "--output", str(directory)]
    assert main([*arguments, "--candidates", "1"]) == 0
    assert "its motion will be rejected" in capsys.readouterr().out
    assert main(["simulate", str(directory)]) == 2
    assert main([*arguments, "--candidates", "8"]) == 0
    assert "its motion will be rejected" not in capsys.readouterr().out
    assert main(["simulate", str(directory), "--hold", "0.5"]) == 0


@pytest.mark.usefixtures("no_plots")
def test_a_training_that_fails_says_so_and_leaves_no_network_and_an_earlier_run_as_it_was(run, tmp_path, capsys, fails):
    earlier = tmp_path / "run"
    shutil.copytree(run, earlier)
    before = {path.name: path.read_bytes() for path in earlier.iterdir()}
    arguments = ["train", "--target", "extended", "--algorithm", "literal", "--epochs", "20", "--candidates", "1"]
    for directory in (tmp_path / "learned", earlier):
        assert main([*arguments, "--output", str(directory)]) == 1
        printed = capsys.readouterr().out
        assert "epochs spent after 20 epochs" in printed
        assert "no network was written; try" in printed
    assert not (tmp_path / "learned").exists()
    assert "holds no run" in fails("simulate", tmp_path / "learned")
    assert "seed must be a whole number" in fails(*arguments, "--output", earlier, "--seed", "-1")
    assert before == {path.name: path.read_bytes() for path in earlier.iterdir() if path.is_file()}


@pytest.mark.usefixtures("no_plots")
@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))])
def test_a_training_that_is_ended_says_so_and_leaves_nothing_half_made(run, tmp_path, capsys, monkeypatch, error):
    """By the user or by a fault, in a directory of its own and in one with an earlier run."""

    def ending(*_):
        raise error

    monkeypatch.setattr(algorithms.ProjectedTraining, "_step", ending)
    code, said = (130, "interrupted") if isinstance(error, KeyboardInterrupt) else (2, "No space left on device")
    directory = tmp_path / "run"
    shutil.copytree(run, directory)
    before = {path.name: path.read_bytes() for path in directory.iterdir()}
    for output in (tmp_path / "new" / "learned", directory):
        assert main(["train", "--target", "extended", "--algorithm", "repaired", "--output", str(output)]) == code
        assert said in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    assert before == {path.name: path.read_bytes() for path in directory.iterdir()}


@pytest.mark.usefixtures("no_plots")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_interrupting_leaves_complete_files_only(tmp_path, capsys, monkeypatch, number, code):
    """While the third plot is drawn."""

    def interrupted(*_):
        try:
            signal.raise_signal(number)
        finally:
            if number == signal.SIGHUP:  # a shell may send another one than the terminal
                signal.raise_signal(number)

    monkeypatch.setattr(plots, "plot_joints", interrupted)
    directory, hangup = tmp_path / "demo", signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which `nohup` ignores
    try:
        assert main(["demo", "--no-video", "--no-page", "--output", str(directory), *FAST]) == code
    finally:
        signal.signal(signal.SIGHUP, hangup)
    printed, message = capsys.readouterr()
    assert message == "lieednn-sim: interrupted; files already reported are complete\n"
    left = {"task.json", "network.npz", "motion.npz", "rollout.npz"}
    assert {path.name for path in directory.iterdir()} == {"lieednn_sim.json", *left}
    assert re.match("certified; .*; not evaluated\n", printed)
    assert set(re.search(f"wrote in {directory}: (.*)", printed)[1].split(", ")) == left


@pytest.mark.rendering
def test_render(run, tmp_path):
    options = ["--preset", "draft", "--size", "160x90", "--fps", "5"]
    assert main(["render", str(run), "--output", str(tmp_path / "out.gif"), *options]) == 0
    assert (tmp_path / "out.gif").stat().st_size > 1000
    assert main(["render", str(run), "--output", str(tmp_path / "out.png"), *options]) == 0
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")


def test_a_target_can_be_numbers_or_a_position(tmp_path):
    q = "-0.2,0.1,0.4,0.1,-0.3,0.1,-0.2,0.1"
    assert main(["plan", "--target", q, "--output", str(tmp_path / "a"), *FAST]) == 0
    assert json.loads((tmp_path / "a" / "task.json").read_text())["target"][4] == -0.3
    assert main(["plan", "--position", "-.9,1.2,1.2", "--output", str(tmp_path / "b"), *FAST[:2]]) == 0
    arm = Arm.load("telescopic_pr")
    goal = arm.link_poses(arm.keyframe("extended"))[-1]
    text = ",".join(map(repr, map(float, [*goal.translation, *goal.rotation.as_rotvec()])))
    assert main(["plan", f"--pose={text}", "--planner", "minimum-jerk", "--output", str(tmp_path / "c")]) == 0
    reached = arm.link_poses(json.loads((tmp_path / "c" / "task.json").read_text())["target"])[-1]
    np.testing.assert_allclose(reached.as_matrix(), goal.as_matrix(), atol=1e-5)


def test_of_several_poses_the_nearest_is_taken_and_a_line_or_an_orientation_is_kept(tmp_path, fails):
    arm = Arm.load("telescopic_pr")
    here = arm.link_poses(arm.keyframe("home"))[-1]
    turn = [*map(float, here.rotation.as_rotvec())]

    def command(folder, *options):
        assert main(["plan", *options, "--output", str(tmp_path / folder)]) == 0
        task = json.loads((tmp_path / folder / "task.json").read_text())
        return task, Motion.load(tmp_path / folder / "motion.npz")

    places = [here.translation + np.array(way) for way in ([-0.02, -0.02, 0.0], [-0.3, 0.0, 0.2])]
    poses = [f"--pose={','.join(map(repr, [*map(float, place), *turn]))}" for place in places]
    task, motion = command("set", *poses[::-1], "--planner", "minimum-jerk")
    np.testing.assert_allclose(arm.tip(task["target"]), places[0], atol=1e-5)
    position = f"--position={','.join(map(repr, map(float, places[1])))}"
    for kept, options in (("line", poses[1:]), ("orientation", [position])):
        task, motion = command(kept, *options, "--path-constraint", kept)
        assert task["options"]["path_constraint"] == kept
        assert task["planner"] == "lieednn-shaped"
        np.testing.assert_allclose(arm.tip(motion.q[-1]), places[1], atol=1e-5)
        middle = arm.link_poses(motion.q[len(motion.q) // 2])[-1]
        if kept == "line":
            way, gone = places[1] - here.translation, middle.translation - here.translation
            assert np.linalg.norm(np.cross(way, gone)) < 5e-4 * np.linalg.norm(way)
        else:
            assert (middle.rotation * here.rotation.inv()).magnitude() < np.deg2rad(0.1)
    assert "--path-constraint line takes one goal, got 2" in fails(
        "plan", *poses, "--path-constraint", "line", "--output", tmp_path / "no"
    )
    words = fails("plan", position, "--path-constraint", "line", "--planner", "dmp", "--output", tmp_path / "no")
    assert "the planner 'dmp' cannot keep a region on the way; planners that can: lieednn-shaped" in words


def test_broken_run_directories(run, tmp_path, fails):
    assert "holds no run" in fails("simulate", tmp_path / "missing")
    for name, damage in (("motion.npz", b"junk"), ("task.json", b"{")):
        broken = tmp_path / name
        broken.mkdir()
        for path in ("lieednn_sim.json", "task.json", "motion.npz"):
            (broken / path).write_bytes((run / path).read_bytes())
        (broken / name).write_bytes(damage)
        before = sorted(path.name for path in broken.iterdir())
        assert str(broken / name) in fails("simulate", broken)
        assert sorted(path.name for path in broken.iterdir()) == before
    only_task = tmp_path / "no-rollout"
    only_task.mkdir()
    for path in ("lieednn_sim.json", "task.json"):
        (only_task / path).write_bytes((run / path).read_bytes())
    assert "rollout.npz" in fails("evaluate", only_task)
    assert "rollout.npz" in fails("render", only_task)


def test_a_full_output_gives_one_line(start):
    with Path("/dev/full").open("w") as full:
        process = start("-c", MAIN, "--version", stdout=full)
        message = process.communicate()[1]
    assert message == "lieednn-sim: error: cannot write to the standard output: No space left on device\n"
    assert process.returncode == 2


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_an_output_that_nobody_reads_ends_the_command_in_silence(start, unbuffered):
    reader, writer = os.pipe()
    os.close(reader)
    process = start("-c", MAIN, "--version", stdout=writer, env={**os.environ, "PYTHONUNBUFFERED": unbuffered})
    os.close(writer)
    assert (process.stderr.read(), process.wait()) == ("", 141)


def test_without_standard_streams_a_command_does_its_work(tmp_path):
    """The files that it opens take their numbers."""
    words = f"-m lieednn_sim plan --planner minimum-jerk --duration 2 --target extended --output {tmp_path}/run"
    done = subprocess.run(["sh", "-c", f"exec {shlex.quote(sys.executable)} {words} <&- >&- 2>&-"], check=False)
    assert done.returncode == 0
    assert (tmp_path / "run" / "motion.npz").is_file()


@pytest.mark.parametrize(
    ("closed", "words", "code"),
    [
        (["stdout"], ["plan", "--planner", "minimum-jerk", "--target", "extended"], 0),
        (["stdin", "stdout", "stderr"], ["plan", "--arm", "nobodys"], 2),
    ],
)
def test_of_streams_that_python_found_closed_nothing_is_expected(tmp_path, monkeypatch, closed, words, code):
    for name in closed:
        monkeypatch.setattr(sys, name, None)
    assert main([*words, "--duration", "2", "--output", str(tmp_path / "run")]) == code
    for name in closed:
        getattr(sys, name).close()
    assert (tmp_path / "run" / "motion.npz").is_file() == (code == 0)


@pytest.mark.usefixtures("no_plots")
def test_a_path_that_the_output_cannot_spell_and_a_backend_for_windows_that_does_not_exist(run, tmp_path, monkeypatch):
    copy = tmp_path / "d\u00e9mo"
    shutil.copytree(run, copy)
    monkeypatch.setenv("MPLBACKEND", "junk")
    output = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", output)
    assert main(["evaluate", str(copy)]) == 0
    assert f"wrote in {tmp_path}/d\\xe9mo: metrics.json" in output.buffer.getvalue().decode("ascii")
    assert os.environ["MPLBACKEND"] == "agg"


@pytest.mark.usefixtures("no_plots")
def test_without_opengl_the_demo_goes_on_without_video(tmp_path, capsys, fails, monkeypatch):
    def refused():
        raise RenderingUnavailableError("cannot render")

    monkeypatch.setattr(commands.opengl, "require", refused)
    monkeypatch.setitem(sys.modules, "viser", None)  # as if it were not installed
    assert main(["demo", *FAST, "--output", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "no video: cannot render" in printed
    missing = r"^no page: (mj)?viser is not installed .*: pip install 'lieednn_sim\[view\]'$"
    assert re.search(missing, printed, re.MULTILINE)
    assert (tmp_path / "metrics.json").exists()
    assert not any((tmp_path / name).exists() for name in ("motion.html", "video.mp4"))
    assert fails("render", tmp_path) == "lieednn-sim: error: cannot render"
