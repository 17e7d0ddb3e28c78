"""Chunks from LeRobot's transitions and ROS 2's messages, against the policy itself."""

import re
import sys
from abc import ABC
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

import lieednn_sim as ls
from lieednn_sim.errors import InputError
from lieednn_sim.policies import ChunkPolicy, ChunkStep, from_joint_trajectory, to_joint_trajectory

ARM = ls.Arm.load("telescopic_pr")
HOME, TO = ARM.keyframe("home"), ARM.keyframe("extended")
DEGREES = np.where([ARM.unit(joint) == "rad" for joint in range(8)], 180.0 / np.pi, 1.0)
CHUNK = HOME + np.linspace(0.0, 0.3, 40)[:, None] ** 2 * (TO - HOME)


class Tensor(np.ndarray):
    """As much of a tensor as the step takes."""

    def new_tensor(self, values):
        return np.asarray(values, dtype=np.float32).view(Tensor)


def expected(*accepted, periods):
    """References of the policy itself."""
    policy = ChunkPolicy(ARM, 50.0)
    policy.reset(HOME)
    rows = []
    for k in range(periods):
        for at, chunk, t0 in accepted:
            if k == at:
                assert policy.accept(chunk, t0, 0.02).accepted
        rows.append(policy.step(rows[-1] if rows else HOME, HOME)[0])
    return np.array(rows)


def test_a_step_of_a_pipeline_is_the_policy_in_degrees_with_a_gripper():
    gripper = np.linspace(0.0, 1.0, 40)[:, None]
    step = ChunkStep(ChunkPolicy(ARM, 50.0), 0.02, delay=0.04, degrees=True)
    state, rows = np.append(HOME * DEGREES, 0.0), []
    for k in range(30):
        chunk = np.hstack([CHUNK * DEGREES, gripper])[None].view(Tensor) if k == 5 else None
        given = {"observation": {"observation.state": state}, "action": chunk, "info": {"mine": 1}}
        result = step(given)
        assert result["info"] == ({"mine": 1, "chunk": "accepted"} if k == 5 else {"mine": 1})
        assert isinstance(result["action"], Tensor) == (k >= 5)
        state = np.asarray(result["action"], dtype=float)
        # What further columns of a state mean, the step cannot know.
        assert state.shape == ((9,) if k >= 5 else (8,))
        state = state if k >= 5 else np.append(state, 0.0)
        rows.append(state)
    rows = np.array(rows)
    np.testing.assert_allclose(rows[:, :8] / DEGREES, expected((5, CHUNK, 0.1 - 0.04), periods=30), atol=1e-6)
    # The gripper's column, at the end of the period: the chunk began 0.06 s after the start.
    np.testing.assert_allclose(rows[5:, 8], gripper[np.arange(3, 28), 0], atol=1e-6)


def test_a_transition_has_its_own_delay_and_a_refused_chunk_says_why():
    step = ChunkStep(ChunkPolicy(ARM, 50.0), 0.02)
    for _ in range(20):
        step({"observation": {"observation.state": HOME}})
    result = step({"action": CHUNK, "complementary_data": {"delay": 0.2}, "observation": None})
    assert (result["info"], step.policy.verdict.dropped) == ({"chunk": "accepted"}, 10)
    assert step({"action": CHUNK * np.nan})["info"]["chunk"].startswith("refused; nan: chunk")
    assert step.policy.counts["nan"] == 1
    # Of two robots.
    assert step({"action": np.stack([CHUNK, CHUNK])})["info"]["chunk"].startswith("refused; shape: chunk")
    step.reset()
    # Before a chunk it is a tensor if the state, here in a batch, is one.
    first = step({"observation": {"observation.state": TO[None].view(Tensor)}})["action"]
    assert isinstance(first, Tensor)
    np.testing.assert_allclose(first, TO, atol=1e-6)
    # The last two states, as some policies see them: the first row would be the older one.
    with pytest.raises(InputError, match=r"observation.state must have shape \(8,\), got \(2, 8\)"):
        step({"observation": {"observation.state": np.stack([HOME, TO])}})
    # Clocks that differ a little, and none at all, end no loop.
    assert step({"action": CHUNK, "complementary_data": {"delay": -1e-9}})["info"]["chunk"].startswith("accepted")
    assert step({"action": CHUNK, "complementary_data": {"delay": np.nan}})["info"]["chunk"].startswith(
        "refused; times"
    )


