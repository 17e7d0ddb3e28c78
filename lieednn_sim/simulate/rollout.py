"""Rollouts: what MuJoCo did with a planned motion, logged with every value of one instant."""

from __future__ import annotations

import contextlib
import copy
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim import storage
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.errors import FileError, InputError, SimulationError
from lieednn_sim.motion import Motion
from lieednn_sim.simulate.control import ComputedTorque, Controller, InverseDynamicsServo, PositionServo, Reference
from lieednn_sim.simulate.mocap import MocapWelds
from lieednn_sim.validation import as_choice, as_floats, as_positive, as_times

Floats = NDArray[np.float64]


CONTROLLERS: dict[str, Callable[[Arm, Reference], Controller]] = {
    "position-servo": PositionServo,
    "inverse-dynamics": InverseDynamicsServo,
    "computed-torque": ComputedTorque,
    "mocap": MocapWelds,
}


@dataclass(frozen=True)
class Rollout:
    """Log of a simulation; row k of every array belongs to time t[k].

    Attributes:
        arm: name of the arm.
        t: ``(K,)`` [s].
        q: ``(K, 2N)`` joint positions [rad, m].
        qd: ``(K, 2N)`` joint velocities [rad/s, m/s].
        q_ref: ``(K, 2N)`` reference positions.
        qd_ref: ``(K, 2N)`` reference velocities.
        ctrl: ``(K, nu)`` actuator controls.
        force: ``(K, 2N)`` what each joint's drive exerts, gravity compensation included [N m, N].
        constraint_force: ``(K, 2N)`` what contacts, joint limits and welds exert on each joint [N m, N].
        link_position: ``(K, N, 3)`` simulated link frames, world [m].
        link_quaternion: ``(K, N, 4)`` the same, (w, x, y, z).
        contacts: ``(K,)`` number of contacts.
        motion_end: time at which the reference comes to rest [s].
        controller: a name of `CONTROLLERS`.
    """

    arm: str
    t: Floats
    q: Floats
    qd: Floats
    q_ref: Floats
    qd_ref: Floats
    ctrl: Floats
    force: Floats
    constraint_force: Floats
    link_position: Floats
    link_quaternion: Floats
    contacts: NDArray[np.int_]
    motion_end: float
    controller: str = "position-servo"

    def __post_init__(self) -> None:
        k = len(as_times("t", self.t))
        n = as_floats("q", self.q, (k, "2N")).shape[1] // 2
        shapes: dict[str, tuple[int, ...]] = {
            "t": (k,),
            **dict.fromkeys(("q", "qd", "q_ref", "qd_ref", "ctrl", "force", "constraint_force"), (k, 2 * n)),
            "link_position": (k, n, 3),
            "link_quaternion": (k, n, 4),
            "contacts": (k,),
        }
        for name, shape in shapes.items():
            value: Any = as_floats(name, getattr(self, name), shape)
            object.__setattr__(self, name, value.astype(int) if name == "contacts" else value)
        if not (np.linalg.norm(self.link_quaternion, axis=-1) > 0.5).all():
            raise InputError("link_quaternion must hold unit quaternions")

    @property
    def timestep(self) -> float:
        """Simulation step [s]."""
        return float(self.t[1] - self.t[0])

    def link_poses(self) -> RigidTransform:
        """Simulated link frames as poses of shape ``(K, N)``."""
        rotation = Rotation.from_quat(self.link_quaternion, scalar_first=True)
        return RigidTransform.from_components(self.link_position, rotation)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to an ``.npz`` file, atomically."""
        meta = {"arm": self.arm, "motion_end": self.motion_end, "controller": self.controller}
        meta["mujoco"] = mujoco.__version__
        storage.save_arrays(path, "rollout", {name: getattr(self, name) for name in _ARRAYS}, meta)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Rollout:
        """Read a file of `save`; `FileError` when it is none."""
        arrays, meta = storage.load_arrays(path, "rollout")
        values = dict(zip(_ARRAYS, storage.take(arrays, path, *_ARRAYS), strict=True))
        try:
            controller = as_choice("controller", meta["controller"], CONTROLLERS)
            return cls(arm=str(meta["arm"]), motion_end=float(meta["motion_end"]), controller=controller, **values)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise FileError(f"{path} is not a valid rollout: {error}") from None


_MAX_HOLD = 1000.0
_ARRAYS = (
    "t",
    "q",
    "qd",
    "q_ref",
    "qd_ref",
    "ctrl",
    "force",
    "constraint_force",
    "link_position",
    "link_quaternion",
    "contacts",
)


def simulate(
    arm: Arm,
    motion: Motion,
    *,
    controller: str = "position-servo",
    hold: float = 1.0,
    mass_scale: float = 1.0,
    dump_directory: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Rollout:
    """Follow a motion with a controller, then hold its end.

    The simulation starts at rest at the motion's first position, and is a function of its arguments alone: two runs
    are bit-identical.

    Args:
        arm: the arm; its model is not changed.
        motion: sampled at the model's time step.
        controller: a name of `CONTROLLERS`.
        hold: time after the end of the motion [s].
        mass_scale: masses and inertias of the simulated arm in units of those that controller and gravity compensation
            know.
        dump_directory: where to leave ``divergence.npz`` when the run fails; by default nothing is written.
        progress: called with (done, total) steps, about every tenth of a second.

    Raises:
        InputError: the motion does not fit the model.
        SimulationError: a warning of MuJoCo or a state that is not finite; names the time and the dump.
    """
    model = arm.model
    step = float(model.opt.timestep)
    if motion.q.shape[1] != model.nq:
        raise InputError(f"the motion has {motion.q.shape[1]} coordinates, arm {arm.name!r} has {model.nq}")
    if not np.isclose(motion.timestep, step, rtol=1e-9):
        raise InputError(f"the motion is sampled every {motion.timestep:g} s, the model steps every {step:g} s")
    if not 0.0 <= hold <= _MAX_HOLD:
        raise InputError(f"hold must be between 0 and {_MAX_HOLD:g} s, got {hold:g}")
    extra = round(hold / step)
    q_ref = np.vstack([motion.q, np.repeat(motion.q[-1:], extra, axis=0)])
    qd_ref = np.vstack([motion.qd, np.zeros((extra, model.nv))])
    as_choice("controller", controller, CONTROLLERS)
    driver = CONTROLLERS[controller](arm, Reference(q_ref, qd_ref, step))
    model = _scaled(driver.plant, as_positive("mass_scale", mass_scale))

    total, n = len(q_ref), arm.n_links
    log: dict[str, Any] = {
        "t": np.zeros(total),
        "q": np.zeros((total, model.nq)),
        "qd": np.zeros((total, model.nv)),
        "ctrl": np.zeros((total, model.nu)),
        "force": np.zeros((total, model.nv)),
        "constraint_force": np.zeros((total, model.nv)),
        "link_position": np.zeros((total, n, 3)),
        "link_quaternion": np.zeros((total, n, 4)),
        "contacts": np.zeros(total, dtype=int),
    }
    data = mujoco.MjData(model)
    data.qpos[:] = q_ref[0]
    shown = time.monotonic()
    with _quiet_warnings():
        for k in range(total):
            # The two halves of mj_step: poses and state are read between them, so that all belong to t[k].
            mujoco.mj_step1(model, data)
            driver.act(data, k)
            log["t"][k], log["q"][k], log["qd"][k], log["ctrl"][k] = k * step, data.qpos, data.qvel, data.ctrl
            log["link_position"][k] = data.site_xpos[arm.site_ids]
            for i, site in enumerate(arm.site_ids):
                mujoco.mju_mat2Quat(log["link_quaternion"][k, i], data.site_xmat[site])
            log["contacts"][k] = data.ncon
            mujoco.mj_step2(model, data)
            # Compensation that is not routed through the actuators still has to come from the drives.
            log["force"][k] = data.qfrc_actuator + np.where(model.jnt_actgravcomp, 0.0, data.qfrc_gravcomp)
            log["constraint_force"][k] = data.qfrc_constraint
            problem = _problem(data)
            if problem:
                raise SimulationError(_dump(arm, log, q_ref, qd_ref, k, problem, dump_directory))
            if progress is not None and (time.monotonic() - shown > 0.1 or k == total - 1):
                shown = time.monotonic()
                progress(k + 1, total)
    end = float(motion.t[-1])
    return Rollout(arm=arm.name, q_ref=q_ref, qd_ref=qd_ref, motion_end=end, controller=controller, **log)


def _scaled(model: mujoco.MjModel, mass_scale: float) -> mujoco.MjModel:
    """The model with other masses, and the gravity compensation of the old ones."""
    if mass_scale == 1.0:
        return model
    scaled = copy.deepcopy(model)
    scaled.body_mass[:] *= mass_scale
    scaled.body_inertia[:] *= mass_scale
    scaled.body_gravcomp[:] /= mass_scale
    mujoco.mj_setConst(scaled, mujoco.MjData(scaled))
    return scaled


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
    for index in np.flatnonzero(data.warning.number):
        return mujoco.mju_warningText(int(index), int(data.warning.lastinfo[index]))
    return "" if np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all() else "the state is not finite"


def _dump(
    arm: Arm,
    log: dict[str, Any],
    q_ref: Floats,
    qd_ref: Floats,
    k: int,
    problem: str,
    directory: str | os.PathLike[str] | None,
) -> str:
    """Keep the log up to the failed step as a rollout file; returns the error message."""
    message = f"the simulation of {arm.name!r} failed at t = {log['t'][k]:.4f} s: {problem}"
    if directory is None or k < 1:
        return message
    path = Path(directory) / "divergence.npz"
    part = {name: values[: k + 1] for name, values in log.items()}
    for name in ("force", "constraint_force", "ctrl"):
        part[name] = np.nan_to_num(part[name])
    Rollout(arm=arm.name, q_ref=q_ref[: k + 1], qd_ref=qd_ref[: k + 1], motion_end=float(log["t"][k]), **part).save(
        path
    )
    return f"{message}; the run up to there is in {path} (Rollout.load reads it)"
