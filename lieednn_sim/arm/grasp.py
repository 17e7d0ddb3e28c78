"""What an arm carries: a free body that moves with the end effector and may touch what it stands on, and a payload.

The payload is a mass at the end effector's frame: a ball of steel, without collisions and gravity compensation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import scipy

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.checks import FREE, ancestry
from lieednn_sim.arm.contacts import ContactFinder, colliding_geoms
from lieednn_sim.arm.equalities import equality_name, involved_joints
from lieednn_sim.arm.serial_arm import SerialArm
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.errors import InputError
from lieednn_sim.lie.se3 import rotations
from lieednn_sim.validation import as_choice, quoted
from lieednn_sim.values import Floats

_DEPTH = 5e-4  # how much further than at the start the held body may sink into what it stands on [m]


@dataclass(frozen=True, eq=False)
class Grasp:
    """A free body fixed to the end effector."""

    named: tuple[str, Sequence[str]]  # the names of the body, and of those that it may touch (`Arm.holding`)
    bodies: tuple[int, ...]  # its id, then those of all bodies that hang from it
    carrier: int  # id of the body that carries it, that of the end effector
    place: scipy.spatial.transform.RigidTransform  # in the end effector's frame
    qpos: int  # address of its free joint's first entry
    qvel: int  # the same in qvel
    # Distances at which its geoms count as touching others, less the clearance (`contacts.ContactOffsets`) [m].
    offsets: dict[tuple[int, int], float]


def find_grasp(
    arm: SerialArm, qpos: Floats, holding: str, touching: Sequence[str], clearance: float, tied: bool
) -> Grasp:
    """The grasp of the free body called ``holding`` at its present pose, where the model is at ``qpos`` ``(nq,)``.

    Arguments and errors are as for `ModelArm.holding`. Other parts of the arm that are nearer than the clearance [m]
    now may be touched, too.
    """
    model, tip = arm.model, arm.frames[-1:]
    free = {model.body(model.jnt_bodyid[j]).name: j for j in np.flatnonzero(model.jnt_type == FREE).tolist()}
    joint, carrier = free[as_choice("body with a free joint", holding, free)], int(tip.bodies[0])
    body, root = int(model.jnt_bodyid[joint]), int(model.body_rootid[carrier])
    if root == body:
        raise InputError(f"{quoted(holding)} carries the end effector, and cannot be held by it")
    for e in np.flatnonzero(model.eq_active0).tolist():
        if joint in (ties := involved_joints(model, e)) and ties.isdisjoint(model.dof_jntid[arm.space.rate_addresses]):
            raise InputError(f"{quoted(holding)} is held by {equality_name(model, e)}; deactivate it first")
    bodies = np.flatnonzero(model.body_rootid == body)
    known = [model.body(k).name for k in range(model.nbody)]
    allowed = [known.index(as_choice("body", name, filter(None, known))) for name in touching]
    data = kinematics_at(model, qpos)
    mine, solid = np.isin(model.geom_bodyid, bodies), colliding_geoms(model)
    # What moves with the arm's base does not count as ground: the body does not stand on the arm or its hand.
    robot = (model.body_rootid == root) & (model.body_weldid != 0)
    offsets: dict[tuple[int, int], float] = {}
    for distance, (a, b) in zip(*ContactFinder(model, clearance + _DEPTH).geoms(qpos), strict=True):
        first, second = (int(a), int(b)) if mine[a] else (int(b), int(a))
        if mine[first] and not mine[second]:
            depth = -np.inf if robot[model.geom_bodyid[second]] else min(float(distance), 0.0) - _DEPTH
            offsets[first, second] = min(offsets.get((first, second), 0.0), depth - clearance)
    # Parts that move with the hand, such as its fingers, keep their distance, so any distance is allowed.
    group = moved_together(model, arm.space.rate_addresses)
    hand = group[model.geom_bodyid] == group[carrier]
    stands = np.isin(model.geom_bodyid, allowed)
    for others, offset in ((hand, -np.inf), (stands, -_DEPTH - clearance)):
        for pair in product(np.flatnonzero(mine & solid).tolist(), np.flatnonzero(others & solid).tolist()):
            offsets.setdefault(pair, offset)
    (place,), (turn,) = tip.poses(data.xpos, data.xmat)
    if not tied:
        # Gaps between the spheres around geoms are measured, since the end effector's frame may be between fingers.
        below = np.isin(model.geom_bodyid, [k for k in range(model.nbody) if carrier in ancestry(model, k)])
        ends, sizes = np.vstack([place, data.geom_xpos[below]]), np.append(0.0, model.geom_rbound[below])
        gaps = np.linalg.norm(ends[:, None] - data.geom_xpos[mine], axis=-1) - sizes[:, None] - model.geom_rbound[mine]
        away = gaps.min(initial=np.linalg.norm(data.xpos[body] - place))
        near = 0.1 * max(1.0, float(np.linalg.norm(place - data.xpos[root])))
        if away > near:
            raise InputError(
                f"{quoted(holding)} is {away:.3g} m or more from the hand, which can hold what is up to {near:.3g} m "
                "away: move the hand there first, in a sequence by a Move before this one"
            )
    turned = scipy.spatial.transform.Rotation.from_matrix(turn.T @ data.xmat[body].reshape(3, 3))
    pose = scipy.spatial.transform.RigidTransform.from_components(turn.T @ (data.xpos[body] - place), turned)
    addresses = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    return Grasp((holding, touching), (body, *bodies[bodies != body].tolist()), carrier, pose, *addresses, offsets)


def add_payload(spec: Any, arm: SerialArm, mass: float, name: str) -> None:
    """Add a ball [kg] to a copy of the arm's spec, as a body of that name."""
    tip = arm.frames[-1:]
    spec.body(arm.model.body(int(tip.bodies[0])).name).add_body(
        name=name,
        pos=tip.positions[0],
        mass=mass,
        ipos=[0.0, 0.0, 0.0],
        inertia=[_ball_inertia(mass)] * 3,
        explicitinertial=True,
    )


