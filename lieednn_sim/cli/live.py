"""The command ``view``: an arm in the browser."""

from __future__ import annotations

import os
import sys
from typing import Annotated, Any

from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer.report import ImportOptions
from lieednn_sim.cli.arguments import joint_position
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console
from lieednn_sim.cli.kinds import Joints
from lieednn_sim.live.page import view as show
from lieednn_sim.live.settings import Settings


def view(
    arm: str = "telescopic_pr",
    *,
    scene: str = "free",
    scene_seed: int = 0,
    target: Joints | None = None,
    start: Joints = "home",
    served: Annotated[dict[str, Any], show, "seed", "port", "host"],
    browser: bool = True,
    settings: Annotated[dict[str, Any], Settings, "policy", "planner", "controller", "payload", "mass_scale"],
    imported: Annotated[ImportOptions, "*"],
) -> None:
    """Show an arm in the browser: drag its target, push it, change its policy and its load.

    It needs the extra 'view' and runs until Ctrl-C. Only this machine can connect, unless --host is given.

    Args:
        arm: a name of `ARMS`, or an MJCF, URDF or YAML file.
        scene: obstacles: a name of `SCENES`, or an MJCF or YAML file.
        scene_seed: seed of the obstacles' positions.
        target: first target, given as for 'plan', with the same default.
        start: joints at the start, given as for --target.
        served: the page.
        browser: open a browser at the page's address, which is printed.
        settings: settings that the page can change.
        imported: how a model file is imported.
    """
    shown = Arm.load(arm, scene, scene_seed, **imported)
    print_import_report(shown)
    page = show(
        shown,
        target=None if target is None else joint_position(shown, target, "target"),
        start=joint_position(shown, start, "start"),
        browser=False,
        **served,
        **settings,
    )
    with page:
        console.print(f"view: {page.url} (Ctrl-C ends it)")
        sys.stdout.flush()
        # Without a window `webbrowser` may start a browser in this terminal.
        windows = sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
        if browser and windows:
            page.open()
        page.wait()
