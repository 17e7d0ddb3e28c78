"""Distances of near geoms along a path, and their derivatives, by MuJoCo's contacts instead of all distances."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.contacts import ContactFinder, moving_geoms
from lieednn_sim.values import Floats, Ints


class ContactSlopes(ContactFinder):
    """Distances of near geoms and their derivatives along a path, from MuJoCo's constraint Jacobian.

    It takes about as long as the collision detection itself, a tenth of `Collisions`. Holds a `mujoco.MjData` of its
    own: one instance for each thread.

    Geoms closer than the margin [m] count; pairs of moving bodies only with ``own``.
    """

    def __init__(self, arm: Arm, margin: float, *, own: bool) -> None:
        bare = arm.without_visuals
        super().__init__(bare.geometry, margin, bare.offsets, bare.leaving_qpos)
        self._arm, model = arm, self._model
        types, affinities = model.geom_contype.copy(), model.geom_conaffinity.copy()
        # Each direction of MuJoCo's filter, which has 31 bits, gets bits of its own, so that a fixed geom meets the
        # same moving ones as before.
        if not own and (types | affinities).max(initial=0) < 2**15:
            moving = moving_geoms(model)
            model.geom_contype[:] = np.where(moving, types | affinities << 15, 0)
            model.geom_conaffinity[:] = np.where(moving, 0, affinities | types << 15)
        # The Jacobian gets one row for each contact, that of its normal, and none for anything else.
        model.geom_condim[:] = 1
        model.flex_condim[:] = 1
        model.pair_dim[:] = 1
        for flag in ("EQUALITY", "FRICTIONLOSS", "LIMIT"):
            model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self._data = mujoco.MjData(model)

    def along(self, q: Floats) -> tuple[Ints, Floats, Floats]:
        """Near geoms at configurations ``(K, n)``.

        Returns:
            For each contact of C, the index of its configuration ``(C,)``, its distance ``(C,)`` [m], negative in
            penetration, and the derivatives of that in the joint coordinates ``(C, n)`` [m/rad, m/m].
        """
        model, data, positions = self._model, self._data, self._arm.qpos(q, strict=False)
        at, distances, kept, rows = list[int](), [np.zeros(0)], [np.zeros(0, dtype=bool)], list[Floats]()
        # Configurations at which loops cannot be closed are left out: there the geoms' places are not known.
        for k in np.flatnonzero(~np.isnan(positions).any(axis=1)).tolist():
            if not self._found(positions[k]):
                continue
            mujoco.mj_comPos(model, data)
            mujoco.mj_makeConstraint(model, data)
            at.append(k)
            distances.append(np.array(self._distances()))
            # Contacts that are not excluded have a row of the Jacobian each, in this order.
            kept.append(data.contact.exclude == 0)
            rows.append(data.efc_J.reshape(-1, model.nv).copy())
        # MuJoCo's velocities for a unit rate of each joint, which depend on the position of ball joints alone.
        rates = self._arm.unit_rates(q[at])
        slopes = np.concatenate([q[:0], *map(np.matmul, rows, rates)])
        index, distance = np.repeat(np.array(at, dtype=int), list(map(len, rows))), np.concatenate(distances)
        near = (distance := distance[np.concatenate(kept)]) < self._margin
        return index[near], distance[near], slopes[near]
