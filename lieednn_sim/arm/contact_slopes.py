"""Distances of near geoms along a path and their derivatives, from MuJoCo's contacts and their constraint Jacobian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.contacts import ContactFinder, moving_geoms
from lieednn_sim.values import Floats


class ContactSlopes(ContactFinder):
    """Distances of near geoms and their derivatives along a path, from MuJoCo's constraint Jacobian.

    It takes about as long as the collision detection itself, a tenth of `Collisions`. Holds a `mujoco.MjData` of its
    own: one instance for each thread.

    Args:
        arm: the arm, in its scene.
        margin: distance below which geoms count [m].
        own: whether two geoms of moving bodies count.
    """

    def __init__(self, arm: Arm, margin: float, *, own: bool) -> None:
        bare = arm.without_visuals
        super().__init__(bare.geometry, margin, bare.offsets, bare.leaving_qpos)
        self._arm, model = arm, self._model
        types, affinities = model.geom_contype.copy(), model.geom_conaffinity.copy()
        # Bits of their own for each direction of MuJoCo's filter, which has 31, so that a fixed geom meets the same
        # moving ones as before.
        if not own and (types | affinities).max(initial=0) < 2**15:
            moving = moving_geoms(model)
            model.geom_contype[:] = np.where(moving, types | affinities << 15, 0)
            model.geom_conaffinity[:] = np.where(moving, 0, affinities | types << 15)
        # One row of the Jacobian for each contact, its normal's, and none for anything else.
        model.geom_condim[:] = 1
        model.pair_dim[:] = 1
        for flag in ("EQUALITY", "FRICTIONLOSS", "LIMIT"):
            model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self._data = mujoco.MjData(model)

    def along(self, q: Floats) -> tuple[NDArray[np.int_], Floats, Floats]:
        """Near geoms at configurations ``(K, n)``.

        Returns:
            For each contact of C, the index of its configuration ``(C,)``, its distance ``(C,)`` [m], negative in
            penetration, and the derivatives of that in the joint coordinates ``(C, n)`` [m/rad, m/m].
        """
        model, data, n = self._model, self._data, q.shape[1]
        counts, distances, rows = np.zeros(len(q), dtype=int), [np.zeros(0)], [np.zeros((0, model.nv))]
        for k, qpos in enumerate(self._arm.qpos(q, strict=False)):
            # Where loops cannot be closed, no place of a geom is known.
            if np.isnan(qpos).any() or not self._found(qpos):
                continue
            mujoco.mj_comPos(model, data)
            mujoco.mj_makeConstraint(model, data)
            contact, distance = data.contact, self._distances()
            used = (contact.exclude == 0) & (distance < self._margin)
            counts[k] = used.sum()
            distances.append(distance[used])
            rows.append(data.efc_J.reshape(-1, model.nv)[contact.efc_address[used]])
        index, near = np.repeat(np.arange(len(q)), counts), np.flatnonzero(counts)
        # MuJoCo's velocities for a unit rate of each joint, which depend on the position of ball joints alone.
        shape = (len(near), n, n)
        rates = self._arm.qvel(np.broadcast_to(q[near, None], shape), np.broadcast_to(np.eye(n), shape))
        slopes = np.einsum("cv,cnv->cn", np.concatenate(rows), rates[np.repeat(np.arange(len(near)), counts[near])])
        return index, np.concatenate(distances), slopes
