"""How far the joints may be from a configuration without any contact: a proof by separating planes.

Let A and B be convex geoms with a gap between them along a unit vector n, measured at a configuration q. Step 4 of
`docs/mathematics/tube.md` bounds how far changes of the joints move the points x of B along n. The bound is linear in x
and, except for a remainder of second order, in the changes. So it suffices that the corners of a polytope around B stay
off A. For a ball joint the lever |z x (x - o)| becomes |x - o|, and 1/2 becomes 3/4, since its rotation vector w turns
the body by J(w) dw only to first order. Levers are computed at q, whatever the deviation. Any n gives a valid bound;
the normal at the nearest points gives a sharp one. Geoms are assumed to be convex, as MuJoCo takes meshes to be.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.checks import BALL, SLIDE, ancestry
from lieednn_sim.arm.collision import AT_ONCE, ROUNDED, Collisions, Places
from lieednn_sim.arm.contacts import moving_geoms, without_clearance
from lieednn_sim.arm.deviations import Group
from lieednn_sim.arm.equalities import dof_addresses
from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.values import Floats, Ints

_TOUCHING = 1e-6  # distance below which normals are lost in rounding, so that nothing is proved [m]


class _Changes(NamedTuple):
    """How the coordinates may change at P configurations, as in a call of `ClearanceBounds`."""

    rates: Floats  # (P, nv, n) velocities of the model's dofs per unit rate of each coordinate
    path: Floats  # (P, n)
    rest: Floats  # (P, 2, n)
    spread: Floats  # (P, G)


class ClearanceBounds:
    """Proves that nothing touches while the joints are anywhere near a few configurations.

    Args:
        arm: the arm, in its scene.
        groups: groups of all coordinates, with weights, as in `Retractor.groups`.
        margin: distance to keep [m].
        own: whether the arm's own parts, its base included, count against each other.

    Raises:
        InputError: there is a flex, or a geom that could touch another is of the type sdf, or is moved by a closed loop
            or a curve (`Arm.dependents`), for which there is no bound.
    """

    def __init__(self, arm: Arm, groups: Sequence[Group], margin: float = 0.0, own: bool = True) -> None:
        model, n = arm.model, arm.n_joints
        self._arm, self._collisions = arm, Collisions(arm)
        self.names = self._collisions.names
        _check_provable(arm, self._collisions.pairs)
        # In collisions, MuJoCo takes as the distance of two boxes the largest one along normals of their Minkowski sum,
        # at least 1 / sqrt(3) of it: three normals, at most at right angles, are around the nearest point's direction.
        boxes = (model.geom_type[self._collisions.pairs] == int(mujoco.mjtGeom.mjGEOM_BOX)).all(axis=1)
        offsets = np.maximum(self._collisions.offsets(self._collisions.pairs), 0.0)
        self._margins = margin + (np.sqrt(3.0) - 1.0) * boxes * offsets
        self._data = mujoco.MjData(model)
        self._members = np.zeros((len(groups), n))
        for row, (indices, weights) in zip(self._members, groups, strict=True):
            row[indices] = 1.0 / weights
        self._joints = joints = model.dof_jntid
        self._turns, self._is_ball = model.jnt_type != SLIDE, model.jnt_type == BALL
        self._dof_turns = self._turns[joints]
        self._bend = np.where(self._is_ball, 0.75, np.where(self._turns, 0.5, 0.0))
        # The map from coordinates to displacements of scalar joints, and the coordinates of each ball joint.
        self._into = np.zeros((model.njnt, n))
        scalar = ~self._is_ball[joints]
        self._into[joints[scalar]] = np.abs(arm.space.rates[scalar])
        self._balls = arm.space.balls
        self._ball_joints = joints[arm.space.ball_rate_addresses[:, 0]] if len(self._balls) else np.zeros(0, int)
        # Bodies that are welded together move alike, so one of them is looked up.
        bodies, which = np.unique(model.body_weldid[model.geom_bodyid], return_inverse=True)
        moves = [arm.moved_by(body)[model.jnt_dofadr] for body in bodies.tolist()]
        self._moves = np.array(moves, dtype=bool).reshape(-1, model.njnt)[which]
        self._hulls, self._counts, self._round, self._flat, self._oval, self._meshes = _hulls(model)
        self._radius = np.linalg.norm(self._hulls, axis=-1).max(axis=1) + self._round
        # Geoms that the same joints move form a group. `_still` says which joints do not move each group; `_places` has
        # the index of each geom of a pair, with the other geom's group, in a flattened table of geoms and groups.
        alike, group = np.unique(self._moves, axis=0, return_inverse=True)
        self._still, (first, second) = (~alike.T).astype(float), self._collisions.pairs.T
        self._places = first * len(alike) + group.ravel()[second], second * len(alike) + group.ravel()[first]
        parts = moving_geoms(arm.geometry) | np.isin(model.geom_bodyid, ancestry(model, int(arm.frames.bodies[-1]))[1:])
        self._parts, self._counted = parts, np.asarray(~parts[self._collisions.pairs].all(axis=1) | own)

    def __call__(
        self, q: Floats, path: Floats, rest: Floats, spread: Floats, most: float
    ) -> tuple[Floats, Floats, Ints]:
        """Largest scales s for which nothing touches at any q + c path + r + d, |c| <= 1, |r_j| <= rest_j.

        ``q`` and ``path`` are ``(I, n)``; ``rest`` ``(I, 2, n)`` has the bounds with the path and without it (c = 0).
        The deviation d is any with |W d| <= s ``spread`` ``(I, G)`` in each group, W being the group's weights.

        Returns:
            Scales ``(I,)`` up to ``most``; those without the path; and the geoms ``(I, 2)`` of the latter, or -1.
        """
        if len(q) > AT_ONCE:
            return _in_parts(partial(self, most=most), q, path, rest, spread)
        each = spread @ self._members
        # Displacements of joints: along the path, without it, and by the deviation.
        steps = self._displacements(np.stack([np.abs(path) + rest[:, 0], rest[:, 1], each]))
        if len(self._balls):
            steps[2][:, self._ball_joints] = each[:, self._balls[:, 0]]
        at, pairs, free, gap, slope, square = self._rows(q, path, rest, spread, steps, steps[0] + most * steps[2], 0.0)
        corners = _largest(free, slope, square[:, None]).min(axis=-1)
        found = np.maximum(corners, _largest(gap, slope.max(axis=-1, initial=0.0), square))
        whole, _ = _least(found.min(axis=0), at, pairs, len(q), most)
        there, limiting = _least(found[1], at, pairs, len(q), most)
        return whole, there, limiting

    def least(self, q: Floats, path: Floats, rest: Floats, cutoff: float) -> tuple[Floats, Floats, Ints]:
        """Lower bounds of the distance from contact at all q + c path + r, |c| <= 1, |r_j| <= rest_j [m].

        ``q``, ``path`` and ``rest`` are as for a call.

        Returns:
            Bounds ``(I,)`` up to the cutoff [m], and at least -1, their value where loops cannot be closed; those
            without the path; and the geoms ``(I, 2)`` that set the first, or -1.
        """
        if len(q) > AT_ONCE:
            return _in_parts(partial(self.least, cutoff=cutoff), q, path, rest)
        steps, still = np.zeros((3, len(q), len(self._turns))), np.zeros((len(q), len(self._members)))
        steps[:2] = self._displacements(np.stack([np.abs(path) + rest[:, 0], rest[:, 1]]))
        try:
            at, pairs, free, gap, _, _ = self._rows(q, path, rest, still, steps, steps[0], cutoff)
        except NoSolutionError:
            return np.full(len(q), -1.0), np.full(len(q), -1.0), np.full((len(q), 2), -1)
        whole, there = np.maximum(np.maximum(free.min(axis=-1, initial=cutoff), gap), -1.0)
        (least, limiting), (middle, _) = (_least(found, at, pairs, len(q), cutoff) for found in (whole, there))
        return least, middle, limiting

    def _rows(
        self, q: Floats, path: Floats, rest: Floats, spread: Floats, steps: Floats, widest: Floats, cutoff: float
    ) -> tuple[Ints, Ints, Floats, Floats, Floats, Floats]:
        """Pairs of geoms that displacements ``widest`` ``(I, J)`` of the joints could bring nearer than a cutoff.

        Returns:
            For each pair, the index of its configuration, ``(P,)``; its geoms; and the distance that is left at each
            corner, ``(2, P, V)``, and for the pair as a whole, ``(2, P)``, with the path and without it. A deviation of
            scale s takes ``(P, V)`` times s plus ``(P,)`` times s^2 of it.
        """
        qpos = self._arm.qpos(q)
        place = Places(self._arm.model, self._data, qpos)
        # Component by component, which takes a quarter of the time of norms over a short axis.
        x, y, z = (place.geoms[..., k, None] - place.anchors[:, None, :, k] for k in range(3))
        levers = np.sqrt(x * x + y * y + z * z) + self._radius[:, None]
        reach = np.where(self._turns, levers, 1.0) * self._moves
        table = ((reach * widest[:, None]) @ self._still).reshape(len(q), -1)
        moved = table.take(self._places[0], axis=1) + table.take(self._places[1], axis=1)
        near = np.where(self._counted, moved + (cutoff + self._margins), -np.inf)
        at, index, gaps, points = self._collisions.separations(place.geoms, place.turns, near)
        if not len(at):
            return at, self._collisions.pairs[:0], np.empty((2, 0, 1)), np.empty((2, 0)), np.empty((0, 1)), gaps
        pairs, normals = self._normals(place, at, self._collisions.pairs[index], gaps, points)
        margin = self._margins[index] + self._collisions.offsets(pairs)
        fixed, moving = pairs.T
        alone = self._moves[moving] & ~self._moves[fixed]
        changes = _Changes(np.ascontiguousarray(self._arm.unit_rates(q))[at], path[at], rest[at], spread[at])
        places, come, deviated, levers = self._corners(place, at, moving, normals, alone, changes)
        # What joints do that move only the other geom, as in a branch of the arm, is bounded by its reach.
        also = reach[at, fixed] * (self._moves[fixed] & ~self._moves[moving])
        taken = steps[:, at]
        constant, linear, square = self._rests(alone, levers, taken)
        constant, linear = constant + (also * taken[:2]).sum(axis=-1), linear + (also * taken[2]).sum(axis=-1)
        slope = deviated + linear[..., None]
        # The distance of each corner from the plane at the other geom, and of all of them by the measured gap, of which
        # no more counts than what lies between the geoms along the normal: MuJoCo's solvers are not exact.
        facing = np.concatenate([normals, -normals])
        support, behind = np.split(self._reaches(place, np.tile(at, 2), np.concatenate([fixed, moving]), facing), 2)
        hollow = self._collisions.fields[index]
        gaps = np.where(hollow, gaps, np.minimum(gaps, -behind - support))
        free = places - come - (support + margin)[:, None] - constant[..., None]
        gap = gaps - margin - come.max(axis=-1, initial=0.0) - constant
        # Geoms that touch have no normal, and no plane separates geoms that are not convex.
        touching = gaps - margin <= _TOUCHING
        free[:, touching], gap[:, touching] = np.minimum(free[:, touching], 0.0), np.minimum(gap[:, touching], 0.0)
        # Parts near a height field count with their whole reach, in all directions.
        widest, far = np.stack([widest, widest - steps[0] + steps[1]]), alone * reach[at, moving] + also
        free[:, hollow] = -np.inf
        gap[:, hollow] = (gaps - margin)[hollow] - np.vecdot(far[hollow], widest[:, at[hollow]])
        return at, pairs, free, gap, slope, square

    def owns(self, pair: tuple[int, int]) -> bool:
        """Whether two geoms are both parts of the arm, its base included."""
        return bool(self._parts[[*pair]].all())

    def _displacements(self, q: Floats) -> Floats:
        """Largest displacements of the joints ``(..., J)`` for changes of the coordinates up to ``(..., n)``."""
        result = q @ self._into.T
        if len(self._balls):
            result[..., self._ball_joints] = self._arm.space.angles(q)
        return np.asarray(result)

    def _normals(self, place: Places, at: Ints, pairs: Ints, gaps: Floats, points: Floats) -> tuple[Ints, Floats]:
        """Pairs, ordered so that more joints move the second geom, and unit normals ``(P, 3)`` that point to it."""
        normals = (points[:, 1] - points[:, 0]) / np.where(np.abs(gaps) > _TOUCHING, gaps, np.inf)[:, None]
        swapped = self._moves[pairs].sum(axis=2) @ [1, -1] > 0
        normals[swapped] *= -1.0
        pairs = np.where(swapped[:, None], pairs[:, ::-1], pairs)
        planes = self._arm.model.geom_type[pairs[:, 0]] == int(mujoco.mjtGeom.mjGEOM_PLANE)
        normals[planes] = place.turns[at[planes], pairs[planes, 0], :, 2]
        return pairs, normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]

    def _reaches(self, place: Places, at: Ints, geoms: Ints, ways: Floats) -> Floats:
        """The largest n . x ``(P,)`` of the points x of geoms, for unit vectors n ``(P, 3)`` [m]."""
        own = np.vecmat(ways, place.turns[at, geoms])
        oval = own * self._oval[geoms]
        reach = np.vecdot(np.abs(own), self._flat[geoms]) + np.sqrt(np.vecdot(oval, oval))
        for geom in self._meshes.keys() & set(geoms.tolist()):
            rows = np.flatnonzero(geoms == geom)
            reach[rows] = (own[rows] @ self._meshes[geom].T).max(axis=1)
        return np.asarray(reach + np.vecdot(place.geoms[at, geoms], ways))

    def _corners(
        self, place: Places, at: Ints, geoms: Ints, normals: Floats, alone: Floats, changes: _Changes
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """How the corners of geoms move along normals if only the joints ``alone`` ``(P, J)`` move them.

        Returns:
            The positions of the corners along the normals, ``(P, V)``; how far, to first order, they move along them by
            path and rest, ``(2, P, V)``, and by the deviation, ``(P, V)``; and the longest lever arms ``(P, J)``.
        """
        corners = self._hulls[geoms, : self._counts[geoms].max(initial=1)]  # of each hull as many as the largest has
        turned = corners @ np.swapaxes(place.turns[at, geoms], -1, -2)
        points, ahead = place.geoms[at, geoms][:, None] + turned, normals[:, None]
        axes, anchors = place.axes[:, self._joints], place.anchors[:, self._joints]
        for joint in np.flatnonzero(self._is_ball):
            turns = place.bodies[:, self._arm.model.jnt_bodyid[joint]].reshape(-1, 3, 3)
            axes[:, self._joints == joint] = np.swapaxes(turns, -1, -2)
        # n . (z x (x - o)) = z . (x x n) - (z x o) . n
        turn = np.swapaxes(axes * self._dof_turns[:, None], -1, -2)
        shift = np.swapaxes(np.where(self._dof_turns[:, None], -np.cross(axes, anchors), axes), -1, -2)
        slopes = np.cross(points, ahead) @ turn[at] + ahead @ shift[at]
        slopes = (slopes * alone[:, None, self._joints]) @ changes.rates
        sizes = np.abs(slopes)
        moved = np.abs((slopes @ changes.path[..., None])[..., 0])
        come = (sizes @ np.swapaxes(changes.rest, -1, -2)).transpose(2, 0, 1)
        come[0] += moved
        deviated = (np.sqrt(np.square(slopes) @ np.square(self._members).T) @ changes.spread[..., None])[..., 0]
        # From the geoms' origins, since squares far from the world's lose digits.
        anchors, axes = place.anchors[at] - place.geoms[at, geoms][:, None], place.axes[at]
        square = np.square(turned).sum(axis=-1)[..., None] - 2.0 * turned @ np.swapaxes(anchors, -1, -2)
        square += np.square(anchors).sum(axis=-1)[:, None]
        along = turned @ np.swapaxes(axes, -1, -2) - (anchors * axes).sum(axis=-1)[:, None]
        along = np.where(self._is_ball, 0.0, along)
        levers = np.where(self._turns, np.sqrt(np.maximum(square - np.square(along), 0.0)).max(axis=1), 1.0)
        places = (points @ normals[..., None])[..., 0] - self._round[geoms][:, None]
        return places, come, deviated, alone * levers

    def _rests(self, alone: Floats, levers: Floats, steps: Floats) -> tuple[Floats, Floats, Floats]:
        """Second-order remainders as a polynomial in s: constant ``(2, P)``, linear ``(2, P)``, quadratic ``(P,)``."""

        def rests(displacements: Floats) -> Floats:
            taken = alone * displacements
            turned = np.cumsum(taken * self._turns, axis=-1) - taken * self._turns
            return np.asarray((levers * taken * (turned + self._bend * taken)).sum(axis=-1))

        each, both = rests(steps), rests(steps[:2] + steps[2])
        return each[:2], both - each[:2] - each[2], each[2]


def _in_parts(bound: Callable[..., tuple[NDArray[Any], ...]], *rows: Floats) -> Any:
    """The arrays that a function returns for rows ``(I, ...)``, of which it is given at most `AT_ONCE` per call."""
    parts = range(0, len(rows[0]), AT_ONCE)
    made = [bound(*(values[k : k + AT_ONCE] for values in rows)) for k in parts]
    return tuple(map(np.concatenate, zip(*made, strict=True)))


def _least(found: Floats, at: Ints, pairs: Ints, count: int, most: float) -> tuple[Floats, Ints]:
    """The least of values ``(P,)`` at each of ``count`` configurations, at most ``most``, and the pairs with it."""
    least, limiting = np.full(count, most), np.full((count, 2), -1)
    np.minimum.at(least, at, found)
    which = np.flatnonzero((found == least[at]) & (found < most))
    limiting[at[which]] = pairs[which]
    return least, limiting


def _check_provable(arm: Arm, pairs: Ints) -> None:
    """Raise `InputError` for pairs of geoms whose distances or displacements have no bound."""
    if said := without_clearance(arm.geometry):
        raise InputError(f"no proof of clearance: {said}")
    if arm.dependents is None:
        return
    model, straight = arm.model, {*arm.dependents.lines, *arm.dependents.sums}
    curved = dof_addresses(model, [joint for joint in arm.dependents.moved if joint not in straight])
    bodies = model.geom_bodyid[pairs]
    moves = np.array([arm.moved_by(body)[curved] for body in range(model.nbody)])
    for first, second in bodies[(moves[bodies[:, 0]] != moves[bodies[:, 1]]).any(axis=1)].tolist():
        body = model.body(first if moves[first].any() else second).name
        raise InputError(
            f"no proof of clearance: body {body!r} is moved by a closed loop or a curve, and could touch others; there "
            "are bounds for what the arm's joints move, or joints that follow them in a straight line"
        )


def _largest(free: Floats, slope: Floats, bent: Floats) -> Floats:
    """The largest s with free - slope s - bent s^2 >= 0, zero if there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        result = 2.0 * free / (slope + np.sqrt(np.square(slope) + 4.0 * bent * np.maximum(free, 0.0)))
    return np.where(free > 0.0, np.where(np.isnan(result), np.inf, result), 0.0)


