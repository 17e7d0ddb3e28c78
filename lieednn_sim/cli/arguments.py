"""What the text of an argument means."""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm, reach
from lieednn_sim.errors import InputError

Floats = NDArray[np.float64]


def start_and_target(arm: Arm, arguments: argparse.Namespace) -> tuple[Floats, Floats]:
    """Joint positions of --start, and of --target or --position."""
    start = arm.check_position(joint_position(arm, arguments.start, "start"), "start")
    if arguments.position is not None:
        return start, reach(arm, numbers(arguments.position, "position", 3), start=start)
    return start, joint_position(arm, arguments.target, "target")


def joint_position(arm: Arm, text: str, what: str) -> Floats:
    """A keyframe's name or comma-separated numbers."""
    if text and (text[0].isalpha() or text[0] == "_"):
        return arm.keyframe(text)
    return numbers(text, what, arm.n_joints)


def numbers(text: str, what: str, count: int) -> Floats:
    """So many comma-separated numbers."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{what} must be {count} comma-separated numbers, got {text!r}") from None
    if len(values) != count:
        raise InputError(f"{what} must be {count} comma-separated numbers, got {len(values)}: {text!r}")
    return np.array(values)


def size(text: str) -> tuple[int, int]:
    """Width and height in pixels."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and len(text) < 12):
        raise InputError(f"size must look like 1280x720, got {text!r}")
    return int(width), int(height)