def test_a_gripper_keeps_step_with_a_chunk_that_takes_longer():
    step, share = ChunkStep(ChunkPolicy(ARM, 50.0), 0.01), np.linspace(0.0, 1.0, 40)[:, None] ** 2
    chunk, q, closed = np.hstack([HOME + share * (TO - HOME), share]), HOME, []
    for k in range(250):
        result = step({"observation": {"observation.state": q}, "action": None if k else chunk})
        q, column = np.split(result["action"], [8])
        closed.append((column[0], np.linalg.norm(q - HOME) / np.linalg.norm(TO - HOME)))
    assert step.policy.verdict.slower > 2.0
    gripper, arm = np.transpose(closed)
    assert np.abs(gripper - arm).max() < 0.06  # a row
    assert gripper[-1] == 1.0


@pytest.mark.parametrize(
    ("chunk", "said"),
    [
        # One column is not broadcast to all joints.
        (CHUNK[:, :1], r"shape: chunk must have shape \(H, 8\), got \(40, 1\)"),
        (CHUNK[:, :7], r"shape: chunk must have shape \(H, 8\), got \(40, 7\)"),
        (np.hstack([CHUNK, np.full((40, 1), np.nan)]), "nan: chunk must be finite"),
        ({"turn.pos": 0.1}, "action must be an array of numbers, got dict"),
        ("home", "action must be an array of numbers, got str"),
    ],
)
def test_chunks_of_too_few_columns_or_no_numbers(chunk, said):
    step = ChunkStep(ChunkPolicy(ARM, 50.0), 0.02)
    given = {"observation": {"observation.state": HOME}, "action": chunk}
    if isinstance(chunk, np.ndarray):
        result = step(given)
        assert re.match(f"refused; {said}", result["info"]["chunk"])
        np.testing.assert_allclose(result["action"], HOME, atol=1e-9)
    else:
        with pytest.raises(InputError, match=said):
            step(given)


def test_a_tensor_that_keeps_its_gradient_is_told_how_to_be_an_array():
    class Attached:
        shape = CHUNK.shape

        def __len__(self):
            return len(CHUNK)

        def __array__(self, *_, **__):
            raise RuntimeError("Use tensor.detach().numpy() instead.")

    step = ChunkStep(ChunkPolicy(ARM, 50.0), 0.02)
    step({"observation": {"observation.state": HOME}})
    assert not step.policy.accept(Attached(), 0.0, 0.02).accepted
    with pytest.raises(InputError, match=r"action must be an array of numbers, got Attached: Use tensor.detach"):
        step({"action": Attached()})


def test_pipelines_of_an_abstract_base_class_take_the_step(monkeypatch):
    class ProcessorStep(ABC):  # noqa: B024 (as theirs, but for its methods)
        """LeRobot's pipelines take its instances alone."""

    monkeypatch.setitem(sys.modules, "lerobot.processor", SimpleNamespace(ProcessorStep=ProcessorStep))
    assert isinstance(ChunkStep(ChunkPolicy(ARM, 50.0), 0.02), ProcessorStep)


def message_of(names, t, q, qd=None):
    store = get_typestore(Stores.ROS2_HUMBLE).types
    duration, none = store["builtin_interfaces/msg/Duration"], np.empty(0)
    points = [
        store["trajectory_msgs/msg/JointTrajectoryPoint"](
            q[k], none if qd is None else qd[k], none, none, duration(*divmod(round(1e9 * t[k]), 10**9))
        )
        for k in range(len(t))
    ]
    header = store["std_msgs/msg/Header"](store["builtin_interfaces/msg/Time"](0, 0), "")
    return store["trajectory_msgs/msg/JointTrajectory"](header, names, points)


