"""Rollouts for ROS 2: the planned trajectory as a message in YAML, and a bag with the measured states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from lieednn_sim.errors import InputError
from lieednn_sim.exports.formats import samples
from lieednn_sim.simulation import Rollout

# The messages below have not changed since this distribution.
_STORE = get_typestore(Stores.ROS2_HUMBLE)
_TRAJECTORY, _STATE = "trajectory_msgs/msg/JointTrajectory", "sensor_msgs/msg/JointState"


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]  # one of two classes
    """Writes arrays as lists."""


_Dumper.add_representer(np.ndarray, lambda dumper, array: dumper.represent_list(array.tolist()))


def write(rollouts: Mapping[str, Rollout], folder: Path, rate: float | None = None) -> None:
    """Write ``<name>.yaml`` and the bag ``<name>_bag`` for each rollout; see `formats.export`.

    The YAML is a trajectory_msgs/JointTrajectory of the planned positions and velocities, from the start until the
    motion comes to rest. The bag holds the same message at time 0 on the topic ``/joint_trajectory``, and the measured
    positions, velocities and actuator forces as sensor_msgs/JointState on ``/joint_states``. Times begin at 0.
    `InputError` for an arm with ball joints, which these messages cannot hold.
    """
    for name, rollout in rollouts.items():
        if len(rollout.arm.space.balls):
            arm = rollout.arm.name
            raise InputError(f"arm {arm!r} has ball joints; a JointTrajectory holds only hinges and slides")
        trajectory, rows, joints = _trajectory(rollout, rate), samples(rollout, rate), list(rollout.arm.joint_names)
        with (folder / f"{name}.yaml").open("w", encoding="utf-8") as stream:
            message = asdict(trajectory, dict_factory=lambda items: {k: v for k, v in items if k != "__msgtype__"})
            yaml.dump(message, stream, _Dumper, sort_keys=False)
        with Writer(folder / f"{name}_bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            planned = bag.add_connection("/joint_trajectory", _TRAJECTORY, typestore=_STORE)
            measured = bag.add_connection("/joint_states", _STATE, typestore=_STORE)
            bag.write(planned, 0, _STORE.serialize_cdr(trajectory, _TRAJECTORY))
            columns = (values[rows] for values in (rollout.t, rollout.q, rollout.qd, rollout.force))
            for t, position, velocity, effort in zip(*columns, strict=True):
                state = _STORE.types[_STATE](_header(t), joints, position, velocity, effort)
                bag.write(measured, _nanoseconds(t), _STORE.serialize_cdr(state, _STATE))


def _trajectory(rollout: Rollout, rate: float | None) -> Any:
    """The message; its last point is the end of the motion at any rate."""
    end = min(int(np.searchsorted(rollout.t, rollout.motion_end - 0.5 * rollout.timestep)), len(rollout.t) - 1)
    point, none = _STORE.types["trajectory_msgs/msg/JointTrajectoryPoint"], np.empty(0)
    points = [
        point(rollout.q_ref[row], rollout.qd_ref[row], none, none, _time("Duration", rollout.t[row]))
        for row in np.union1d(np.arange(end + 1)[samples(rollout, rate)], [end])
    ]
    return _STORE.types[_TRAJECTORY](_header(0.0), list(rollout.arm.joint_names), points)


def _header(t: float) -> Any:
    return _STORE.types["std_msgs/msg/Header"](_time("Time", t), frame_id="")


def _time(kind: str, t: float) -> Any:
    return _STORE.types[f"builtin_interfaces/msg/{kind}"](*divmod(_nanoseconds(t), 10**9))


def _nanoseconds(t: float) -> int:
    return round(1e9 * float(t))
