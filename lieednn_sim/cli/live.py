"""The command ``view``: an arm in the browser."""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path
from typing import Annotated, Any

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer.importing import ImportOptions, import_arm
from lieednn_sim.cli.arguments import joint_position
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, progress
from lieednn_sim.cli.interruption import say
from lieednn_sim.cli.kinds import Directory, Joints
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.live import view as show
from lieednn_sim.live.page import warning
from lieednn_sim.simulation import Rollout
from lieednn_sim.studies.comparison.together import replay_together
from lieednn_sim.values import Floats


def view(
    arm: str = "telescopic_pr",
    *,
    scene: str = "free",
    scene_seed: int = 0,
    run: Directory | None = None,
    target: Joints | None = None,
    start: Joints = "home",
    live: Annotated[
        dict[str, Any], show, "policy", "planner", "controller", "payload", "mass_scale", "seed", "port", "host"
    ],
    browser: bool = True,
    imported: Annotated[ImportOptions, import_arm],
) -> None:
    """Show an arm in the browser: drag its target, push it, change its policy and its load.

    It needs the extra 'view' and runs until Ctrl-C. Only this machine can connect, unless --host is given.

    Args:
        arm: a name of `ARMS`, or an MJCF, URDF or YAML file.
        scene: a name of `SCENES`, or an MJCF or YAML file.
        scene_seed: seed of the obstacles' positions.
        run: play a simulated run, or motions of a comparison; arm, scene, start and target are those of the run.
        target: first target, given as for 'plan', with the same default.
        start: joints at the start, given as for --target.
        live: the simulation and its page.
        browser: open a browser at the page's address, which is printed.
        imported: how a model file is imported.
    """
    rollouts: dict[str, Rollout] = {}
    if run is None:
        shown = Arm.load(arm, scene, scene_seed, **imported)
        print_import_report(shown)
        goal = None if target is None else joint_position(shown, target, "target")
        begin = joint_position(shown, start, "start")
    else:
        rollouts, begin = _recorded(run)
        shown, goal = (some := next(iter(rollouts.values()))).arm, some.target
    if said := warning(live.get("host", "127.0.0.1")):
        say(f"warning: {said}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        page = show(
            shown,
            target=goal,
            start=begin,
            rollouts=rollouts,
            browser=False,
            **live,
        )
    with page:
        console.print(f"view: {page.url} (Ctrl-C ends it)")
        sys.stdout.flush()
        if browser and _has_display():
            page.open()
        page.wait()


def _recorded(directory: str) -> tuple[dict[str, Rollout], Floats]:
    """The rollout of a run, or those of several planners of a comparison, by the planners' names; and their start."""
    if (Path(directory) / "comparison.sqlite").exists():
        with progress("plan"):
            rollouts = replay_together(directory)
    else:
        run = RunDirectory(directory).existing()
        with io.locked(run.path, shared=True):
            task, arm = run.load_task()
            rollouts = {task.planner: run.load_rollout(task, arm)}
    return rollouts, next(iter(rollouts.values())).q_ref[0]


def _has_display() -> bool:
    """Whether a browser would have a window; without one `webbrowser` may start a browser in this terminal."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
