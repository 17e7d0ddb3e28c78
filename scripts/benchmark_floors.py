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
from scipy.linalg import lapack

from lieednn_sim._blas import one_blas_thread
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError, RenderingUnavailableError
from lieednn_sim.planning import missing_planners, plan
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


def processor_time(what: Callable[[], object], repeats: int) -> float:
    """Median processor time [s], which other load on the machine disturbs less than wall time.

    With one BLAS thread, since threads that wait for work count as busy.
    """
    times = []
    with one_blas_thread():
        for _ in range(repeats):
            begun = time.process_time()
            what()
            times.append(time.process_time() - begun)
    return float(np.median(times))


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


def synthesis_floor(targets: list[np.ndarray]) -> str:
    """Time of a certified synthesis in that of its solves and eigendecompositions; the median over targets."""
    shares = []
    for seed, xi in enumerate(targets):
        begun = time.perf_counter()
        with timed_algebra() as times:
            synthesize(xi, seed=seed)
        shares.append((time.perf_counter() - begun) / sum(times))
    return f"{np.median(shares):.1f}"


def stacked_ratios(arms: list[Arm], count: int) -> dict[str, str]:
    """Speed-up of syntheses at once over one by one, for candidates of plans and for targets of four links."""
    speedups = []
    for seed, arm in enumerate(arms):
        candidates = np.repeat(arm.encode(draw_target(arm, seed))[None], 24, axis=0)
        speedups.append(_speedup(candidates, list(CandidateOptions().magnitudes()), seed))
    rng = np.random.default_rng(0)
    targets = rng.uniform(-0.8, 0.8, (count, 4, 6))
    return {
        "24 candidates of a plan at once, times as fast as one by one": f"{np.median(speedups):.1f}",
        f"{count} targets at once, N = 4, times as fast as one by one": f"{_speedup(targets, [0.125] * count, 0):.1f}",
    }


def _speedup(targets: np.ndarray, magnitudes: list[float], seed: int) -> float:
    generators = np.random.default_rng(seed).spawn(len(targets))

    def one_by_one() -> None:
        for xi, magnitude, rng in zip(targets, magnitudes, generators, strict=True):
            synthesize(xi, bias="sign-matched", bias_magnitude=magnitude, seed=rng)

    def at_once() -> None:
        synthesize_many(targets, bias="sign-matched", bias_magnitude=magnitudes, seed=seed)

    return processor_time(one_by_one, 1) / processor_time(at_once, 1)


def check_ratio(arm: Arm, seed: int, repeats: int) -> str:
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

    floor = processor_time(bare, repeats) * len(positions) / len(positions[::10])
    return f"{processor_time(lambda: check_motion(arm, motion), repeats) / floor:.2f}"


def planning_ratio(arms: list[Arm], seeds: int) -> str:
    """Time of a plan of ``lieednn-certified`` in that of RRT-Connect's; medians over targets in free space."""
    if "rrt-connect" in missing_planners():
        return "OMPL is not installed"
    times: dict[str, list[float]] = {"lieednn-certified": [], "rrt-connect": []}
    for arm in arms:
        for seed in range(seeds):
            for planner, taken in times.items():
                with contextlib.suppress(LieEDNNError):
                    target = draw_target(arm, seed)
                    taken.append(processor_time(partial(plan, arm, target, planner=planner, seed=seed), 1))
    return f"{np.median(times['lieednn-certified']) / np.median(times['rrt-connect']):.2f}"


