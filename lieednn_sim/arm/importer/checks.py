"""Checks of an adopted model: kinematics, stability of the servos, sag, touching bodies, turns near pi."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.freezing import pose
from lieednn_sim.arm.importer.ranges import place, random_coordinates
from lieednn_sim.arm.importer.serial_chain import Frame
from lieednn_sim.arm.importer.servos import Freedom, Servo, growth, reduced_inertia, resting_load
from lieednn_sim.arm.importer.stages import Couplings
from lieednn_sim.errors import InputError

Floats = NDArray[np.float64]
_EULER, _IMPLICITFAST = int(mujoco.mjtIntegrator.mjINT_EULER), mujoco.mjtIntegrator.mjINT_IMPLICITFAST
_SAG = 1e-3  # worth a remark [rad, m]
_SLOW = 5.0  # worth a remark [Hz]


def check_kinematics(
    original: mujoco.MjModel,
    adopted: mujoco.MjModel,
    qpos: Floats,
    frames: Sequence[Frame],
    samples: Sequence[dict[int, Floats]],
    couplings: Couplings,
) -> None:
    """Compare the link frames of both models at ``samples``; `InputError` when they differ by more than 1e-9."""
    bodies, sites = [frame.body for frame in frames], _frame_sites(adopted, len(frames))
    fixed = pose(np.array([frame.pos for frame in frames]), np.array([frame.quat for frame in frames]))
    before, after = mujoco.MjData(original), mujoco.MjData(adopted)
    for q in samples:
        before.qpos[:] = place(original, original, q, couplings, qpos)
        after.qpos[:] = place(adopted, original, q, couplings, adopted.qpos0)
        mujoco.mj_kinematics(original, before)
        mujoco.mj_kinematics(adopted, after)
        wanted = pose(before.xpos[bodies], before.xquat[bodies]) * fixed
        rotations = Rotation.from_matrix(after.site_xmat[sites].reshape(-1, 3, 3))
        found = RigidTransform.from_components(after.site_xpos[sites], rotations)
        same = np.isclose(wanted.as_matrix(), found.as_matrix(), rtol=0.0, atol=1e-9).all(axis=(-2, -1))
        if not same.all():
            raise InputError(
                f"the frame {frames[int(same.argmin())].name!r} moved while other joints were frozen; the model uses a "
                "feature that cannot be carried over: remove the joints beside the arm by hand"
            )


def stabilise(
    spec: Any,
    model: mujoco.MjModel,
    postures: Sequence[Floats],
    freedoms: list[Freedom],
    servos: tuple[Servo, ...],
    notes: list[str],
) -> None:
    """Where the servos would be unstable at one of ``postures`` take a better integrator, then shorter timesteps."""
    inertias = [reduced_inertia(model, qpos, freedoms) for qpos in postures]

    def unstable() -> bool:
        timestep = float(model.opt.timestep)
        return any(growth(model, inertia, freedoms, servos, timestep) > 1.0 + 1e-9 for inertia in inertias)

    if unstable() and model.opt.integrator in (_EULER, int(mujoco.mjtIntegrator.mjINT_RK4)):
        model.opt.integrator = spec.option.integrator = int(_IMPLICITFAST)
        notes.append("the servos would be unstable with the model's integrator; it is implicitfast now")
    for _ in range(6):
        if not unstable():
            break
        model.opt.timestep /= 2.0
        spec.option.timestep = model.opt.timestep
        notes.append(f"the servos would be unstable with the timestep; it is {model.opt.timestep:g} s now")


def remarks_on_turns(
    adopted: mujoco.MjModel,
    original: mujoco.MjModel,
    groups: Sequence[Sequence[int]],
    samples: Sequence[dict[int, Floats]],
    couplings: Couplings,
) -> list[str]:
    """Say which compound joints of several hinges come near half a turn at one of ``samples``."""
    postures = [adopted.qpos0, *(place(adopted, original, q, couplings, adopted.qpos0) for q in samples)]
    frames = _frame_matrices(adopted, postures, len(groups))
    relative = Rotation.from_matrix(frames[:, :-1]).inv() * Rotation.from_matrix(frames[:, 1:])
    turns = (relative[0].inv() * relative).magnitude().max(axis=0)
    return [
        f"link {i} may turn by {turn:.3g} rad against link {i - 1}; the logarithm is unique below pi: cut it finer"
        for i, (group, turn) in enumerate(zip(groups, turns, strict=True), start=1)
        if len(group) > 1 and turn > 0.95 * np.pi
    ]


def remarks_at_home(model: mujoco.MjModel, freedoms: list[Freedom], servos: tuple[Servo, ...]) -> list[str]:
    """Say which servos sag or are too weak at the keyframe ``home``, and which bodies touch there."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    notes = []
    load = resting_load(model, data.qpos)
    for freedom, servo in zip(freedoms, servos, strict=True):
        force = float(load @ freedom.rates)
        if servo.frequency < _SLOW:
            remedy = "; servos='design' makes another" if servo.kept else ""
            slow = f"its servo is slow, {servo.frequency:.2g} Hz, and follows motions badly"
            notes.append(f"{servo.name}: {slow}{remedy}")
        low, high = servo.force_range
        if not low <= force <= high:
            notes.append(f"{servo.name}: needs {force:.4g} at home, more than its force limits allow")
        elif abs(force / servo.kp) > _SAG:
            notes.append(f"{servo.name}: sags by {abs(force) / servo.kp:.2g} rad or m at home under its load")
    for contact in data.contact[: data.ncon]:
        if contact.dist < 0.0:
            one, other = (model.body(model.geom_bodyid[geom]).name for geom in contact.geom)
            notes.append(f"bodies {one!r} and {other!r} touch at home")
    return notes


def random_samples(
    model: mujoco.MjModel, joints: Sequence[int], couplings: Couplings, ranges: dict[int, Floats], count: int
) -> list[dict[int, Floats]]:
    """Positions of the independent joints, uniform within their ranges, with a fixed seed."""
    rng = np.random.default_rng(0)
    return [random_coordinates(model, joints, couplings, ranges, rng) for _ in range(count)]


def _frame_sites(model: mujoco.MjModel, count: int) -> list[int]:
    return [model.site(f"link{i}_frame" if i else "base_frame").id for i in range(count)]


def _frame_matrices(model: mujoco.MjModel, postures: Sequence[Floats], links: int) -> Floats:
    """Rotation matrices of the base's and the links' frames at each posture, ``(postures, links + 1, 3, 3)``."""
    data = mujoco.MjData(model)
    sites = _frame_sites(model, links + 1)
    found = np.empty((len(postures), links + 1, 9))
    for matrices, data.qpos[:] in zip(found, postures, strict=True):
        mujoco.mj_kinematics(model, data)
        matrices[:] = data.site_xmat[sites]
    return found.reshape(-1, links + 1, 3, 3)
