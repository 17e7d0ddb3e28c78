"""Small things that a newcomer meets first: plain text, one line for what is large, signals."""

from __future__ import annotations

import builtins
import os
import signal
import sys
import warnings

import numpy as np
from rollouts import make_rollout

from lieednn_sim.arm import Arm
from lieednn_sim.cli import doctor, main
from lieednn_sim.cli.console import console, to_stderr
from lieednn_sim.evaluation.display import table
from lieednn_sim.learning import TrainingOptions
from lieednn_sim.learning import train as learn
from lieednn_sim.planning import Plan, reference_network
from lieednn_sim.planning.certified import CertifiedDetails
from lieednn_sim.planning.network_path import NetworkPath


def test_what_is_printed_is_no_markup(capsys):
    text = "pip install 'lieednn_sim[rivals]' :smile: [red]x[/red] [/]"
    rows = table("of [bold]arms", "[a]", "[b]")
    rows.add_row("[c]", "[red]9[/red]")
    rows.caption = "[d]"
    console.print(text)
    console.print(rows)
    printed = capsys.readouterr().out
    assert text in printed
    assert all(part in printed for part in ("of [bold]arms", "[a]", "[b]", "[c]", "[red]9[/red]", "[d]"))
    to_stderr().print(text)
    assert text in capsys.readouterr().err.replace("\n", " ")


def test_a_terminal_of_unknown_width_shows_what_is_printed(start):
    process = start("-m", "lieednn_sim", "doctor", env=os.environ | {"COLUMNS": "0"})
    printed, errors = process.communicate()
    assert "telescopic_pr" in printed
    assert errors == ""


def test_a_signal_during_an_import_ends_the_command_cleanly(tmp_path, monkeypatch, capsys):
    """While plots are imported a signal comes, and the module makes an error of its own of what that raises."""
    original = builtins.__import__

    def hook(name, *how, **named):
        wanted = named.get("fromlist", how[2] if len(how) > 2 else ())
        if name == "lieednn_sim.evaluation" and "plots" in (wanted or ()):
            try:
                signal.raise_signal(signal.SIGTERM)
            except BaseException:
                raise ImportError("cannot load the library") from None
        return original(name, *how, **named)

    words = "demo --no-page --no-video --target random:3 --planner minimum-jerk --hold 0 --output"
    with monkeypatch.context() as patch:
        patch.setattr(builtins, "__import__", hook)
        assert main([*words.split(), str(tmp_path / "run")]) == 143
    printed, message = capsys.readouterr()
    assert message == "lieednn-sim: interrupted; files already reported are complete\n"
    assert (tmp_path / "run" / "rollout.npz").exists()
    assert "rollout.npz" in printed
    assert not (tmp_path / "run" / "metrics.json").exists()


def test_large_objects_are_shown_in_a_line():
    arm = Arm.load("telescopic_pr")
    network = reference_network(arm)
    motion = NetworkPath.integrate(arm, network, arm.keyframe("home")).timed(0.4, arm.timestep)
    rollout = make_rollout(arm, motion.q)
    learned = learn(0.1 * np.ones((2, 6)), TrainingOptions.tracked(max_epochs=2))
    shown = {
        "Rollout of telescopic_pr by position-servo": rollout,
        "Motion: 201 samples in 0.4 s, 8 joints, 4 links": motion,
        "Arm telescopic_pr: 4 links, 8 joints, scene free": arm,
        "LieEDNN: 4 neurons of 6 coordinates, gamma 1, mu 1, certified": network,
        "History: ": learned.history,
        "TrainingResult: ": learned,
        "Trajectory: 4 neurons of 6 coordinates": network.trajectory(np.zeros((4, 6)), 1.0),
    }
    for words, value in shown.items():
        assert words in str(value)
        assert len(repr(value)) < 200
        assert "array" not in repr(value)
        assert "\n" not in repr(value)
    assert len(str(Plan(motion, network, CertifiedDetails(24, 3))).splitlines()) < 4


def test_a_warning_is_a_line(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["lieednn-sim", "doctor"])
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    monkeypatch.setattr(doctor, "doctor", lambda: warnings.warn("mind the step", stacklevel=2))
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert main() == 0
    assert capsys.readouterr().err == "lieednn-sim: warning: mind the step\n"
