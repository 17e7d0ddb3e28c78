"""The benchmark of synthesis and learning, on one target of each kind."""

from __future__ import annotations

import json
import os
from functools import partial
from importlib.util import find_spec

import benchmark
import benchmark_floors
import benchmark_rows
import benchmark_stepping
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.planning import plan
from lieednn_sim.simulation import simulate


def test_every_row_is_measured_and_written(tmp_path, monkeypatch):
    # What is measured takes as little time as may be.
    for module in (benchmark, benchmark_floors):
        monkeypatch.setattr(module, "plan", partial(plan, duration=1.5))
    for module in (benchmark, benchmark_stepping):
        monkeypatch.setattr(module, "simulate", partial(simulate, hold=0.0))
    monkeypatch.setattr(benchmark_floors, "_FRAMES", 2)
    codes = []
    monkeypatch.setattr(benchmark_floors, "peak_memory", lambda code: codes.append(code) or "9 MB")
    table = benchmark.write(tmp_path, 1000).read_text(encoding="utf-8")
    written = json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))
    rows = written["synthesis"]
    assert len(rows) == 12
    with threadpool_limits(1, "blas"):
        assert benchmark.blas_threads() == 1
    assert f"{os.cpu_count()} processors, {benchmark.blas_threads()} BLAS threads, " in table
    assert all(f"| {row['targets']} | {row['certified']} |" in table for row in rows)
    stepping = {name: float(value) for name, value in written["ratios"].items() if "step" in name}
    assert len([name for name in stepping if "mj_step" in name]) == 12
    assert len([name for name in stepping if "simulate_many" in name or "at once" in name]) == 4
    assert len([name for name in stepping if "environment step of " in name]) == (8 if find_spec("dm_control") else 4)
    assert all(value > 0.0 for name, value in stepping.items() if "added" not in name)
    beside = ("in products W", "in SciPy's", "in starts of", "in imports of")
    assert all(sum(what in name and float(value) > 0.0 for name, value in written["ratios"].items()) for what in beside)
    floors = (
        "in its solves",
        "24 candidates",
        "1 targets at once",
        "in mj_geomDistance",
        "of RRT-Connect",
        "a video, in",
    )
    ratios = written["ratios"].items()
    assert all(
        any(what in name and (value[0].isdigit() or value[0] in "O-n") for name, value in ratios) for what in floors
    )
    assert len(codes) == 6
    assert all(compile(code, "memory", "exec") for code in codes)
    studied = [row for row in rows if "angles" in row["targets"]]
    assert {row["targets"].split(",")[0] for row in studied} == set(arm_names())
    assert all(row["certified"] == "1 of 1" for row in studied)


@pytest.mark.usefixtures("undrawn")
def test_made_up_rows_come_in_unsorted_and_end_as_table_summary_and_page(tmp_path):
    benchmark_rows.collect(tmp_path, 60)
    lines = (tmp_path / "comparison.csv").read_text(encoding="utf-8").splitlines()[1:]
    benchmark_rows.finish(tmp_path)
    assert len(lines) == 60
    assert (tmp_path / "comparison.csv").read_text(encoding="utf-8").splitlines()[1:] != lines
    assert {path.suffix for path in tmp_path.iterdir()} == {".csv", ".json", ".md", ".html"}


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
    little, much = (
        float(benchmark_floors.peak_memory(code).split()[0]) for code in ("", "b = b'x' * 64_000_000; del b")
    )
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
