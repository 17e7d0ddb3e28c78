"""Rows of the benchmark that compare parts of the package with the least work that they need."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from benchmark_timing import Row, seconds, time_ratios
from scipy.linalg import lapack

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError, RenderingUnavailableError
from lieednn_sim.planning import PLANNERS, plan
from lieednn_sim.planning.certified import CandidateOptions
from lieednn_sim.planning.motion import check_motion
from lieednn_sim.rendering import ffmpeg
from lieednn_sim.rendering.overlay import Overlay
from lieednn_sim.rendering.video import Camera, render_video
from lieednn_sim.simulation import Rollout
from lieednn_sim.synthesis import synthesize, synthesize_many

# Functions that count as linear algebra in a synthesis, by module.
_ALGEBRA: tuple[tuple[Any, tuple[str, ...]], ...] = (
    (np.linalg, ("eigh", "eigvals", "eigvalsh", "solve", "inv", "lstsq", "pinv", "svd", "cholesky", "qr")),
    (lapack, ("dpotrf", "dpotrs")),
)
# Largest distance that is measured [m].
_FAR = 0.05
_FRAME_SIZE, _FRAMES = (640, 360), 60


@contextlib.contextmanager
def timed_algebra() -> Iterator[list[float]]:
    """List of the times of all linear algebra in the block [s]; nested calls count once."""
    times: list[float] = []
    depth = [0]

    def timed(function: Callable[..., Any], *given: Any, **named: Any) -> Any:
        if depth[0]:
            return function(*given, **named)
        depth[0] = 1
        begun = time.perf_counter()
        try:
            return function(*given, **named)
        finally:
            times.append(time.perf_counter() - begun)
            depth[0] = 0

    originals = [(module, name, getattr(module, name)) for module, names in _ALGEBRA for name in names]
    try:
        for module, name, function in originals:
            setattr(module, name, partial(timed, function))
        yield times
    finally:
        for module, name, function in originals:
            setattr(module, name, function)


def synthesis_row(targets: list[np.ndarray]) -> Row:
    """Time of a certified synthesis in that of its solves and eigendecompositions, over targets."""
    ratios = []
    for seed, xi in enumerate(targets):
        with timed_algebra() as times:
            whole = seconds(partial(synthesize, xi, seed=seed), time.perf_counter)
        ratios.append(whole / sum(times))
    return Row("certified synthesis, N = 4, in its solves and eigendecompositions", ratios, "<= 4")


def stacked_rows(arms: list[Arm], count: int, repeats: int) -> list[Row]:
    """Speed-up of syntheses at once over one by one, for candidates of plans and for targets of four links."""
    candidates: list[float] = []
    for seed, arm in enumerate(arms):
        same = np.repeat(arm.encode(draw_target(arm, seed))[None], 24, axis=0)
        candidates += _speedups(same, list(CandidateOptions().magnitudes()), seed, repeats)
    targets = np.random.default_rng(0).uniform(-0.8, 0.8, (count, 4, 6))
    speedups = _speedups(targets, [0.125] * count, 0, repeats)
    return [
        Row("24 candidates of a plan at once, times as fast as one by one", candidates, ">= 3"),
        Row(f"{count} targets at once, N = 4, times as fast as one by one", speedups, ">= 3"),
    ]


def _speedups(targets: np.ndarray, magnitudes: list[float], seed: int, repeats: int) -> list[float]:
    def one_by_one() -> None:
        generators = np.random.default_rng(seed).spawn(len(targets))
        for xi, magnitude, rng in zip(targets, magnitudes, generators, strict=True):
            synthesize(xi, bias="sign-matched", bias_magnitude=magnitude, seed=rng)

    def at_once() -> None:
        synthesize_many(targets, bias="sign-matched", bias_magnitude=magnitudes, seed=seed)

    return time_ratios(one_by_one, at_once, repeats)


def check_row(arm: Arm, seed: int, repeats: int) -> Row:
    """Time of the checks of a motion, in that of `mj_geomDistance` for all pairs at all samples."""
    motion = plan(arm, draw_target(arm, seed), planner="lieednn-shaped", seed=seed).motion
    model, pairs, positions = arm.model, Collisions(arm).pairs, arm.qpos(motion.q)
    data = mujoco.MjData(model)

    def bare() -> None:
        for position in positions[::10]:
            data.qpos[:] = position
            mujoco.mj_kinematics(model, data)
            for first, second in pairs:
                mujoco.mj_geomDistance(model, data, first, second, _FAR, None)

    part = len(positions[::10]) / len(positions)
    ratios = [part * ratio for ratio in time_ratios(partial(check_motion, arm, motion), bare, repeats)]
    return Row("checks of a motion among poles, in mj_geomDistance over all pairs", ratios, "<= 1.5")


def planning_rows(arms: list[Arm], seeds: int) -> list[Row]:
    """Time of plans of ``lieednn-certified`` in free space, in RRT-Connect's median; no row without OMPL."""
    if "rrt-connect" in PLANNERS.missing():
        return []
    times: dict[str, list[float]] = {"lieednn-certified": [], "rrt-connect": []}
    for arm in arms:
        for seed in range(seeds):
            target = draw_target(arm, seed)
            for planner, taken in times.items():
                with contextlib.suppress(LieEDNNError):
                    taken.append(seconds(partial(plan, arm, target, planner=planner, seed=seed)))
    ratios = np.array(times["lieednn-certified"]) / np.median(times["rrt-connect"])
    return [Row("plan of lieednn-certified, in RRT-Connect's median, free space", ratios.tolist(), "<= 1")]


