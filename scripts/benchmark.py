"""Benchmark: success and time of synthesis and learning, and costs of the package beside those of its engines.

    python scripts/benchmark.py [--quick] [--output results/benchmark]

Writes a JSON file and Markdown tables. Absolute times depend on the machine; the last table has ratios within the run.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from benchmark_floors import floor_ratios, processor_time
from benchmark_stepping import stepping_ratios
from scipy.spatial.transform import RigidTransform
from threadpoolctl import threadpool_info

from lieednn_sim import filesystem, storage
from lieednn_sim._blas import one_blas_thread
from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.learning import TrainingOptions, train
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import plan
from lieednn_sim.planning.network_path import NetworkPath
from lieednn_sim.planning.shaped import ShapedOptions
from lieednn_sim.simulation import Feedback, follow, simulate
from lieednn_sim.simulation.feedback import FeedbackFollower
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
    milliseconds = 1e3 * np.array([outcome.seconds for outcome in outcomes])
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


def epoch_costs(epochs: int, count: int) -> dict[str, float]:
    """Microseconds per epoch of each learning algorithm at N = 4, medians over ``count`` targets."""
    runs = {
        "literal Algorithm 1": TrainingOptions.literal(max_epochs=max(epochs // 10, 1)),
        "repaired Algorithm 1": TrainingOptions.repaired(max_epochs=epochs),
        "repaired, no projection": TrainingOptions.repaired(max_epochs=epochs, projection="none"),
        "tracked": TrainingOptions.tracked(),
    }
    costs = {}
    for name, options in runs.items():
        results = [train(xi, options, seed=k) for k, xi in enumerate(random_targets(4, count))]
        costs[name] = float(np.median([1e6 * result.seconds / result.epochs for result in results]))
    return costs


def lu_solve(size: int, repeats: int = 1000) -> float:
    """Seconds per call of `numpy.linalg.solve` with this number of unknowns."""
    rng = np.random.default_rng(0)
    matrix, right = rng.normal(size=(size, size)), rng.normal(size=size)
    return processor_time(lambda: [np.linalg.solve(matrix, right) for _ in range(repeats)], 5) / repeats


def control_step_costs(arm: Arm) -> dict[str, str]:
    """Time of a control step of `follow` with feedback and 12 neurons, and in evaluations of the vector field.

    The median over a run with its simulation, which empties the processor's caches between steps.
    """
    target, home = draw_target(arm, 0), arm.keyframe("home")
    network = plan(arm, target, planner="lieednn-shaped", options=ShapedOptions(neurons=(8,))).network
    assert isinstance(network, LieEDNN)
    assert network.n_neurons == 12
    advance, seconds = FeedbackFollower.advance, list[float]()

    def timed(*arguments: Any) -> Any:
        began = time.perf_counter()
        result = advance(*arguments)
        seconds.append(time.perf_counter() - began)
        return result

    with one_blas_thread(), patch.object(FeedbackFollower, "advance", timed):
        follow(arm, network, target[None], 7.0, feedback=Feedback())
    x = network.start(arm.encode(home)).ravel()
    field = processor_time(lambda: [network.flat_vector_field(x) for _ in range(200)], 5) / 200
    whole, of = float(np.median(seconds)), f"control step of follow with feedback, 12 neurons, {arm.name}"
    return {
        f"{of} [us]": f"{1e6 * whole:.0f}",
        f"{of}, in evaluations of the field": f"{whole / field:.0f}",
    }


def evaluation_ratio(arm: Arm, network: LieEDNN, instants: int, repeats: int) -> str:
    """Time to evaluate xi(t) and joints at many instants, in that of SciPy's exponentials alone."""
    path = NetworkPath.drawn(arm, network, arm.keyframe("home"))
    assert path.way is not None
    tau = np.linspace(0.0, path.way[0].t[-1], instants)
    twists = network.visible(path.state(tau)).reshape(-1, 6)
    bare = processor_time(lambda: RigidTransform.from_exp_coords(twists), repeats)
    return f"{processor_time(lambda: arm.decode(network.visible(path.state(tau))), repeats) / bare:.1f}"


def retargeting_ratio(network: LieEDNN, repeats: int) -> str:
    """Time to retarget, in that of a product W phi(x)."""
    xi, weight = random_targets(network.n_visible, 1, seed=1)[0], network.weight
    times = [
        processor_time(lambda run=run: [run() for _ in range(500)], repeats)  # type: ignore[misc]
        for run in (lambda: network.retarget(xi), lambda: weight @ network.phi(xi).ravel())
    ]
    return f"{times[0] / times[1]:.1f}"


