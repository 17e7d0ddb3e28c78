"""The command ``view``: an arm in the browser."""

from __future__ import annotations

import argparse
import os
import sys
import warnings

from lieednn_sim.arm import Arm
from lieednn_sim.cli.arguments import import_options, joint_position
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console
from lieednn_sim.cli.interruption import say
from lieednn_sim.live import view as show


def view(arguments: argparse.Namespace) -> None:
    """Show the arm until Ctrl-C."""
    arm = Arm.load(arguments.arm, arguments.scene, arguments.scene_seed, **import_options(arguments))
    print_import_report(arm)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        page = show(
            arm,
            target=None if arguments.target is None else joint_position(arm, arguments.target, "target"),
            start=joint_position(arm, arguments.start, "start"),
            seed=arguments.seed,
            host=arguments.host,
            port=arguments.port,
            browser=False,
            policy=arguments.policy,
            planner=arguments.planner,
            controller=arguments.controller,
            payload=arguments.payload,
            mass_scale=arguments.mass_scale,
        )
    for warning in told:
        say(f"warning: {warning.message}")
    with page:
        console.print(f"view: {page.url} (Ctrl-C ends it)")
        sys.stdout.flush()
        if not arguments.no_browser and _has_display():
            page.open()
        page.wait()


def _has_display() -> bool:
    """Whether a browser would have a window; without one `webbrowser` may start a browser in this terminal."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
