"""Rows of the benchmark: times of the package beside those of its engines, each measured several times in one run."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from gymnasium.vector import AsyncVectorEnv
from mujoco import rollout
from scipy.linalg import lapack
from scipy.spatial.transform import RigidTransform

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm, solve_ik
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.environments.gymnasium import Environment, VectorEnvironment
from lieednn_sim.errors import LieEDNNError, RenderingUnavailableError
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import PLANNERS, Plan, plan
from lieednn_sim.planning.certified import CandidateOptions
from lieednn_sim.planning.motion import Motion, check_motion
from lieednn_sim.policies import POLICIES, NetworkPolicy, ReplanningPolicy, make_policy
from lieednn_sim.registry import DEFAULT_ARMS
from lieednn_sim.rendering.overlay import Overlay, draw_lines
from lieednn_sim.rendering.video import Camera, mp4_writer, render_video
from lieednn_sim.simulation import Disturbances, Rollout, Simulation, follow, simulate, simulate_many
from lieednn_sim.simulation.controllers import make_controller
from lieednn_sim.simulation.reference import Reference
from lieednn_sim.simulation.simulation import make_plant
from lieednn_sim.synthesis import ShapingOptions, shape, synthesize, synthesize_many

HEADINGS = ("what", "minimum", "median", "maximum", "aim")
FRAME_SIZE, FRAMES = (640, 360), 60


@dataclass(frozen=True)
class Row:
    """A figure measured several times, and the least or largest value wanted, if any."""

    what: str
    samples: Sequence[float] | np.ndarray
    aim: str = ""

    @property
    def spread(self) -> dict[str, float]:
        """Minimum, median and maximum."""
        low, middle, high = np.quantile(self.samples, [0.0, 0.5, 1.0])
        return {"minimum": float(low), "median": float(middle), "maximum": float(high)}

    def cells(self) -> list[str]:
        """The row as in the table, under `HEADINGS`."""
        digits = [0 if abs(value) >= 20.0 else 1 if abs(value) >= 4.0 else 2 for value in self.spread.values()]
        spread = [f"{value:.{n}f}" for value, n in zip(self.spread.values(), digits, strict=True)]
        return [self.what, *spread, self.aim]


def seconds(work: Callable[[], object], clock: Callable[[], float] = time.process_time, times: int = 1) -> float:
    """Mean time of a call [s]; processor time by default, which other load disturbs less."""
    start = clock()
    for _ in range(times):
        work()
    return (clock() - start) / times


def ratios(
    one: Callable[[], object],
    other: Callable[[], object],
    repeats: int,
    clock: Callable[[], float] = time.process_time,
    times: int = 1,
) -> list[float]:
    """Ratios of the time of one call to that of another, measured in turns, so that other load affects both."""
    return [seconds(one, clock, times) / seconds(other, clock, times) for _ in range(repeats)]


def retarget_row(targets: list[np.ndarray]) -> Row:
    """Time of a synthesis, divided by that of retargeting its network."""
    ratios = []
    for seed, xi in enumerate(targets):
        synthesis = synthesize(xi, seed=seed)
        ratios.append(synthesis.cpu_time / seconds(partial(synthesis.unwrap().retarget, 0.5 * xi), times=200))
    return Row("certified synthesis of a network, in retargetings", ratios)


def real_time_row(arm: Arm, motion: Motion, repeats: int) -> Row:
    """Simulated time, divided by the time that the simulation takes."""
    simulated = [simulate(arm, motion).t[-1] / seconds(partial(simulate, arm, motion)) for _ in range(repeats)]
    return Row("real time, in simulations of it", simulated)


def control_step_row(arm: Arm) -> Row:
    """Time of a control step of `follow`, in a run whose simulation empties the processor's caches between steps."""
    target = draw_target(arm, 0)
    guide = plan(arm, target, planner="minimum-jerk").motion
    network = shape(guide.xi[::2], options=ShapingOptions(neurons=(8,))).network
    assert network.n_neurons == 12
    times = follow(NetworkPolicy(arm, network), target, 7.0).step_time
    return Row(f"control step of follow with feedback, 12 neurons, {arm.name} [us]", 1e6 * times)


