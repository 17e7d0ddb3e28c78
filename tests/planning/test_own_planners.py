"""Planners of others: registered by a decorator or by an installed package, held to what every planner promises."""

from __future__ import annotations

import re
import sys
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.evaluation.metrics import motion_metrics
from lieednn_sim.planning import PLANNERS, ShapedOptions, joint_motion, plan, register_planner
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import PlanningProblem

from .arms import coarse

ARM = coarse()
HOME, TARGET = ARM.keyframe("home"), ARM.keyframe("extended")
HALF = 0.5 * (HOME + TARGET)
OTHER = coarse("telescopic_compound")
FIRST, LAST = OTHER.keyframe("home"), OTHER.keyframe("extended")
DOCUMENT = Path(__file__).parents[2] / "docs" / "howto" / "own_planner.md"


@pytest.fixture(autouse=True)
def _only_here(own_names):
    """What a test registers or imports is gone after it."""
    path, modules = list(sys.path), set(sys.modules)
    yield
    sys.path[:] = path
    for name in set(sys.modules) - modules:
        if name.startswith("my_"):
            del sys.modules[name]


def smoothstep(problem: PlanningProblem):
    t = problem.times()
    s = (t / t[-1])[:, None]
    way = problem.target - problem.start
    return joint_motion(problem, problem.start + (3 * s**2 - 2 * s**3) * way, (6 * s - 6 * s**2) * way / t[-1], s[:, 0])


def installed(folder: Path, points: str, **modules: str) -> None:
    """A package with entry points, as pip leaves it."""
    information = folder / "my_planners-0.1.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my-planners\nVersion: 0.1\n")
    (information / "entry_points.txt").write_text(f"[lieednn_sim.planners]\n{points}\n")
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text)
    sys.path.insert(0, str(folder))


def test_the_example_of_an_installed_package_plans(tmp_path):
    code = re.search(r"```python\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)[1]
    point = re.search(r'planners"\]\n(.*?)\n', DOCUMENT.read_text())[1]
    assert len(code.splitlines()) <= 40
    installed(tmp_path / "site", point.replace('"', ""), my_planners=code)
    motion, best = (plan(ARM, TARGET, planner=name).motion for name in ("one-detour", "minimum-jerk"))
    # Two cubics through the middle at half of the average speed jerk; minimum jerk jerks least.
    assert motion_metrics(ARM, motion).jerk_joints > 1.2 * motion_metrics(ARM, best).jerk_joints


def test_a_registered_planner_plans_like_the_others():
    @dataclass(frozen=True)
    class Way(PlannerOptions):
        power: float = 1.0

    register_planner("my-smoothstep", Way)(lambda problem, options: smoothstep(problem))
    made = plan(ARM, TARGET, planner="my-smoothstep", duration=2.0, options=Way(2.0))
    assert made.planner == "my-smoothstep"
    assert made.network is None
    np.testing.assert_array_equal(made.motion.q[-1], TARGET)
    # Half way in half of the time, at one and a half times the average speed.
    half = len(made.motion.t) // 2
    np.testing.assert_allclose(made.motion.q[half], 0.5 * (HOME + TARGET), atol=1e-12)
    np.testing.assert_allclose(made.motion.qd[half], 1.5 * (TARGET - HOME) / made.motion.t[-1], atol=1e-12)
    # One rule for what is too fast.
    assert plan(ARM, TARGET, planner="my-smoothstep", duration=(0.1, 10.0)).motion.t[-1] > 0.2
    with pytest.raises(InputError, match="takes options of class Way"):
        plan(ARM, TARGET, planner="my-smoothstep", options=ShapedOptions())


@pytest.mark.parametrize(
    ("solve", "message"),
    [
        (lambda problem: 1 / 0, "the planner failed: ZeroDivisionError"),
        (lambda problem: problem.start, "returned ndarray, neither a Motion nor a Plan"),
        (lambda problem: smoothstep(replace(problem, target=HALF)), "ends .* from where it was asked to"),
        (lambda problem: smoothstep(replace(problem, start=HALF)), "begins .* from where it was asked to"),
        (
            lambda problem: smoothstep(replace(problem, arm=OTHER, start=FIRST, target=LAST)),
            "24 joints .* the arm has 8",
        ),
    ],
)
def test_what_breaks_a_promise_is_refused_with_the_reason(solve, message):
    register_planner("my-wrong")(solve)
    with pytest.raises(PlanError, match=message):
        plan(ARM, TARGET, planner="my-wrong", duration=2.0)


@pytest.mark.parametrize("name", ["minimum-jerk", "My", "a b", "", "a--b", 3])
def test_names_that_are_taken_or_malformed_are_refused(name):
    with pytest.raises(InputError, match=r"already registered|of a to z, digits|name must be a string"):
        register_planner(name)(smoothstep)


def test_options_must_be_options():
    with pytest.raises(InputError, match="subclass of PlannerOptions"):
        register_planner("my-planner", dict)


def test_a_package_that_cannot_be_loaded_is_named_and_left_out(tmp_path):
    installed(
        tmp_path, "my-broken = my_broken:solve\nminimum-jerk = my_other:solve", my_other="def solve(problem): ..."
    )
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        assert "my-broken" not in PLANNERS
    said = sorted(str(one.message) for one in seen)
    assert said[0].startswith("planner 'minimum-jerk' of package 'my-planners' (my_other:solve) is left out: ")
    assert said[1].startswith("planner 'my-broken' of package 'my-planners' (my_broken:solve) is left out: No module")
    assert plan(ARM, TARGET, planner="minimum-jerk").planner == "minimum-jerk"
    with pytest.raises(InputError, match=r"no planner 'my-broken'; allowed: .*minimum-jerk"):
        plan(ARM, TARGET, planner="my-broken")
