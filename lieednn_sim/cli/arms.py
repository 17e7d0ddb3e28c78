"""The command ``arms``: the arms of the package in a table, or one arm in full."""

from __future__ import annotations

from collections import Counter
from typing import Annotated

import numpy as np
from scipy.optimize import minimize

from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.importer.report import ImportOptions
from lieednn_sim.cli.console import console
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.display import table
from lieednn_sim.values import Floats


def arms(arm: str | None = None, *, imported: Annotated[ImportOptions, "*"]) -> None:
    """List the arms of the package, or describe one of them or that of a file.

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
    print_import_report(loaded)


def print_import_report(arm: Arm) -> None:
    """Print the report of an imported arm; nothing for another arm."""
    if arm.import_report is None:
        return
    rows = table(f"{arm.name}: imported from {arm.source.name}", "what", "how")
    rows.columns[1].justify = "left"
    rows.columns[1].overflow = "fold"
    for line in str(arm.import_report).splitlines():
        what, _, how = line.partition(": ")
        rows.add_row(what, how)
    console.print(rows)


def farthest(arm: Arm) -> float:
    """Largest distance of the end effector from the base frame found by a search within the limits [m].

    Contacts are ignored.
    """
    low, high = arm.position_limits.T
    origin = np.asarray(arm.base.translation)

    def negative(q: Floats) -> float:
        return -float(np.linalg.norm(arm.tip(arm.within_angles(q)) - origin))

    rng = np.random.default_rng(0)
    starts = [*map(arm.keyframe, arm.keyframes), *rng.uniform(low, high, (4, arm.n_joints))]
    return max(-float(minimize(negative, q, bounds=arm.position_limits, method="L-BFGS-B").fun) for q in starts)


def _print_summaries(loaded: list[Arm]) -> None:
    rows = table("arms", "arm", "links", "n", "joints", "reach m", "unit m", "keyframes")
    for arm in loaded:
        kinds = Counter(factor.kind for joint in arm.joints.joints for factor in joint.factors)
        rows.add_row(
            arm.name,
            str(arm.n_links),
            str(arm.n_joints),
            ", ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in sorted(kinds.items())),
            f"{farthest(arm):.2f}",
            f"{arm.length_scale:g}",
            ", ".join(arm.keyframes),
        )
    rows.caption = "n: joint coordinates; reach: farthest end effector found from the base; unit: network's length unit"
    console.print(rows)


def _coordinates(arm: Arm) -> object:
    rows = table("joint coordinates", "coordinate", "unit", "from", "to", "velocity", "acceleration", "jerk", "force")
    for j, name in enumerate(arm.joint_names):
        limits = (arm.velocity_limits, arm.acceleration_limits, arm.jerk_limits, arm.force_limits)
        texts = ("-" if np.isinf(limit[j]) else f"{limit[j]:g}" for limit in limits)
        rows.add_row(name, arm.unit(j), *(f"{bound:.4g}" for bound in arm.position_limits[j]), *texts)
    rows.caption = "limits; -: none" + ("; of a ball joint the angle is limited" if len(arm.space.balls) else "")
    return rows
