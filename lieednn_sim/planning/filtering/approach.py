"""How fast geoms can approach each other at most: the filter leaves out pairs that are too far apart to matter.

A degree of freedom that moves both geoms of a pair does not change their distance. Any other moves the points of a geom
by at most 1 for a slide, and by the distance of its anchor from the geom's centre plus the geom's radius for a turn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.values import Floats

Pairs = NDArray[np.int_]


class ApproachBounds:
    """Bounds of the rates at which the distances of pairs change.

    Args:
        arm: the arm.
        pairs: ``(P, 2)`` geom ids.
    """

    def __init__(self, arm: Arm, pairs: Pairs) -> None:
        self._arm = arm
        self._data = mujoco.MjData(arm.model)
        model = arm.model
        self._geoms, index = np.unique(pairs, return_inverse=True)
        self._first, self._second = index.reshape(-1, 2).T
        self._moves = np.array([_moved_by(model, int(model.geom_bodyid[geom])) for geom in self._geoms])
        self._turns = model.jnt_type[model.dof_jntid] != mujoco.mjtJoint.mjJNT_SLIDE
        self._radius = np.where(model.geom_rbound > 0.0, model.geom_rbound, 0.0)[self._geoms]
        self._identity = np.eye(arm.n_joints)

    def __call__(self, q: Floats, speeds: Floats) -> Floats:
        """Bounds ``(P,)`` [m/s] at ``q`` ``(n,)`` for joint velocities of at most ``speeds`` ``(n,)``."""
        model, data = self._arm.model, self._data
        data.qpos[:] = self._arm.qpos(q)
        mujoco.mj_kinematics(model, data)
        rates = self._arm.qvel(np.broadcast_to(q, self._identity.shape), self._identity)
        anchors = data.xanchor[model.dof_jntid]
        levers = np.linalg.norm(data.geom_xpos[self._geoms][:, None] - anchors, axis=2) + self._radius[:, None]
        moved = np.where(self._turns, levers, 1.0) * self._moves * (speeds @ np.abs(rates))
        table = moved @ ~self._moves.T
        return np.asarray(table[self._first, self._second] + table[self._second, self._first])


def _moved_by(model: mujoco.MjModel, body: int) -> NDArray[np.bool_]:
    """Which degrees of freedom ``(nv,)`` move a body."""
    moved = np.zeros(model.nv, dtype=bool)
    while body > 0:
        first = model.body_dofadr[body]
        moved[first : first + model.body_dofnum[body]] = True
        body = int(model.body_parentid[body])
    return moved
