"""What is wrong is said in one line, by exit code 2, before any work, and nothing is made."""

from __future__ import annotations

import importlib
import shlex

import numpy as np
import pytest

from lieednn_sim.cli import main

WRITING = ("demo", "plan", "train", "compare")
# The words of a command, and what its line of error says.
REFUSED = {
    "simulte a": "no command 'simulte', did you mean simulate?; commands: demo, plan, train, learn, simulate,",
    "simulate": "the following arguments are required: RUN (lieednn-sim simulate --help)",
    "simulate a b": "b is not understood (lieednn-sim simulate --help)",
    "simulate none": "holds no run",
    "plan --targt home": "--targt is not understood, did you mean --target? (lieednn-sim plan --help)",
    "plan --duration": "argument --duration: expected one argument",
    "plan --target extended --arm crane": "no arm 'crane'; allowed: telescopic_compound, telescopic_crane",
    "plan --target nowhere": "no keyframe 'nowhere'",
    "plan --target 1,2,3": "target must be 8 comma-separated numbers, got 3",
    "plan --target 0,nan,0,0,0,0,0,0": "target must be 8 comma-separated numbers, got '0,nan",
    "plan --target nan,0,0,0,0,0,0,0": "target must be 8 comma-separated numbers, got 'nan,",
    "plan --target 0,0.1,0,9,0,0,0,0": "joint 'extend1' would be at 9 m",
    "plan --target home --position 1,2,3": "give one of --target, --position and --pose",
    "plan --position 1e6,0,0": "cannot reach (1e+06, 0, 0) m",
    "plan --position 2e6,0,0": "position must",
    "plan --pose 0,0,1": "argument --pose: must be 6 comma-separated numbers, got 3",
    "plan --pose 1,0,1,0,90,0": "the rotation vector of --pose, in radians, must not exceed 6.3 in size, got 90",
    "plan --start 0,0,0,0,0,0,0,99": "start is out of reach",
    "plan --duration 0.1": "a duration of at least",
    "plan --seed -1": "seed must be a whole number",
    "plan --option bias=odd": "no bias rule 'odd'; allowed",
    "plan --option n_networks=2.5": "option n_networks must be a whole number, such as 12, got '2.5'",
    "plan --option rate": "'rate' must be NAME=VALUE with a name of activation, n_networks, ",
    "plan --planner minimum-jerk --option a=1": "the planner minimum-jerk has no options, got 'a=1'",
    "plan --path-constraint circle": "no path_constraint 'circle'; allowed: line, orientation",
    "plan --target extended --output file/run": "cannot create directory",
    "demo --duration 1_000": "--duration: must be a finite decimal number, such as 0.25 or 1e-3, got '1_000'",
    "demo --duration 1000": "duration must be 2 to 100000 time steps of 0.002 s, got 1000 s",
    "demo --seed 1.5": "argument --seed: must be a whole number, such as 12, got '1.5'",
    "demo --position 1e308,0,0": "position must not exceed 1e+100 in size, got 1e+308",
    "demo --hold -1": "hold must not be negative, got -1",
    "demo --push 'link 1,1,2,3'": "argument --push: must look like BODY,FX,FY,FZ,START,DURATION",
    "demo --push moon,1,2,3,1,1": "no body to push 'moon'; allowed: ",
    "demo --reference-rate 7": "reference_rate must divide the simulation's 500 Hz",
    "demo --controller magic": "no controller 'magic'; allowed: computed-torque",
    "demo --planner magic": "no planner 'magic'; allowed: ",
    "demo --links a,b": "takes no import options, got",
    "demo --arm nowhere.xml": "no such file: nowhere.xml",
    "demo --target random:x": "a random target must look like random:7",
    "demo --size huge": "--size: must look like 1280x720",
    "demo --preset best": "no preset 'best'",
    "demo --fps 0": "fps must be positive",
    "demo --camera moon": "no camera 'moon'",
    # Only a budget may be infinite.
    **{
        f"demo --{name} inf": name.replace("-", "_")
        for name in ("duration", "hold", "payload", "mass-scale", "position-noise", "reference-rate")
    },
    # An empty name is no directory.
    **{
        f"{command} ''": "must be a path, got ''"
        for command in ("simulate", "evaluate", "render", *(f"{name} --output" for name in WRITING))
    },
    "train --algorithm adam": "no algorithm 'adam'; allowed: literal, repaired, riemannian",
    "train --bias solved": "the solved bias needs no learning",
    "train --bias loud": "no bias rule 'loud'",
    "train --period 0": "period must be at least 1",
    "train --algorithm riemannian --period 8": "--period and --epochs are for the algorithms literal, repaired and",
    "learn way.csv --unit inch": "no unit 'inch'",
    "learn way.csv --rivals dmp,gmm": "no rival 'gmm'",
    "learn way.csv --clock-rate 2": "rate must be from 0.01 to 1",
    "learn way.csv --goals moved": "no goals 'moved'",
    "learn way.csv --starts 0": "starts must be at least 1",
    "learn way.csv --deviation -1": "deviation must be positive",
    "learn way.csv --links a,b": "--links needs --arm FILE.xml",
    "learn way.csv --arm telescopic_pr": "must have 8 columns",
    "compare --jobs 0": "jobs must be at least 1",
    "compare --policy fabric": "--policy adds to the benchmark of --reactive, which needs a number of seeds",
    "compare --reactive 1 --policy no.py:one": "policy 'no.py:one': there is no file no.py",
    "compare --views -1": "views must be at least 0",
    "export a": "the following arguments are required: --format",
    "export --format csv": "name the directories to export, or the number of --episodes to record",
    "export a --format csv --arm crane": "--arm is for --episodes",
    "export a --format csv --episodes 2": "--episodes are recorded in the format lerobot, and of no runs",
    "arms x.xml --home c": "argument --home: must look like NAME=0.3,OTHER=-1, got 'c'",
    "arms --links a --home c=1": "--links, --home: for model files only",
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_wrong_is_said_before_the_work(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    t = np.linspace(0.0, 1.0, 50)
    np.savetxt("way.csv", np.column_stack([0.3 * (1.0 - t), 0.1 * np.sin(np.pi * t)]), delimiter=",")
    (tmp_path / "file").touch()
    # No further start helps where nothing reaches.
    monkeypatch.setattr(importlib.import_module("lieednn_sim.arm.inverse_kinematics"), "_ATTEMPTS", 2)
    if words.startswith("demo"):
        monkeypatch.setattr("lieednn_sim.cli.planning.plan_motion", lambda *_, **__: pytest.fail("it was planned"))
    assert main(shlex.split(words)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("lieednn-sim: error: ")
    assert REFUSED[words] in line
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "way.csv"]
