"""Benchmark: success and time of synthesis, and times of the package beside those of its engines.

    python scripts/benchmark.py [--quick] [--output results/benchmark]

Writes a JSON file and Markdown tables. Absolute times depend on the machine; the table of rows has ratios within the
run, see `benchmark_rows`.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from benchmark_rows import HEADINGS, ratio_rows, seconds
from common import options
from common import write as write_lines
from threadpoolctl import threadpool_info

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.budget import one_blas_thread
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.registry import DEFAULT_ARMS
from lieednn_sim.synthesis import ShapingOptions, Synthesis, shape, synthesize

# Numbers of neurons between which costs are compared.
SIZES = (2, 4, 8, 16, 32)


def random_targets(neurons: int, count: int, seed: int = 0) -> list[np.ndarray]:
    """The paper's targets: every coordinate uniform in (-0.8, 0.8)."""
    rng = np.random.default_rng(seed)
    return [rng.uniform(-0.8, 0.8, (neurons, 6)) for _ in range(count)]


def arm_targets(arm: Arm, count: int, *, tiny: bool = False) -> list[np.ndarray]:
    """Joint targets as `draw_target` draws them; ``tiny``: with each angle shrunk by 1 to 1e-7."""
    rng, angular = np.random.default_rng(0), np.array(arm.space.units) == "rad"
    drawn = np.array([draw_target(arm, seed) for seed in range(count)])
    return list(arm.encode(np.where(tiny & angular, drawn * 10.0 ** rng.uniform(-7.0, 0.0, drawn.shape), drawn)))


def summarise(name: str, results: list[Synthesis]) -> dict[str, object]:
    """One row of the table of syntheses."""
    good = [result for result in results if result.success]
    milliseconds = 1e3 * np.array([result.cpu_time for result in results])
    return {
        "targets": name,
        "certified": f"{len(good)} of {len(results)}",
        "median [ms]": round(float(np.median(milliseconds)), 2),
        "95 % [ms]": round(float(np.percentile(milliseconds, 95)), 2),
        "max [ms]": round(float(milliseconds.max()), 1),
        "largest residual": f"{max((result.residual for result in good), default=np.nan):.1e}",
        "largest t": round(max((result.largest_translation for result in good), default=float("nan")), 2),
        "smallest margin": f"{min((r.certificate.margin for r in good if r.certificate), default=np.nan):.1e}",
        "proved impossible": sum(result.impossible for result in results),
    }


def synthesis_rows(scale: int) -> list[dict[str, object]]:
    """The table of syntheses, of a fraction 1 / ``scale`` of all targets."""
    rows = []
    sizes = [(4, 10_000, "uniform"), (4, 10_000, "sign-matched")]
    sizes += [(neurons, count, "uniform") for neurons, count in ((2, 200), (3, 200), (8, 100), (12, 50))]
    for neurons, count, bias in sizes:
        targets = random_targets(neurons, max(count // scale, 1))
        name = f"N = {neurons}, U(-0.8, 0.8), {bias} bias 1/8"
        rows.append(summarise(name, [synthesize(xi, bias=bias, seed=k) for k, xi in enumerate(targets)]))
        print(rows[-1], flush=True)
    for name, kind in [*((name, "mixed") for name in DEFAULT_ARMS), ("telescopic_pr", "tiny")]:
        targets = arm_targets(Arm.load(name), max(1000 // scale, 1), tiny=kind == "tiny")
        results = [synthesize(xi, bias="sign-matched", seed=k) for k, xi in enumerate(targets)]
        rows.append(summarise(f"{name}, {kind} angles, sign-matched", results))
        print(rows[-1], flush=True)
    return rows


def growth(scale: int, sizes: Sequence[int]) -> dict[str, list[str]]:
    """Median CPU times [ms] of synthesis and of shaping 100 samples, by size; last the exponent of the largest two."""
    repeats = max(7 // scale, 1)
    options = ShapingOptions(neurons=(4,))
    s = np.linspace(0.0, 1.0, 100)[:, None, None]
    times: dict[str, list[float]] = {"certified synthesis": [], "shaping": []}
    for size in sizes:
        targets = random_targets(size, repeats, seed=size)
        curve = s * targets[0] + 0.2 * np.sin(np.pi * s) * targets[-1]
        calls: dict[str, Sequence[Callable[[], object]]] = {
            "certified synthesis": [partial(synthesize, xi, seed=0) for xi in targets],
            "shaping": [partial(shape, curve, 1e-9, units=0.5, options=options)] * repeats,
        }
        for name, works in calls.items():
            times[name].append(1e3 * float(np.median([seconds(work) for work in works])))
    doublings = np.log(sizes[-1] / sizes[-2])
    exponents = {name: np.log(found[-1] / found[-2]) / doublings for name, found in times.items()}
    return {name: [f"{value:.3g}" for value in found] + [f"{exponents[name]:.1f}"] for name, found in times.items()}


def write(directory: Path, scale: int, suffix: str = "") -> None:
    """Measure a fraction 1 / ``scale`` of all targets and write both files."""
    synthesize(random_targets(4, 1)[0])  # warm up
    rows, grown = synthesis_rows(scale), growth(scale, SIZES)
    ratios = ratio_rows(random_targets(4, max(200 // scale, 1), seed=2), scale)
    io.save_json(
        directory / "benchmark.json",
        {
            "synthesis": rows,
            "growth": grown,
            "ratios": {row.what: {**row.spread, "samples": len(row.samples), "aim": row.aim} for row in ratios},
        },
    )
    threads = max((pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"), default=1)
    lines = [
        "# Benchmark",
        "",
        f"`python scripts/benchmark.py{suffix}`, {os.cpu_count()} processors, BLAS threads: {threads}, "
        f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}.",
        *markdown_table(rows[0], (row.values() for row in rows)),
        *markdown_table(
            ["CPU time [ms]", *(f"N = {size}" for size in SIZES), "exponent"],
            ([name, *values] for name, values in grown.items()),
        ),
        "",
        "Ratios of times in this run, each measured several times. The aim is the least or largest value wanted.",
        *markdown_table(HEADINGS, (row.cells() for row in ratios)),
    ]
    write_lines(directory / "benchmark.md", lines)


def main(arguments: list[str] | None = None) -> None:
    given = options(arguments, __doc__, "results/benchmark", quick=False)
    # BLAS threads that wait for work would count as busy.
    with one_blas_thread():
        write(io.make_directory(given.output), 10 if given.quick else 1, " --quick" if given.quick else "")


if __name__ == "__main__":
    main()
