"""Plots of a run: network states, tracking error, joint motion."""

from __future__ import annotations

import os
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler
from numpy.typing import ArrayLike, NDArray

from lieednn_sim import storage
from lieednn_sim.arm import Arm
from lieednn_sim.evaluate import SETTLED_ROTATION, SETTLED_TRANSLATION, pose_errors
from lieednn_sim.learning import History
from lieednn_sim.motion import Motion
from lieednn_sim.simulate import Rollout

Floats = NDArray[np.float64]

# Okabe and Ito's palette, distinguishable by colour-blind readers.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
# Names in a row of a legend.
_MOST_IN_ROW = 8
# A plot of joints has at most this many rows; longer names are written smaller.
_MOST_ROWS, _LONGEST_NAME = 12, 14
_STYLE: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    # Arms may have more links than there are colours.
    "axes.prop_cycle": cycler(linestyle=["-", "--", ":"]) * cycler(color=_COLOURS),
    "legend.frameon": False,
}


def plot_network(motion: Motion, path: str | os.PathLike[str]) -> None:
    """States xi(t) of each neuron with their targets dashed."""
    n = motion.xi.shape[1]
    names = [f"$\\omega_{a}$" for a in "xyz"] + [f"$v_{a}$" for a in "xyz"]
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(10, 2.2 + 1.9 * ((n + 1) // 2)), layout="constrained")
        axes = figure.subplots((n + 1) // 2, 2, sharex=True, squeeze=False).ravel()
        for i in range(n):
            for c in range(6):
                axes[i].plot(motion.t, motion.xi[:, i, c], color=_COLOURS[c], label=names[c])
                axes[i].axhline(motion.xi_target[i, c], color=_COLOURS[c], ls="--", lw=0.9)
            axes[i].set_title(f"neuron {i + 1}", loc="left")
            axes[i].set_ylabel("$\\xi$ [rad, length units]")
        for i in range(n, len(axes)):
            axes[i].set_visible(False)
        for axis in axes[max(0, n - 2) : n]:
            axis.set_xlabel("time [s]")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=6)
        _save(figure, path)


def plot_tracking(arm: Arm, rollout: Rollout, target: ArrayLike, path: str | os.PathLike[str]) -> None:
    """Tracking error of every link frame, and the end effector's distance to its target on a logarithmic scale.

    A line marks the end of the motion, grey bands are pushes.
    """
    simulated = rollout.link_poses()
    distance, angle = pose_errors(simulated, arm.link_poses(rollout.q_ref))
    to_go = [error[:, -1] for error in pose_errors(simulated, arm.link_poses(target))]
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(10, 6), layout="constrained")
        axes = figure.subplots(2, 2, sharex=True)
        for i, name in enumerate(arm.link_names):
            axes[0, 0].plot(rollout.t, 1e3 * distance[:, i], label=name)
            axes[0, 1].plot(rollout.t, np.rad2deg(angle[:, i]), label=name)
        axes[0, 0].set_title("tracking error (planned to simulated frame)", loc="left")
        axes[0, 0].set_ylabel("translation [mm]")
        axes[0, 1].set_ylabel("rotation [deg]")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=min(arm.n_links, _MOST_IN_ROW))
        axes[1, 0].semilogy(rollout.t, np.maximum(1e3 * to_go[0], 1e-6), color=_COLOURS[3])
        axes[1, 1].semilogy(rollout.t, np.maximum(np.rad2deg(to_go[1]), 1e-7), color=_COLOURS[3])
        axes[1, 0].axhline(1e3 * SETTLED_TRANSLATION, color="0.4", ls="--", lw=0.9, label="settled")
        axes[1, 1].axhline(np.rad2deg(SETTLED_ROTATION), color="0.4", ls="--", lw=0.9, label="settled")
        axes[1, 0].set_title("end effector to target", loc="left")
        axes[1, 0].set_ylabel("distance [mm]")
        axes[1, 1].set_ylabel("angle [deg]")
        axes[1, 0].legend()
        for axis in axes[1]:
            axis.set_xlabel("time [s]")
        for axis in axes.ravel():
            axis.axvline(rollout.motion_end, color="0.7", lw=0.8)
            for push in rollout.disturbances.pushes:
                axis.axvspan(push.start, min(push.end, rollout.t[-1]), color="0.9", zorder=0)
        _save(figure, path)


