"""A free body that an arm carries: it moves with the end effector, and may touch what it stands on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import scipy

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.contacts import ContactFinder, colliding_geoms
from lieednn_sim.arm.frames import BodyFrames
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice, quoted
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

# How much further than at the start the held body may sink into what it stands on [m].
_DEPTH = 5e-4


@dataclass(frozen=True, eq=False)
class Grasp:
    """A free body fixed to the end effector.

    Attributes:
        bodies: ids of it, first, and of all bodies that hang from it.
        carrier: id of the body that carries it, that of the end effector.
        place: its pose in the end effector's frame.
        qpos, qvel: addresses of its free joint's first entries.
        offsets: distances at which its geoms count as touching others, less the clearance (`contacts.ContactOffsets`).
    """

    bodies: tuple[int, ...]
    carrier: int
    place: RigidTransform
    qpos: int
    qvel: int
    offsets: dict[tuple[int, int], float]


def find_grasp(
    model: mujoco.MjModel, qpos: Floats, tip: BodyFrames, holding: str, touching: Sequence[str], clearance: float
) -> Grasp:
    """The grasp of a free body at its present pose.

    The held body may touch what it is nearer to than the clearance now, and the bodies of ``touching``, but sink into
    them no deeper than now. What carries it may touch it, and so may other parts of the arm that are that near now.

    Args:
        model: the model.
        qpos: its positions ``(nq,)``.
        tip: the frame of the end effector.
        holding: name of a body with a free joint.
        touching: names of bodies that the held body may touch as well, such as where it is put.
        clearance: distance that other pairs keep [m].

    Raises:
        InputError: there is no such free body, it carries the arm, or there is no body to touch.
    """
    free = {
        model.body(model.jnt_bodyid[joint]).name: joint
        for joint in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).tolist()
    }
    if holding not in free:
        names = ", ".join(sorted(filter(None, free))) or "none"
        raise InputError(f"nothing to hold is called {quoted(holding)}; bodies with a free joint are: {names}")
    joint, carrier = free[holding], int(tip.bodies[0])
    body, root = int(model.jnt_bodyid[joint]), int(model.body_rootid[carrier])
    if root == body:
        raise InputError(f"{quoted(holding)} carries the end effector, and cannot be held by it")
    bodies = np.flatnonzero(model.body_rootid == body)
    known = [model.body(k).name for k in range(model.nbody)]
    allowed = [known.index(as_choice("body", name, filter(None, known))) for name in touching]
    data = kinematics_at(model, qpos)
    mine, solid = np.isin(model.geom_bodyid, bodies), colliding_geoms(model)
    # What moves with the arm's base may not be stood on: neither the arm itself nor its hand is below the body.
    robot = (model.body_rootid == root) & (model.body_weldid != 0)
    offsets: dict[tuple[int, int], float] = {}
    for distance, (a, b) in zip(*ContactFinder(model, clearance + _DEPTH).geoms(qpos), strict=True):
        first, second = (int(a), int(b)) if mine[a] else (int(b), int(a))
        if mine[first] and not mine[second]:
            depth = -np.inf if robot[model.geom_bodyid[second]] else min(float(distance), 0.0) - _DEPTH
            offsets[first, second] = min(offsets.get((first, second), 0.0), depth - clearance)
    hand = model.body_weldid[model.geom_bodyid] == model.body_weldid[carrier]
    stands = np.isin(model.geom_bodyid, allowed)
    for others, offset in ((hand, -np.inf), (stands, -_DEPTH - clearance)):
        for pair in product(np.flatnonzero(mine & solid).tolist(), np.flatnonzero(others & solid).tolist()):
            offsets.setdefault(pair, offset)
    place, turn = tip.poses(data.xpos, data.xmat)
    inside = turn[0].T @ data.xmat[body].reshape(3, 3), turn[0].T @ (data.xpos[body] - place[0])
    pose = scipy.spatial.transform.RigidTransform.from_components(
        inside[1], scipy.spatial.transform.Rotation.from_matrix(inside[0])
    )
    addresses = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    return Grasp((body, *bodies[bodies != body].tolist()), carrier, pose, *addresses, offsets)