def policy_rows(arm: Arm) -> Iterator[Row]:
    """Time of a step of every policy, over a run with its simulation."""
    target = draw_target(arm, 0)
    for name in POLICIES:
        times = follow(make_policy(name, arm, target), target, 4.0).step_time
        yield Row(f"step of policy {name}, {arm.name} [us]", 1e6 * times)


def change_row(arm: Arm, count: int) -> Row:
    """Time of a control step in which the policy ``lieednn-replanning`` gets another target on its way."""
    policy, times = ReplanningPolicy(arm), []
    policy.reset("home")
    for seed in range(count):
        target = draw_target(arm, seed)
        times.append(1e6 * seconds(partial(policy.step, None, target)))
        for _ in range(30):
            policy.step(None, target)
    return Row(f"new target for lieednn-replanning, {arm.name} [us]", times, "<= 1000")


def product_row(network: LieEDNN, repeats: int) -> Row:
    """Time to retarget, divided by that of a product W phi(x)."""
    xi, weight = 0.5 * network.visible(network.equilibrium().xi), network.weight
    product = lambda: weight @ network.phi(xi).ravel()  # noqa: E731
    samples = ratios(partial(network.retarget, xi), product, repeats, times=500)
    return Row("retargeting, in products W phi(x)", samples, "<= 5")


def start_rows(repeats: int) -> Iterator[Row]:
    """Start-up times, divided by those of the libraries needed; processor times of a fresh Python."""

    def children() -> float:
        return sum(os.times()[2:4])

    def python(*arguments: str) -> Any:
        return partial(subprocess.run, [sys.executable, *arguments], check=True, capture_output=True)

    for what, ours, floor in (
        ("lieednn-sim --help, in starts of Python with NumPy", ("-m", "lieednn_sim", "--help"), "import numpy"),
        ("import of lieednn_sim.arm, in imports of mujoco", ("-c", "import lieednn_sim.arm"), "import mujoco"),
    ):
        yield Row(what, ratios(python(*ours), python("-c", floor), repeats, children), "<= 1.5")


def floor(arm: Arm, controller: str, followed: Rollout) -> Simulation:
    """A plant at the start of a rollout, with the controls of its first step."""
    driver = make_controller(controller, arm, Reference.of(arm, followed.q_ref, followed.qd_ref))
    plant = make_plant(arm, None, driver.add_bodies)
    driver.equip(plant)
    simulation = Simulation(arm, plant)
    simulation.reset(followed.q[0])
    driver.act(simulation.data, 0, simulation.noise)
    return simulation


def rollout_rows(arm: Arm, motion: Motion, repeats: int) -> Iterator[Row]:
    """Steps/s of rollouts with their log, divided by those of bare rollouts of the same arm."""

    def step_by_step(model: mujoco.MjModel, data: mujoco.MjData, steps: int) -> None:
        for _ in range(steps):
            mujoco.mj_step(model, data)

    call, loop = "a bare call of mj_step with nstep", "a bare Python loop of mj_step"
    noise = Disturbances(position_noise=1e-4, velocity_noise=1e-3)
    cases = [(name, Disturbances(), call) for name in ("position-servo", "inverse-dynamics", "mocap")]
    cases += [("computed-torque", Disturbances(), loop), ("computed-torque", noise, loop)]
    cases += [("position-servo", noise, loop)]
    for controller, changes, rival in cases:
        ours = partial(simulate, arm, motion, controller=controller, disturbances=changes)
        followed = ours()
        # The package simulates no visual geoms, which do not change the motion.
        for label, floored in {"on the whole model": arm, "without visual geoms": arm.without_visuals}.items():
            simulation = floor(floored, controller, followed)
            run = partial(mujoco.mj_step if rival == call else step_by_step, simulation.model, simulation.data)
            name = f"{controller}{' with noise' if changes == noise else ''}, in those of {rival} {label}"
            samples, aim = ratios(partial(run, len(followed.t)), ours, repeats), ">= 0.8" if rival == call else ">= 0.6"
            yield Row(f"steps/s of a rollout by {name}", samples, aim if floored is arm else "")


