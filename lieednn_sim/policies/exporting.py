"""The numbers of a network policy in C: its arm, limits and settings, for the sources in the folder ``c``.

The arm's links are products of exponentials. A hinge is a ball joint with one axis, and the ratio of a coupled joint
scales its axes. Lengths are in the network's unit.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sized
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.arm.serial_arm import ROUNDING
from lieednn_sim.errors import InputError
from lieednn_sim.network.exporting import c_header, write_sources
from lieednn_sim.policies.feedback import FEEDBACK, Feedback
from lieednn_sim.values import StrPath


def write_policy(
    arm: Arm, settings: Mapping[str, tuple[object, str]], feedback: Feedback | None, folder: StrPath
) -> Path:
    """Write ``policy.h``, ``policy.c`` and ``policy_numbers.h``, for a network beside them; see `NetworkPolicy.to_c`.

    Settings are numbers by name, each with what it is in words.
    """
    if arm.stops is not None:
        raise InputError(
            f"the joints of arm {arm.name!r} move others, or tendons, that have ranges of their own, which the C code "
            "cannot hold a target against: choose joints that move none, or run the policy in Python"
        )
    joints = arm.joints.joints
    pull = feedback or FEEDBACK
    numbers = {
        "JOINTS": (arm.n_joints, "joint coordinates: " + ", ".join(arm.joint_names)),
        "LINKS": (arm.n_links, "links"),
        **settings,
        "FEEDBACK": (int(feedback is not None), "whether measured joints are used"),
        "PULL": (pull.rate, "rate at which measured joints pull the network's state [1/s]"),
        "TOLERANCE": (pull.tolerance, "error up to which they do not, as a fraction of joints' ranges"),
        "PATIENCE": (pull.patience, "error at which the network runs at half its speed, likewise"),
        "ROUNDING": (ROUNDING, "how far a target may be beyond a limit, at which it is taken to be"),
        "START_TOLERANCE": (arm.start_tolerance, "how far a start may be beyond a limit, at which it is taken to be"),
    }
    low, high = arm.position_limits.T
    balls, begin = np.zeros(arm.n_joints, dtype=int), np.arange(arm.n_joints)
    balls[arm.space.balls[:, 0]] = 1
    for joint in joints:
        begin[joint.indices] = np.minimum(begin[joint.indices], joint.indices[0])
    factors = [factor for joint in joints for factor in joint.factors]
    axes, anchors = np.zeros((len(factors), 3, 3)), np.zeros((len(factors), 3))
    coordinates = np.zeros((len(factors), 3), dtype=int)
    for i, factor in enumerate(factors):
        columns, unit = len(factor.indices), arm.length_scale if factor.kind == "slide" else 1.0
        axes[i, :columns], coordinates[i, :columns] = factor.ratio / unit * factor.axes.T, factor.indices
        anchors[i] = factor.anchor / arm.length_scale
    screwed, screws = np.full(len(joints), -1), np.zeros((len(joints), 6))
    for i, joint in enumerate(joints):
        if joint.screw is not None:
            screwed[i], screws[i] = joint.indices[0], joint.screw / arm.twist_units
    arrays = {
        "low": (low, "position limits [rad, m]"),
        "high": (high, "of a ball joint, the largest angle"),
        "range": (arm.ranges, "their widths"),
        "max_speed": (arm.velocity_limits, "[rad/s, m/s]"),
        "jump_speed": (arm.jump_speeds, "faster targets jump, and so do measured joints"),
        "max_acceleration": (arm.acceleration_limits, "[rad/s^2, m/s^2]"),
        "reference": (arm.joints.reference, "where every link's pose is the identity [rad, m]"),
        "ball": (balls, "whether a ball joint begins here"),
        "begin": (begin, "first coordinate of those that share a link with this one"),
        "moved_by": (_ends(joint.indices for joint in joints), "where the coordinates of each link begin, and the end"),
        "mover": (np.concatenate([joint.indices for joint in joints]), "which these are"),
        "screwed": (screwed, "coordinate of links that move along one screw, else -1"),
        "screw": (screws, "and the screw"),
        "factor_of": (_ends(joint.factors for joint in joints), "where the factors of each link begin, and the end"),
        "turns": (np.array([int(factor.kind != "slide") for factor in factors]), "whether a factor turns"),
        "columns": (np.array([len(factor.indices) for factor in factors]), "the number of its coordinates"),
        "coordinate": (coordinates, "which these are"),
        "axes": (axes, "its axes"),
        "anchor": (anchors, "a point that it does not move"),
    }
    header = c_header("policy_numbers", f"The policy's numbers, of the arm {arm.name!r}.", "POLICY", numbers, arrays)
    return write_sources(folder, Path(__file__).parent / "c", {"policy_numbers.h": header})


def _ends(parts: Iterable[Sized]) -> NDArray[np.int_]:
    """Where each of several parts begins in their concatenation, and its end."""
    return np.cumsum([0, *map(len, parts)])