def _hulls(model: mujoco.MjModel) -> tuple[Floats, Ints, Floats, Floats, Floats, dict[int, Floats]]:
    """Polytopes around geoms, and their exact shapes, in their frames.

    Returns:
        Corners ``(G, V, 3)``, how many are distinct, radii of balls around these; then half sizes ``(G, 3)`` of a box
        and of an ellipsoid, whose sum the geom is; or the corners ``(M, 3)`` of a mesh, by its geom.
    """
    sides = 12  # of the prism around a cylinder
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1) / np.cos(np.pi / sides)
    prism = np.concatenate([ring, ring])
    prism[:, 2] = np.repeat([1.0, -1.0], sides)
    box = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, 8).T
    segment = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    hulls, counts, radii = np.zeros((model.ngeom, len(prism), 3)), np.ones(model.ngeom, int), np.zeros(model.ngeom)
    kinds, meshes = mujoco.mjtGeom, dict[int, Floats]()
    own = (kinds.mjGEOM_BOX, kinds.mjGEOM_ELLIPSOID)  # others follow
    flat, oval = (np.where(model.geom_type[:, None] == int(kind), model.geom_size, 0.0) for kind in own)
    for geom in range(model.ngeom):
        kind, size, aabb = kinds(model.geom_type[geom]), model.geom_size[geom], model.geom_aabb[geom]
        corners = aabb[:3] + box * (aabb[3:] + ROUNDED * np.abs(aabb).sum())
        if kind == kinds.mjGEOM_SPHERE:
            corners, radii[geom], oval[geom] = np.zeros((1, 3)), size[0], size[0]
        elif kind == kinds.mjGEOM_CAPSULE:
            corners, radii[geom], oval[geom], flat[geom, 2] = size[1] * segment, size[0], size[0], size[1]
        elif kind == kinds.mjGEOM_CYLINDER:
            corners, oval[geom, :2], flat[geom, 2] = prism * [size[0], size[0], size[1]], size[0], size[1]
        elif kind == kinds.mjGEOM_PLANE:
            corners = np.zeros((1, 3))
        elif kind == kinds.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            meshes[geom] = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]].astype(float)
            if (start := int(model.mesh_graphadr[mesh])) >= 0:
                # The graph of its hull: numbers of corners and faces, an entry for each corner, and the corners' ids.
                count = int(model.mesh_graph[start])
                meshes[geom] = meshes[geom][model.mesh_graph[start + 2 + count :][:count]]
        hulls[geom], counts[geom] = corners[np.arange(len(prism)) % len(corners)], len(corners)
    return hulls, counts, radii, flat, oval, meshes
