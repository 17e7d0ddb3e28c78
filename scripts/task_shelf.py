"""The task of `tasks.py` for a robot of MuJoCo Menagerie: a mobile manipulator that puts a can into a shelf."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from task_cases import ASSETS, LeftOutError, Outcome, Task

import lieednn_sim as ls
from lieednn_sim._mujoco import kinematics_at, mujoco

_RADIUS, _HALF, _FALL = 0.03, 0.05, 0.012  # of the can, and how far it is above the board [m]
_BOARD = 0.8 + _HALF + _FALL - 0.1145  # of the lift, above which the gripper is by the rest [m]
_JOINTS = [f"stretch_joint_{name}" for name in ("lift", *(f"arm_l{k}" for k in (3, 2, 1, 0)), "wrist_yaw")]
_ABOVE = 0.02  # of the place, where a can comes in [m]
_CLOSED, _OPEN = 0.009, 0.03  # of the gripper's slide [m]


class Shelf(Task):
    """A mobile manipulator that puts a can into a shelf."""

    title = "Stretch 3 puts a can into a shelf"
    published = (
        "Published: the robot's default and largest speeds (sources: `assets/tasks/shelf/README.md`). Pass mark: the "
        "robot goes there and back in at most the time that it takes at the default speeds, one joint after the other; "
        "the can stands upright within 10 mm of its place; the planned motions keep 2 mm from everything."
    )
    columns: ClassVar[dict[str, str]] = {
        "time_s": "there and back [s]",
        "of_default": "of the default speeds'",
        "can_mm": "can [mm]",
        "tilt_deg": "tilt [deg]",
    }
    most: ClassVar[dict[str, float]] = {"of_default": 1.0, "can_mm": 10.0, "tilt_deg": 5.0}
    joints: ClassVar[list[str]] = _JOINTS
    # The telescope's four stages share its extension.
    limits: ClassVar[dict[str, dict[str, float]]] = {
        joint: {"velocity": velocity, "acceleration": acceleration}
        for joint, velocity, acceleration in zip(
            (_JOINTS[0], _JOINTS[1], _JOINTS[-1]), (0.15, 0.1, 3.0), (0.3, 0.1, 3.0), strict=True
        )
    }
    defaults: ClassVar[tuple[tuple[float, float], ...]] = ((0.11, 0.2), (0.14, 0.14), (2.0, 3.0))
    begin: ClassVar[list[float]] = [0.35, 0.1, 0.0]
    places: ClassVar[list[list[float]]] = [  # lift [m], whole extension of the arm [m], yaw of the wrist [rad]
        [_BOARD, 0.48, 0.0],
        [_BOARD, 0.46, 0.25],
        [_BOARD, 0.50, -0.25],
        [_BOARD, 0.44, 0.4],
        [_BOARD, 0.50, -0.4],
    ]

    def __init__(self, menagerie: Sequence[Path] = ()) -> None:
        folders = [folder / "hello_robot_stretch_3" for folder in menagerie]
        if not folders and importlib.util.find_spec("mujoco_menagerie"):
            folders = [Path(importlib.import_module("mujoco_menagerie").get("hello_robot_stretch_3").path())]
        files = [folder / "stretch.xml" for folder in folders if (folder / "stretch.xml").is_file()]
        if not files:
            raise LeftOutError("it needs MuJoCo Menagerie: --menagerie FOLDER, or pip install mujoco-menagerie")
        self.file = files[0]
        self.grip = self._upright()

    def start(self, case: int) -> Outcome:
        done = self._compiled(held=True)
        self._place(done, self.begin)
        return done

    def play(self, done: Outcome, case: int, planner: str) -> None:
        lift, extension, yaw = self.places[case]
        options: dict[str, Any] = {"planner": planner, "seed": case, "duration": 6.0, "fastest": True}
        # The servos are soft, so the way there and back is 15 mm from everything; close to the can it cannot be.
        done.move(self._arm(done, 0.006), [lift + _ABOVE, extension / 4, yaw], 0.5, **options)
        done.move(self._arm(done), [lift, extension / 4, yaw], 0.5, **options)
        run = done.runs[-1]
        self.wanted = kinematics_at(run.arm.model, run.arm.qpos(run.q_ref[-1])).body("can").xpos.copy()
        self._open(done)
        done.move(self._arm(done), [lift, self.begin[1] / 4, yaw], 0.5, **options)
        done.move(self._arm(done, 0.006), [self.begin[0], self.begin[1] / 4, self.begin[2]], 0.5, **options)

    def _arm(self, done: Outcome, clearance: float = 0.002) -> ls.Arm:
        """The view of the arm in the present state."""
        tip = "stretch_link_grasp_center"
        return ls.Arm.of(done.model, done.data, self.joints, tip=tip, limits=self.limits, clearance=clearance)

    def judge(self, done: Outcome, case: int) -> dict[str, float]:
        taken = sum(run.motion_end for run in done.runs)
        moves = np.abs(np.subtract(self.places[case], self.begin))
        default = 2.0 * sum(_trapezoid_time(move, *limit) for move, limit in zip(moves, self.defaults, strict=True))
        can = done.runs[-1].poses("can")[-1]
        off = (can.translation - self.wanted) * (1.0, 1.0, 0.0)
        return {
            "time_s": taken,
            "of_default": float(taken / default),
            "can_mm": 1e3 * float(np.linalg.norm(off)),
            "tilt_deg": float(np.rad2deg(np.arccos(np.clip(can.rotation.as_matrix()[2, 2], -1.0, 1.0)))),
        }

    def _compiled(self, *, held: bool) -> Outcome:
        """Robot, shelf and can: fixed to the gripper, or free."""
        spec, robot = mujoco.MjSpec.from_file(str(ASSETS / "shelf/scene.xml")), mujoco.MjSpec.from_file(str(self.file))
        for one in [*robot.keys, robot.body("base_link").first_joint()]:
            robot.delete(one)
        spec.attach(robot, prefix="stretch_", site=spec.site("robot"))
        hand = spec.body("stretch_link_SG3_gripper_body")
        can = (
            hand.add_body(name="can", pos=[0, 0, 0.23], quat=self.grip) if held else spec.worldbody.add_body(name="can")
        )
        can.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[_RADIUS, _HALF, 0], mass=0.3, rgba=[0.8, 0.15, 0.1, 1])
        if held:
            for body in hand.find_all("body"):
                if body.name != "can":
                    spec.add_exclude(bodyname1="can", bodyname2=body.name)
        else:
            can.add_freejoint()
        model = spec.compile()
        return Outcome(model, mujoco.MjData(model))

    def _upright(self) -> list[float]:
        """Orientation of a can in the hand that stands upright in the world."""
        self.grip = [1.0, 0.0, 0.0, 0.0]
        done = self._compiled(held=True)
        self._place(done, self.begin)
        inverse = np.empty(4)
        mujoco.mju_negQuat(inverse, done.data.body("can").xquat)
        return [float(value) for value in inverse]

    def _place(self, done: Outcome, posture: list[float]) -> None:
        """Put the robot into a posture, with a closed gripper."""
        data, (lift, extension, yaw) = done.data, posture
        data.joint("stretch_joint_lift").qpos, data.joint("stretch_joint_wrist_yaw").qpos = lift, yaw
        for stage in range(4):
            data.joint(f"stretch_joint_arm_l{stage}").qpos = extension / 4
        data.joint("stretch_joint_gripper_slide").qpos = data.actuator("stretch_gripper").ctrl = _CLOSED
        for side in ("left", "right"):
            data.joint(f"stretch_joint_gripper_finger_{side}_open").qpos = 10.0 * _CLOSED
        mujoco.mj_forward(done.model, data)

    def _open(self, done: Outcome) -> None:
        """Let go of the can, which is a free body from now on, and wait until it stands."""
        free, before, pose = self._compiled(held=False), done.data, done.data.body("can")
        for joint in range(done.model.njnt):
            name = done.model.joint(joint).name
            free.data.joint(name).qpos = before.joint(name).qpos
        free.data.qpos[-7:] = [*pose.xpos, *pose.xquat]
        free.data.ctrl[:] = before.ctrl
        free.data.actuator("stretch_gripper").ctrl = _OPEN
        log = [free.data.qpos.copy()]
        for _ in range(round(2.0 / free.model.opt.timestep)):
            mujoco.mj_step(free.model, free.data)
            log.append(free.data.qpos.copy())
        t = np.arange(len(log)) * free.model.opt.timestep
        done.shots.append((free.model, t, np.array(log), ""))
        free.data.qvel[:] = 0.0
        done.model, done.data = free.model, free.data


def _trapezoid_time(distance: float, speed: float, acceleration: float) -> float:
    """Time of a move from rest to rest [s]."""
    if distance > speed**2 / acceleration:
        return distance / speed + speed / acceleration
    return 2.0 * float(np.sqrt(distance / acceleration))
