"""Growth of the costs of synthesis, shaping, simulation and checks with size: measured exponents and a plot.

    python scripts/growth.py [--quick] [--output results/growth]

Each series doubles one size and keeps the others: neurons in certified synthesis; neurons, and samples, of a curve for
which a network with four hidden neurons is shaped; links of a simulated chain of hinges with position servos; spheres
around such a chain of four, each of which adds a pair with every moving link to the checks of a motion. Times are CPU
times of one core, medians of a few; an exponent is the slope in a log-log plot between the two largest sizes. Writes
``growth.csv``, ``growth.md`` and ``growth.png``.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterable
from functools import cache, partial
from pathlib import Path

import matplotlib
import numpy as np
from benchmark_timing import seconds
from csv_rows import write_rows
from matplotlib.figure import Figure

from lieednn_sim import filesystem
from lieednn_sim._blas import one_blas_thread
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.evaluation.figure_layout import STYLE, save_figure
from lieednn_sim.planning import plan
from lieednn_sim.planning.motion import check_motion
from lieednn_sim.simulation import simulate
from lieednn_sim.synthesis import ShapingOptions, shape, synthesize

FIELDS = ("series", "size", "cpu_ms")
# Name and values of the size in each series.
SERIES: dict[str, tuple[str, tuple[int, ...]]] = {
    "certified synthesis": ("neurons N", (2, 4, 8, 16, 32)),
    "shaping, 100 samples": ("neurons N", (2, 4, 8, 16, 32)),
    "shaping, 4 neurons": ("samples", (50, 100, 200, 400, 800, 1600)),
    "a simulated second": ("links", (2, 4, 8, 16, 32)),
    "checks of a motion": ("pairs", (1, 2, 4, 8, 16, 32, 64)),
}
_SPACING = 0.1  # distance between the chain's hinges [m]


def chain(links: int) -> str:
    """MJCF of a chain of hinges with capsules and servos, their axes alternately along y and z."""
    bodies, servos = "", ""
    for index in reversed(range(links)):
        axis = ("0 1 0", "0 0 1")[index % 2]
        bodies = (
            f'<body name="link{index}" pos="0 0 {_SPACING}" gravcomp="1"><joint name="q{index}" axis="{axis}" '
            f'range="-60 60" damping="0.5" armature="0.01"/><geom type="capsule" size="0.01" mass="0.1" '
            f'fromto="0 0 0.03 0 0 {_SPACING - 0.03}"/>{bodies}</body>'
        )
        servos = f'<position joint="q{index}" kp="50" dampratio="1" forcerange="-50 50"/>' + servos
    return (
        f'<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="foot"><geom size="0.02"/>'
        f"{bodies}</body></worldbody><actuator>{servos}</actuator></mujoco>"
    )


def scene(spheres: int) -> str:
    """A scene file: small spheres in a ring that the chain does not reach."""
    rows = ["obstacles:"]
    for angle in 2.0 * np.pi * np.arange(spheres) / spheres:
        place = f"[{np.cos(angle):.6f}, {np.sin(angle):.6f}, 0.3]"
        rows.append(f"  - {{shape: sphere, radius: 0.02, position: {place}}}")
    return "\n".join(rows)


@cache
def loaded(folder: Path, links: int, spheres: int = 0) -> Arm:
    """The chain, with spheres around it."""
    path, names = folder / f"chain{links}.xml", [f"link{index}" for index in range(links)]
    path.write_text(chain(links))
    if not spheres:
        return Arm.load(path, links=names)
    around = folder / f"ring{spheres}.yaml"
    around.write_text(scene(spheres))
    return Arm.load(path, around, links=names)


def curve(neurons: int, samples: int) -> np.ndarray:
    """A curve ``(samples, neurons, 6)`` from zero, with a random end and bend of each coordinate."""
    rng = np.random.default_rng(neurons)
    s = np.linspace(0.0, 1.0, samples)[:, None, None]
    ends, bends = rng.uniform(-0.8, 0.8, (2, neurons, 6))
    return np.asarray(s * ends + 0.2 * np.sin(np.pi * s) * bends)


def works(series: str, size: int, repeats: int, folder: Path) -> Iterable[Callable[[], object]]:
    """Functions to be timed, one for each repetition."""
    if series == "certified synthesis":
        targets = np.random.default_rng(size).uniform(-0.8, 0.8, (repeats, size, 6))
        return [partial(synthesize, xi, seed=0) for xi in targets]
    if series.startswith("shaping"):
        neurons, samples = (size, 100) if series.endswith("samples") else (4, size)
        options = ShapingOptions(neurons=(4,))
        return [partial(shape, curve(neurons, samples), 1e-9, units=0.5, options=options)] * repeats
    arm = loaded(folder, size) if series == "a simulated second" else loaded(folder, 4, size)
    motion = plan(arm, draw_target(arm, 0), planner="minimum-jerk", duration=1.0).motion
    if series == "a simulated second":
        return [partial(simulate, arm, motion, controller="position-servo", hold=0.0)] * repeats
    return [partial(check_motion, arm, motion)] * repeats


def measured(series: str, size: int, repeats: int, folder: Path) -> dict[str, object]:
    """A row with the median CPU time of a series at a size; for checks the size is the number of pairs."""
    times = [seconds(work) for work in works(series, size, repeats, folder)]
    if series == "checks of a motion":
        size = len(Collisions(loaded(folder, 4, size)).pairs)
    return dict(zip(FIELDS, (series, size, 1e3 * float(np.median(times))), strict=True))


def exponent(sizes: np.ndarray, times: np.ndarray) -> float:
    """The slope between the two largest sizes, in logarithms."""
    return float(np.log(times[-1] / times[-2]) / np.log(sizes[-1] / sizes[-2]))


def points(rows: list[dict[str, object]], series: str) -> tuple[np.ndarray, np.ndarray]:
    """Sizes and CPU times [ms] of a series."""
    pairs = [(row["size"], row["cpu_ms"]) for row in rows if row["series"] == series]
    sizes, times = np.array(pairs, dtype=float).T
    return sizes, times


def table(rows: list[dict[str, object]], command: str) -> str:
    """Markdown table of all series."""
    lines = [
        "# How cost grows",
        "",
        f"`{command}`, one core: median CPU time, and the exponent between the two largest sizes. What is measured is "
        "said in the script.",
        "",
        "| | size: CPU ms | exponent |",
        "| --- | --- | --- |",
    ]
    for series, (name, _) in SERIES.items():
        sizes, times = points(rows, series)
        cells = ", ".join(f"{size:.0f}: {spent:.3g}" for size, spent in zip(sizes, times, strict=True))
        lines.append(f"| {series}, by {name} | {cells} | {exponent(sizes, times):.1f} |")
    return "\n".join(lines) + "\n"


def plot(rows: list[dict[str, object]], path: Path) -> None:
    """A panel for each series, with logarithmic axes and a common axis of times."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 2.9), layout="constrained")
        for axes, (series, (name, _)) in zip(figure.subplots(1, len(SERIES), sharey=True), SERIES.items(), strict=True):
            sizes, times = points(rows, series)
            axes.loglog(sizes, times, "o-")
            axes.set_xticks(sizes, [f"{size:.0f}" for size in sizes])
            axes.minorticks_off()
            axes.set_xlabel(name)
            axes.set_title(f"{series}\nexponent {exponent(sizes, times):.1f}", loc="left", fontsize="medium")
        figure.axes[0].set_ylabel("CPU time [ms]")
        save_figure(figure, path)


def main(arguments: list[str] | None = None) -> int:
    """Measure, and write all three files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the two smallest sizes once")
    parser.add_argument("--output", type=Path, default=Path("results/growth"))
    options = parser.parse_args(arguments)
    try:
        directory = filesystem.make_directory(options.output)
        filesystem.check_outputs([directory / f"growth.{kind}" for kind in ("csv", "md", "png")])
    except LieEDNNError as error:
        parser.error(str(error))
    rows = []
    with tempfile.TemporaryDirectory() as folder, one_blas_thread():
        for series, (_, sizes) in SERIES.items():
            for size in sizes[:2] if options.quick else sizes:
                rows.append(measured(series, size, 1 if options.quick else 7, Path(folder)))
                print(*rows[-1].values(), sep=", ", flush=True)
    write_rows(directory / "growth.csv", FIELDS, rows)
    text = table(rows, "python scripts/growth.py" + " --quick" * options.quick)
    with filesystem.atomic_text(directory / "growth.md") as file:
        file.write(text)
    plot(rows, directory / "growth.png")
    print(text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
