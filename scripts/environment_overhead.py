# /// script
# requires-python = ">=3.11,<3.13"
# dependencies = ["lieednn_sim[gymnasium]", "gymnasium-robotics>=1.4,<2"]
# ///
"""What a step of an environment adds to its bare substeps, beside others: FetchReach, and the reacher of dm_control.

    pip install 'gymnasium-robotics>=1.4,<2'
    python scripts/environment_overhead.py [--episodes 20] [--output results/environment_overhead]

Before each step the state is copied, and afterwards one call of `mj_step` does the same substeps from there, with the
controls that the step left. CPU times of the thread, medians over all steps, from which the bare substeps are
subtracted pair by pair. Ours simulate no visual geoms in Gymnasium, so there are two floors. Writes
``environment_overhead.md``.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np

from lieednn_sim import io
from lieednn_sim._blas import one_blas_thread
from lieednn_sim._mujoco import mujoco
from lieednn_sim.environments.gymnasium import Environment

STEPS = 45  # of an episode: FetchReach has 50
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True)
class Case:
    """An environment, what it simulates, and the model of its bare substeps where that is another."""

    name: str
    reset: Callable[[], object]
    step: Callable[[Any], object]
    size: int
    model: mujoco.MjModel
    data: mujoco.MjData
    substeps: int
    whole: mujoco.MjModel | None = None


def cases() -> Iterator[Case]:
    """Ours and the others."""
    own = Environment()
    task = own.task
    known = (task.simulation.model, task.simulation.data, task.substeps)
    yield Case("ours, Gymnasium", own.reset, own.step, task.arm.n_joints, *known)
    yield Case("ours, Gymnasium, of the whole model", own.reset, own.step, task.arm.n_joints, *known, task.arm.model)
    control = importlib.import_module("lieednn_sim.environments.suite").load(random=0)
    task = control.task
    known = (task.simulation.model, task.simulation.data, task.substeps)
    yield Case("ours, dm_control", control.reset, control.step, task.arm.n_joints, *known)
    fetch = _fetch()
    robot = fetch.unwrapped
    known = (robot.model, robot.data, robot.n_substeps)
    yield Case("FetchReach-v4", fetch.reset, fetch.step, 4, *known)
    reacher = importlib.import_module("dm_control.suite").load("reacher", "easy", task_kwargs={"random": 0})
    known = (reacher.physics.model.ptr, reacher.physics.data.ptr, 1)
    yield Case("dm_control's reacher, easy", reacher.reset, reacher.step, 2, *known)


def _fetch() -> Any:
    gymnasium.register_envs(importlib.import_module("gymnasium_robotics"))
    utilities: Any = importlib.import_module("gymnasium_robotics.utils.mujoco_utils")
    # Version 1.4 compares numbers with names of kinds of joints, which MuJoCo 3.17 takes for different.
    kinds = {name: kind.value for name, kind in mujoco.mjtJoint.__members__.items()}
    utilities.mujoco = SimpleNamespace(**vars(mujoco) | {"mjtJoint": SimpleNamespace(**kinds)})
    return gymnasium.make("FetchReach-v4")


def measured(case: Case, episodes: int) -> tuple[np.ndarray, np.ndarray]:
    """CPU times of steps, and of their bare substeps, both ``(episodes * STEPS,)`` [us]."""
    rng, clock = np.random.default_rng(0), time.thread_time
    model = case.model if case.whole is None else case.whole
    bare, state = mujoco.MjData(model), np.zeros(mujoco.mj_stateSize(case.model, _STATE))
    steps, alone = [], []
    for _ in range(episodes):
        case.reset()
        for _ in range(STEPS):
            action = 0.5 * rng.uniform(-1.0, 1.0, case.size)
            mujoco.mj_getState(case.model, case.data, state, _STATE)
            begun = clock()
            case.step(action)
            steps.append(1e6 * (clock() - begun))
            mujoco.mj_setState(model, bare, state, _STATE)
            bare.ctrl[:] = case.data.ctrl
            bare.mocap_pos[:], bare.mocap_quat[:] = case.data.mocap_pos, case.data.mocap_quat
            begun = clock()
            mujoco.mj_step(model, bare, case.substeps)
            alone.append(1e6 * (clock() - begun))
    return np.array(steps), np.array(alone)


def table(rows: Sequence[tuple[str, int, np.ndarray, np.ndarray]]) -> str:
    """Markdown table of medians, and quartiles of what is added."""
    lines = ["# What a step of an environment adds", "", "| | substeps | step [us] | bare substeps [us] | added [us] |"]
    lines.append("| --- | --- | --- | --- | --- |")
    for name, substeps, steps, alone in rows:
        low, middle, high = np.quantile(steps - alone, [0.25, 0.5, 0.75])
        cells = f"{np.median(steps):.0f} | {np.median(alone):.0f} | {middle:.0f} ({low:.0f} to {high:.0f})"
        lines.append(f"| {name} | {substeps} | {cells} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--output", type=Path, default=Path("results/environment_overhead"))
    options = parser.parse_args(arguments)
    folder = io.make_directory(options.output)
    with one_blas_thread():
        rows = [(case.name, case.substeps, *measured(case, options.episodes)) for case in cases()]
    with io.atomic_text(folder / "environment_overhead.md") as file:
        file.write(table(rows))
    print(table(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
