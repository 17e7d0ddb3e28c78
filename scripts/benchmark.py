"""Benchmark: success and time of synthesis and learning, and costs of the package beside those of its engines.

    python scripts/benchmark.py [--quick] [--output results/benchmark]

Writes a JSON file and Markdown tables. Absolute times depend on the machine; the last table has ratios within the run.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from benchmark_c import code_rows
from benchmark_floors import floor_rows, memory
from benchmark_networks import epoch_costs, network_rows, start_rows
from benchmark_stepping import stepping_rows
from benchmark_timing import HEADINGS
from threadpoolctl import threadpool_info

from lieednn_sim import io
from lieednn_sim._blas import one_blas_thread
from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.planning import plan
from lieednn_sim.simulation import simulate
from lieednn_sim.synthesis import Synthesis, synthesize


def random_targets(neurons: int, count: int, seed: int = 0) -> list[np.ndarray]:
    """The paper's targets: every coordinate uniform in (-0.8, 0.8)."""
    rng = np.random.default_rng(seed)
    return [rng.uniform(-0.8, 0.8, (neurons, 6)) for _ in range(count)]


def arm_targets(arm: Arm, kind: str, count: int, seed: int = 0) -> list[np.ndarray]:
    """Joint targets within the limits, as `draw_target` draws them, with changed angles.

    ``"mixed"`` angles as they are; ``"negative"``, within the limits; ``"tiny"``, each shrunk by 1 to 1e-7; or
    ``"zero"``, pure extension.
    """
    rng = np.random.default_rng(seed)
    angular = np.array(arm.space.units) == "rad"
    low = arm.position_limits[:, 0]
    targets = []
    for k in range(count):
        q = draw_target(arm, seed + k)
        changed = {
            "mixed": q,
            "negative": np.maximum(-np.abs(q), low),
            "tiny": q * 10.0 ** rng.uniform(-7.0, 0.0, q.shape),
            "zero": np.zeros_like(q),
        }[kind]
        targets.append(arm.encode(np.where(angular, changed, q)))
    return targets


def summarise(name: str, outcomes: list[Synthesis]) -> dict[str, object]:
    """One row of the table."""
    good = [outcome for outcome in outcomes if outcome.success]
    milliseconds = 1e3 * np.array([outcome.cpu_time for outcome in outcomes])
    return {
        "targets": name,
        "certified": f"{len(good)} of {len(outcomes)}",
        "median [ms]": round(float(np.median(milliseconds)), 2),
        "95 % [ms]": round(float(np.percentile(milliseconds, 95)), 2),
        "max [ms]": round(float(milliseconds.max()), 1),
        "largest residual": f"{max((outcome.residual for outcome in good), default=np.nan):.1e}",
        "largest t": round(max((outcome.largest_translation for outcome in good), default=float("nan")), 2),
        "smallest margin": f"{min((o.certificate.margin for o in good if o.certificate), default=np.nan):.1e}",
        "proved impossible": sum(outcome.impossible for outcome in outcomes),
    }


def blas_threads() -> int:
    """Number of threads that a product of large matrices may use, as far as known."""
    return max((pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"), default=1)


def table(headings: Iterable[object], rows: Iterable[Iterable[object]]) -> list[str]:
    """Lines of a Markdown table, after an empty one."""
    lines = ["| " + " | ".join(str(cell) for cell in cells) + " |" for cells in (headings, *rows)]
    return ["", lines[0], "|" + " --- |" * len(list(headings)), *lines[1:]]


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the targets")
    parser.add_argument("--output", default="results/benchmark", help="directory (default: %(default)s)")
    options = parser.parse_args(arguments)
    directory = io.make_directory(options.output)
    # BLAS threads that wait for work would count as busy.
    with one_blas_thread():
        write(directory, 10 if options.quick else 1, " --quick" if options.quick else "")


def write(directory: Path, scale: int, suffix: str = "") -> Path:
    """Measure a fraction 1 / ``scale`` of all targets and write both files; returns the path of the table."""
    synthesize(random_targets(4, 1)[0])  # warm up

    rows = []
    sizes = [(4, 10_000, "uniform"), (4, 10_000, "sign-matched")]
    sizes += [(neurons, count, "uniform") for neurons, count in ((2, 200), (3, 200), (8, 100), (12, 50))]
    for neurons, count, bias in sizes:
        targets = random_targets(neurons, max(count // scale, 1))
        outcomes = [synthesize(xi, bias=bias, seed=k) for k, xi in enumerate(targets)]
        rows.append(summarise(f"N = {neurons}, U(-0.8, 0.8), {bias} bias 1/8", outcomes))
        print(rows[-1], flush=True)
    studies = [(name, "mixed", 1000) for name in arm_names()]
    studies += [("telescopic_pr", "negative", 100), ("telescopic_pr", "zero", 100), ("telescopic_pr", "tiny", 1000)]
    for name, kind, count in studies:
        targets = arm_targets(Arm.load(name), kind, max(count // scale, 1))
        outcomes = [synthesize(xi, bias="sign-matched", seed=k) for k, xi in enumerate(targets)]
        rows.append(summarise(f"{name}, {kind} angles, sign-matched", outcomes))
        print(rows[-1], flush=True)

    arm = Arm.load("telescopic_pr")
    epochs = epoch_costs(random_targets(4, min(5, max(1000 // scale, 1))), max(5000 // scale, 1))
    chosen = plan(arm, arm.keyframe("extended"))
    rollout = simulate(arm, chosen.motion)
    ratios = [
        *network_rows(arm, chosen, random_targets(4, max(20 // scale, 1)), epochs, scale),
        *start_rows(max(10 // scale, 1)),
        *stepping_rows(arm, chosen.motion, max(10 // scale, 1), scale),
        *floor_rows(rollout, random_targets(4, 200, seed=2), scale),
        *code_rows(scale),
    ]
    memories = memory(scale)

    io.save_json(
        directory / "benchmark.json",
        {
            "synthesis": rows,
            "epoch [us]": {name: float(np.median(costs)) for name, costs in epochs.items()},
            "ratios": {row.what: {**row.spread, "samples": len(row.samples), "aim": row.aim} for row in ratios},
            "memory [MB]": memories,
        },
    )
    lines = [
        "# Benchmark",
        "",
        f"`python scripts/benchmark.py{suffix}`, {os.cpu_count()} processors, BLAS threads: {blas_threads()}, "
        f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}.",
        *table(rows[0], (row.values() for row in rows)),
        *table(["learning, N = 4", "one epoch [us]"], ([name, f"{np.median(c):.0f}"] for name, c in epochs.items())),
        "",
        "Ratios of times in this run, each measured several times; what it should be at least or at most is the aim.",
        *table(HEADINGS, (row.cells() for row in ratios)),
        *table(["peak memory", "MB"], memories.items()),
    ]
    path = directory / "benchmark.md"
    with io.atomic_text(path) as stream:
        stream.write("\n".join(lines) + "\n")
    print(path.read_text(encoding="utf-8"))
    return path


if __name__ == "__main__":
    main()
