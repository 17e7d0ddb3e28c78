"""Signed distances between an arm's links and their surroundings, and their gradients in the joint coordinates.

Distances are MuJoCo's (`mj_geomDistance`), of the geom pairs that pass its collision filter. Bounding boxes of the
geoms give lower bounds, so that only a few pairs are measured. With witness points a on geom A and b on geom B at a
distance d, negative in penetration, the normal is n = (b - a) / d, and d changes at the rate n . (b' - a').
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import kinematics_along, kinematics_at, mujoco
from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.contacts import ContactOffsets, colliding_pairs, geom_name, move_bodies, moving_geoms
from lieednn_sim.errors import InputError
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_count, as_floats
from lieednn_sim.values import Floats, Ints

__all__ = ["Collisions"]

_PLANE_SIZE = 1e6  # a plane is a half-space: for the bounds, a box of this half size [m]
AT_ONCE = 32  # configurations whose pairs of geoms are in memory at once
_SLACK = 1e-9  # rounding of the bounds [m]
ROUNDED = 2e-7  # and that of meshes, whose corners have single precision, as a share of their bounding boxes


class Distances(NamedTuple):
    """Geom pairs closer than a cutoff, the nearest first."""

    distance: Floats  # ``(P,)`` signed, from where the geoms begin to push each other [m]
    jacobian: Floats  # ``(P, n)`` derivatives in the joint coordinates [m/rad, m/m]; zero for geoms that just touch
    pairs: Ints  # ``(P, 2)`` geom ids


class Places:
    """Where MuJoCo has geoms and joints at positions ``(I, nq)``, and the bodies' rotations."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, qpos: Floats) -> None:
        arrays = kinematics_along(model, qpos, "geom_xpos", "geom_xmat", "xanchor", "xaxis", "xmat", data=data)
        self.geoms, turns, self.anchors, self.axes, self.bodies = arrays
        self.turns = turns.reshape(*self.geoms.shape, 3)