def many_row(arm: Arm, count: int, repeats: int) -> Row:
    """Steps/s of many rollouts at once, divided by those of `mujoco.rollout` with as many threads."""
    motions = [plan(arm, draw_target(arm, k), planner="minimum-jerk").motion for k in range(count)]
    threads = os.cpu_count() or 1
    ours = partial(simulate_many, arm, motions, hold=0.0, threads=threads)
    result = ours()
    simulation, kind = floor(arm, "position-servo", result.rollout(0)), mujoco.mjtState.mjSTATE_FULLPHYSICS
    model, data = simulation.model, [mujoco.MjData(simulation.model) for _ in range(threads)]
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, simulation.data, state, kind)
    rival = partial(rollout.rollout, model, data, np.tile(state, (count, 1)), np.ascontiguousarray(result.ctrl))
    name = f"steps/s of {count} rollouts by simulate_many, in those of mujoco.rollout on the whole model"
    return Row(name, ratios(rival, ours, repeats), ">= 0.9")


def environment_rows(arm: Arm, repeats: int, actions: int) -> Iterator[Row]:
    """Time that the environments of both interfaces add to bare substeps."""
    own = Environment(arm=arm)
    model, substeps, cases = arm.model, own.task.substeps, dict[str, Any](Gymnasium=own)
    # dm_control does not support MuJoCo 4.
    if importlib.util.find_spec("dm_control") is not None:
        suite = importlib.import_module("lieednn_sim.environments.suite")
        cases["dm_control"] = suite.load(arm, "reach", random=0)
    given = 0.3 * np.random.default_rng(0).uniform(-1.0, 1.0, (actions, arm.n_joints))
    for name, environment in cases.items():
        data, added = mujoco.MjData(model), []
        for _ in range(repeats):
            environment.reset(seed=0)
            mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
            every = iter(given)
            ours = seconds(lambda step=environment.step, rows=every: step(next(rows)), times=actions)  # type: ignore[misc]
            added.append(1e6 * (ours - seconds(partial(mujoco.mj_step, model, data, substeps), times=actions)))
        yield Row(f"environment step of {name}, added to its {substeps} bare substeps [us]", added, "<= 10")


def vector_row(arm: Arm, repeats: int, actions: int, count: int) -> Row:
    """Steps/s of many environments at once, divided by those of Gymnasium's processes."""
    own, processes = VectorEnvironment(count, arm=arm), AsyncVectorEnv([partial(Environment, arm=arm.name)] * count)
    some = 0.3 * np.random.default_rng(0).uniform(-1.0, 1.0, (count, arm.n_joints))
    own.reset(seed=0)
    processes.reset(seed=0)
    # Wall time: processes and threads run on all cores.
    samples = ratios(partial(processes.step, some), partial(own.step, some), repeats, time.perf_counter, actions)
    own.close()
    processes.close()
    return Row(f"steps/s of {count} environments at once, in those of Gymnasium's AsyncVectorEnv", samples, ">= 10")


# Functions that count as linear algebra in a synthesis, by module.
_ALGEBRA: tuple[tuple[Any, tuple[str, ...]], ...] = (
    (np.linalg, ("eigh", "eigvals", "eigvalsh", "solve", "inv", "lstsq", "pinv", "svd", "cholesky", "qr")),
    (lapack, ("dpotrf", "dpotrs")),
)


@contextlib.contextmanager
def timed_algebra() -> Iterator[list[float]]:
    """The times of all calls of linear algebra in the block [s]; calls within these do not count again."""
    times: list[float] = []

    def timed(function: Callable[..., Any], *given: Any, **named: Any) -> Any:
        start = time.perf_counter()
        try:
            return function(*given, **named)
        finally:
            times.append(time.perf_counter() - start)

    with contextlib.ExitStack() as stack:
        for module, names in _ALGEBRA:
            for name in names:
                stack.enter_context(mock.patch.object(module, name, partial(timed, getattr(module, name))))
        yield times


