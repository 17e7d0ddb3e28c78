"""Logs of simulations of a compiled model that somebody else made."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np

from lieednn_sim import io
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.frames import find_frame
from lieednn_sim.lie import transforms
from lieednn_sim.values import Floats, frozen

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform


@frozen
class ModelRun:
    """What happened in a model while its arm followed a plan, from `run_in`; row k belongs to time ``t[k]``.

    Attributes:
        model: a copy of the given model, in which mocap bodies are where the given state had them.
        t: ``(K,)`` times from 0, at the model's steps [s].
        qpos: ``(K, nq)`` positions of everything, in the model's order.
        qvel: ``(K, nv)`` velocities.
        ctrl: ``(K, nu)`` controls.
        planned: ``(K, nq)`` positions of the plan.
        joint_names: names of the arm's n coordinates.
        tracking_error: ``(K, n)`` how far the coordinates are from the planned ones [rad, m].
        motion_end: when the plan ended [s]; after it the arm was to rest.
        tip: name of the body or site that is the end effector.
        steps: when each step of a sequence began [s], and its name; none for a single plan.
    """

    model: mujoco.MjModel = field(compare=False)
    t: Floats
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    planned: Floats
    joint_names: tuple[str, ...]
    tracking_error: Floats
    motion_end: float
    tip: str
    steps: tuple[tuple[float, str], ...] = ()

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        arm: Arm,
        t: Floats,
        log: Mapping[str, Floats],
        planned: Floats,
        motion_end: float,
        steps: tuple[tuple[float, str], ...] = (),
    ) -> ModelRun:
        """The run of a log of positions, velocities and controls; mocap bodies of the model are put where they were."""
        for body in np.flatnonzero(model.body_mocapid >= 0):
            mocap = model.body_mocapid[body]
            model.body_pos[body], model.body_quat[body] = data.mocap_pos[mocap], data.mocap_quat[mocap]
        error = arm.coordinates(log["qpos"]) - arm.coordinates(planned)
        return cls(
            model,
            t,
            **log,
            planned=planned,
            joint_names=arm.joint_names,
            tracking_error=error,
            motion_end=motion_end,
            tip=arm.frames.names[-1],
            steps=steps,
        )

    def __repr__(self) -> str:
        return (
            f"<ModelRun: {len(self.t)} samples in {self.t[-1]:g} s, {len(self.joint_names)} joints, "
            f"tracking error up to {np.abs(self.tracking_error).max():.2g} rad or m>"
        )

    @property
    def timestep(self) -> float:
        """Simulation step [s]."""
        return float(self.t[1] - self.t[0])

    @property
    def hold(self) -> float:
        """Time simulated after the plan [s]."""
        return float(self.t[-1] - self.motion_end)

    def step_at(self, time: float) -> str:
        """Name of the step of a sequence that was being done at a time [s]; empty for a single plan."""
        return next((name for begin, name in reversed(self.steps) if begin <= time + 1e-9), "")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the arrays and the steps to an ``.npz`` file, atomically."""
        names = ("t", "qpos", "qvel", "ctrl", "planned", "tracking_error")
        meta = {"joint_names": list(self.joint_names), "motion_end": self.motion_end, "tip": self.tip}
        meta["steps"] = [list(step) for step in self.steps]
        io.save_arrays(path, "model run", {name: getattr(self, name) for name in names}, meta)

    def poses(self, name: str, *, planned: bool = False) -> RigidTransform:
        """Poses of shape ``(K,)`` of a body or site in the world, as simulated or as planned.

        Raises:
            InputError: there is no such body or site.
        """
        frame, data = find_frame(self.model, name), mujoco.MjData(self.model)
        positions, turns = np.empty((len(self.t), 3)), np.empty((len(self.t), 3, 3))
        turn, own = np.empty(9), np.empty(9)
        mujoco.mju_quat2Mat(own, frame.quat)
        for k, data.qpos[:] in enumerate(self.planned if planned else self.qpos):
            mujoco.mj_kinematics(self.model, data)
            turn = data.xmat[frame.body].reshape(3, 3)
            positions[k], turns[k] = data.xpos[frame.body] + turn @ frame.pos, turn @ own.reshape(3, 3)
        return transforms(turns, positions)
