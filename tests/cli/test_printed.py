"""Numbers that commands print, cell by cell, of results that are made up."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from importlib import metadata
from types import SimpleNamespace

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.cli import arms, doctor, main, planning, training
from lieednn_sim.planning.certified import CertifiedDetails
from lieednn_sim.planning.clearance import Clearance
from lieednn_sim.planning.shaped import ShapedDetails
from lieednn_sim.rendering.opengl import Backend

# Its largest gaps are of either link, on the way, and neither is an end's.
MOTION = SimpleNamespace(
    t=np.array([0.0, 1.5, 4.25]),
    gap_translation=np.array([[0.0, 0.001], [0.0125, 0.002], [0.003, 0.0]]),
    gap_rotation=np.deg2rad([[0.0, 0.0], [1.0, 3.5], [0.5, 0.25]]),
    xi_target="the target's poses",
)


class Network:
    """What commands ask of a network, at the equilibrium of the target alone."""

    certificate = "globally stable"
    certified = True

    def goal(self, xi):
        return f"goal of {xi}"

    def assess(self, xi):
        return xi

    def robustness(self):
        return "a push of size 1"


@pytest.fixture
def printed(capsys):
    """The cells of each line that was printed: they are apart by two blanks or more."""

    def lines():
        return [re.split(r"  +", line.strip()) for line in capsys.readouterr().out.splitlines()]

    return lines


HOW = {
    "networks": (CertifiedDetails(7, 3), ["networks: 7 drawn, 3 keep the limits"]),
    "guide": (ShapedDetails(0.0135, 0.25), ["guide: rrt-connect; the plan is 14 mm off its path at the end effector"]),
    "nothing": (None, []),
}


@pytest.mark.parametrize("how", HOW)
def test_plan_prints_a_verdict_first_and_all_that_is_proved_when_asked(capsys, how):
    details, told = HOW[how]
    network = None if how == "nothing" else Network()
    guide = SimpleNamespace(planner="rrt-connect")
    found = {
        "motion": MOTION,
        "details": details,
        "guide": guide,
        "leaves": "'a' to 'b' (1 mm)",
        "arm": SimpleNamespace(payload=1.5, import_report=None),
        "load_clearance": 8 if how == "guide" else None,
    }
    result = SimpleNamespace(planner="some", network=network, **found)
    clear = Clearance(0.007, 0.0, (), np.empty((0, 2)))
    certificate = [] if network is None else ["certificate: globally stable"]
    short = [
        f"{'certified' if network else 'no certificate'}; at least 7 mm clear, proved; arrives",
        *certificate,
        "clearance: at least 7 mm, proved at every instant",
        *(["what hangs, as it swings by its linear model: 8"] if how == "guide" else []),
        "planner: some",
        "leaves at the start: 'a' to 'b' (1 mm)",
        "payload: 1.5 kg",
        "mechanism gap: 12.5 mm and 3.5 degrees at most on the way, 0 at the target",
    ]
    planning.print_plan(result, "planner: some", clear, "arrives")
    assert capsys.readouterr().out.splitlines() == short
    proof = ["stability: goal of the target's poses", "a push of size 1"]
    planning.print_plan(result, "planner: some", clear, "arrives", verbose=True)
    assert capsys.readouterr().out.splitlines() == [*short, *told, *(proof if network else [])]


@pytest.mark.parametrize(("epochs", "each"), [(600, 2500), (0, 1_500_000)])
def test_train_prints_its_time_and_the_network(capsys, epochs, each):
    result = SimpleNamespace(message="converged", cpu_time=1.5, epochs=epochs)
    training._report(result, Network(), "poses", verbose=True)
    assert capsys.readouterr().out.splitlines() == [
        f"converged; certified; 1.50 s of CPU time, {each} us an epoch",
        "stability: poses",
        "a push of size 1",
    ]


def test_arms_prints_limits_in_the_units_of_the_joints_and_the_reach(gantry, printed):
    """The furthest corner is (2, 2, 3) from the base, the beam of 1 m included, wherever that stands."""
    spec = gantry.spec.copy()
    spec.body("base").pos = (5.0, 0.0, 7.0)
    moved = replace(Arm.from_spec(spec, gantry.source, "moved"), length_scale=2.0)
    arms._print_summaries([gantry, moved])
    arms.console.print(arms._coordinates(gantry))
    lines = printed()
    for name in ("gantry", "moved"):
        assert [name, "2", "1 hinge, 3 slides", "4.12", "home"] in lines
    heading = ["coordinate", "unit", "from", "to", "velocity", "acceleration", "jerk", "force"]
    rows = lines[lines.index(heading) + 2 :][:4]
    assert rows == [
        ["x", "m", "-1", "1", "1", "10", "-", "60"],
        ["y", "m", "-2", "2", "2", "20", "-", "15"],
        ["z", "m", "-2", "3", "4", "40", "-", "40"],
        ["turn", "rad", "-3", "3", "8", "80", "-", "-"],
    ]


@pytest.mark.parametrize("what", ["nothing", "an extra", "a package", "rendering", "the arms"])
def test_doctor_is_content_where_nothing_is_missing(monkeypatch, capsys, what):
    installed = metadata.version

    def version(name):
        if (what, name) in (("a package", "daqp"), ("an extra", "ompl")):
            raise metadata.PackageNotFoundError
        return installed(name)

    monkeypatch.setattr(metadata, "version", version)
    backend = Backend("disable", "no GPU") if what == "rendering" else Backend("egl", "a renderer")
    monkeypatch.setattr(doctor.opengl, "configure", lambda: backend)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr(doctor, "arm_names", lambda: [] if what == "the arms" else ["one", "two"])
    well = what in ("nothing", "an extra")
    assert main(["doctor"]) == (0 if well else 1)
    printed = " ".join(capsys.readouterr().out.split())
    assert ("everything works" in printed) == well
    assert what != "an extra" or "not installed: pip install 'lieednn_sim[rivals]'" in printed
    assert ("install with pip: daqp" in printed) == (what == "a package")
    assert ("on Debian or Ubuntu: apt-get install libegl1" in printed) == (what == "rendering")
    assert ("does not work: no GPU" in printed) == (what == "rendering")
    assert ("a renderer" in printed) == (what != "rendering")
    assert main(["doctor", "--json"]) == (0 if well else 1)
    report = json.loads(capsys.readouterr().out)
    assert report["healthy"] == well
    assert report["arms"] == doctor.arm_names()
    assert report["versions"]["mujoco"] == installed("mujoco")
    assert what != "an extra" or report["extras"]["ompl"]["version"] is None
    assert report["python_packages_to_install"] == (["daqp"] if what == "a package" else [])
    assert report["debian_packages_to_install"] == (["libegl1", "libgl1"] if what == "rendering" else [])
    assert report["extras"]["ompl"]["install"] == "pip install 'lieednn_sim[rivals]'"
