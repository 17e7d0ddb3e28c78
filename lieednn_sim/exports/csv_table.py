"""Rollouts as CSV: one row for each instant, with names and units in the header."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lieednn_sim.exports.formats import samples
from lieednn_sim.simulation import Rollout


def write(rollouts: Mapping[str, Rollout], folder: Path, rate: float | None = None) -> None:
    """Write ``<name>.csv`` for each rollout; see `formats.export`.

    The columns are the time, for each joint coordinate its planned and measured position and velocity, and the
    measured pose of the end effector in the world, its rotation as a unit quaternion without jumps of sign. Numbers are
    exact.
    """
    for name, rollout in rollouts.items():
        arm, rows = rollout.arm, samples(rollout, rate)
        header, columns = ["time [s]"], [rollout.t]
        for j, joint in enumerate(arm.joint_names):
            for what, values, unit in (
                ("planned position", rollout.q_ref, arm.unit(j)),
                ("measured position", rollout.q, arm.unit(j)),
                ("planned velocity", rollout.qd_ref, f"{arm.unit(j)}/s"),
                ("measured velocity", rollout.qd, f"{arm.unit(j)}/s"),
            ):
                header.append(f"{joint} {what} [{unit}]")
                columns.append(values[:, j])
        header += [f"end effector {axis} [m]" for axis in "xyz"] + [f"end effector q{part} [1]" for part in "wxyz"]
        pose = np.hstack([rollout.link_position[:, -1], rollout.link_quaternion[:, -1]])
        with (folder / f"{name}.csv").open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(header)
            # Python writes the shortest decimals that are read as the same numbers.
            writer.writerows(np.column_stack([*columns, pose])[rows].tolist())
