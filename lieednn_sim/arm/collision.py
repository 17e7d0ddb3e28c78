"""Signed distances between an arm's links and their surroundings, and their gradients in the joint coordinates.

Distances are MuJoCo's (`mj_geomDistance`), of the geom pairs that pass its collision filter. Bounding boxes of the
geoms give lower bounds, so that few pairs are measured. With witness points a on geom A and b on geom B at a distance
d, negative in penetration, the normal is n = (b - a) / d, and d changes at the rate n . (b' - a').
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.contacts import ContactOffsets, geom_name, move_bodies, moving_geoms
from lieednn_sim.errors import InputError
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import as_count, as_floats
from lieednn_sim.values import Floats

__all__ = ["Collisions"]

Pairs = NDArray[np.int_]

# A plane is a half-space: for the bounds, a box of this half size [m].
_PLANE_SIZE = 1e3
# Rounding of the bounds [m].
_SLACK = 1e-9


class Distances(NamedTuple):
    """Geom pairs closer than a cutoff, the nearest first.

    Attributes:
        distance: ``(P,)`` signed, from where the geoms begin to push each other [m].
        jacobian: ``(P, n)`` derivatives in the joint coordinates [m/rad, m/m]; zero for geoms that just touch.
        pairs: ``(P, 2)`` geom ids.
    """

    distance: Floats
    jacobian: Floats
    pairs: Pairs


class Collisions:
    """Distances of one arm, in the scene that its model holds.

    Holds a `mujoco.MjData` of its own: one instance for each thread.

    Attributes:
        arm: the arm.
        pairs: ``(P, 2)`` ids of the geoms that may collide, by MuJoCo's filter: contype and conaffinity, bodies
            welded together, parent and child, excludes, and the model's explicit pairs.
        own: ``(P,)`` which pairs are both parts of the arm; links may pass each other closely by design.
        offsets: the distances at which geoms begin to push each other.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.offsets, self.pairs = ContactOffsets(arm.geometry, arm.offsets), _colliding_pairs(arm.geometry)
        self._offset = self.offsets(self.pairs)
        self._data = mujoco.MjData(arm.geometry)
        # The model as it was given, once obstacles have moved.
        self._scene: mujoco.MjModel | None = None
        self.own = np.asarray(moving_geoms(arm.geometry)[self.pairs].all(axis=1))
        used, index = np.unique(self.pairs, return_inverse=True)
        self._used, self._first, self._second = used, *index.reshape(-1, 2).T
        model = arm.geometry
        self._center, self._half = model.geom_aabb[used, :3].copy(), model.geom_aabb[used, 3:].copy()
        planes = model.geom_type[used] == mujoco.mjtGeom.mjGEOM_PLANE
        self._center[planes], self._half[planes] = (0.0, 0.0, -_PLANE_SIZE), _PLANE_SIZE
        self._radius = np.linalg.norm(self._half, axis=1)
        # MuJoCo's bounding sphere is smaller than the box's, but centred at the geom's frame: used where these agree.
        centred = ~planes & (np.abs(self._center).max(axis=1) < _SLACK) & (model.geom_rbound[used] > 0.0)
        self._radius[centred] = np.minimum(self._radius, model.geom_rbound[used])[centred]
        self._segment = np.zeros(6)
        # The moving bodies, which of them each geom belongs to, and their Jacobians; the last is zero, for fixed ones.
        bodies = np.unique(model.geom_bodyid[used])
        self._bodies = bodies[model.body_weldid[bodies] != 0]
        slots = np.full(model.nbody, len(self._bodies))
        slots[self._bodies] = np.arange(len(self._bodies))
        self._slots = slots[model.geom_bodyid]
        self._jacobians = np.zeros((len(self._bodies) + 1, 6, model.nv))

    def move(self, places: Mapping[str, ArrayLike]) -> None:
        """Put obstacles where they are now, and all others back where the scene has them, in another `Arm.geometry`.

        Args:
            places: positions ``(3,)`` of bodies without joints, in the frames of their parents [m], by name.

        Raises:
            InputError: there is no such body, or a value is malformed.
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

        Raises:
            InputError: q is malformed, or the cutoff is not positive.
        """
        self._move(q)
        limits = as_floats("cutoff", cutoff, (), batched=True)
        limits = np.broadcast_to(as_floats("cutoff", limits, self.pairs.shape[: limits.ndim]), len(self.pairs))
        if (limits <= 0.0).any():
            raise InputError(f"cutoff must be positive, got {limits.min():g}")
        data, turns = self._data, self._data.geom_xmat.reshape(1, -1, 3, 3)
        _, index, distance, points = self.separations(data.qpos[None].copy(), data.geom_xpos[None], turns, limits[None])
        apart = distance - self._offset[index]
        order = np.argsort(apart, kind="stable")
        pairs = self.pairs[index[order]]
        if not len(order):
            return Distances(apart, np.zeros((0, self.arm.n_joints)), pairs)
        slopes = self._slopes(pairs, points[order], distance[order])
        return Distances(apart[order], slopes @ self.arm.unit_rates(q), pairs)

    def separations(
        self, qpos: Floats, places: Floats, turns: Floats, cutoff: Floats
    ) -> tuple[NDArray[np.int_], NDArray[np.int_], Floats, Floats]:
        """Distances of the geoms themselves, without their offsets, at positions ``(I, nq)`` at once, unsorted.

        Args:
            qpos: positions of everything in the model.
            places: ``(I, ngeom, 3)`` of all geoms there.
            turns: ``(I, ngeom, 3, 3)`` their rotations.
            cutoff: ``(I, P)`` [m].

        Returns:
            Which of the positions each is at, ``(C,)``, which pair it is, distances, and witness points.
        """
        model, count = self.arm.geometry, len(as_floats("qpos", qpos, ("I", self.arm.model.nq)))
        as_floats("cutoff", cutoff, (count, len(self.pairs)), largest=np.inf)
        places = as_floats("places", places, (count, model.ngeom, 3))
        turns = as_floats("turns", turns, (count, model.ngeom, 3, 3))[:, self._used]
        center = places[:, self._used] + (turns @ self._center[:, :, None])[..., 0]
        reach, first, second = self._radius, self._first, self._second
        wanted = cutoff + self._offset + _SLACK
        places = np.ascontiguousarray(np.moveaxis(center, -1, 0))
        x, y, z = places.take(second, axis=-1) - places.take(first, axis=-1)
        apart = np.sqrt(x * x + y * y + z * z) - reach[first] - reach[second]
        at, index = np.nonzero(apart < wanted)
        # Boxes along the normals of the faces of each.
        one, other = first[index], second[index]
        between = center[at, other] - center[at, one]
        cosines = np.swapaxes(turns[at, one], -1, -2) @ turns[at, other]
        half, halves = self._half[one], self._half[other]
        beyond = np.abs(np.vecmat(between, turns[at, one])) - half - np.matvec(np.abs(cosines), halves)
        back = np.abs(np.vecmat(between, turns[at, other])) - halves - np.vecmat(half, np.abs(cosines))
        near = np.maximum(beyond.max(axis=1), back.max(axis=1)) < wanted[at, index]
        at, index = at[near], index[near]
        # Of the geoms themselves, without their offsets.
        limits, last = cutoff[at, index] + self._offset[index], -1
        distance, segments = np.empty(len(at)), np.empty((len(at), 6))
        rows = zip(at.tolist(), self.pairs[index].tolist(), limits.tolist(), segments, strict=True)
        for row, (k, (first, second), limit, segment) in enumerate(rows):
            if k != last:
                self._move_to(qpos[k])
                last = k
            distance[row] = mujoco.mj_geomDistance(model, self._data, first, second, limit, segment)
        kept = distance < limits
        return at[kept], index[kept], distance[kept], segments[kept].reshape(-1, 2, 3)

    def clearance(self, q: ArrayLike) -> float:
        """The smallest signed distance at ``q`` ``(n,)`` [m]; negative in penetration, infinite without pairs."""
        self._move(q)
        return self._least()

    def _least(self) -> float:
        bounds = self._lower_bounds()
        best = np.inf
        for index in np.argsort(bounds, kind="stable").tolist():
            if bounds[index] >= best:
                break
            best = min(best, self._measure(index, best if np.isfinite(best) else bounds[index] + 2.0 * _PLANE_SIZE))
        return best

    def least_clearance(self, q: ArrayLike) -> float:
        """The smallest `clearance` at configurations ``(K, n)`` [m]; fastest where consecutive ones are close."""
        return self.least_clearance_at(self.arm.qpos(as_floats("q", q, ("K", self.arm.n_joints))))

    def least_clearance_at(self, qpos: ArrayLike) -> float:
        """The same at positions ``(K, nq)`` of everything in the model.

        A pair is measured again only where it may have come closer than the least so far: no point of a geom moves
        further than its bounding sphere's centre plus what the rotation moves it about that centre.
        """
        rows = as_floats("qpos", qpos, ("K", self.arm.model.nq))
        if not len(rows):
            return np.inf
        self._move_to(rows[0])
        least = self._least()
        bounds, (center, rotation) = self._lower_bounds(), self._frames()
        model, data = self.arm.geometry, self._data
        # Penetration depths are not bounded by how far geoms move.
        deep = -np.minimum(self._offset, 0.0)
        for data.qpos[:] in rows[1:]:
            mujoco.mj_kinematics(model, data)
            before, (center, rotation) = (center, rotation), self._frames()
            # The 2-norm of a difference of rotations is its Frobenius norm over sqrt(2).
            turned = np.sqrt(0.5 * np.square(rotation - before[1]).sum(axis=(1, 2)))
            moved = np.linalg.norm(center - before[0], axis=1) + self._radius * turned
            bounds -= moved[self._first] + moved[self._second]
            for index in np.flatnonzero(bounds < np.maximum(max(least, 0.0), deep)).tolist():
                # Measured a little further, so that it is skipped until the geoms have moved as much.
                bounds[index] = value = self._measure(index, max(least, 0.0) + 0.1)
                least = min(least, value)
        return least

    def is_free(self, q: ArrayLike, margin: float = 0.0, *, own: float | None = None) -> bool:
        """Whether all pairs are further apart than ``margin`` [m] at ``q`` ``(n,)``, and the arm's own than ``own``."""
        self._move(q)
        limit = float(as_floats("margin", margin, ()))
        limits = np.where(self.own, limit if own is None else float(as_floats("own", own, ())), limit)
        near = np.flatnonzero(self._lower_bounds() <= limits)
        return all(self._measure(index, abs(limits[index]) + 1.0) > limits[index] for index in near.tolist())

    def _measure(self, index: int, most: float) -> float:
        """Distance of a pair [m], or ``most`` where its geoms are further apart; the witness points are `_segment`."""
        (first, second), offset = self.pairs[index].tolist(), float(self._offset[index])
        most += offset
        return float(mujoco.mj_geomDistance(self.arm.geometry, self._data, first, second, most, self._segment)) - offset

    def names(self, pair: ArrayLike) -> tuple[str, str]:
        """Names of two geoms by id; an unnamed geom is called after its body."""
        first, second = as_floats("pair", pair, (2,))
        return self._name(int(first)), self._name(int(second))

    def _name(self, geom: int) -> str:
        return geom_name(self.arm.model, as_count("geom", geom, 0, self.arm.model.ngeom - 1))

    def _move(self, q: ArrayLike) -> None:
        self._move_to(self.arm.qpos(as_floats("q", q, (self.arm.n_joints,))))

    def _move_to(self, qpos: Floats) -> None:
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.arm.geometry, self._data)

    def _frames(self) -> tuple[Floats, Floats]:
        """Centres ``(G, 3)`` and rotations ``(G, 3, 3)`` of the geoms' boxes."""
        rotation = self._data.geom_xmat[self._used].reshape(-1, 3, 3)
        return self._data.geom_xpos[self._used] + (rotation @ self._center[:, :, None])[:, :, 0], rotation

    def _lower_bounds(self) -> Floats:
        """Lower bounds ``(P,)`` of the distances, from boxes along their faces' normals and from bounding spheres."""
        count, half, first, second = len(self._used), self._half, self._first, self._second
        if not count:
            return np.zeros(0)
        center, rotation = self._frames()
        # All geoms at once, in arrays (geom, its axis, other geom): a few large products beat many small ones.
        axes = np.ascontiguousarray(rotation.transpose(0, 2, 1)).reshape(-1, 3)
        own = (rotation.transpose(0, 2, 1) @ center[:, :, None]).reshape(-1, 1)
        beyond = (np.abs(axes @ center.T - own) - half.reshape(-1, 1)).reshape(count, 3, count)
        extent = np.einsum("ghk,hk->gh", np.abs(axes @ axes.T).reshape(-1, count, 3), half)
        faces = (beyond - extent.reshape(count, 3, count)).max(axis=1)
        balls = np.sqrt((np.maximum(beyond, 0.0) ** 2).sum(axis=1)) - self._radius
        # A sphere whose centre is inside the box says nothing about the depth.
        table = np.maximum(faces, np.where(balls > 0.0, balls, -np.inf))
        return np.asarray(np.maximum(table[first, second], table[second, first]) - self._offset - _SLACK)

    def _slopes(self, pairs: Pairs, points: Floats, distance: Floats) -> Floats:
        """Derivatives ``(P, nv)``, in MuJoCo's velocities, of distances just found between points ``(P, 2, 3)``."""
        model, data = self.arm.geometry, self._data
        mujoco.mj_comPos(model, data)
        for body, jacobian in zip(self._bodies.tolist(), self._jacobians, strict=False):
            mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], body)
        # At less the normal of two touching geoms is lost in rounding.
        apart = np.abs(distance) >= 1e-10
        normal = np.zeros((len(pairs), 3))
        normal[apart] = (points[apart, 1] - points[apart, 0]) / distance[apart, None]
        along = np.stack([-normal, normal], axis=1)
        # A point x of a body at p moves by v + w x (x - p), and n . (w x r) = (r x n) . w.
        arms = points - data.xpos[model.geom_bodyid[pairs]]
        wrenches = np.concatenate([along, np.cross(arms, along)], axis=2)
        return np.asarray((wrenches[:, :, None] @ self._jacobians[self._slots[pairs]])[:, :, 0].sum(axis=1))


