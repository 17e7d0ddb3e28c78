"""Trajectories and bags for ROS 2, read again by rosbags, by another reader of MCAP, and as the message in YAML."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from rollouts import make_rollout

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.exports import export

pytest.importorskip("rosbags")


def as_message(store, kind, values):
    """A message from its fields as `ros2 topic pub` would fill them in: all are known, and of its type."""
    from rosbags.interfaces import Nodetype

    fields = {}
    for name, (category, content) in store.fielddefs[kind][1]:
        value = values.pop(name)
        if category == Nodetype.NAME:
            value = as_message(store, content, value)
        elif category == Nodetype.SEQUENCE and content[0][0] == Nodetype.NAME:
            value = [as_message(store, content[0][1], one) for one in value]
        elif category == Nodetype.SEQUENCE and content[0][1][0] == "float64":
            value = np.array(value, dtype=np.float64)
        fields[name] = value
    assert not values
    return store.types[kind](**fields)


def test_the_bag_and_the_yaml_hold_the_planned_and_the_measured_motion(rollout, tmp_path):
    from mcap.reader import make_reader
    from rosbags.highlevel import AnyReader

    export({"reach": rollout}, tmp_path, format="ros2", rate=20.0)
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.[my]*")) == [
        *("reach.yaml", "reach_bag/metadata.yaml", "reach_bag/reach_bag.mcap")
    ]
    with AnyReader([tmp_path / "reach_bag"]) as reader:
        found = {connection.topic: [] for connection in reader.connections}
        for connection, time, data in reader.messages():
            found[connection.topic].append((time, reader.deserialize(data, connection.msgtype)))
        store = reader.typestore
    ((start, planned),) = found["/joint_trajectory"]
    states = found["/joint_states"]
    assert start == 0
    assert planned.joint_names == [*rollout.arm.joint_names] == states[0][1].name
    # Every 0.05 s, until the motion ends.
    rows = slice(0, 41, 5)
    points = planned.points
    np.testing.assert_array_equal([point.positions for point in points], rollout.q_ref[rows])
    np.testing.assert_array_equal([point.velocities for point in points], rollout.qd_ref[rows])
    times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in points]
    np.testing.assert_allclose(times, rollout.t[rows], atol=1e-12)
    np.testing.assert_array_equal([state.position for _, state in states], rollout.q[::5])
    np.testing.assert_array_equal([state.velocity for _, state in states], rollout.qd[::5])
    np.testing.assert_array_equal([state.effort for _, state in states], rollout.force[::5])
    assert [time for time, _ in states] == [50_000_000 * k for k in range(11)]
    assert [state.header.stamp.nanosec for _, state in states] == [50_000_000 * k for k in range(11)]
    with (tmp_path / "reach_bag" / "reach_bag.mcap").open("rb") as stream:
        kinds = [(schema.name, channel.topic) for schema, channel, _ in make_reader(stream).iter_messages()]
    assert kinds.count(("sensor_msgs/msg/JointState", "/joint_states")) == 11
    assert kinds.count(("trajectory_msgs/msg/JointTrajectory", "/joint_trajectory")) == 1
    text = yaml.safe_load((tmp_path / "reach.yaml").read_text())
    kind = "trajectory_msgs/msg/JointTrajectory"
    assert bytes(store.serialize_cdr(as_message(store, kind, text), kind)) == bytes(store.serialize_cdr(planned, kind))


def test_the_last_point_is_the_end_of_the_motion_at_any_rate(rollout, tmp_path):
    export(rollout, tmp_path, format="ros2", rate=100.0 / 7.0)
    points = yaml.safe_load((tmp_path / "motion.yaml").read_text())["points"]
    assert [point["time_from_start"]["nanosec"] for point in points[-2:]] == [350_000_000, 400_000_000]


def test_ball_joints_are_refused(tmp_path):
    with pytest.raises(InputError, match="ball joints"):
        export(make_rollout(Arm.load("telescopic_compound")), tmp_path, format="ros2")
