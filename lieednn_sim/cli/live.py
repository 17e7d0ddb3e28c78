"""The command ``view``: an arm in the browser."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from pathlib import Path

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import import_options, joint_position
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, progress
from lieednn_sim.cli.interruption import say
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.live import view as show
from lieednn_sim.live.page import warning
from lieednn_sim.simulation import Rollout
from lieednn_sim.studies.comparison.statistics import controllers_of
from lieednn_sim.studies.comparison.study import Comparison
from lieednn_sim.studies.comparison.together import choose_problems, replay_together
from lieednn_sim.values import Floats


def view(arguments: argparse.Namespace) -> None:
    """Show the arm until Ctrl-C."""
    rollouts: dict[str, Rollout] = {}
    if arguments.run is None:
        arm = Arm.load(arguments.arm, arguments.scene, arguments.scene_seed, **import_options(arguments))
        print_import_report(arm)
        target = None if arguments.target is None else joint_position(arm, arguments.target, "target")
        start = joint_position(arm, arguments.start, "start")
    else:
        rollouts, start = _recorded(arguments.run)
        arm, target = (some := next(iter(rollouts.values()))).arm, some.target
    if said := warning(arguments.host):
        say(f"warning: {said}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        page = show(
            arm,
            policy=arguments.policy,
            planner=arguments.planner,
            controller=arguments.controller,
            payload=arguments.payload,
            mass_scale=arguments.mass_scale,
            target=target,
            start=start,
            rollouts=rollouts,
            seed=arguments.seed,
            host=arguments.host,
            port=arguments.port,
            browser=False,
        )
    with page:
        console.print(f"view: {page.url} (Ctrl-C ends it)")
        sys.stdout.flush()
        if not arguments.no_browser and _has_display():
            page.open()
        page.wait()


def _recorded(directory: str) -> tuple[dict[str, Rollout], Floats]:
    """The rollout of a run, or those of several planners of a comparison, by the planners' names; and their start."""
    if (Path(directory) / "comparison.sqlite").exists():
        with progress("plan"):
            table = Comparison.read(directory)
            controller = next(iter(controllers_of(table.sorted_rows())), "")
            cases = next(iter(choose_problems(table, 1, controller)), [])
            rollouts = replay_together(table, cases, controller)
    else:
        run = RunDirectory(directory).existing()
        with io.locked(run.path, shared=True):
            task, arm = run.load_task()
            rollouts = {task.planner: run.load_rollout(task, arm)}
    return rollouts, next(iter(rollouts.values())).q_ref[0]


def _has_display() -> bool:
    """Whether a browser would have a window; without one `webbrowser` may start a browser in this terminal."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
