"""What MuJoCo leaves out of a URDF: limits that lock a joint or are wrong, planar joints, limits of velocities."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import scipy

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError

Joints = Mapping[str, ElementTree.Element]


def read_joints(source: Path, notes: list[str]) -> Joints:
    """The joints of a URDF by name; none of another file, or, with a note, of one that cannot be read."""
    if source.suffix.lower() != ".urdf":
        return {}
    try:
        robot = ElementTree.parse(source).getroot()
    except ElementTree.ParseError as error:
        notes.append(f"limits of velocities, and joints without limits, could not be read of the URDF: {error}")
        return {}
    return {joint.get("name", ""): joint for joint in robot.iterfind("joint")} if robot.tag == "robot" else {}


def mend_joints(spec: mujoco.MjSpec, joints: Joints, notes: list[str]) -> None:
    """Lock joints whose limits are equal, where MuJoCo would take them for unlimited; say which have none.

    `InputError` if a lower limit is above the upper one, or no joint is left.
    """
    locked: list[str] = []
    for name, element in joints.items():
        joint, kind, limit = spec.joint(name), element.get("type"), element.find("limit")
        if joint is None or kind not in ("revolute", "prismatic"):
            continue
        low, high = joint.range
        if low > high:
            raise InputError(f"joint {name!r} of the URDF has the lower limit {low:g} above the upper one, {high:g}")
        if limit is None or not {"lower", "upper"}.intersection(limit.keys()):
            notes.append(f"{name}: {kind}, but without limits in the URDF")
        elif low == high:
            _lock(spec, joint, low, locked)
    if locked:
        notes.append(f"locked by equal limits in the URDF: {', '.join(locked)}")
        if not spec.joints:
            raise InputError(f"equal limits in the URDF lock all of its joints: {', '.join(locked)}; correct them")


def _lock(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, value: float, locked: list[str]) -> None:
    """Fix the body of a hinge or slide where a joint position has it, and those of the joints that follow it."""
    locked.append(f"{joint.name} at {value:g}")
    for equality in [item for item in spec.equalities if joint.name in (item.name1, item.name2)]:
        follower, coefficients = equality.name1, np.array(equality.data[:5])
        spec.delete(equality)
        if follower != joint.name:
            _lock(spec, spec.joint(follower), float(np.polynomial.polynomial.polyval(value, coefficients)), locked)
    body, turn = joint.parent, scipy.spatial.transform.Rotation
    before, axis = turn.from_quat(body.quat, scalar_first=True), np.array(joint.axis) / np.linalg.norm(joint.axis)
    if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        body.quat = (before * turn.from_rotvec(value * axis)).as_quat(scalar_first=True)
    else:
        body.pos = body.pos + before.apply(value * axis)
    spec.delete(joint)


def planar_joints(joints: Joints) -> dict[str, str]:
    """The URDF's planar joints, which have no ranges, by the names of those that MuJoCo makes of them."""
    planar = [name for name, element in joints.items() if element.get("type") == "planar"]
    return {f"{name}_{motion}": name for name in planar for motion in ("TX", "TY", "RZ")}


def velocities(joints: Joints) -> dict[str, float]:
    """The velocity limit of each joint [rad/s, m/s] that has one, zero being none; `ValueError` if it is no number."""
    limits = {name: element.find("limit") for name, element in joints.items()}
    result = {name: float(limit.get("velocity", "0")) for name, limit in limits.items() if limit is not None}
    return {name: velocity for name, velocity in result.items() if velocity > 0.0}
