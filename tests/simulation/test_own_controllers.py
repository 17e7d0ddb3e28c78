"""Controllers of others: by a decorator or an installed package, held to what every controller promises."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.cli import main
from lieednn_sim.errors import InputError, SimulationError
from lieednn_sim.planning import plan
from lieednn_sim.simulation import CONTROLLERS, Controller, Disturbances, Rollout, register_controller, simulate
from lieednn_sim.simulation.controllers.base import PositionServo
from lieednn_sim.simulation.controllers.mocap import MocapWelds
from lieednn_sim.studies import Comparison

ARM = Arm.load("telescopic_pr")
DOCUMENT = Path(__file__).parents[2] / "docs" / "howto" / "own_controller.md"
MOTION = plan(ARM, ARM.keyframe("extended"), planner="minimum-jerk", duration=1.5).motion


@pytest.fixture(autouse=True)
def _only_here(own_names):
    """What a test registers is gone after it."""
    path = list(sys.path)
    yield
    sys.path[:] = path
    sys.modules.pop("my_controllers", None)


@pytest.mark.usefixtures("undrawn")
def test_the_example_of_an_installed_package_appears_in_table_and_page(tmp_path, capsys):
    text = DOCUMENT.read_text()
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "my_controllers" in block)
    (tmp_path / "my_controllers.py").write_text(code)
    sys.path.insert(0, str(tmp_path))
    line = re.search(r'controllers"\]\n(.*?)\n', text)[1].replace('"', "")
    information = tmp_path / "my_controllers-0.1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my-controllers\nVersion: 0.1\n")
    (information / "entry_points.txt").write_text(f"[lieednn_sim.controllers]\n{line}\n")
    words = "compare --planners minimum-jerk --arms telescopic_pr --scenes free --seeds 1 --duration 1 --views 0"
    assert main([*words.split(), "--controllers", "plain-servo,position-servo", "--output", str(tmp_path / "out")]) == 0
    assert "controller plain-servo: my_controllers.PlainServo" in capsys.readouterr().out
    rows = {row.controller: row for row in Comparison.read(tmp_path / "out").rows.values()}
    assert rows["plain-servo"].tracking_rms_mm > 10.0 * rows["position-servo"].tracking_rms_mm
    assert "plain-servo" in (tmp_path / "out" / "comparison.html").read_text()


def test_the_examples_measure_with_noise_and_late():
    names = {"__name__": "__main__"}
    for block in re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(), re.DOTALL):
        exec(block, names)
    noise = Disturbances(position_noise=1e-3)
    for controller in ("plain-servo", "delayed"):
        noisy, exact = (simulate(ARM, MOTION, controller=controller, disturbances=d) for d in (noise, Disturbances()))
        assert np.abs(noisy.q - exact.q).max() > 1e-4, controller
    prompt = simulate(ARM, MOTION, controller="computed-torque")
    assert np.abs(exact.tracking_error).max() > 10.0 * np.abs(prompt.tracking_error).max()
    names["Delayed"].steps = 0
    np.testing.assert_array_equal(simulate(ARM, MOTION, controller="delayed").q, prompt.q)


@pytest.mark.parametrize("kind", [PositionServo, MocapWelds])
def test_a_registered_controller_does_what_it_does_otherwise(kind, tmp_path):
    register_controller("mine")(lambda arm, reference: kind(arm, reference))
    name = next(name for name, entry in CONTROLLERS.items() if entry.load() is kind)
    mine, own = (simulate(ARM, MOTION, controller=controller, hold=0.1) for controller in ("mine", name))
    np.testing.assert_array_equal(mine.q, own.q)
    np.testing.assert_array_equal(mine.ctrl, own.ctrl)
    assert mine.channels.keys() == own.channels.keys()
    mine.save(tmp_path / "rollout.npz")
    assert Rollout.load(tmp_path / "rollout.npz", ARM, MOTION).controller == "mine"


def test_controls_that_are_no_numbers_are_refused_with_the_time():
    register_controller("mine")(
        lambda *_: type("Mine", (Controller,), {"act": lambda _, data, step, noise: data.ctrl.fill(np.nan)})()
    )
    with pytest.raises(SimulationError, match=r"failed at t = 0\.0000 s: Nan, Inf or huge value in CTRL"):
        simulate(ARM, MOTION, controller="mine")


def test_names_and_makers_are_checked():
    with pytest.raises(InputError, match="controller 'mocap' is already registered"):
        register_controller("mocap")(PositionServo)
    with pytest.raises(InputError, match="controller 'mine' must be a Controller, or a function"):
        register_controller("mine")(3)
    with pytest.raises(InputError, match="no controller 'mine'; allowed: computed-torque"):
        simulate(ARM, MOTION, controller="mine")
    register_controller("arm")(lambda arm, reference: arm)
    with pytest.raises(InputError, match="the controller 'arm' is no Controller, but Arm"):
        simulate(ARM, MOTION, controller="arm")


def test_a_run_by_a_controller_from_a_file_is_read_without_it(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("from lieednn_sim.simulation.controllers.base import ComputedTorque as Mine\n")
    rollout = simulate(ARM, MOTION, controller=f"{file}:Mine")
    rollout.save(tmp_path / "rollout.npz")
    file.unlink()
    CONTROLLERS.entries.pop(f"{file}:Mine")
    assert Rollout.load(tmp_path / "rollout.npz", ARM, rollout.motion).controller == f"{file}:Mine"
    (tmp_path / "none.py").write_text("def none(goal):\n    return goal\n")
    with pytest.raises(InputError, match=r"none.py:none' is not made of an arm and a reference: .* takes 1 positional"):
        simulate(ARM, MOTION, controller=f"{tmp_path / 'none.py'}:none")