def synthesis_rows(targets: list[np.ndarray], arms: list[Arm], count: int, repeats: int) -> Iterator[Row]:
    """Time of a synthesis over that of its linear algebra, and the speed-up of syntheses at once over one by one."""
    shares = []
    for seed, xi in enumerate(targets):
        with timed_algebra() as times:
            whole = seconds(partial(synthesize, xi, seed=seed), time.perf_counter)
        shares.append(whole / sum(times))
    yield Row("certified synthesis, N = 4, in its solves and eigendecompositions", shares, "<= 4")

    def speedups(targets: np.ndarray, magnitudes: list[float], seed: int) -> list[float]:
        def one_by_one() -> None:
            generators = np.random.default_rng(seed).spawn(len(targets))
            for xi, magnitude, rng in zip(targets, magnitudes, generators, strict=True):
                synthesize(xi, bias="sign-matched", bias_magnitude=magnitude, seed=rng)

        at_once = partial(synthesize_many, targets, bias="sign-matched", bias_magnitude=magnitudes, seed=seed)
        return ratios(one_by_one, at_once, repeats)

    magnitudes, candidates = list(CandidateOptions().magnitudes()), list[float]()
    for seed, arm in enumerate(arms):
        candidates += speedups(np.repeat(arm.encode(draw_target(arm, seed))[None], 24, axis=0), magnitudes, seed)
    yield Row("24 candidates of a plan at once, times as fast as one by one", candidates, ">= 3")
    many = np.random.default_rng(0).uniform(-0.8, 0.8, (count, 4, 6))
    samples = speedups(many, [0.125] * count, 0)
    yield Row(f"{count} targets at once, N = 4, times as fast as one by one", samples, ">= 3")


def check_row(arm: Arm, seed: int, repeats: int) -> Row:
    """Time of the checks of a motion with its proof, divided by that of contact tests at all its samples."""
    motion = plan(arm, draw_target(arm, seed), planner="lieednn-shaped", seed=seed).motion

    def samples() -> None:
        deque(arm.near_contacts_along(motion.q), maxlen=0)

    taken = np.array(ratios(partial(check_motion, arm, motion), samples, repeats))
    return Row("checks of a motion among poles, in contact tests at its samples", taken, "<= 0.5")


def rival_rows(arms: list[Arm], seeds: int) -> Iterator[Row]:
    """Time of plans of ``lieednn-certified`` in free space, over RRT-Connect's median; no row without OMPL."""
    if "rrt-connect" in PLANNERS.missing():
        return
    times: dict[str, list[float]] = {"lieednn-certified": [], "rrt-connect": []}
    for arm in arms:
        for seed in range(seeds):
            target = draw_target(arm, seed)
            for planner, taken in times.items():
                with contextlib.suppress(LieEDNNError):
                    taken.append(seconds(partial(plan, arm, target, planner=planner, seed=seed)))
    samples = np.array(times["lieednn-certified"]) / np.median(times["rrt-connect"])
    yield Row("plan of lieednn-certified, in RRT-Connect's median, free space", samples, "<= 1")


def inverse_rows(arms: list[Arm], seeds: int) -> Iterator[Row]:
    """Time of inverse kinematics with contact test, from home, over the median of mink with daqp; none without mink."""
    if importlib.util.find_spec("mink") is None:
        return
    mink = importlib.import_module("mink")

    def rival(arm: Arm) -> Callable[[RigidTransform], None]:
        configuration, home = mink.Configuration(arm.model), arm.qpos(arm.keyframe("home"))
        # With this little damping mink takes the fewest steps.
        task = mink.FrameTask(arm.frames.names[-1], "site", 1.0, 1.0, lm_damping=1e-3)
        limits = [mink.ConfigurationLimit(arm.model)]

        def solve(pose: RigidTransform) -> None:
            task.set_target(mink.SE3.from_matrix(pose.as_matrix()))
            configuration.update(home)
            for _ in range(100):
                if np.abs(task.compute_error(configuration)).max() < 1e-6:
                    break
                speed = mink.solve_ik(configuration, [task], 1.0, "daqp", 1e-6, limits=limits)
                configuration.integrate_inplace(speed, 1.0)

        return solve

    for arm in arms:
        solve, poses = rival(arm), [arm.link_poses(draw_target(arm, seed))[-1] for seed in range(seeds)]
        ours, theirs = [], []
        for pose, place, turn in [(pose, pose.translation, pose.rotation) for pose in poses]:
            ours.append(seconds(partial(solve_ik, arm, place, turn)))
            theirs.append(seconds(partial(solve, pose)))
        name = f"inverse kinematics with contact test, {arm.name}, in the median of mink with daqp"
        yield Row(name, np.array(ours) / np.median(theirs), "<= 1.5")