def test_a_trajectory_message_is_a_chunk_in_the_arms_order():
    names, order = ["other", *ARM.joint_names[::-1]], np.arange(8)[::-1]
    t = 0.5 + 0.02 * np.arange(40)
    rows = np.hstack([np.ones((40, 1)), CHUNK[:, order]])
    targets, t0, dt = from_joint_trajectory(ARM, message_of(names, t, rows), 2.0)
    np.testing.assert_allclose(targets, CHUNK, atol=1e-12)
    assert (t0, dt) == pytest.approx((2.5, 0.02))
    # Uneven times, from positions and velocities of a cubic.
    t = np.array([0.0, 0.1, 0.25, 0.6])
    q, qd = np.outer(t**3 - t, np.ones(8)), np.outer(3.0 * t**2 - 1.0, np.ones(8))
    targets, t0, dt = from_joint_trajectory(ARM, message_of(list(ARM.joint_names), t, q, qd))
    even = 0.1 * np.arange(7)
    np.testing.assert_allclose(targets, np.outer(even**3 - even, np.ones(8)), atol=1e-12)
    assert (t0, dt) == pytest.approx((0.0, 0.1))
    # Straight without velocities.
    targets, _, _ = from_joint_trajectory(ARM, message_of(list(ARM.joint_names), t, q))
    np.testing.assert_allclose(targets[4], q[2] + (0.15 / 0.35) * (q[3] - q[2]), atol=1e-12)


def test_a_reference_is_a_message_of_the_library_of_another():
    like = message_of(list(ARM.joint_names), [0.0, 1.0], CHUNK[:2])
    message = to_joint_trajectory(ARM, like, HOME, 0.1 * TO, 0.02)
    store, kind = get_typestore(Stores.ROS2_HUMBLE), "trajectory_msgs/msg/JointTrajectory"
    again = store.deserialize_cdr(store.serialize_cdr(message, kind), kind)
    (point,) = again.points
    np.testing.assert_array_equal([point.positions, point.velocities], [HOME, 0.1 * TO])
    assert (point.time_from_start.sec, point.time_from_start.nanosec) == (0, 20_000_000)
    assert (len(like.points), again.joint_names) == (2, list(ARM.joint_names))
    for given in ((HOME[:7], TO, 0.02), (HOME, TO * np.nan, 0.02), (HOME, TO, -1.0)):
        with pytest.raises(InputError, match="must"):
            to_joint_trajectory(ARM, like, *given)


@dataclass
class Lists:
    """A point whose fields are arrays of the standard library, as rclpy's."""

    positions: list = field(default_factory=list)
    time_from_start: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(sec=0, nanosec=0))


def test_other_libraries_get_arrays_of_the_standard_library():
    like = SimpleNamespace(joint_names=[], points=[Lists()])
    (point,) = to_joint_trajectory(ARM, like, HOME, TO, 0.02).points
    assert (point.positions.typecode, list(point.velocities)) == ("d", list(TO))


@pytest.mark.parametrize(
    ("names", "t", "columns", "said"),
    [
        (ARM.joint_names[1:], [0.0, 1.0], 7, "lacks, or names twice, turn; it has lift, pitch"),
        ((*ARM.joint_names, "lift"), [0.0, 1.0], 9, "lacks, or names twice, lift; it has turn, lift"),
        (ARM.joint_names, [0.0, 0.0], 8, "must increase from point to point"),
        (ARM.joint_names, [], 8, "must increase from point to point, and it needs one"),
        (ARM.joint_names, [0.0, 1.0], 7, "positions of the points"),
    ],
)
def test_messages_that_are_no_trajectory_of_the_arm(names, t, columns, said):
    with pytest.raises(InputError, match=said):
        from_joint_trajectory(ARM, message_of(list(names), t, np.zeros((2, columns))))


def test_what_is_no_message():
    with pytest.raises(InputError, match="must be a trajectory_msgs/JointTrajectory: 'int' object"):
        from_joint_trajectory(ARM, 5)
    with pytest.raises(InputError, match="JointTrajectory with a point"):
        to_joint_trajectory(ARM, message_of(list(ARM.joint_names), [], CHUNK), HOME, TO, 0.02)