class Collisions:
    """Distances of one arm in the scene of its model.

    Holds a `mujoco.MjData` of its own: one instance for each thread.

    Attributes:
        arm: the arm.
        pairs: ``(P, 2)`` ids of the geoms that may collide, by MuJoCo's filter: contype and conaffinity, bodies
            welded together, parent and child, excludes, and the model's explicit pairs.
        own: ``(P,)`` which pairs are two parts of the arm; links may pass each other closely by design.
        fields: ``(P,)`` which pairs are a height field and another geom.
        offsets: the distances at which geoms begin to push each other.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.offsets, self.pairs = ContactOffsets(arm.geometry, arm.offsets), colliding_pairs(arm.geometry)
        self._offset = self.offsets(self.pairs)
        self._data = mujoco.MjData(arm.geometry)
        # The original model, kept once obstacles have moved.
        self._scene: mujoco.MjModel | None = None
        self.own = np.asarray(moving_geoms(arm.geometry)[self.pairs].all(axis=1))
        model = arm.geometry
        kinds, capsule = model.geom_type[self.pairs], int(mujoco.mjtGeom.mjGEOM_CAPSULE)
        self.fields = (kinds == int(mujoco.mjtGeom.mjGEOM_HFIELD)).any(axis=1)
        self._rods = (np.sort(kinds, axis=1) == [capsule, int(mujoco.mjtGeom.mjGEOM_BOX)]).all(axis=1)
        self._rod_first = np.where(kinds[:, :1] == capsule, self.pairs, self.pairs[:, ::-1])
        used = np.flatnonzero(np.bincount(self.pairs.ravel(), minlength=model.ngeom))
        self._used, (self._first, self._second) = used, np.searchsorted(used, self.pairs.T)
        self._center, self._half = np.hsplit(model.geom_aabb[used], 2)
        self._half = self._half + ROUNDED * np.abs(model.geom_aabb[used]).sum(axis=1, keepdims=True)
        planes = model.geom_type[used] == int(mujoco.mjtGeom.mjGEOM_PLANE)
        self._center[planes], self._half[planes] = (0.0, 0.0, -_PLANE_SIZE), _PLANE_SIZE
        self._radius = np.linalg.norm(self._half, axis=1)
        # MuJoCo's bounding sphere is smaller than the box's; it is used if the box is centred at the geom's frame, too.
        centred = ~planes & (np.abs(self._center).max(axis=1) < _SLACK) & (model.geom_rbound[used] > 0.0)
        self._radius[centred] = np.minimum(self._radius, model.geom_rbound[used])[centred]
        self._reach = self._radius[self._first] + self._radius[self._second] + _SLACK
        # Of two geoms, the one that fills its bounding ball better is replaced by this ball in the first test.
        empty = np.where(planes, np.inf, self._radius / np.maximum(self._half.min(axis=1), 1e-300))
        swapped = empty[self._first] < empty[self._second]
        self._first, self._second = np.where(swapped, [self._second, self._first], [self._first, self._second])
        # The moving bodies, which of them each geom belongs to, and their Jacobians; the last is zero, for fixed ones.
        bodies = np.unique(model.geom_bodyid[used])
        self._bodies = bodies[model.body_weldid[bodies] != 0]
        slots = np.full(model.nbody, len(self._bodies))
        slots[self._bodies] = np.arange(len(self._bodies))
        self._slots = slots[model.geom_bodyid]
        self._jacobians = np.zeros((len(self._bodies) + 1, 6, model.nv))

    def move(self, places: Mapping[str, ArrayLike]) -> None:
        """Put obstacles where they are now, and all others back to the scene, in another `Arm.geometry`.

        ``places`` and errors are as for `Arm.with_moved_bodies`.
        """
        if self._scene is None:
            if not places:
                return
            self._scene = self.arm.geometry
            self.arm = replace(self.arm, collision_model=copy.deepcopy(self._scene))
        self.arm.geometry.body_pos[:] = self._scene.body_pos
        move_bodies(self.arm.geometry, places)

    def distances(self, q: ArrayLike, cutoff: ArrayLike) -> Distances:
        """Distances and gradients of all pairs closer than ``cutoff`` [m], a scalar or ``(P,)``, at ``q`` ``(n,)``.

        The gradient is exact where geoms are apart. In penetration it is taken along MuJoCo's direction of separation,
        which for capsules in boxes is not always the shortest one.
        """
        kinematics_at(self.arm.geometry, self.arm.qpos(as_floats("q", q, (self.arm.n_joints,))), self._data)
        limits = as_floats("cutoff", cutoff, (), batched=True)
        limits = np.broadcast_to(as_floats("cutoff", limits, self.pairs.shape[: limits.ndim]), len(self.pairs))
        if (limits <= 0.0).any():
            raise InputError(f"cutoff must be positive, got {limits.min():g}")
        places, turns = self._data.geom_xpos[None], self._data.geom_xmat.reshape(1, -1, 3, 3)
        _, index, distance, points = self.separations(places, turns, limits)
        apart = distance - self._offset[index]
        order = np.argsort(apart, kind="stable")
        pairs = self.pairs[index[order]]
        if not len(order):
            return Distances(apart, np.zeros((0, self.arm.n_joints)), pairs)
        slopes = self._slopes(pairs, points[order], distance[order])
        return Distances(apart[order], slopes @ self.arm.unit_rates(q), pairs)

    def separations(self, places: Floats, turns: Floats, cutoff: Floats | float) -> tuple[Ints, Ints, Floats, Floats]:
        """Distances of the geoms themselves, without their offsets, at I configurations at once, unsorted; unchecked.

        Args:
            places: ``(I, ngeom, 3)`` of all geoms.
            turns: ``(I, ngeom, 3, 3)`` their rotations.
            cutoff: ``(I, P)``, ``(P,)`` or ``()`` [m].

        Returns:
            Which of the configurations each is at, ``(C,)``, which pair it is, distances, and witness points.
        """
        used, first, second, limits = turns[:, self._used], self._first, self._second, cutoff + self._offset
        center = places[:, self._used] + (used @ self._center[:, :, None])[..., 0]
        some, reach = np.arange(len(first)), self._reach
        if len(center) > 4 and len(first) > 2000:
            # First drop the pairs that are far apart wherever the geoms are in these configurations.
            low, high = center.min(axis=0), center.max(axis=0)
            middle, spread = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1)
            far = reach + spread.take(first) + spread.take(second) + limits.reshape(-1, len(first)).max(axis=0)
            away = middle.take(second, axis=0) - middle.take(first, axis=0)
            some = (np.vecdot(away, away) < np.square(np.maximum(far, 0.0))).nonzero()[0]
            first, second, reach, limits = (part.take(some, axis=-1) for part in (first, second, reach, limits))
        # The configurations are the last axis, so that `take` copies whole rows.
        parts = np.ascontiguousarray(center.transpose(2, 1, 0))
        away = parts.take(second, axis=1) - parts.take(first, axis=1)
        apart = np.ascontiguousarray(np.square(away, out=away).sum(axis=0).T)
        near = (apart < np.square(np.maximum(limits + reach, 0.0))).ravel().nonzero()[0]
        at, index = np.divmod(near, len(first))
        limits = limits.take(near if limits.ndim == 2 else index)
        # First a ball against the other one's box, then both boxes along the normals of their faces; `take` needs a
        # third of the time of indexing.
        centers, frames = center.reshape(-1, 3), used.reshape(-1, 3, 3)
        one, other = first.take(index), second.take(index)
        here, there = at * len(self._used) + one, at * len(self._used) + other
        between, frame = centers.take(there, axis=0) - centers.take(here, axis=0), frames.take(here, axis=0)
        beyond = np.abs(np.vecmat(between, frame)) - self._half.take(one, axis=0)
        # Sorting out a few pairs would take longer than all that follows.
        if len(at) > 256:
            deep, outside = np.minimum(beyond.max(axis=1), 0.0), np.maximum(beyond, 0.0)
            apart = np.sqrt(np.vecdot(outside, outside)) + deep - self._radius.take(other)
            near = (apart < limits + _SLACK).nonzero()[0]
            at, index, one, other, there = (part.take(near) for part in (at, index, one, other, there))
            limits, between, beyond, frame = (part.take(near, axis=0) for part in (limits, between, beyond, frame))
        turn, half = frames.take(there, axis=0), self._half.take(other, axis=0)
        back, cosines = np.abs(np.vecmat(between, turn)) - half, np.abs(frame.swapaxes(1, 2) @ turn)
        beyond -= np.matvec(cosines, half)
        back -= np.vecmat(self._half.take(one, axis=0), cosines)
        between_boxes = np.maximum(beyond, back).max(axis=1)
        near = (between_boxes < limits + _SLACK).nonzero()[0]
        at, index, limits, last = at[near], some[index[near]], limits[near], -1
        distance, segments, nearer = np.empty(len(at)), np.empty((len(at), 6)), np.empty(6)
        pairs, fields = self.pairs[index].tolist(), self.fields[index].tolist()
        rows = zip(at.tolist(), pairs, limits.tolist(), segments, fields, strict=True)
        for row, (k, pair, limit, segment, field) in enumerate(rows):
            if k != last:
                self._data.geom_xpos[:], self._data.geom_xmat[:], last = places[k], turns[k].reshape(-1, 9), k
            least = mujoco.mj_geomDistance(self.arm.geometry, self._data, *pair, limit, segment)
            # MuJoCo takes the least of the first 50 prisms of a height field within the limit: others may be nearer.
            while field and 0.0 < least < limit:
                limit, least = least, mujoco.mj_geomDistance(self.arm.geometry, self._data, *pair, least, nearer)
                segment[:] = nearer if least < limit else segment
            distance[row] = least
        if (left := np.flatnonzero(self._rods[index] & (distance >= limits) & (between_boxes[near] < 0.0))).size:
            distance[left] = self._from_rods(places, turns, at[left], index[left])
        kept = distance < limits
        return at[kept], index[kept], distance[kept], segments[kept].reshape(-1, 2, 3)

    def _from_rods(self, places: Floats, turns: Floats, at: Ints, index: Ints) -> Floats:
        """Distances of capsules from boxes; MuJoCo takes some as apart that are not, such as with the axis inside."""
        (rod, box), size = self._rod_first[index].T, self.arm.geometry.geom_size
        turn, half, length = turns[at, box], size[box], size[rod, 1:2]
        way, off = np.vecmat(turns[at, rod, :, 2], turn), np.vecmat(places[at, rod] - places[at, box], turn)
        # The square of a point's distance from the box is quadratic between where the axis crosses planes of faces.
        with np.errstate(divide="ignore", invalid="ignore"):
            cuts = np.hstack([(-half - off) / way, (half - off) / way, -length, length])
            cuts = np.sort(np.clip(np.nan_to_num(cuts), -length, length), axis=1)
            points = off[:, None] + cuts[..., None] * way[:, None]
            slopes = ((points - np.clip(points, -half[:, None], half[:, None])) @ way[..., None])[..., 0]
            last = np.clip((slopes < 0.0).sum(axis=1, keepdims=True), 1, cuts.shape[1] - 1)
            (a, b), (f, g) = ([np.take_along_axis(v, last - n, axis=1) for n in (1, 0)] for v in (cuts, slopes))
            nearest = off + (a + (b - a) * np.clip(np.nan_to_num(-f / (g - f)), 0.0, 1.0)) * way
        return np.asarray(np.linalg.norm(nearest - np.clip(nearest, -half, half), axis=1) - size[rod, 0])

    def clearance(self, q: ArrayLike) -> float:
        """Smallest signed distance at all ``q`` ``(..., n)`` [m]; negative in penetration, infinite without pairs."""
        rows = as_floats("q", q, (self.arm.n_joints,), batched=True).reshape(-1, self.arm.n_joints)
        return self.nearest_at(self.arm.qpos(rows))[0]

    def nearest_at(self, qpos: ArrayLike) -> tuple[float, int, tuple[int, ...]]:
        """`clearance` at rows ``(K, nq)`` of the whole model, its row, and the geoms' ids, empty without pairs."""
        rows, best = as_floats("qpos", qpos, ("K", self.arm.model.nq)), (np.inf, 0, -1)

        def look(some: Ints, cutoff: Floats | float) -> None:
            nonlocal best
            distance, at, index = self._nearer(rows[some], cutoff)
            best = min([best, *zip(distance.tolist(), some[at].tolist(), index.tolist(), strict=True)])

        # First at a few rows, with a growing cutoff, so that only nearer pairs are measured at the others.
        every, cutoff = np.arange(len(rows)), 0.05
        while len(rows) and best[0] == np.inf and cutoff < 2.0 * _PLANE_SIZE:
            look(every[:: len(rows) // AT_ONCE + 1], cutoff)
            cutoff *= 4.0
        # Boxes give no bound of depths as MuJoCo measures them, so everything that overlaps is measured.
        deep = np.where(np.isfinite(self._offset), np.maximum(-self._offset, 0.0), 0.0)
        for k in range(0, len(rows) if best[0] < np.inf else 0, AT_ONCE):
            look(every[k : k + AT_ONCE], np.maximum(deep, best[0]))
        least, row, pair = best
        return least, row, tuple(self.pairs[pair].tolist()) if pair >= 0 else ()

    def is_free(
        self, q: ArrayLike, margin: float = 0.0, *, own: float | None = None, home: Floats | None = None
    ) -> bool:
        """Whether all pairs are further apart than ``margin`` [m] at ``q`` ``(n,)``, and the arm's own than ``own``.

        Pairs that are nearly that near at ``home`` ``(n,)``, such as a first link and the floor, may be a fifth nearer.
        """
        qpos, limit = self.arm.qpos(as_floats("q", q, (self.arm.n_joints,))), float(as_floats("margin", margin, ()))
        limits = np.where(self.own, limit if own is None else float(as_floats("own", own, ())), limit)
        if home is not None:
            distance, _, pairs = self._nearer(self.arm.qpos(home)[None], 1.25 * limits)
            limits[pairs] = np.minimum(limits[pairs], 0.8 * distance)
        return not len(self._nearer(qpos[None], np.nextafter(limits, np.inf))[0])

    def _nearer(self, rows: Floats, cutoff: Floats | float) -> tuple[Floats, Ints, Ints]:
        """Distances ``(C,)`` below a cutoff ``()`` or ``(P,)`` [m], their rows of ``(K, nq)``, and their pairs."""
        place = Places(self.arm.geometry, self._data, rows)
        at, index, distance, _ = self.separations(place.geoms, place.turns, cutoff)
        return np.asarray(distance - self._offset[index]), at, index

    def names(self, pair: ArrayLike) -> tuple[str, str]:
        """Names of two geoms by id; an unnamed geom is called after its body."""
        model = self.arm.model
        ids = (as_count("geom", int(geom), 0, model.ngeom - 1) for geom in as_floats("pair", pair, (2,)))
        first, second = (geom_name(model, geom) for geom in ids)
        return first, second

    def _slopes(self, pairs: Ints, points: Floats, distance: Floats) -> Floats:
        """Derivatives ``(P, nv)``, in MuJoCo's velocities, of distances just found between points ``(P, 2, 3)``."""
        model, data = self.arm.geometry, self._data
        mujoco.mj_comPos(model, data)
        for body, jacobian in zip(self._bodies.tolist(), self._jacobians, strict=False):
            mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], body)
        # Below this, the normal of two touching geoms is lost in rounding.
        apart = np.abs(distance) >= 1e-10
        normal = np.zeros((len(pairs), 3))
        normal[apart] = (points[apart, 1] - points[apart, 0]) / distance[apart, None]
        along = np.stack([-normal, normal], axis=1)
        # A point x of a body at p moves by v + w x (x - p), and n . (w x r) = (r x n) . w.
        arms = points - data.xpos[model.geom_bodyid[pairs]]
        wrenches = np.concatenate([along, np.cross(arms, along)], axis=2)
        return np.asarray((wrenches[:, :, None] @ self._jacobians[self._slots[pairs]])[:, :, 0].sum(axis=1))


typecheck_public(globals())