def load_body(model: mujoco.MjModel, arm: SerialArm, mass: float) -> None:
    """Add a ball [kg] to the mass and inertia of the end effector's body in a compiled model, which is changed.

    `InputError` if MuJoCo compensates that body for gravity, at its centre of mass, or takes it for symmetric.
    """
    tip = arm.frames[-1:]
    body, turn = int(tip.bodies[0]), np.empty(9)
    if model.body_gravcomp[body] or (model.body_simple[body] and tip.positions[0].any()):
        raise InputError(
            f"a payload cannot be added to {model.body(body).name!r} of a compiled model, whose gravity MuJoCo "
            'compensates at its centre of mass, or which it takes for symmetric: give it gravcomp="0" and '
            'simple="false", or add the payload to the model as a body'
        )
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    rotation, before = turn.reshape(3, 3), float(model.body_mass[body])
    whole = before + mass
    centre = (before * model.body_ipos[body] + mass * tip.positions[0]) / whole
    inertia = rotation @ np.diag(model.body_inertia[body]) @ rotation.T + _ball_inertia(mass) * np.eye(3)
    for part, place in ((before, model.body_ipos[body]), (mass, tip.positions[0])):
        off = place - centre
        inertia += part * (off @ off * np.eye(3) - np.outer(off, off))
    moments, axes = np.linalg.eigh(inertia)
    axes *= np.sign(np.linalg.det(axes))
    model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = whole, centre, moments
    model.body_iquat[body] = rotations(axes).as_quat(scalar_first=True)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _ball_inertia(mass: float) -> float:
    """Moment of inertia [kg m^2] of a ball of steel, 7850 kg/m^3."""
    radius = (3.0 * mass / (4.0 * np.pi * 7850.0)) ** (1.0 / 3.0)
    return float(0.4 * mass * radius**2)
