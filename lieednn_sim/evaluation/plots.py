"""Plots of a run, and of a training; PNG, or by the file's suffix."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter
from numpy.typing import ArrayLike

from lieednn_sim import io
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.evaluation import figure_layout as layout
from lieednn_sim.evaluation.evaluation import SETTLED_ROTATION, SETTLED_TRANSLATION
from lieednn_sim.evaluation.joint_plots import plot_joints
from lieednn_sim.evaluation.metrics import pose_errors
from lieednn_sim.learning import History
from lieednn_sim.planning.clearance import FAR, Cubics, bounds_of
from lieednn_sim.simulation import Rollout
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.values import Floats, StrPath

__all__ = ["plot"]

_LABELS_IN_ROW = 5  # of channels


def plot(rollout: Rollout, directory: StrPath) -> tuple[Path, ...]:
    """Plot a run in PNG files: tracking error, joints, and network, clearance, modes and channels if it has them.

    Files have these names: ``tracking.png``, ``joints.png``, ``network.png``, and so on.

    Args:
        rollout: the simulated run.
        directory: where the files are written or replaced; it is created if needed.

    Returns:
        The paths of the files.

    Raises:
        FileError: the directory cannot be written.
    """
    folder = io.make_directory(directory)
    files = {folder / f"{name}.png": draw for name, draw in plots_of(rollout).items()}
    for file, draw in files.items():
        draw(rollout, file)
    return tuple(files)


def plots_of(rollout: Rollout) -> dict[str, Callable[[Rollout, Path], None]]:
    """The plots that a run has, by name."""
    drawn: dict[str, Callable[[Rollout, Path], None]] = {"tracking": plot_tracking, "joints": plot_joints}
    if rollout.motion is not None:
        drawn["network"] = plot_network
    if rollout.clearance is not None:
        drawn["clearance"] = plot_clearance
    with suppress(NoSolutionError):
        if PassiveJoints(rollout.arm).modes(rollout.q_ref[0]):
            drawn["modes"] = plot_modes
    if rollout.channels:
        drawn["channels"] = plot_channels
    return drawn


def plot_modes(rollout: Rollout, path: StrPath) -> None:
    """Plot the natural frequencies of what nothing drives along the reference, with the driven joints held there."""
    passive, some = PassiveJoints(rollout.arm), np.linspace(0, len(rollout.t) - 1, 41).astype(int)
    modes = [passive.modes(q) for q in rollout.q_ref[some]]
    title = "natural frequencies, and largest damping, of what nothing drives"
    with layout.over_time(rollout, path, "[Hz]", title) as axis:
        # Only as many modes as there are at all instants; modes that are overdamped somewhere come last.
        for k, of_one in enumerate(zip(*modes, strict=False)):
            label = f"{k + 1} {of_one[0].joint} ({max(mode.damping for mode in of_one):.1%})"
            axis.semilogy(rollout.t[some], [mode.frequency for mode in of_one], lw=max(4.0 - 2.0 * k, 1.0), label=label)
        axis.set_ylim(*np.multiply(axis.get_ylim(), (0.8, 1.25)))  # so that small changes look small
        for each in (axis.yaxis.set_major_formatter, axis.yaxis.set_minor_formatter):
            each("{x:g}")


def plot_clearance(rollout: Rollout, path: StrPath) -> None:
    """Plot the distance from contact, as MuJoCo measures it at samples, and what is proved of it in intervals.

    Distances are shown up to 0.1 m. Bounds are widened by the errors of the joints, as in `Rollout.clearance`.
    """
    assert rollout.tracked is not None
    assert rollout.clearance is not None
    some, bounds = np.arange(0, len(rollout.t), 5), bounds_of(rollout.arm.unsupported, own=True)
    collisions, least = Collisions(rollout.arm.unsupported), np.zeros(len(some) - 1)
    distance = [1e3 * min(collisions.nearest_at(qpos[None])[0], FAR) for qpos in rollout.qpos[some]]
    if not isinstance(bounds, str):
        t, *tracked = rollout.tracked
        least = bounds.least(*Cubics(t[1] - t[0], *tracked).around(some[:-1], some[1:]), FAR)[0] - rollout.slack
    for begin, end in rollout.clearance.unproved:
        least[(rollout.t[some[1:]] > begin) & (rollout.t[some[:-1]] < end)] = 0.0
    low, high = min(1.05 * min(distance), 0.0), 1e3 * FAR
    with layout.over_time(rollout, path, "[mm]", f"distance from contact, up to {high:g} mm") as axis:
        proved = {"fill": True, "color": layout.COLOURS[2], "alpha": 0.4, "label": "proved"}
        axis.stairs(1e3 * np.maximum(least, 0.0), rollout.t[some], **proved)
        for stretch in rollout.clearance.unproved:
            axis.axvspan(*stretch, color=layout.COLOURS[1], alpha=0.4, lw=0.0, label="not proved")
        axis.plot(rollout.t[some], distance, color=layout.COLOURS[0], label="measured at samples")
        axis.set_ylim(low, 1.02 * high)  # the line is not cut at the edge


def plot_network(rollout: Rollout, path: StrPath) -> None:
    """Plot the states xi(t) of the neuron of each link, rotations and translations apart, with their targets dashed.

    Below are the clock, the network's own time, and the joint effect of all other neurons, of which there may be
    hundreds: how far they bend each link's state off the straight way to its target, which it would take without them;
    a turn counts by the arm's length scale.
    """
    arm, motion = rollout.arm, rollout.motion
    assert motion is not None
    n = arm.n_links
    # Rows that do not fit a page go into further columns.
    blocks = -(-n // layout.MOST_ROWS)
    rows = -(-n // blocks)
    columns = (("rotation $\\omega$", "[rad]", 0, 1.0), ("translation $v$", "[m]", 3, arm.length_scale))
    with layout.drawn(path, 10.0 * blocks, 1.2 + 1.7 * (rows + 1)) as figure:
        axes = layout.subplots(figure, motion.t, rows + 1, 2 * blocks)
        for i in range(rows * blocks):
            pair = axes[i % rows, 2 * (i // rows) : 2 * (i // rows) + 2]
            for axis, (title, unit, first, scale) in zip(pair, columns, strict=True):
                if i >= n:
                    axis.set_visible(False)
                    continue
                looks = zip(layout.COLOURS, "xyz", (2.8, 1.8, 1.0), strict=False)
                for c, (colour, name, width) in enumerate(looks, first):
                    label = f"$\\omega_{name}$ / $v_{name}$"
                    # Lines drawn first are wider, so that equal ones are all visible.
                    axis.plot(motion.t, scale * motion.xi[:, i, c], color=colour, lw=width, label=label)
                    axis.axhline(scale * motion.xi_target[i, c], color=colour, ls="--", lw=0.9)
                layout.set_label(axis, unit, f"{arm.link_names[i]} (neuron {i + 1}): {title}", fontsize=9)
                shown = scale * np.vstack([motion.xi, motion.xi_target[None]])[..., first : first + 3]
                # Smaller variations are rounding.
                margin = max(0.05 * float(np.ptp(shown)), 1e-3)
                axis.set_ylim(shown.min() - margin, shown.max() + margin)
        clock, bend, *others = axes[-1]
        clock.plot(motion.t, motion.tau, color="0.3")
        layout.set_label(clock, "[1]", "clock: the network's own time $\\tau$", fontsize=9)
        for name, way in zip(arm.link_names, arm.length_scale * bends(motion.xi, motion.xi_target).T, strict=True):
            bend.plot(motion.t, 1e3 * way, lw=1.2, label=name)
        layout.set_label(bend, "[mm]", "all other neurons together: bent off the straight way", fontsize=9)
        bend.legend(fontsize=8)
        for axis in (clock, bend):
            axis.set_xlabel("time [s]")
        for axis in others:
            axis.set_visible(False)
        target = {"target": Line2D([], [], color="0.3", ls="--", lw=0.9)}
        layout.fitted_legend(figure, layout.entries_of(axes[0, 0]) | target)


def bends(xi: Floats, target: Floats) -> Floats:
    """Distance ``(K, N)`` of states ``(K, N, d)`` from the straight ways between the first and a target ``(N, d)``."""
    left, way = xi - target, xi[0] - target
    length = np.sum(way**2, axis=-1)
    along = np.sum(left * way, axis=-1) / np.where(length > 0.0, length, 1.0)
    return np.asarray(np.linalg.norm(left - along[..., None] * way, axis=-1))


def plot_tracking(rollout: Rollout, path: StrPath) -> None:
    """Plot the tracking error of every link frame, and the end effector's distance to its target.

    The distance has a logarithmic scale, without distances below a hundredth of the settled error, which are rounding.
    A line marks the end of the motion, grey bands are pushes.
    """
    arm, simulated = rollout.arm, rollout.link_poses()
    tracking = pose_errors(simulated, arm.link_poses(rollout.q_ref))
    to_go = [error[:, -1] for error in pose_errors(simulated, arm.link_poses(rollout.target))]
    columns = (
        ("translation", "[mm]", 1e3 * tracking[0], 1e3 * to_go[0], 1e3 * SETTLED_TRANSLATION),
        ("rotation", "[deg]", np.rad2deg(tracking[1]), np.rad2deg(to_go[1]), np.rad2deg(SETTLED_ROTATION)),
    )
    with layout.drawn(path, 10.0, 6.0) as figure:
        axes = layout.subplots(figure, rollout.t, 2, 2)
        for (upper, lower), (what, unit, errors, distance, settled) in zip(axes.T, columns, strict=True):
            for name, error in zip(arm.link_names, errors.T, strict=True):
                upper.plot(rollout.t, error, label=name)
            # At least a tenth of the settled error, so that small errors look small; a line at 0 is not hidden.
            upper.set_ylim(np.array([-0.02, 1.0]) * max(1.08 * float(errors.max()), 0.1 * settled))
            layout.set_label(upper, unit, f"tracking error, {what}: planned to simulated frame")
            own = upper.lines[-1]  # the end effector's
            lower.semilogy(rollout.t, np.maximum(distance, 1e-3 * settled), c=own.get_color(), ls=own.get_linestyle())
            lower.axhline(settled, color="0.4", ls="--", lw=0.9)
            place = {"xytext": (4, 3), "xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
            lower.annotate(f"settled: below {settled:g} {unit[1:-1]}", (0.0, settled), color="0.3", fontsize=8, **place)
            lower.set_ylim(1e-2 * settled, 2.0 * max(float(distance.max()), settled))
            layout.set_label(lower, unit, f"end effector to target, {what}")
            lower.set_xlabel("time [s]")
        for axis in axes.ravel():
            layout.mark_events(axis, rollout)
        layout.fitted_legend(figure, layout.entries_of(axes[0, 0]) | layout.events(rollout))


def plot_channels(rollout: Rollout, path: StrPath) -> None:
    """Plot the channels, one at least: a subplot for each unit, a line for each component."""
    lines: dict[str, dict[str, Floats]] = {}
    for name, values in rollout.channels.items():
        of_unit = lines.setdefault(rollout.channel_units[name], {})
        for index in np.ndindex(values.shape[1:]):
            of_unit[name + (f"[{', '.join(map(str, index))}]" if index else "")] = values[:, *index]
    legend = 0.25 + 0.18 * -(-max(map(len, lines.values())) // _LABELS_IN_ROW)
    with layout.drawn(path, 10.0, 0.8 + (1.8 + legend) * len(lines)) as figure:
        axes = layout.subplots(figure, rollout.t, len(lines), 1)[:, 0]
        for axis, (unit, of_unit) in zip(axes, lines.items(), strict=True):
            for label, values in of_unit.items():
                axis.plot(rollout.t, values, label=label)
            layout.set_label(axis, f"[{unit}]")
            axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=_LABELS_IN_ROW, fontsize=8)
            layout.mark_events(axis, rollout)
        axes[-1].set_xlabel("time [s]")


def plot_training(history: History, target: ArrayLike, tolerance: float, path: StrPath) -> None:
    """Error, accuracy and learning rate by epoch, and the equilibrium's distance to the target by coordinate."""
    goal = np.asarray(target)
    error = np.abs(history.equilibrium - goal)
    with layout.drawn(path, 10, 6.4) as figure:
        distance, accuracy, rate, equilibrium = figure.subplots(2, 2, sharex=True).ravel()
        distance.semilogy(history.epoch, history.error, lw=1.2, label="$\\Vert\\xi^*-\\xi_d\\Vert_2$ (loss E)")
        distance.semilogy(history.epoch, error.max(axis=(-2, -1)), lw=1.2, label="largest coordinate")
        distance.axhline(tolerance, color="0.4", ls="--", lw=0.9, label="tolerance")
        layout.set_label(distance, "[rad, length units]", "distance of the equilibrium to the target")
        distance.legend()
        accuracy.plot(history.epoch, 100.0 * history.accuracy)
        accuracy.set_ylim(-2.0, 102.0)
        layout.set_label(accuracy, "[%]", "accuracy: coordinates within the tolerance")
        rate.semilogy(history.epoch, history.rate)
        # Otherwise a range of less than a decade has no tick, or too many.
        low, high = float(history.rate.min()), float(history.rate.max())
        rate.set_ylim(10.0 ** np.floor(np.log10(low) - 1e-9), 10.0 ** np.ceil(np.log10(high) + 1e-9))
        rate.yaxis.set_minor_formatter(NullFormatter())
        layout.set_label(rate, "$\\eta$", "learning rate")
        # Rotation and translation of SE(3) by colour; other groups have one kind of coordinate.
        kinds: list[tuple[str, Any]] = [("coordinates", slice(None))]
        if goal.shape[-1] == 6:
            kinds = [("rotation $\\omega$", slice(0, 3)), ("translation $v$", slice(3, 6))]
        for colour, (name, chosen) in zip(layout.COLOURS, kinds, strict=False):
            values = history.equilibrium[..., chosen].reshape(len(history), -1)
            equilibrium.plot(history.epoch, values, color=colour, ls="-", lw=0.9)[0].set_label(name)
            for value in goal[..., chosen].ravel():
                equilibrium.axhline(value, color=colour, ls="--", lw=0.6)
        equilibrium.plot([], [], color="0.3", ls="--", lw=0.9, label="target")
        layout.set_label(equilibrium, "[rad, length units]", "equilibrium $\\xi^*$ by coordinate")
        equilibrium.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.16))
        for axis in (rate, equilibrium):
            axis.set_xlabel("epoch")


typecheck_public(globals())
