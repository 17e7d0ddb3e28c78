"""The commands ``arms``, which lists the arms or describes one, and ``view``, which shows an arm in the browser."""

from __future__ import annotations

import os
import sys
from collections import Counter
from typing import Annotated, Any

import numpy as np
from scipy.optimize import minimize

from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.importer.report import ImportOptions
from lieednn_sim.cli.arguments import joint_position
from lieednn_sim.cli.console import console, print_import_report
from lieednn_sim.cli.kinds import Joints
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.display import table
from lieednn_sim.live.page import view as show
from lieednn_sim.live.settings import Settings
from lieednn_sim.values import Floats, rounded


def arms(arm: str | None = None, *, imported: Annotated[ImportOptions, "*"]) -> None:
    """List the arms of the package, or describe one of them or an arm from a file.

    Without a name, the arms of the package are listed.

    Args:
        arm: name of an arm, or an MJCF, URDF or YAML file.
        imported: how a model file is imported.
    """
    if arm is None:
        if imported:
            options = ", ".join(f"--{name}" for name in imported)
            raise InputError(f"{options}: for model files only, as in lieednn-sim arms FILE.xml --links A,B,...")
        _print_summaries([Arm.load(name) for name in arm_names()])
        return
    loaded = Arm.load(arm, **imported)
    _print_summaries([loaded])
    console.print(_coordinates(loaded))
    print_import_report(loaded, whole=True)


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
        print_import_report(shown)
        sys.stdout.flush()
        # Without a display `webbrowser` may start a text browser in this terminal.
        windows = sys.platform in ("darwin", "win32") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
        if browser and windows:
            page.open()
        page.wait()


def farthest(arm: Arm) -> float:
    """Largest distance of the end effector from the base frame found by a search within the limits [m].

    Contacts are ignored.
    """

    def negative(q: Floats) -> float:
        return -float(np.linalg.norm(arm.tip(arm.within_angles(q)) - arm.base.translation))

    low, high = arm.position_limits.T
    starts = [*map(arm.keyframe, arm.keyframes), *np.random.default_rng(0).uniform(low, high, (4, arm.n_joints))]
    return max(-float(minimize(negative, q, bounds=arm.position_limits, method="L-BFGS-B").fun) for q in starts)


def _print_summaries(loaded: list[Arm]) -> None:
    rows = table("arms", "arm", "links", "joints", "reach m", "keyframes")
    for arm in loaded:
        kinds = Counter(factor.kind for joint in arm.joints.joints for factor in joint.factors)
        counts = ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in sorted(kinds.items()))
        rows.add_row(arm.name, str(arm.n_links), counts, f"{farthest(arm):.2f}", ", ".join(arm.keyframes))
    rows.caption = "reach: of the end effector from the base"
    console.print(rows)


def _coordinates(arm: Arm) -> object:
    rows = table("joint coordinates", "coordinate", "unit", "from", "to", "velocity", "acceleration", "jerk", "force")
    for j, name in enumerate(arm.joint_names):
        limits = (arm.velocity_limits, arm.acceleration_limits, arm.jerk_limits, arm.force_limits)
        texts = ("-" if np.isinf(limit[j]) else rounded(limit[j]) for limit in limits)
        rows.add_row(name, arm.unit(j), *(f"{bound:.4g}" for bound in arm.position_limits[j]), *texts)
    rows.caption = "limits; -: none" + ("; of a ball joint the angle is limited" if len(arm.space.balls) else "")
    rows.caption += f"; unit of length in networks: {arm.length_scale:g} m"
    return rows
