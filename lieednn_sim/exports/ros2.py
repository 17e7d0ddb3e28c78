"""Rollouts for ROS 2: the planned trajectory as a message in YAML, and a bag with what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from lieednn_sim.errors import InputError
from lieednn_sim.exports.formats import samples
from lieednn_sim.simulation import Rollout

# The messages below are the same in every distribution since.
_STORE = get_typestore(Stores.ROS2_HUMBLE)
_TRAJECTORY, _STATE = "trajectory_msgs/msg/JointTrajectory", "sensor_msgs/msg/JointState"


def write(rollouts: Mapping[str, Rollout], folder: Path, rate: float | None = None) -> None:
    """Write ``<name>.yaml`` and the bag ``<name>_bag`` for each rollout; see `formats.export`.

    The YAML is a trajectory_msgs/JointTrajectory of the planned positions and velocities, from the start until the
    motion comes to rest. The bag holds the same message at time 0 on the topic ``/joint_trajectory``, and the measured
    positions, velocities and actuator forces as sensor_msgs/JointState on ``/joint_states``. Times begin at 0.

    Raises:
        InputError: the arm has ball joints, which these messages cannot hold.
    """
    for name, rollout in rollouts.items():
        if len(rollout.arm.space.balls):
            raise InputError(
                f"arm {rollout.arm.name!r} has ball joints, but a JointTrajectory holds hinges and slides alone"
            )
        trajectory, rows = _trajectory(rollout, rate), samples(rollout, rate)
        with (folder / f"{name}.yaml").open("w", encoding="utf-8") as stream:
            yaml.dump(trajectory, stream, getattr(yaml, "CSafeDumper", yaml.SafeDumper), sort_keys=False)
        with Writer(folder / f"{name}_bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            planned = bag.add_connection("/joint_trajectory", _TRAJECTORY, typestore=_STORE)
            measured = bag.add_connection("/joint_states", _STATE, typestore=_STORE)
            bag.write(planned, 0, _STORE.serialize_cdr(_as_message(trajectory), _TRAJECTORY))
            columns = (values[rows] for values in (rollout.t, rollout.q, rollout.qd, rollout.force))
            for t, position, velocity, effort in zip(*columns, strict=True):
                values = {"position": position, "velocity": velocity, "effort": effort}
                state = _STORE.types[_STATE](header=_header(_time(t)), name=trajectory["joint_names"], **values)
                bag.write(measured, _nanoseconds(t), _STORE.serialize_cdr(state, _STATE))


def _trajectory(rollout: Rollout, rate: float | None) -> dict[str, Any]:
    """The message as YAML has it; its last point is the end of the motion at any rate."""
    end = min(int(np.searchsorted(rollout.t, rollout.motion_end - 0.5 * rollout.timestep)), len(rollout.t) - 1)
    points = [
        {
            "positions": rollout.q_ref[row].tolist(),
            "velocities": rollout.qd_ref[row].tolist(),
            "accelerations": [],
            "effort": [],
            "time_from_start": _time(rollout.t[row]),
        }
        for row in np.union1d(np.arange(end + 1)[samples(rollout, rate)], [end])
    ]
    header = {"stamp": _time(0.0), "frame_id": ""}
    return {"header": header, "joint_names": list(rollout.arm.joint_names), "points": points}


def _as_message(trajectory: Mapping[str, Any]) -> Any:
    duration, point = (
        _STORE.types[kind] for kind in ("builtin_interfaces/msg/Duration", "trajectory_msgs/msg/JointTrajectoryPoint")
    )
    points = [
        point(
            time_from_start=duration(**one["time_from_start"]),
            **{name: np.array(values, dtype=float) for name, values in one.items() if name != "time_from_start"},
        )
        for one in trajectory["points"]
    ]
    header = _header(trajectory["header"]["stamp"])
    return _STORE.types[_TRAJECTORY](header=header, joint_names=trajectory["joint_names"], points=points)


def _header(stamp: Mapping[str, int]) -> Any:
    time = _STORE.types["builtin_interfaces/msg/Time"](**stamp)
    return _STORE.types["std_msgs/msg/Header"](stamp=time, frame_id="")


def _time(t: float) -> dict[str, int]:
    seconds, nanoseconds = divmod(_nanoseconds(t), 10**9)
    return {"sec": seconds, "nanosec": nanoseconds}


def _nanoseconds(t: float) -> int:
    return round(1e9 * float(t))
