"""The benchmark of synthesis and learning, on one target of each kind."""

from __future__ import annotations

import json
import os
import shutil
import time
from functools import partial
from importlib.util import find_spec

import benchmark
import benchmark_rows
import numpy as np
import pytest
from benchmark_rows import Row, ratios
from gymnasium.vector import SyncVectorEnv

from lieednn_sim.arm import Arm
from lieednn_sim.learning import training
from lieednn_sim.planning import plan
from lieednn_sim.policies import POLICIES
from lieednn_sim.registry import DEFAULT_ARMS
from lieednn_sim.simulation import follow, simulate
from lieednn_sim.synthesis import certified


@pytest.mark.usefixtures("undrawn")
def test_every_row_is_measured_and_written(tmp_path, monkeypatch):
    # What is measured takes as little time as may be.
    monkeypatch.setattr(benchmark_rows, "plan", partial(plan, duration=1.0))
    monkeypatch.setattr(benchmark_rows, "simulate", partial(simulate, hold=0.0))
    monkeypatch.setattr(benchmark_rows, "follow", lambda policy, target, _: follow(policy, target, 0.2))
    monkeypatch.setattr(benchmark_rows, "FRAMES", 2)
    monkeypatch.setattr(benchmark_rows, "FRAME_SIZE", (64, 36))
    monkeypatch.setattr(benchmark, "SIZES", (3, 4))
    # Instead of environments in processes, each of which imports all that there is.
    monkeypatch.setattr(benchmark_rows, "AsyncVectorEnv", SyncVectorEnv)
    for module in (certified, training):
        monkeypatch.setattr(module, "cpu_time", time.thread_time)
    benchmark.write(tmp_path, 10_000)
    text = (tmp_path / "benchmark.md").read_text(encoding="utf-8")
    written = json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))
    rows, measured = written["synthesis"], written["ratios"]
    assert len(rows) == 10
    assert f"{os.cpu_count()} processors, BLAS threads: " in text
    assert all(f"| {row['targets']} | {row['certified']} |" in text for row in rows)
    assert text.count("| certified synthesis | ") == text.count("| shaping | ") == 1
    for parts, count in (
        (("mj_step", "rollout"), 12),
        (("simulate_many",), 1),
        (("environments at once",), 1),
        (("environment step of ",), 2 if find_spec("dm_control") else 1),
        (("step of policy ",), len(POLICIES)),
        (("control step of follow",), len(DEFAULT_ARMS)),
        (("new target for lieednn-replanning",), len(DEFAULT_ARMS)),
    ):
        assert len([name for name in measured if all(part in name for part in parts)]) == count, parts
    assert all(f"| {name} | " in text for name in measured)
    assert all(row["minimum"] <= row["median"] <= row["maximum"] for row in measured.values())
    assert all(row["minimum"] > 0.0 for name, row in measured.items() if "added" not in name)
    for part, there in (
        ("in RRT-Connect's", find_spec("ompl")),
        ("16 neurons in C", any(map(shutil.which, ("cc", "gcc", "clang")))),
    ):
        assert sum(part in name for name in measured) == bool(there)
    studied = [row for row in rows if "angles" in row["targets"]]
    assert {row["targets"].split(",")[0] for row in studied} == set(DEFAULT_ARMS)
    assert all(row["certified"] == "1 of 1" for row in studied)


def test_a_row_is_the_minimum_median_and_maximum_of_ratios_taken_in_turns():
    """A clock that says when the first call took 2, 6, 3 seconds and the second 4, 2, 3."""
    ticks = iter([0, 2, 2, 6, 6, 12, 12, 14, 14, 17, 17, 20])
    called = []
    samples = ratios(lambda: called.append("one"), lambda: called.append("other"), 3, lambda: next(ticks))
    assert samples == [0.5, 3.0, 1.0]
    assert called == ["one", "other"] * 3
    assert Row("name", samples, "<= 2").cells() == ["name", "0.50", "1.00", "3.00", "<= 2"]
    assert Row("name", [4.44, 25.6]).cells() == ["name", "4.4", "15.0", "26", ""]


def test_growth_is_the_exponent_between_the_largest_two_sizes_in_milliseconds(monkeypatch):
    """Synthesis takes 1, 2, 12 ms and shaping 3 ms whatever the size."""
    times = iter([0.001, 0.003, 0.002, 0.003, 0.012, 0.003])
    monkeypatch.setattr(benchmark, "seconds", lambda work: next(times))
    assert benchmark.growth(7, (2, 3, 6)) == {
        "certified synthesis": ["1", "2", "12", "2.6"],
        "shaping": ["3", "3", "3", "0.0"],
    }


def test_targets_of_arms_keep_the_limits_and_may_have_tiny_angles():
    arm = Arm.load("telescopic_pr")
    q = [arm.decode(np.array(benchmark.arm_targets(arm, 5, tiny=tiny))).q for tiny in (False, True)]
    assert (arm.limit_excess(np.concatenate(q)) < 1e-9).all()
    angular = np.array(arm.space.units) == "rad"
    assert np.abs(q[0][:, angular]).min() > 1e-3
    assert 1e-12 < np.abs(q[1][:, angular]).min() < 1e-4
    np.testing.assert_allclose(q[0][:, ~angular], q[1][:, ~angular], atol=1e-12)


def test_linear_algebra_is_counted_once_and_put_back():
    solve = np.linalg.solve
    with benchmark_rows.timed_algebra() as times:
        for _ in range(3):
            np.linalg.solve(np.eye(3), np.ones(3))
        np.linalg.pinv(np.eye(3))
    assert len(times) == 4
    assert all(one > 0.0 for one in times)
    assert np.linalg.solve is solve
