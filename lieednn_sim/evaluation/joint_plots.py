"""Plots of the joints of a run: positions, errors, velocities and forces."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from lieednn_sim.evaluation import figure_layout as layout
from lieednn_sim.simulation import Rollout
from lieednn_sim.values import Floats, StrPath

# Least half range of axes for errors [mm, deg] and percentages of a limit [%], so that small values look small.
_LEAST_ERROR, _LEAST_PERCENT = 0.01, 10.0
# The length beyond which names are written smaller.
_LONGEST_NAME = 14


def plot_joints(rollout: Rollout, path: StrPath) -> None:
    """Plot reference and simulated position with its limits, error, velocity and actuator force of each joint.

    Velocity and force are in percent of their limits, or absolute without limits. Joints of one unit share the scale of
    each column, so that small values look small. More than `MOST_ROWS` coordinates are split into blocks.
    """
    arm = rollout.arm
    blocks = -(-arm.n_joints // layout.MOST_ROWS)
    rows = -(-arm.n_joints // blocks)
    with layout.drawn(path, 14.0 * blocks, 1.3 + 1.25 * rows) as figure:
        axes = layout.subplots(figure, rollout.t, rows, 4 * blocks)
        for block in range(blocks):
            joints = range(block * rows, min((block + 1) * rows, arm.n_joints))
            _plot_joints(axes[:, 4 * block : 4 * block + 4], rollout, joints)
        entries: dict[str, Any] = {
            "simulated": Line2D([], [], color=layout.COLOURS[0]),
            "reference": Line2D([], [], color=layout.COLOURS[4], ls="--"),
            "limits": Line2D([], [], color=layout.COLOURS[1], lw=0.8),
        }
        layout.fitted_legend(figure, entries | layout.events(rollout))


def _plot_joints(axes: Any, rollout: Rollout, joints: range) -> None:
    """Fill rows of axes ``(rows, 4)``; those left over are hidden."""
    arm = rollout.arm
    angular = np.array([arm.unit(j) == "rad" for j in range(arm.n_joints)])
    error = np.where(angular, np.rad2deg(1.0), 1e3) * (rollout.q - rollout.q_ref)
    for row, j in zip(axes, joints, strict=False):
        row[0].plot(rollout.t, rollout.q[:, j], color=layout.COLOURS[0])
        row[0].plot(rollout.t, rollout.q_ref[:, j], color=layout.COLOURS[4], ls="--")
        low, high = arm.position_limits[j]
        for bound in (low, high):
            row[0].axhline(bound, color=layout.COLOURS[1], lw=0.8)
        margin = 0.06 * (high - low)
        row[0].set_ylim(low - margin, high + margin)
        name = arm.joint_names[j]
        layout.set_label(row[0], f"{name}\n[{arm.unit(j)}]", fontsize=min(9.0, 9.0 * _LONGEST_NAME / len(name)))
        alike = angular == angular[j]
        row[1].plot(rollout.t, error[:, j], color=layout.COLOURS[3])
        layout.set_label(row[1], "[deg]" if angular[j] else "[mm]")
        _from_zero(row[1], error[:, alike], _LEAST_ERROR)
        for axis, values, limits, unit in (
            (row[2], rollout.qd, arm.velocity_limits, f"{arm.unit(j)}/s"),
            (row[3], rollout.force, arm.force_limits, "N m" if angular[j] else "N"),
        ):
            limited = np.isfinite(limits)
            drawn_alike, least = (limited, _LEAST_PERCENT) if limited[j] else (alike & ~limited, 0.0)
            scaled = np.where(limited, 100.0 / limits, 1.0) * values
            axis.plot(rollout.t, scaled[:, j], color=layout.COLOURS[0])
            _from_zero(axis, scaled[:, drawn_alike], least)
            layout.set_label(axis, "[%]" if limited[j] else f"[{unit}]")
        for axis in row:
            layout.mark_events(axis, rollout)
    titles = ["position", "error: simulated less reference"]
    for what, limits in (("velocity", arm.velocity_limits), ("actuator force", arm.force_limits)):
        titles.append(f"{what}, % of its limit" if np.isfinite(limits[joints]).any() else what)
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title, loc="left")
    for axis in axes[len(joints) :].ravel():
        axis.set_visible(False)
    for axis in axes[len(joints) - 1]:
        axis.set_xlabel("time [s]")
        axis.tick_params(labelbottom=True)


def _from_zero(axis: Any, values: Floats, least: float) -> None:
    """Set the range to all values, zero, and at least ``least`` to both sides."""
    low, high = min(-least, float(values.min())), max(least, float(values.max()))
    margin = 0.06 * (high - low) or 1.0
    axis.set_ylim(low - margin, high + margin)
