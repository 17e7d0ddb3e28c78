"""Run directories: what belongs together is used together, what is outdated is gone, and a run can be made again."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import re
import shutil

import numpy as np
import pytest

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.cli import main
from lieednn_sim.cli.run_directory import RunDirectory, Task
from lieednn_sim.entries import PlannerEntry
from lieednn_sim.errors import FileError
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import Motion, Plan, plan
from lieednn_sim.planning.network_path import NetworkPath
from lieednn_sim.registry import PLANNERS
from lieednn_sim.simulation import Disturbances, Push, Rollout, simulate

pytestmark = pytest.mark.usefixtures("no_plots")


@pytest.fixture(scope="module")
def made():
    """A task whose planner made the motion, so that every step reads what the one before it wrote."""
    arm = Arm.load("telescopic_pr")
    start = arm.keyframe("home")
    target = start + 0.05 * (arm.keyframe("extended") - start)
    made = plan(arm, target, planner="linear-attractor", start=start, duration=0.6)
    network, motion = made.network, made.motion
    rollout = simulate(arm, motion, hold=0.05)
    task = Task(arm.name, tuple(start), tuple(target), 0.6, planner="linear-attractor", model=arm.fingerprint)
    return task, network, motion, rollout


def save(path, made, **changes):
    """A run directory with what was made, as if for a changed task."""
    task, network, motion, rollout = made
    task = dataclasses.replace(task, **changes)
    run = RunDirectory(path)
    with run.at_work():
        run.save_network(task, network, motion)
        run.save_rollout(rollout)
    return run, Task.load(run.task)


def names(directory):
    return {path.name for path in directory.iterdir()}


def test_the_fastest_run_is_kept_and_simulated_and_the_network_of_an_earlier_one_is_gone(tmp_path, capsys):
    """A certified network draws its motion by itself in a duration that was asked for, but not in the least one."""
    pytest.importorskip("toppra")
    run = RunDirectory(tmp_path)
    for planner in ("lieednn-certified", "minimum-jerk"):
        words = ["--target", "extended", "--planner", planner, "--fastest", "--output", str(tmp_path)]
        assert main(["plan", *words, "--duration", "0.5"]) == 0  # which is too short
        assert main(["plan", *words]) == 0
        assert f"planner: {planner}, asked for; target: extended" in capsys.readouterr().out
        task, arm = run.load_task()
        motion = run.load_motion(task)
        assert run.network.exists() == (planner != "minimum-jerk")
        assert motion.t[-1] < 0.8 * task.duration
        np.testing.assert_allclose(motion.q[-1], arm.keyframe("extended"), atol=1e-6)
        assert main(["simulate", str(tmp_path), "--hold", "0"]) == 0
        assert run.load_rollout(task, arm).t[-1] == pytest.approx(motion.t[-1])


def test_a_motion_after_which_the_load_hangs_still_is_asked_for(tmp_path, capsys, fails):
    words = ["--arm", "telescopic_crane", "--planner", "minimum-jerk", "--output", str(tmp_path)]
    words += ["--target", "0.1,0.55,0.55", "--duration", "4"]
    assert main(["plan", *words, "--settle", "zv"]) == 0
    assert "what hangs, as it swings by its linear model: at least 100 mm" in capsys.readouterr().out
    run = RunDirectory(tmp_path)
    task, arm = run.load_task()
    assert task.options["settle"] == "zv"
    # What `planning/test_settling.py` simulates.
    wanted = plan(arm, task.target, start=task.start, planner="minimum-jerk", duration=4.0, settle="zv").motion
    np.testing.assert_array_equal(run.load_motion(task).q, wanted.q)
    assert "least-energy" in fails("plan", *words, "--settle", "shaken")


def test_slow_arms_get_the_time_that_they_need(tmp_path, capsys, fails):
    words = ["plan", "--arm", "telescopic_crane", "--output", str(tmp_path)]
    assert main(words) == 0
    task, _ = RunDirectory(tmp_path).load_task()
    lasts = float(RunDirectory(tmp_path).load_motion(task).t[-1])
    assert 12.0 < lasts < 20.0
    assert f"arrives in {lasts:.3g} s" in capsys.readouterr().out
    assert "a duration of at least 14" in fails(*words, "--duration", "4")


def test_a_network_with_hidden_neurons_goes_all_the_way(tmp_path, cascade, capsys, monkeypatch):
    """From a planner, by the command line."""

    def hidden(problem):
        network = cascade(problem.arm.encode(problem.target), 0.02)
        return Plan(
            NetworkPath.integrate(problem.arm, network, problem.start).timed(problem.duration, problem.timestep),
            network,
        )

    monkeypatch.setitem(PLANNERS.entries, "hidden", PlannerEntry(hidden))
    directory = str(tmp_path / "run")
    words = ("--planner", "hidden", "--target", "home", "--duration", "3")
    assert main(["plan", *words, "--output", directory]) == 0
    assert "globally stable" in capsys.readouterr().out
    run = RunDirectory(directory)
    task, _ = run.load_task()
    network = LieEDNN.load(run.network)
    assert (network.n_visible, network.n_hidden, network.n_clock) == (4, 3, 1)
    assert main(["simulate", directory, "--hold", "0"]) == 0
    assert main(["evaluate", directory]) == 0
    assert run.load_motion(task).xi.shape[1:] == (4, 6)


def test_files_of_different_runs_are_refused_and_both_named(tmp_path, made, fails):
    _, _, motion, rollout = made
    run, task = save(tmp_path / "run", made)
    # A motion of another planner between the same ends, and one of another arm.
    detour = 1e-6 * np.sin(np.linspace(0.0, np.pi, len(motion.q)))[:, None]
    others = [dataclasses.replace(motion, **change) for change in ({"tau": motion.tau + 1.0}, {"q": motion.q + detour})]
    for other in (*others, dataclasses.replace(motion, q=motion.q[:, :2], qd=motion.qd[:, :2])):
        other.save(run.motion)
        for command in ("simulate", "evaluate", "render"):
            assert f"{run.motion} and {run.task} are of different runs" in fails(command, run.path)
    # A task that was changed.
    motion.save(run.motion)
    for change in ({"seed": 1}, {"duration": 0.7}, {"target": task.start}):
        dataclasses.replace(task, **change).save(run.task)
        assert f"{run.motion} and {run.task} are of different runs" in fails("simulate", run.path)
    dataclasses.replace(task, target=(99.0, *task.target[1:])).save(run.task)
    assert "does not fit arm 'telescopic_pr': target is out of reach" in fails("simulate", run.path)
    # A rollout that followed another motion.
    run.save_network(task, None, others[1])
    rollout.save(run.rollout)
    for command in ("evaluate", "render"):
        line = fails(command, run.path)
        assert f"{run.rollout} is not a valid rollout: the motion is another one than the rollout followed" in line
    # No motion at all.
    run.motion.unlink()
    assert f"no such file: {run.motion}" in fails("simulate", run.path)


def test_an_arm_that_changed_since_is_refused(tmp_path, fails, two_hinges):
    path = tmp_path / "own.xml"
    path.write_text(two_hinges)
    arm = Arm.load(str(path))
    task = Task(str(path), (0.0, 0.0), (0.1, 0.1), 1.0, model=arm.fingerprint)
    run = RunDirectory(tmp_path / "run")
    with run.at_work():
        task.save(run.task)
    assert run.load_task()[0] == task
    # Looks do not count.
    path.write_text(two_hinges.replace('size="0.02"', 'size="0.02" rgba="0 1 0 1"'))
    assert run.load_task()[0] == task
    for old, new in (("0.05 0 0 0.3", "0.05 0 0 0.300001"), ("-90 90", "-90 80"), ('"b"', '"c"')):
        path.write_text(two_hinges.replace(old, new))
        assert f"is not the one for which {run.task} was made" in fails("simulate", run.path)


def test_a_new_simulation_leaves_nothing_of_the_first(tmp_path, made, capsys):
    run, _ = save(tmp_path, made)
    assert main(["evaluate", str(tmp_path)]) == 0
    for path in (run.video, run.divergence):
        path.touch()
    first = json.loads(run.metrics_json.read_text())
    assert main(["simulate", str(tmp_path), "--payload", "2", "--hold", "0.05"]) == 0
    assert names(tmp_path) == {"lieednn_sim.json", "task.json", "network.npz", "motion.npz", "rollout.npz"}
    assert main(["evaluate", str(tmp_path)]) == 0
    second = json.loads(run.metrics_json.read_text())
    assert [value["disturbances"]["payload"] for value in (first, second)] == [0.0, 2.0]
    assert second["frames"][-1]["tracking_rms_mm"] > 2.0 * first["frames"][-1]["tracking_rms_mm"]


class _Killed(BaseException):
    pass


def test_a_run_that_is_killed_while_it_replaces_another_leaves_no_mixture(tmp_path, made, monkeypatch):
    """Killed before its k-th step on the disk, whatever k is."""
    task, network, motion, rollout = made
    new, later = dataclasses.replace(task, seed=1), dataclasses.replace(motion, tau=motion.tau + 1.0)
    real = {name: getattr(type(tmp_path), name) for name in ("unlink", "replace")}
    outcomes = []
    run, _ = save(tmp_path / "old", made)
    for path in (run.metrics_json, run.video):
        path.write_text("old")
    for deadly in range(100):
        run = RunDirectory(shutil.copytree(tmp_path / "old", tmp_path / str(deadly)))
        steps = iter(range(deadly))

        def mortal(name, steps=steps):
            def call(self, *arguments, **options):
                if self.exists() and next(steps, None) is None:
                    raise _Killed
                return real[name](self, *arguments, **options)

            return call

        finished = False
        with monkeypatch.context() as patch, contextlib.suppress(_Killed):
            for name in real:
                patch.setattr(type(tmp_path), name, mortal(name))
            run.save_network(new, network, later)
            run.save_rollout(rollout)
            finished = True
        if not run.task.exists():
            outcomes.append("none")
        elif (now := Task.load(run.task)).seed == task.seed:
            assert run.load_rollout(now, rollout.arm).motion == motion
            outcomes.append("old")
        else:
            assert run.load_motion(now) == later
            assert not any(path.exists() for path in run.results)
            outcomes.append("new")
        if finished:
            break
    assert finished
    assert sorted(set(outcomes), key=outcomes.index) == ["old", "none", "new"]


def command_line(task, metrics):
    """The words that make a run again, from its two JSON files alone."""
    numbers = {name: ",".join(map(repr, task[name])) for name in ("start", "target")}
    words = ["plan", "--arm", task["arm"], "--scene", task["scene"], "--scene-seed", str(task["scene_seed"])]
    words += [f"--start={numbers['start']}", f"--target={numbers['target']}", "--duration", repr(task["duration"])]
    words += ["--planner", task["planner"], "--seed", str(task["seed"])]
    words += ["--time-budget", str(task["options"]["time_budget"])]
    for name, value in task["options"]["option"].items():
        words += ["--option", f"{name}={','.join(map(str, value)) if isinstance(value, list) else value}"]
    told = metrics["disturbances"]
    again = ["--controller", metrics["controller"], "--hold", repr(metrics["hold"])]
    if metrics["reference_rate"] is not None:
        again += ["--reference-rate", repr(metrics["reference_rate"])]
    for option in ("payload", "mass_scale", "position_noise", "velocity_noise"):
        again += [f"--{option.replace('_', '-')}", repr(told[option])]
    again += ["--noise-seed", str(told["seed"])]
    for push in told["pushes"]:
        parts = [push["body"], *push["force"], push["start"], push["duration"]]
        again += ["--push", ",".join(map(str, parts))]
    return words, again


def test_a_run_can_be_made_again_from_task_and_metrics(tmp_path, capsys):
    first, second = tmp_path / "first", tmp_path / "second"
    words = "plan --target random:3 --duration 3 --option n_networks=2 --option bias_magnitudes=0.5 --seed 5 --output"
    assert main([*words.split(), str(first)]) == 0
    conditions = ["--controller", "computed-torque", "--payload", "0.3", "--mass-scale", "1.05", "--hold", "0.2"]
    conditions += ["--push", "end effector,0,-3,5.5,0.4,0.1", "--reference-rate", "250", "--position-noise", "1e-5"]
    conditions += ["--velocity-noise", "1e-4", "--noise-seed", "4"]
    assert main(["simulate", str(first), *conditions]) == 0
    assert main(["evaluate", str(first)]) == 0
    task, metrics = (json.loads((first / name).read_text()) for name in ("task.json", "metrics.json"))
    assert (task["planner"], task["reason"]) == ("lieednn-certified", "the default without obstacles")
    assert {"lieednn_sim", "mujoco", "numpy", "scipy"} <= task["versions"].keys()
    assert metrics["versions"]["mujoco"] == task["versions"]["mujoco"]
    words, again = command_line(task, metrics)
    assert main([*words, "--output", str(second)]) == 0
    assert main(["simulate", str(second), *again]) == 0
    for name in ("network.npz", "motion.npz", "rollout.npz"):
        contents = []
        for directory in (first, second):
            with np.load(directory / name) as archive:
                contents.append({key: archive[key].tobytes() for key in archive.files if key != "meta_json"})
        assert contents[0] == contents[1], name
    arm = Arm.load(task["arm"])
    network, motion = LieEDNN.load(first / "network.npz"), Motion.load(first / "motion.npz")
    np.testing.assert_array_equal(
        NetworkPath.integrate(arm, network, task["start"]).timed(3.0, arm.timestep).q, motion.q
    )
    one, other = (Rollout.load(directory / "rollout.npz", arm) for directory in (first, second))
    push = Push("end effector", (0.0, -3.0, 5.5), 0.4, 0.1)
    noise = {"position_noise": 1e-5, "velocity_noise": 1e-4, "seed": 4}
    given = Disturbances(pushes=(push,), mass_scale=1.05, payload=0.3, **noise)
    assert one.disturbances == other.disturbances == given
    assert one.reference_rate == 250.0
    printed = capsys.readouterr().out
    assert re.search(r"end effector +0\.4 +0\.5 +\d", printed)
    assert "reference held at 250 Hz, masses times 1.05, payload 0.3 kg, position noise 1e-05, velocity" in printed


def test_no_planner_takes_the_place_of_one_that_is_not_installed(tmp_path, fails, monkeypatch):
    monkeypatch.setattr("lieednn_sim.registry.importlib.util.find_spec", lambda _: None)
    task = ["--scene", "window", "--target", "random:0", "--planner", "rrt-connect"]
    line = fails("plan", *task, "--output", tmp_path / "run")
    assert (
        "planner 'rrt-connect' is not installed: pip install 'lieednn_sim[rivals]'; or name one without extra" in line
    )
    assert "lieednn-shaped" in line
    assert not (tmp_path / "run").exists()


def test_a_named_output_is_looked_at_before_the_work(tmp_path, made, fails):
    run, _ = save(tmp_path / "run", made)
    (tmp_path / "x.gif").mkdir()
    before = names(run.path)
    for output, words in (("x.gif", "it is a directory"), ("no/x.gif", "there is no directory")):
        assert words in fails("render", run.path, "--output", tmp_path / output)
    assert "must be a path, got ''" in fails("render", run.path, "--output", "")
    assert names(run.path) == before


def test_a_command_waits_for_no_other_but_says_that_one_is_at_work(tmp_path, made, fails):
    run, task = save(tmp_path / "run", made)
    again = ["--target", "extended", "--output", run.path]
    busy = f"another lieednn-sim is at work in {run.path}"
    with run.at_work():
        for words in (["simulate", run.path], ["evaluate", run.path], ["plan", *again], ["train", *again]):
            assert busy in fails(*words)
    # A video takes minutes; the plots may be made meanwhile, another rollout may not.
    with run.at_work(shared=True), run.at_work(shared=True):
        assert busy in fails("simulate", run.path)
    with io.locked(tmp_path):
        assert f"at work in {tmp_path}" in fails("compare", "--output", tmp_path)
    run.load_rollout(task, made[3].arm)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"start": ["0"] * 8}, r"start\[0\] must be a number, got '0'"),
        ({"target": [10**400]}, "target must be an array of numbers"),
        ({"duration": math.inf}, "duration must be finite"),
        ({"seed": 1.5}, "seed must be a whole number"),
        ({"imported": {"link": []}}, "no option 'link' of an import"),
        ({"options": []}, "options must be a dictionary"),
        ({"model": None}, "model must be a string"),
    ],
)
def test_a_broken_task_is_named(tmp_path, made, change, words):
    path = tmp_path / "task.json"
    path.write_text(json.dumps({**dataclasses.asdict(made[0]), **change}))
    with pytest.raises(FileError, match=f"task.json is not a valid task: {words}"):
        Task.load(path)


def test_a_task_without_its_values_is_named(tmp_path, made):
    path = tmp_path / "task.json"
    for name in dataclasses.asdict(made[0]):
        path.write_text(json.dumps({key: value for key, value in dataclasses.asdict(made[0]).items() if key != name}))
        with pytest.raises(FileError, match=f"it has no '{name}'"):
            Task.load(path)