def _colliding_pairs(model: mujoco.MjModel) -> Pairs:
    """Geom pairs ``(P, 2)`` that pass MuJoCo's collision filter, and the explicit ones."""
    first, second = np.triu_indices(model.ngeom, k=1)
    kind, affinity = model.geom_contype, model.geom_conaffinity
    meets = ((kind[first] & affinity[second]) | (kind[second] & affinity[first])) != 0
    first, second = first[meets], second[meets]
    bodies = model.geom_bodyid[first], model.geom_bodyid[second]
    weld = model.body_weldid
    apart = weld[bodies[0]] != weld[bodies[1]]
    if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        parent = weld[model.body_parentid[weld]]
        welds = weld[bodies[0]], weld[bodies[1]]
        related = (welds[0] == parent[welds[1]]) | (welds[1] == parent[welds[0]])
        apart &= ~(related & (welds[0] != 0) & (welds[1] != 0))
    signature = (np.minimum(*bodies).astype(np.int64) << 16) + np.maximum(*bodies)
    apart &= ~np.isin(signature, model.exclude_signature)
    implicit = np.stack([first[apart], second[apart]], axis=1)
    explicit = np.sort(np.stack([model.pair_geom1, model.pair_geom2], axis=1).astype(int), axis=1)
    pairs = np.unique(np.concatenate([implicit, explicit]), axis=0)
    pairs.setflags(write=False)
    return pairs


typecheck_public(globals())