def plot_joints(arm: Arm, rollout: Rollout, path: str | os.PathLike[str]) -> None:
    """Position with its limits, velocity and drive force of each joint, the latter two in percent of their limits.

    More than `_MOST_ROWS` coordinates stand in several blocks of columns; where there is no limit, values are plain.
    """
    blocks = -(-arm.n_joints // _MOST_ROWS)
    rows = -(-arm.n_joints // blocks)
    width, height = 11.0 * blocks, 1.0 + 1.25 * rows
    with matplotlib.rc_context(_STYLE):
        # Margins in inches: with so many axes an automatic layout takes seconds.
        figure = Figure(figsize=(width, height))
        for block in range(blocks):
            grid = figure.add_gridspec(
                rows,
                3,
                left=(11.0 * block + 0.9) / width,
                right=(11.0 * block + 10.8) / width,
                bottom=0.5 / height,
                top=1.0 - 0.35 / height,
                wspace=0.24,
                hspace=0.2,
            )
            joints = range(block * rows, min((block + 1) * rows, arm.n_joints))
            _plot_joints(grid.subplots(sharex=True, squeeze=False), arm, rollout, joints)
        _save(figure, path)


def _plot_joints(axes: Any, arm: Arm, rollout: Rollout, joints: range) -> None:
    """Fill rows of axes ``(rows, 3)``; what is left over is hidden."""
    for row, j in zip(axes, joints, strict=False):
        row[0].plot(rollout.t, rollout.q[:, j])
        row[0].plot(rollout.t, rollout.q_ref[:, j], color="0.2", ls="--", lw=0.9)
        low, high = arm.position_limits[j]
        for bound in (low, high):
            row[0].axhline(bound, color=_COLOURS[1], lw=0.8)
        margin = 0.06 * (high - low)
        row[0].set_ylim(low - margin, high + margin)
        name = arm.joint_names[j]
        row[0].set_ylabel(f"{name}\n[{arm.unit(j)}]", fontsize=min(9.0, 9.0 * _LONGEST_NAME / len(name)))
        force_unit = "N m" if arm.unit(j) == "rad" else "N"
        for axis, values, limit, unit in (
            (row[1], rollout.qd[:, j], arm.velocity_limits[j], f"{arm.unit(j)}/s"),
            (row[2], rollout.force[:, j], arm.force_limits[j], force_unit),
        ):
            limited = np.isfinite(limit)
            axis.plot(rollout.t, 100.0 * values / limit if limited else values)
            axis.set_ylabel("" if limited else f"[{unit}]")
    axes[0, 0].set_title("position (reference dashed, limits orange)", loc="left")
    for column, what, limits in ((1, "velocity", arm.velocity_limits), (2, "drive force", arm.force_limits)):
        suffix = " [% of limit]" if np.isfinite(limits[joints]).any() else ""
        axes[0, column].set_title(what + suffix, loc="left")
    for axis in axes[len(joints) :].ravel():
        axis.set_visible(False)
    for axis in axes[len(joints) - 1]:
        axis.set_xlabel("time [s]")
        axis.tick_params(labelbottom=True)
    axes[0, 0].figure.align_ylabels(axes[:, 0])


def plot_training(history: History, target: ArrayLike, tolerance: float, path: str | os.PathLike[str]) -> None:
    """Error, accuracy and learning rate by epoch, and the equilibrium with its target dashed."""
    goal = np.asarray(target)
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(10, 6), layout="constrained")
        axes = figure.subplots(2, 2, sharex=True)
        worst = np.abs(history.equilibrium - goal).max(axis=(-2, -1))
        axes[0, 0].semilogy(history.epoch, history.error, lw=1.0, label="$\\Vert\\xi^*-\\xi_d\\Vert_2$")
        axes[0, 0].semilogy(history.epoch, worst, lw=1.0, label="largest coordinate")
        axes[0, 0].axhline(tolerance, color="0.4", ls="--", lw=0.9, label="tolerance")
        axes[0, 0].set_title("distance of the equilibrium to the target", loc="left")
        axes[0, 0].legend()
        axes[0, 1].plot(history.epoch, history.accuracy)
        axes[0, 1].set_ylim(-0.02, 1.02)
        axes[0, 1].set_title("accuracy (coordinates within the tolerance)", loc="left")
        axes[1, 0].semilogy(history.epoch, history.rate)
        axes[1, 0].set_title("learning rate", loc="left")
        flat, wanted = history.equilibrium.reshape(len(history), -1), goal.ravel()
        for c in range(wanted.size):
            colour = _COLOURS[c % len(_COLOURS)]
            axes[1, 1].plot(history.epoch, flat[:, c], color=colour, lw=0.9)
            axes[1, 1].axhline(wanted[c], color=colour, ls="--", lw=0.6)
        axes[1, 1].set_title("equilibrium (target dashed)", loc="left")
        for axis in axes[1]:
            axis.set_xlabel("epoch")
        _save(figure, path)


def _save(figure: Figure, path: str | os.PathLike[str]) -> None:
    with storage.atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=130)
