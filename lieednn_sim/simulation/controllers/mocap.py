"""Arms led by mocap bodies instead of actuators: one for each link frame, welded to it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import kinematics_along, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.forces import actuator_moments, driving
from lieednn_sim.errors import InputError
from lieednn_sim.lie.se3 import rotations
from lieednn_sim.simulation.controllers.base import Controller, Inputs
from lieednn_sim.simulation.disturbances import Noise
from lieednn_sim.simulation.reference import AHEAD, Foreseen, Reference, runs
from lieednn_sim.values import Floats


class MocapWelds(Controller):
    """Mocap bodies at the reference's link frames, welded to those of the arm; the actuators are idle.

    The reference's poses are those of joint positions, so the joints can meet them. A mocap body has no velocity, and a
    weld with time constant T and damping ratio zeta follows it with a delay of 2 T zeta^2; so the bodies run ahead by
    this time. There is no joint feedback, and hence no sensor noise.

    Logged channels: ``weld_force`` and ``weld_torque`` ``(K, N)``, between each link and its mocap body.
    """

    channel_units: Mapping[str, str] = MappingProxyType({"weld_force": "N", "weld_torque": "N m"})

    def __init__(self, arm: Arm, reference: Reference) -> None:
        self._arm, self._reference = arm, reference
        # The welds' time constant [s] and damping ratio, and the time by which the mocap bodies run ahead [s].
        self._solref, self._lead = (0.01, 1.0), 0.02
        self._scratch = mujoco.MjData(arm.model)
        self._foreseen = Foreseen(reference)
        self._ids: NDArray[np.int_] = np.zeros(0, dtype=int)

    def add_bodies(self, spec: Any) -> None:
        """See `Controller`."""
        frames = self._arm.frames
        for i, (body, pos, turn) in enumerate(zip(frames.bodies, frames.positions, frames.rotations, strict=True)):
            name, quat = mocap_name(i), rotations(turn).as_quat(scalar_first=True)
            spec.worldbody.add_body(name=name, mocap=True).add_site(name=f"{name}_frame")
            spec.body(self._arm.model.body(int(body)).name).add_site(name=f"{name}_link", pos=pos, quat=quat)
            weld = spec.add_equality(
                name=name,
                type=mujoco.mjtEq.mjEQ_WELD,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                name1=f"{name}_frame",
                name2=f"{name}_link",
            )
            weld.solref[:2], weld.solimp[:] = self._solref, (0.9999, 0.9999, 0.001, 0.5, 2.0)

    def equip(self, plant: mujoco.MjModel) -> None:
        """See `Controller`."""
        names = [mocap_name(i) for i in range(self._arm.n_links)]
        self._ids = plant.body_mocapid[[plant.body(name).id for name in names]]
        bodies = np.argsort(plant.body_mocapid)[-plant.nmocap :]
        self._rest = np.hstack([plant.body_pos[bodies], plant.body_quat[bodies]])
        idle = driving(actuator_moments(self._arm.model), self._arm.unit_rates())
        plant.actuator_gainprm[idle], plant.actuator_biasprm[idle] = 0.0, 0.0

    def mocap_poses(self, steps: range) -> Floats:
        """Link frames of the reference a lead ahead of some steps: positions and quaternions ``(m, N, 7)``."""
        qpos = self._reference.ahead(steps, self._lead)
        firsts, run = runs(qpos)
        bodies = kinematics_along(self._arm.model, qpos[firsts], "xpos", "xmat", data=self._scratch)
        position, rotation = self._arm.frames.poses(*bodies)
        return np.concatenate([position, rotations(rotation).as_quat(scalar_first=True)], axis=-1)[run]

    def inputs(self, steps: range, noise: Noise) -> Inputs:
        """See `Controller`."""
        poses = np.tile(self._rest, (len(steps), 1, 1))
        # In parts, to save memory, since poses of all bodies are computed.
        for begin in range(0, len(steps), AHEAD):
            some = slice(begin, begin + AHEAD)
            poses[some, self._ids] = self.mocap_poses(steps[some])
        return {mujoco.mjtState.mjSTATE_MOCAP_POS: poses[..., :3], mujoco.mjtState.mjSTATE_MOCAP_QUAT: poses[..., 3:]}

    def act(self, data: mujoco.MjData, step: int, noise: Noise) -> None:
        """Place the mocap bodies at the reference a lead ahead."""
        poses = self._foreseen.row(step, self.mocap_poses)
        data.mocap_pos[self._ids], data.mocap_quat[self._ids] = poses[:, :3], poses[:, 3:]

    def sample(self, data: mujoco.MjData) -> Floats:
        """Constraint forces ``(6 N,)`` of the welds' rows in MuJoCo's solver."""
        # Equalities come first among the constraints, and the welds, which nothing switches off, are the last of them.
        return data.efc_force[data.ne - 6 * len(self._ids) : data.ne].copy()

    def channel_values(self, samples: Floats) -> tuple[Floats, ...]:
        """See `ChannelSource`."""
        wrench = samples.reshape(-1, len(self._ids), 6)
        force, torque = (np.sqrt(np.vecdot(part, part)) for part in (wrench[:, :, :3], wrench[:, :, 3:]))
        # The angular rows measure the sine of half the angle, so a torque is half their force.
        return force, 0.5 * torque


class DeadbeatWelds(MocapWelds):
    """`MocapWelds` whose welds reach their mocap bodies within one step.

    With solref (2 h, 1/2) a weld's reference acceleration at the distance r is -r/h^2 - v/h, so the step
    v' = v + h a = -r/h ends at the body, which is where the reference will be one step later. Jumps of the bodies are
    followed at once, with proportional forces; hence references held between samples are refused (`InputError`).
    """

    def __init__(self, arm: Arm, reference: Reference) -> None:
        if reference.hold > 1:
            raise InputError(
                "the controller mocap-deadbeat follows every jump of its reference within one step, so it takes none "
                f"that is held for {reference.hold} steps; use mocap, or leave reference_rate out"
            )
        super().__init__(arm, reference)
        self._solref, self._lead = (2.0 * reference.timestep, 0.5), reference.timestep


def mocap_name(link: int) -> str:
    """Name of a link's mocap body, and of the weld between them."""
    return f"mocap{link + 1}"
