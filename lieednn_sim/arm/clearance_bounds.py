"""How far the joints may be from a configuration without any contact: a proof by separating planes.

Let A and B be convex geoms with a gap between them along a unit vector n, measured at a configuration q. Then the
joints are changed to q + a one after another, from the base outwards. A joint that moves both geoms moves them rigidly:
n is turned with them, and the gap stays. One that moves B alone, by the angle theta about an axis z through o, moves
the points x of B, which those before it have only moved rigidly. These have turned the axis and the points by at most
Theta, the sum of their own angles, against n. So along n, x moves by

    theta n . (z x (x - o)) + rest,    |rest| <= |z x (x - o)| |theta| (|theta| / 2 + Theta),

and for a slide by ds (n . z) + rest with |rest| <= |ds| Theta. In a ball joint |z x (x - o)| becomes |x - o|, and 1/2
becomes 3/4, since its rotation vector w turns the body by J(w) dw only to first order. Levers are those at q, whatever
the deviation. The sum over all joints is linear in a, but for the rests, and both it and n . x are linear in x: so it
suffices that the corners of a polytope around B stay off A. Any n gives a valid bound; the normal at the nearest points
gives a sharp one. Geoms are assumed to be convex; MuJoCo takes meshes for their convex hulls.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.collision import Collisions, Pairs
from lieednn_sim.arm.deviations import Group
from lieednn_sim.arm.equalities import dof_addresses
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats

# Distance below which normals are lost in rounding, so that nothing is proved [m].
_TOUCHING = 1e-6


class ClearanceBounds:
    """Proves that nothing touches while the joints are anywhere near a configuration.

    Args:
        arm: the arm, in its scene.
        groups: all coordinates in groups with weights, as of `Retractor.groups`.
        margin: distance to keep [m].

    Raises:
        InputError: a geom that could touch another is moved by a closed loop or a curve (`Arm.dependents`), of which
            nothing is proved.
    """

    def __init__(self, arm: Arm, groups: Sequence[Group], margin: float = 0.0) -> None:
        model, n = arm.model, arm.n_joints
        self._arm, self._collisions, self._margin = arm, Collisions(arm), margin
        _check_provable(arm, self._collisions.pairs)
        self._data, self._identity = mujoco.MjData(model), np.eye(n)
        self._members = np.zeros((len(groups), n))
        for row, (indices, weights) in zip(self._members, groups, strict=True):
            row[indices] = 1.0 / weights
        joints = model.dof_jntid
        self._joints, kinds = joints, model.jnt_type
        self._dof_turns = (kinds != mujoco.mjtJoint.mjJNT_SLIDE)[joints]
        self._turns = kinds != mujoco.mjtJoint.mjJNT_SLIDE
        self._is_ball = kinds == mujoco.mjtJoint.mjJNT_BALL
        self._bend = np.where(self._is_ball, 0.75, np.where(self._turns, 0.5, 0.0))
        # From coordinates to the displacements of scalar joints; and the coordinates of each ball joint.
        self._into = np.zeros((model.njnt, n))
        scalar = ~self._is_ball[joints]
        self._into[joints[scalar]] = np.abs(arm.space.rates[scalar])
        self._balls = arm.space.balls
        self._ball_joints = joints[arm.space.ball_rate_addresses[:, 0]] if len(self._balls) else np.zeros(0, int)
        self._moves = np.array([arm.moved_by(body)[model.jnt_dofadr] for body in model.geom_bodyid])
        self._hulls, self._round = _hulls(model)
        self._radius = np.linalg.norm(self._hulls, axis=-1).max(axis=1) + self._round
        self._first, self._second = self._collisions.pairs.T

    def __call__(
        self, q: Floats, path: Floats, rest: Floats, spread: Floats, most: float
    ) -> tuple[float, float, tuple[int, int]]:
        """Largest scale s for which nothing touches at any q + c path + r + d, |c| <= 1, |r_j| <= rest_j.

        The deviation d is any with |W d| <= s ``spread`` in each group, W being the group's weights.

        Args:
            q: ``(n,)`` configuration.
            path: ``(n,)`` direction.
            rest: ``(2, n)`` bounds with the path, and without it.
            spread: ``(G,)`` sizes at s = 1.
            most: no larger scale is looked for.

        Returns:
            The scale, the scale without the path (c = 0), and the geoms that limit the latter.
        """
        model, data = self._arm.model, self._data
        data.qpos[:] = self._arm.qpos(q)
        mujoco.mj_kinematics(model, data)
        each = spread @ self._members
        # Displacements of joints: along the path, without it, and by the deviation.
        steps = self._displacements(np.stack([np.abs(path) + rest[0], rest[1], each]))
        if len(self._balls):
            steps[2, self._ball_joints] = each[self._balls[:, 0]]
        near = self._near(q, steps[0] + most * steps[2])
        if near is None:
            return most, most, (-1, -1)
        gaps, normals, pairs = near
        margin = self._margin + self._collisions.offsets(pairs)
        nearest = int((gaps - margin).argmin())
        if gaps[nearest] - margin[nearest] <= _TOUCHING:
            return 0.0, 0.0, (int(pairs[nearest, 0]), int(pairs[nearest, 1]))
        fixed, moving = pairs.T
        alone = self._moves[moving] & ~self._moves[fixed]
        places, come, deviated, levers = self._corners(q, moving, normals, alone, path, rest, spread)
        # Where the other one moves alone, too, as in a branch of the arm, its reach is subtracted.
        also = self._reach[fixed] * (self._moves[fixed] & ~self._moves[moving])
        constant, linear, square = self._rests(alone, levers, steps)
        constant, linear = constant + (also @ steps[:2].T).T, linear + also @ steps[2]
        free, slope = places - come, deviated + linear[..., None]
        # Each corner against the plane at the other geom, or all of them against the measured gap.
        support = (self._support(fixed, normals) + margin)[:, None]
        each = _largest(free - support - constant[..., None], slope, square[:, None]).min(axis=-1)
        gap = gaps - margin - come.max(axis=-1) - constant
        scales = np.maximum(each, _largest(gap, slope.max(axis=-1), square))
        worst = int(scales[1].argmin())
        result = np.minimum(scales.min(axis=1), most)
        return float(result[0]), float(result[1]), (int(fixed[worst]), int(moving[worst]))

    def names(self, pair: tuple[int, int]) -> tuple[str, str]:
        """Names of two geoms."""
        return self._collisions.names(pair)

    def _displacements(self, q: Floats) -> Floats:
        """Largest displacements of the joints ``(..., J)`` for changes of the coordinates up to ``(..., n)``."""
        result = q @ self._into.T
        if len(self._balls):
            result[..., self._ball_joints] = np.linalg.norm(q[..., self._balls], axis=-1)
        return np.asarray(result)

    def _near(self, q: Floats, steps: Floats) -> tuple[Floats, Floats, Pairs] | None:
        """Gaps ``(P,)``, normals ``(P, 3)`` and geoms ``(P, 2)`` of the pairs that the steps could bring together.

        Normals lead from the first geom to the second one, which is moved by more joints.
        """
        data = self._data
        levers = np.linalg.norm(data.geom_xpos[:, None] - data.xanchor, axis=2) + self._radius[:, None]
        self._reach = np.where(self._turns, levers, 1.0) * self._moves
        table = (self._reach * steps) @ ~self._moves.T
        needed = table[self._first, self._second] + table[self._second, self._first] + self._margin
        gaps, points, pairs = self._collisions.separations(q, np.maximum(needed, 1e-9))
        if not len(gaps):
            return None
        normals = (points[:, 1] - points[:, 0]) / np.where(np.abs(gaps) > _TOUCHING, gaps, np.inf)[:, None]
        swapped = self._moves[pairs].sum(axis=2) @ [1, -1] > 0
        normals[swapped] *= -1.0
        pairs = np.where(swapped[:, None], pairs[:, ::-1], pairs)
        planes = self._arm.model.geom_type[pairs[:, 0]] == mujoco.mjtGeom.mjGEOM_PLANE
        normals[planes] = data.geom_xmat[pairs[planes, 0]].reshape(-1, 3, 3)[:, :, 2]
        return gaps, normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None], pairs

    def _points(self, geoms: NDArray[np.int_]) -> Floats:
        """Corners ``(P, V, 3)`` of the hulls of geoms."""
        rotation = self._data.geom_xmat[geoms].reshape(-1, 3, 3)
        return self._data.geom_xpos[geoms][:, None] + self._hulls[geoms] @ np.swapaxes(rotation, -1, -2)

    def _support(self, geoms: NDArray[np.int_], normals: Floats) -> Floats:
        """How far geoms reach along normals, ``(P,)``."""
        return np.asarray((self._points(geoms) @ normals[..., None])[..., 0].max(axis=1) + self._round[geoms])

    def _corners(
        self,
        q: Floats,
        geoms: NDArray[np.int_],
        normals: Floats,
        alone: Floats,
        path: Floats,
        rest: Floats,
        spread: Floats,
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """What the corners of geoms do against normals, moved by the joints ``alone`` ``(P, J)``.

        Returns:
            Their places along the normals, ``(P, V)``; how far they move along them, to first order, by path and rests,
            ``(2, P, V)``, and by the deviation, ``(P, V)``; and the longest lever arms ``(P, J)``.
        """
        points, ahead = self._points(geoms), normals[:, None]
        axes, anchors = self._axes()
        # n . (z x (x - o)) = z . (x x n) - (z x o) . n
        turning = np.cross(points, ahead) @ (axes * self._dof_turns[:, None]).T
        slopes = turning + ahead @ np.where(self._dof_turns[:, None], -np.cross(axes, anchors), axes).T
        slopes = (slopes * alone[:, None, self._joints]) @ self._rates(q)
        sizes = np.abs(slopes)
        come = np.stack([np.abs(slopes @ path) + sizes @ rest[0], sizes @ rest[1]])
        deviated = np.sqrt(np.square(slopes) @ np.square(self._members).T) @ spread
        anchors, axes = self._data.xanchor, self._data.xaxis
        square = np.square(points).sum(axis=-1)[..., None] - 2.0 * points @ anchors.T + np.square(anchors).sum(axis=1)
        along = np.where(self._is_ball, 0.0, points @ axes.T - (anchors * axes).sum(axis=1))
        levers = np.where(self._turns, np.sqrt(np.maximum(square - np.square(along), 0.0)).max(axis=1), 1.0)
        places = (points @ normals[..., None])[..., 0] - self._round[geoms][:, None]
        return places, come, deviated, alone * levers

    def _rates(self, q: Floats) -> Floats:
        """Rates ``(nv, n)`` of MuJoCo's velocities by the coordinates'."""
        return np.ascontiguousarray(self._arm.qvel(np.broadcast_to(q, self._identity.shape), self._identity).T)

    def _axes(self) -> tuple[Floats, Floats]:
        """Axes and anchors ``(nv, 3)`` of the degrees of freedom."""
        model, data = self._arm.model, self._data
        axes = data.xaxis[self._joints].copy()
        for joint in np.flatnonzero(self._is_ball):
            first = model.jnt_dofadr[joint]
            axes[first : first + 3] = data.xmat[model.jnt_bodyid[joint]].reshape(3, 3).T
        return axes, data.xanchor[self._joints]

    def _rests(self, alone: Floats, levers: Floats, steps: Floats) -> tuple[Floats, Floats, Floats]:
        """The rests as a polynomial of degree two in s: constant ``(2, P)``, linear ``(2, P)``, quadratic ``(P,)``."""

        def rests(displacements: Floats) -> Floats:
            taken = alone * displacements
            turned = np.cumsum(taken * self._turns, axis=1) - taken * self._turns
            return np.asarray((levers * taken * (turned + self._bend * taken)).sum(axis=1))

        bent = rests(steps[2])
        constant = np.stack([rests(steps[0]), rests(steps[1])])
        both = np.stack([rests(steps[0] + steps[2]), rests(steps[1] + steps[2])])
        return constant, both - constant - bent, bent


def _check_provable(arm: Arm, pairs: Pairs) -> None:
    """Raise `InputError` for pairs of geoms that joints bring together whose displacements have no bound."""
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


def _hulls(model: mujoco.MjModel) -> tuple[Floats, Floats]:
    """Corners ``(G, V, 3)`` in the geoms' frames, and radii ``(G,)`` of balls: each geom is inside their sum."""
    sides = 12  # of the prism around a cylinder
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1) / np.cos(np.pi / sides)
    prism = np.concatenate([ring, ring])
    prism[:, 2] = np.repeat([1.0, -1.0], sides)
    box = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, 8).T
    segment = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    hulls, radii = np.zeros((model.ngeom, len(prism), 3)), np.zeros(model.ngeom)
    kinds = mujoco.mjtGeom
    for geom in range(model.ngeom):
        kind, size, center = model.geom_type[geom], model.geom_size[geom], model.geom_aabb[geom, :3]
        if kind == kinds.mjGEOM_SPHERE:
            corners, radii[geom] = np.zeros((1, 3)), size[0]
        elif kind == kinds.mjGEOM_CAPSULE:
            corners, radii[geom] = size[1] * segment, size[0]
        elif kind == kinds.mjGEOM_CYLINDER:
            corners = prism * [size[0], size[0], size[1]]
        elif kind == kinds.mjGEOM_PLANE:
            corners = np.zeros((1, 3))
        else:
            corners = center + box * model.geom_aabb[geom, 3:]
        hulls[geom] = corners[np.arange(len(prism)) % len(corners)]
    return hulls, radii
