"""One arm in MuJoCo, step by step: what rollouts and environments run on."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import SimulationError
from lieednn_sim.simulate.disturbances import Disturbances, Noise, Sensors
from lieednn_sim.simulate.mocap import ghost_name
from lieednn_sim.simulate.plant import make_plant
from lieednn_sim.validation import as_count, as_floats

Floats = NDArray[np.float64]


class Instant(NamedTuple):
    """What is true at one time, the forces being those of the step that begins there.

    Attributes:
        t: [s].
        qpos: ``(nq,)``.
        qvel: ``(nv,)``.
        ctrl: ``(nu,)``.
        drive_force: ``(nv,)`` of actuators, gravity compensation included [N m, N].
        constraint_force: ``(nv,)`` of contacts, joint limits, couplings and welds [N m, N].
        link_position: ``(N, 3)`` link frames, world [m].
        link_quaternion: ``(N, 4)`` the same, (w, x, y, z).
        contacts: number of contacts.
        contact_force: largest normal force among them [N].
        weld_force: ``(N,)`` force of each link's weld to its ghost [N].
        weld_torque: ``(N,)`` its torque [N m].
    """

    t: float
    qpos: Floats
    qvel: Floats
    ctrl: Floats
    drive_force: Floats
    constraint_force: Floats
    link_position: Floats
    link_quaternion: Floats
    contacts: int
    contact_force: float
    weld_force: Floats
    weld_torque: Floats


class Simulation:
    """An arm that is stepped; everything is a function of the arguments, the resets and the controls given since.

    A user sets ``data.ctrl`` (or a `Controller` does) and calls `step` or `advance`.

    Args:
        arm: the arm; its model is not changed.
        plant: what is simulated instead of a copy of the arm's model with the disturbances, of `make_plant`.
        disturbances: pushes and sensor noise, and what `make_plant` takes of them.

    Attributes:
        model: the plant.
        data: its state.
        noise: errors of the measurement at the present time, to be added to qpos (by `mj_integratePos`) and qvel.
    """

    def __init__(
        self, arm: Arm, plant: mujoco.MjModel | None = None, *, disturbances: Disturbances | None = None
    ) -> None:
        self.arm = arm
        self.disturbances = Disturbances() if disturbances is None else disturbances
        self.model = make_plant(arm, self.disturbances) if plant is None else plant
        self.data = mujoco.MjData(self.model)
        self._pushes = [(push, push.body_id(arm, self.model)) for push in self.disturbances.pushes]
        self._sensors = Sensors(arm, self.disturbances)
        # Gravity compensation that is not routed through the actuators still has to come from the drives.
        self._compensated = ~self.model.jnt_actgravcomp[self.model.dof_jntid].astype(bool)
        self._welds = [
            mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_EQUALITY, ghost_name(i)) for i in range(arm.n_links)
        ]
        self._step = 0
        self.noise: Noise
        self.reset(arm.coordinates(arm.model.qpos0))

    @property
    def time(self) -> float:
        """Present time [s]: the steps done times the time step, without the rounding of a sum."""
        return self._step * float(self.model.opt.timestep)

    @property
    def q(self) -> Floats:
        """Joint coordinates ``(n,)`` [rad, m]."""
        return self.arm.coordinates(self.data.qpos)

    @property
    def qd(self) -> Floats:
        """Their rates ``(n,)`` [rad/s, m/s]."""
        return self.arm.rates(self.q, self.data.qvel)

    def measured(self) -> tuple[Floats, Floats]:
        """Joint coordinates and rates ``(n,)`` as the sensors see them."""
        qpos = self.data.qpos.copy()
        mujoco.mj_integratePos(self.model, qpos, self.noise.position, 1.0)
        q = self.arm.coordinates(qpos)
        return q, self.arm.rates(q, self.data.qvel + self.noise.velocity)

    def link_poses(self) -> RigidTransform:
        """Link frames at the present time, poses of shape ``(N,)``."""
        mujoco.mj_kinematics(self.model, self.data)
        rotation = Rotation.from_matrix(self.data.site_xmat[self.arm.site_ids].reshape(-1, 3, 3))
        return RigidTransform.from_components(self.data.site_xpos[self.arm.site_ids], rotation)

    def reset(self, q: ArrayLike, qd: ArrayLike | None = None) -> None:
        """Start again at time 0 from joint coordinates ``(n,)`` and their rates, by default zero.

        Nothing is left of what was before: controls, mocap poses, warm starts, warnings, the noise's generator.
        """
        position = as_floats("q", q, (self.arm.n_joints,))
        velocity = np.zeros_like(position) if qd is None else as_floats("qd", qd, position.shape)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = self.arm.qpos(position), self.arm.qvel(position, velocity)
        self._step = 0
        self._sensors.reset()
        self.noise = self._sensors.draw()

    def step(self) -> Instant:
        """Do one step; returns the instant before it.

        Raises:
            SimulationError: a warning of MuJoCo or a state that is not finite; names the time.
        """
        with _quiet_warnings():
            self._begin()
            model, data, sites = self.model, self.data, self.arm.site_ids
            qpos, qvel, ctrl = data.qpos.copy(), data.qvel.copy(), data.ctrl.copy()
            position, quaternion = data.site_xpos[sites], np.empty((len(sites), 4))
            for i, site in enumerate(sites):
                mujoco.mju_mat2Quat(quaternion[i], data.site_xmat[site])
            mujoco.mj_step2(model, data)
            instant = Instant(
                self.time,
                qpos,
                qvel,
                ctrl,
                data.qfrc_actuator + self._compensated * data.qfrc_gravcomp,
                data.qfrc_constraint.copy(),
                position,
                quaternion,
                int(data.ncon),
                _largest_contact(model, data),
                *self._weld_forces(),
            )
            self._end()
        return instant

    def advance(self, steps: int = 1) -> None:
        """Do steps with the present controls, without a record; raises as `step` does."""
        with _quiet_warnings():
            for _ in range(as_count("steps", steps)):
                self._begin()
                mujoco.mj_step2(self.model, self.data)
                self._end()

    def _begin(self) -> None:
        """Pushes, and the first half of mj_step: poses and state are of one instant after it."""
        now, half = self.time, 0.5 * float(self.model.opt.timestep)
        if self._pushes:
            self.data.xfrc_applied[:] = 0.0
            for push, body in self._pushes:
                # Halfway between steps, so that rounding of the times does not decide.
                if push.start - half < now < push.end - half:
                    self.data.xfrc_applied[body, :3] += push.force
        mujoco.mj_step1(self.model, self.data)

    def _end(self) -> None:
        problem = _problem(self.data)
        if problem:
            raise SimulationError(f"the simulation of {self.arm.name!r} failed at t = {self.time:.4f} s: {problem}")
        self._step += 1
        self.noise = self._sensors.draw()

    def _weld_forces(self) -> tuple[Floats, Floats]:
        forces, torques = np.zeros(len(self._welds)), np.zeros(len(self._welds))
        if self._welds[0] >= 0:
            data = self.data
            equality = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
            for i, weld in enumerate(self._welds):
                row = data.efc_force[equality & (data.efc_id == weld)]
                # The angular rows measure half the angle's sine: what they exert is half a torque.
                forces[i], torques[i] = np.linalg.norm(row[:3]), 0.5 * np.linalg.norm(row[3:])
        return forces, torques


def _largest_contact(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    wrench, largest = np.zeros(6), 0.0
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, wrench)
        largest = max(largest, float(wrench[0]))
    return largest


@contextlib.contextmanager
def _quiet_warnings() -> Iterator[None]:
    """Keep MuJoCo from printing its warnings and from leaving a log file behind: `_problem` turns them into errors."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _problem(data: mujoco.MjData) -> str:
    """MuJoCo's warning about the last step, or an empty string."""
    if data.warning.number.any():
        index = int(np.flatnonzero(data.warning.number)[0])
        return str(mujoco.mju_warningText(index, int(data.warning.lastinfo[index])))
    return "" if np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all() else "the state is not finite"