def video_rows(run: Rollout, repeats: int) -> Iterator[Row]:
    """Frames per second of a video, over those of rendering all pictures before encoding; no row without OpenGL."""
    fps, samples = round(FRAMES / float(run.t[-1])), []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        ours = partial(render_video, run, path, size=FRAME_SIZE, fps=fps, preset="draft")
        try:
            frames = ours()
        except RenderingUnavailableError:
            return
        bare = partial(render_then_encode, run, path, fps, frames)
        # They take turns to begin, since the first one may take a tenth longer.
        for k in range(repeats):
            taken = {work: seconds(work, time.perf_counter) for work in ((ours, bare) if k % 2 else (bare, ours))}
            samples.append(taken[bare] / taken[ours])
    yield Row("frames/s of a video, in those of rendering and encoding one after the other", samples, ">= 1")


def render_then_encode(run: Rollout, path: Path, fps: int, frames: int) -> None:
    """Make the video of `render_video`, but render all pictures before encoding."""
    overlay = Overlay(run.arm.link_poses(run.q_ref).as_matrix(), run.link_position[:, -1], 1.0)
    with Camera(run.arm, size=FRAME_SIZE, preset="draft", run=run) as camera:
        shown = np.linspace(0, len(run.t) - 1, frames).astype(int).tolist()
        draw, paths = overlay.draw, partial(overlay.paths, camera.seen, height=FRAME_SIZE[1])
        pictures = [draw_lines(camera.picture(run.q[k], partial(draw, k=k)), paths(k=k)) for k in shown]
    with mp4_writer(path, FRAME_SIZE, fps) as append:
        for picture in pictures:
            append(picture)


# The thread's own clock stands still while another program has the processor.
_MAIN = """
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>
#include "lieednn.h"

static lieednn net;

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return 1e6 * (double)time.tv_sec + 1e-3 * (double)time.tv_nsec;
}

int main(void)
{
    lieednn_init(&net);
    for (int k = 0; k < LIEEDNN_SIZE; k++) net.x[k] = 0.0;
    for (long step = 0; step < STEPS; step++) {
        double start = now();
        lieednn_step(&net, 0.01);
        printf("%.3f\\n", now() - start);
    }
    return 0;
}
"""


def code_rows(steps: int, neurons: int = 16) -> Iterator[Row]:
    """Time of steps of a network in C; no row without a C compiler."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        return
    target = np.random.default_rng(0).uniform(-0.8, 0.8, (neurons, 6))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        synthesize(target).unwrap().to_c(folder)
        (folder / "main.c").write_text(_MAIN, encoding="utf-8")
        sources = [folder / "main.c", folder / "lieednn.c"]
        words: list[Any] = [compiler, "-std=c99", "-O2", f"-DSTEPS={steps}", *sources, "-o", folder / "main", "-lm"]
        subprocess.run(words, check=True)
        times = subprocess.run([folder / "main"], check=True, capture_output=True, text=True).stdout.split()
    yield Row(f"step of a network of {neurons} neurons in C [us]", list(map(float, times)), "<= 20")


def ratio_rows(targets: list[np.ndarray], scale: int) -> list[Row]:
    """All rows, with a fraction 1 / ``scale`` of the repetitions."""
    arms, arm = [Arm.load(name) for name in DEFAULT_ARMS], Arm.load("telescopic_pr")
    few, repeats, often = (max(count // scale, 1) for count in (5, 10, 20))
    chosen: Plan = plan(arm, arm.keyframe("extended"))
    assert isinstance(chosen.network, LieEDNN)
    return [
        retarget_row(targets[:20]),
        real_time_row(arm, chosen.motion, often),
        *map(control_step_row, arms),
        *policy_rows(arm),
        *(change_row(each, max(200 // scale, 2)) for each in arms),
        product_row(chosen.network, often),
        *start_rows(repeats),
        *rollout_rows(arm, chosen.motion, repeats),
        many_row(arm, max(256 // scale, 2), min(few, 3)),
        *environment_rows(arm, repeats, max(50 // scale, 2)),
        vector_row(arm, few, max(20 // scale, 2), max(64 // scale, 2)),
        *synthesis_rows(targets, arms, max(1000 // scale, 1), few),
        check_row(Arm.load("telescopic_pr", "poles", 1), 1, few),
        *rival_rows(arms, max(10 // scale, 1)),
        *inverse_rows(arms, max(40 // scale, 2)),
        *video_rows(simulate(arm, chosen.motion), max(6 // scale, 1)),
        *code_rows(max(100_000 // scale, 10)),
    ]