def video_ratio(rollout: Rollout, repeats: int) -> str:
    """Frames per second of wall time of a video, in those of rendering all pictures first and then encoding them.

    A first run warms OpenGL up, and the two take turns to begin, since the first one may take a tenth longer.
    """
    fps, shares = round(_FRAMES / float(rollout.t[-1])), []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        ours = partial(render_video, rollout, path, size=_FRAME_SIZE, fps=fps, preset="draft")
        try:
            frames = ours()
        except RenderingUnavailableError:
            return "no OpenGL"
        bare = partial(_render_then_encode, rollout, path, fps, frames)
        for k in range(repeats):
            seconds = {}
            for run in (ours, bare) if k % 2 else (bare, ours):
                begun = time.perf_counter()
                run()
                seconds[run] = time.perf_counter() - begun
            shares.append(seconds[bare] / seconds[ours])
    return f"{np.median(shares):.2f}"


def _render_then_encode(rollout: Rollout, path: Path, fps: int, frames: int) -> None:
    overlay = Overlay(rollout.arm.link_poses(rollout.q_ref).as_matrix(), rollout.link_position[:, -1], 1.0)
    with Camera(rollout.arm, size=_FRAME_SIZE, preset="draft", target=rollout.target) as camera:
        shown = np.linspace(0, len(rollout.t) - 1, frames).astype(int)
        pictures = [camera.picture(rollout.q[k], partial(overlay.draw, k=int(k))) for k in shown]
    with ffmpeg.mp4_writer(path, _FRAME_SIZE, fps) as append:
        for picture in pictures:
            append(picture)


def peak_memory(code: str) -> str:
    """Peak resident memory of a fresh Python that runs some code [MB]."""
    # Not `ru_maxrss`, which starts from the parent's memory when it forked.
    words = f"{code}\nprint(*(line for line in open('/proc/self/status') if 'VmHWM' in line))"
    done = subprocess.run([sys.executable, "-c", words], check=True, capture_output=True, text=True)
    return f"{int(done.stdout.split()[-2]) / 1024:.0f} MB"


def memory(scale: int) -> dict[str, str]:
    """Peak memory of a loaded arm, a long rollout, the demo without its video, and comparisons."""
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
        "memory of a loaded arm": peak_memory(load),
        f"memory of a rollout of {seconds + 4} s at 500 Hz": peak_memory(long),
        "memory of the demo without its video": peak_memory(demo),
    }


def comparison_memory(rows: int) -> dict[str, str]:
    """Peak memory of a comparison with made-up rows: a hundredth of them, all of them, and their summary."""
    scripts, peaks = f"import sys\nsys.path.insert(0, {str(Path(__file__).parent)!r})\nfrom pathlib import Path\n", {}
    with tempfile.TemporaryDirectory() as folder:
        few, many = Path(folder) / "few", Path(folder) / "many"
        for name, what in {
            f"a comparison while {rows // 100:,} rows come in": f"collect(Path({str(few)!r}), {rows // 100})",
            f"a comparison while {rows:,} rows come in": f"collect(Path({str(many)!r}), {rows})",
            f"sorting {rows:,} rows, their summary and page": f"finish(Path({str(many)!r}))",
        }.items():
            peaks[f"memory of {name}"] = peak_memory(f"{scripts}import benchmark_rows\nbenchmark_rows.{what}")
    return peaks


def floor_ratios(rollout: Rollout, targets: list[np.ndarray], scale: int) -> dict[str, str]:
    """All rows of this module by name, with a share 1 / ``scale`` of the cases."""
    arms = [Arm.load(name) for name in arm_names()]
    repeats = max(5 // scale, 1)
    return {
        "certified synthesis, N = 4, in its solves and eigendecompositions": synthesis_floor(
            targets[: max(200 // scale, 1)]
        ),
        **stacked_ratios(arms, max(1000 // scale, 1)),
        "checks of a motion among poles, in mj_geomDistance over all pairs": check_ratio(
            Arm.load("telescopic_pr", "poles", 1), 1, repeats
        ),
        "plan of lieednn-certified, in those of RRT-Connect, free space": planning_ratio(arms, max(10 // scale, 1)),
        "frames/s of a video, in those of rendering and encoding one after the other": video_ratio(
            rollout, max(6 // scale, 1)
        ),
        **memory(scale),
    }