def start_ratios(repeats: int) -> dict[str, str]:
    """Start-up times in those of the libraries that they need; processor times of a fresh Python."""

    def cost(*arguments: str) -> float:
        times = []
        for _ in range(repeats):
            begun = sum(os.times()[2:4])
            subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
            times.append(sum(os.times()[2:4]) - begun)
        return float(np.median(times))

    pairs = {
        "lieednn-sim --help, in starts of Python with NumPy": (("-m", "lieednn_sim.cli", "--help"), "import numpy"),
        "import of lieednn_sim.arm, in imports of mujoco": (("-c", "import lieednn_sim.arm"), "import mujoco"),
    }
    return {name: f"{cost(*ours) / cost('-c', floor):.1f}" for name, (ours, floor) in pairs.items()}


def blas_threads() -> int:
    """Number of threads that a product of large matrices may use, as far as known."""
    return max((pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"), default=1)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the targets")
    parser.add_argument("--output", default="results/benchmark", help="directory (default: %(default)s)")
    options = parser.parse_args(arguments)
    write(filesystem.make_directory(options.output), 10 if options.quick else 1, " --quick" if options.quick else "")


def write(directory: Path, scale: int, suffix: str = "") -> Path:
    """Measure a share 1 / ``scale`` of all targets and write both files; returns the path of the table."""
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
    xi = random_targets(4, 1)[0]
    repeats = max(200 // scale, 1)
    begun = time.perf_counter()
    for k in range(repeats):
        network = synthesize(xi, seed=k).unwrap()
    synthesis_time = (time.perf_counter() - begun) / repeats
    others = random_targets(4, repeats, seed=1)
    begun = time.perf_counter()
    for other in others:
        network.retarget(other)
    retarget_time = (time.perf_counter() - begun) / repeats
    begun = time.perf_counter()
    chosen = plan(arm, arm.keyframe("extended"))
    assert isinstance(chosen.network, LieEDNN)
    plan_time = time.perf_counter() - begun
    begun = time.perf_counter()
    rollout = simulate(arm, chosen.motion)
    simulation_time = time.perf_counter() - begun
    costs = epoch_costs(max(5000 // scale, 1), min(5, max(1000 // scale, 1)))
    literal, repaired = costs["literal Algorithm 1"], costs["repaired Algorithm 1"]
    learned = train(xi, TrainingOptions.tracked())
    ratios = {
        "epoch of the literal Algorithm 1, in epochs of the repaired": f"{literal / repaired:.0f}",
        "epoch of the repaired Algorithm 1, in LU solves of its size by NumPy": f"{1e-6 * repaired / lu_solve(24):.1f}",
        "tracked learning of a network, in certified syntheses": f"{learned.seconds / synthesis_time:.0f}",
        "retargeting a certified network, in syntheses": f"1 / {synthesis_time / retarget_time:.0f}",
        "planning with 24 candidates, in syntheses": f"{plan_time / synthesis_time:.0f}",
        "simulation, in real time": f"1 / {rollout.t[-1] / simulation_time:.0f}",
        **{key: cost for name in arm_names() for key, cost in control_step_costs(Arm.load(name)).items()},
        "retargeting, in products W phi(x)": retargeting_ratio(network, max(20 // scale, 1)),
        "xi(t) and q(t) at 10,000 instants, in SciPy's exponentials": evaluation_ratio(
            arm, chosen.network, max(10_000 // scale, 10), max(20 // scale, 1)
        ),
        **start_ratios(max(10 // scale, 1)),
        **stepping_ratios(arm, chosen.motion, max(10 // scale, 1), scale),
        **floor_ratios(rollout, random_targets(4, 200, seed=2), scale),
    }

    storage.save_json(
        directory / "benchmark.json", {"synthesis": rows, "microseconds an epoch": costs, "ratios": ratios}
    )
    lines = [
        "# Benchmark",
        "",
        f"`python scripts/benchmark.py{suffix}`, {os.cpu_count()} processors, {blas_threads()} BLAS threads, "
        f"one where processor time is measured, {platform.machine()}, Python {platform.python_version()}, "
        f"NumPy {np.__version__}.",
        "",
        "| " + " | ".join(rows[0]) + " |",
        "|" + " --- |" * len(rows[0]),
        *("| " + " | ".join(str(value) for value in row.values()) + " |" for row in rows),
        "",
        "| learning, N = 4 | one epoch [us] |",
        "| --- | --- |",
        *(f"| {name} | {cost:.0f} |" for name, cost in costs.items()),
        "",
        "| ratio of times in this run | value |",
        "| --- | --- |",
        *(f"| {name} | {value} |" for name, value in ratios.items()),
    ]
    path = directory / "benchmark.md"
    with filesystem.atomic_text(path) as stream:
        stream.write("\n".join(lines) + "\n")
    print(path.read_text(encoding="utf-8"))
    return path


if __name__ == "__main__":
    main()