def video_rows(rollout: Rollout, repeats: int) -> list[Row]:
    """Frames per second of wall time of a video, in those of rendering all pictures first and then encoding them.

    A first run warms OpenGL up, and the two take turns to begin, since the first one may take a tenth longer. No row
    without OpenGL.
    """
    fps, ratios = round(_FRAMES / float(rollout.t[-1])), []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        ours = partial(render_video, rollout, path, size=_FRAME_SIZE, fps=fps, preset="draft")
        try:
            frames = ours()
        except RenderingUnavailableError:
            return []
        bare = partial(_render_then_encode, rollout, path, fps, frames)
        for k in range(repeats):
            taken = {run: seconds(run, time.perf_counter) for run in ((ours, bare) if k % 2 else (bare, ours))}
            ratios.append(taken[bare] / taken[ours])
    return [Row("frames/s of a video, in those of rendering and encoding one after the other", ratios, ">= 1")]


def _render_then_encode(rollout: Rollout, path: Path, fps: int, frames: int) -> None:
    overlay = Overlay(rollout.arm.link_poses(rollout.q_ref).as_matrix(), rollout.link_position[:, -1], 1.0)
    with Camera(rollout.arm, size=_FRAME_SIZE, preset="draft", target=rollout.target) as camera:
        shown = np.linspace(0, len(rollout.t) - 1, frames).astype(int)
        pictures = [camera.picture(rollout.q[k], partial(overlay.draw, k=int(k))) for k in shown]
    with ffmpeg.mp4_writer(path, _FRAME_SIZE, fps) as append:
        for picture in pictures:
            append(picture)


def peak_memory(code: str) -> int:
    """Peak resident memory of a fresh Python that runs some code [MB]."""
    # Not `ru_maxrss`, which starts from the parent's memory when it forked.
    words = f"{code}\nprint(*(line for line in open('/proc/self/status') if 'VmHWM' in line))"
    done = subprocess.run([sys.executable, "-c", words], check=True, capture_output=True, text=True)
    return round(int(done.stdout.split()[-2]) / 1024)


def memory(scale: int) -> dict[str, int]:
    """Peak memory [MB] of a loaded arm, a long rollout, the demo without its video, and comparisons."""
    seconds = max(600 // scale, 1)
    load = "from lieednn_sim.arm import Arm\narm = Arm.load('telescopic_pr')"
    long = f"""{load}
from lieednn_sim.planning import plan
from lieednn_sim.simulation import simulate
simulate(arm, plan(arm, arm.keyframe('extended'), planner='minimum-jerk').motion, hold={seconds})"""
    demo = """import tempfile
from lieednn_sim.cli import main
with tempfile.TemporaryDirectory() as folder:
    main(['demo', '--no-video', '--output', folder])"""
    return {
        **comparison_memory(100_000 // scale),
        "a loaded arm": peak_memory(load),
        f"a rollout of {seconds + 4} s at 500 Hz": peak_memory(long),
        "the demo without its video": peak_memory(demo),
    }


def comparison_memory(rows: int) -> dict[str, int]:
    """Peak memory [MB] of a comparison with made-up rows: a hundredth of them, all of them, and their summary."""
    scripts, peaks = f"import sys\nsys.path.insert(0, {str(Path(__file__).parent)!r})\nfrom pathlib import Path\n", {}
    with tempfile.TemporaryDirectory() as folder:
        few, many = Path(folder) / "few", Path(folder) / "many"
        for name, what in {
            f"a comparison while {rows // 100:,} rows come in": f"collect(Path({str(few)!r}), {rows // 100})",
            f"a comparison while {rows:,} rows come in": f"collect(Path({str(many)!r}), {rows})",
            f"sorting {rows:,} rows, their summary and page": f"finish(Path({str(many)!r}))",
        }.items():
            peaks[name] = peak_memory(f"{scripts}import benchmark_rows\nbenchmark_rows.{what}")
    return peaks


def floor_rows(rollout: Rollout, targets: list[np.ndarray], scale: int) -> list[Row]:
    """All ratios of this module, with a fraction 1 / ``scale`` of the cases."""
    arms = [Arm.load(name) for name in arm_names()]
    repeats = max(5 // scale, 1)
    return [
        synthesis_row(targets[: max(200 // scale, 1)]),
        *stacked_rows(arms, max(1000 // scale, 1), repeats),
        check_row(Arm.load("telescopic_pr", "poles", 1), 1, repeats),
        *planning_rows(arms, max(10 // scale, 1)),
        *video_rows(rollout, max(6 // scale, 1)),
    ]
