"""The benchmark of synthesis and learning, on one target of each kind."""

from __future__ import annotations

import json
import os
import shutil
import time
from functools import partial
from importlib.util import find_spec

import benchmark
import benchmark_floors
import benchmark_networks
import benchmark_rows
import benchmark_stepping
import numpy as np
import pytest
from benchmark_timing import Row, time_ratios
from threadpoolctl import threadpool_limits

from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.learning import projected
from lieednn_sim.planning import plan
from lieednn_sim.policies import policies
from lieednn_sim.simulation import follow, simulate
from lieednn_sim.studies import Comparison
from lieednn_sim.synthesis import attempts


def test_every_row_is_measured_and_written(tmp_path, monkeypatch):
    # What is measured takes as little time as may be.
    for module in (benchmark, benchmark_networks, benchmark_floors):
        monkeypatch.setattr(module, "plan", partial(plan, duration=1.5))
    for module in (benchmark, benchmark_networks, benchmark_stepping):
        monkeypatch.setattr(module, "simulate", partial(simulate, hold=0.0))
    monkeypatch.setattr(benchmark_networks, "follow", lambda policy, target, _: follow(policy, target, 0.2))
    monkeypatch.setattr(benchmark_floors, "_FRAMES", 2)
    for module in (attempts, projected):
        monkeypatch.setattr(module, "cpu_time", time.thread_time)
    codes = []
    monkeypatch.setattr(benchmark_floors, "peak_memory", lambda code: codes.append(code) or 9)
    table = benchmark.write(tmp_path, 1000).read_text(encoding="utf-8")
    written = json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))
    rows = written["synthesis"]
    assert len(rows) == 12
    with threadpool_limits(1, "blas"):
        assert benchmark.blas_threads() == 1
    assert f"{os.cpu_count()} processors, BLAS threads: {benchmark.blas_threads()}, " in table
    assert all(f"| {row['targets']} | {row['certified']} |" in table for row in rows)
    ratios = written["ratios"]
    assert len([name for name in ratios if "mj_step" in name and "rollout" in name]) == 12
    assert len([name for name in ratios if "simulate_many" in name or "environments at once" in name]) == 4
    assert len([name for name in ratios if "environment step of " in name]) == (8 if find_spec("dm_control") else 4)
    assert len([name for name in ratios if name.startswith("step of policy ")]) == len(policies())
    assert len([name for name in ratios if "control step of follow" in name]) == 2 * len(arm_names())
    assert all(f"| {name} | " in table for name in ratios)
    assert all(row["minimum"] <= row["median"] <= row["maximum"] for row in ratios.values())
    assert all(row["minimum"] > 0.0 for name, row in ratios.items() if "added" not in name)
    others = {
        "in products W": "<= 5",
        "in SciPy's": "<= 3",
        "in starts of": "<= 1.5",
        "in imports of": "<= 1.5",
        "in its solves": "<= 4",
        "24 candidates of": ">= 3",
        "1 targets at once": ">= 3",
        "in mj_geomDistance": "<= 1.5",
        "in epochs of": ">= 50",
        "in LU solves": "<= 5",
    }
    others |= {"in RRT-Connect's": "<= 1"} if find_spec("ompl") else {}
    others |= {"16 neurons in C": "<= 20"} if any(map(shutil.which, ("cc", "gcc", "clang"))) else {}
    for part, aim in others.items():
        assert [row["aim"] for name, row in ratios.items() if part in name] == [aim]
    assert len(written["memory [MB]"]) == len(codes) == 6
    assert all(compile(code, "memory", "exec") for code in codes)
    studied = [row for row in rows if "angles" in row["targets"]]
    assert {row["targets"].split(",")[0] for row in studied} == set(arm_names())
    assert all(row["certified"] == "1 of 1" for row in studied)


def test_a_row_is_the_minimum_median_and_maximum_of_ratios_taken_in_turns():
    """A clock that says when the first call took 2, 6, 3 seconds and the second 4, 2, 3."""
    ticks = iter([0, 2, 2, 6, 6, 12, 12, 14, 14, 17, 17, 20])
    called = []
    samples = time_ratios(lambda: called.append("one"), lambda: called.append("other"), 3, lambda: next(ticks))
    assert samples == [0.5, 3.0, 1.0]
    assert called == ["one", "other"] * 3
    assert Row("name", samples, "<= 2").cells() == ["name", "0.50", "1.00", "3.00", "<= 2"]
    assert Row("name", [4.44, 25.6]).cells() == ["name", "4.4", "15.0", "26", ""]


@pytest.mark.usefixtures("undrawn")
def test_made_up_rows_end_as_table_summary_and_page(tmp_path):
    benchmark_rows.collect(tmp_path, 60)
    assert len(Comparison.read(tmp_path).rows) == 60
    benchmark_rows.finish(tmp_path)
    assert {path.suffix for path in tmp_path.iterdir()} == {".sqlite", ".md", ".html"}


@pytest.mark.parametrize("kind", ["mixed", "negative", "tiny", "zero"])
def test_targets_of_arms_keep_the_limits_and_have_the_angles_that_they_say(kind):
    arm = Arm.load("telescopic_pr")
    q = arm.decode(np.array(benchmark.arm_targets(arm, kind, 5))).q
    assert (arm.limit_excess(q) < 1e-9).all()
    angles = q[:, np.array(arm.space.units) == "rad"]
    said = {
        "mixed": angles.min() < -0.1 and angles.max() > 0.1,
        "negative": (angles < 0.0).all(),
        "tiny": 1e-12 < np.abs(angles).min() < 1e-4,
        "zero": np.abs(angles).max() < 1e-9,
    }
    assert said[kind]


def test_memory_is_that_of_a_fresh_python_at_its_peak():
    """A list of 64 million bytes that is gone at the end."""
    little, much = (benchmark_floors.peak_memory(code) for code in ("", "b = b'x' * 64_000_000; del b"))
    assert 50.0 < much - little < 80.0


def test_linear_algebra_is_counted_once_and_put_back():
    solve = np.linalg.solve
    with benchmark_floors.timed_algebra() as times:
        for _ in range(3):
            np.linalg.solve(np.eye(3), np.ones(3))
        np.linalg.pinv(np.eye(3))
    assert len(times) == 4
    assert all(one > 0.0 for one in times)
    assert np.linalg.solve is solve
