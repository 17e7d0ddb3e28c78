"""Retraction: the joint position nearest to given per-joint poses, in closed form where there is one.

Compound joints that share a coordinate (coupled stages on several links) are retracted together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lieednn_sim.arm.joints import CompoundJoint, CompoundJoints
from lieednn_sim.arm.nearest import NearestPose
from lieednn_sim.lie import exp, left_jacobian_se3, left_jacobian_so3

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Retraction:
    """Joint motion nearest to given per-joint poses, with what the mechanism cannot follow.

    Attributes:
        q: ``(..., n)`` joint coordinates [rad, m].
        qd: ``(..., n)`` their rates; zero for poses at rest.
        gap_translation: ``(..., N)`` distance between given and feasible pose [m].
        gap_rotation: ``(..., N)`` angle between them [rad].
    """

    q: Floats
    qd: Floats
    gap_translation: Floats
    gap_rotation: Floats


@dataclass(frozen=True, eq=False)
class MovingPoses:
    """Poses (rotation, translation) with their angular and linear velocities in the joint frame, all ``(..., N, .)``.

    The rates are None for poses at rest.
    """

    rotation: Rotation
    translation: Floats
    omega: Floats | None
    velocity: Floats | None

    @classmethod
    def along(cls, xi: Floats, xi_dot: Floats | None) -> MovingPoses:
        """exp(xi) and its rate along xi_dot, by the left Jacobian of SE(3)."""
        pose = exp(xi)
        p = np.asarray(pose.translation)
        if xi_dot is None:
            return cls(pose.rotation, p, None, None)
        spatial = (left_jacobian_se3(xi) @ xi_dot[..., None])[..., 0]
        omega = spatial[..., :3]
        return cls(pose.rotation, p, omega, spatial[..., 3:] + np.cross(omega, p))


class _Solver(Protocol):
    """Retracts the links ``links`` onto the coordinates ``indices``."""

    links: tuple[int, ...]
    indices: NDArray[np.int_]

    def __call__(self, poses: MovingPoses) -> tuple[Floats, Floats | None]:
        """Displacements ``(..., c)`` from the reference and their rates."""


class Retractor:
    """Retracts the poses of an arm's compound joints.

    Args:
        joints: of the arm.
        length: [m] that weighs as much as one radian where a pose cannot be met and both must give way.
    """

    def __init__(self, joints: CompoundJoints, length: float) -> None:
        self._joints = joints
        self._solvers = [_solver(joints, links, length) for links in _sharing(joints)]

    @property
    def exact(self) -> bool:
        """Whether every compound joint has six freedoms, so that no pose leaves a gap."""
        return all(isinstance(solver, _SixFreedoms) for solver in self._solvers)

    def __call__(self, xi: Floats, xi_dot: Floats | None = None) -> Retraction:
        """Nearest joint position to exp(xi_i), with its derivative along xi_dot.

        Args:
            xi: ``(..., N, 6)``.
            xi_dot: ``(..., N, 6)``, or None for poses at rest.
        """
        given = MovingPoses.along(xi, xi_dot)
        reference = self._joints.reference
        q = np.broadcast_to(reference, (*xi.shape[:-2], len(reference))).copy()
        qd = np.zeros_like(q)
        for solver in self._solvers:
            offset, rate = solver(given)
            q[..., solver.indices] += offset
            if rate is not None:
                qd[..., solver.indices] = rate
        found = self._joints.poses(q)
        gap_translation = np.linalg.norm(given.translation - found.translation, axis=-1)
        gap_rotation = np.asarray((found.rotation.inv() * given.rotation).magnitude())
        return Retraction(q, qd, gap_translation, gap_rotation)


class _RevolutePrismatic:
    """Rot(axis, theta) Trans(direction s), or the two factors swapped; several coupled stages make one direction.

    The revolute coordinate is the twist angle of the swing-twist decomposition about the axis, which minimises the
    rotational distance; the prismatic one is the projection of the translation onto its direction.
    """

    def __init__(self, joint: CompoundJoint, link: int) -> None:
        hinge = next(factor for factor in joint.factors if factor.kind == "hinge")
        slides = [factor for factor in joint.factors if factor.kind == "slide"]
        self.links: tuple[int, ...] = (link,)
        self.indices = np.concatenate([hinge.indices, slides[0].indices])
        self._axis = hinge.axes[:, 0]
        self._first = joint.factors[0] is hinge
        self._direction = np.sum([slide.ratio * slide.axes[:, 0] for slide in slides], axis=0)
        self._dual = self._direction / (self._direction @ self._direction)

    @staticmethod
    def fits(joint: CompoundJoint) -> bool:
        kinds = [factor.kind for factor in joint.factors]
        hinges = [factor for factor in joint.factors if factor.kind == "hinge"]
        return (
            len(hinges) == 1
            and hinges[0].ratio == 1.0
            and np.abs(hinges[0].anchor).max() < 1e-12
            and kinds.count("slide") == len(kinds) - 1
            and "hinge" in (kinds[0], kinds[-1])
            and len(joint.indices) == 2
        )

    def __call__(self, poses: MovingPoses) -> tuple[Floats, Floats | None]:
        link = self.links[0]
        p = poses.translation[..., link, :]
        quaternion = poses.rotation.as_quat(canonical=True)[..., link, :]
        real, imaginary = quaternion[..., 3], quaternion[..., :3]
        twist = imaginary @ self._axis
        angle = 2.0 * np.arctan2(twist, real)
        turn = Rotation.from_rotvec(angle[..., None] * self._axis)
        local = turn.inv().apply(p) if self._first else p
        offset = np.stack([angle, local @ self._dual], axis=-1)
        if poses.omega is None or poses.velocity is None:
            return offset, None
        omega, velocity = poses.omega[..., link, :], poses.velocity[..., link, :]
        # Quaternion rates for an angular velocity in the joint frame: q' = (0, omega) q / 2.
        real_rate = -0.5 * (imaginary * omega).sum(axis=-1)
        imaginary_rate = 0.5 * (real[..., None] * omega + np.cross(omega, imaginary))
        angle_rate = 2.0 * (real * (imaginary_rate @ self._axis) - twist * real_rate) / (real**2 + twist**2)
        if self._first:
            velocity = turn.inv().apply(velocity) - angle_rate[..., None] * np.cross(self._axis, local)
        return offset, np.stack([angle_rate, velocity @ self._dual], axis=-1)


class _SixFreedoms:
    """Trans(S s) Rot(A w), three slides below a ball joint: every pose is met exactly."""

    def __init__(self, joint: CompoundJoint, link: int) -> None:
        *slides, ball = joint.factors
        self.links: tuple[int, ...] = (link,)
        self.indices = np.concatenate([factor.indices for factor in joint.factors])
        self._inverse = np.linalg.inv(np.column_stack([slide.ratio * slide.axes[:, 0] for slide in slides]))
        self._ball = ball.axes

    @staticmethod
    def fits(joint: CompoundJoint) -> bool:
        if [factor.kind for factor in joint.factors] != ["slide", "slide", "slide", "ball"]:
            return False
        if len(joint.indices) != 6 or np.abs(joint.factors[-1].anchor).max() > 1e-12:
            return False
        axes = np.column_stack([factor.axes[:, 0] for factor in joint.factors[:3]])
        return abs(float(np.linalg.det(axes))) > 1e-3

    def __call__(self, poses: MovingPoses) -> tuple[Floats, Floats | None]:
        link = self.links[0]
        rotvec = poses.rotation.as_rotvec()[..., link, :]
        offset = np.concatenate([poses.translation[..., link, :] @ self._inverse.T, rotvec @ self._ball], axis=-1)
        if poses.omega is None or poses.velocity is None:
            return offset, None
        turning = np.linalg.solve(left_jacobian_so3(rotvec), poses.omega[..., link, :, None])[..., 0]
        return offset, np.concatenate([poses.velocity[..., link, :] @ self._inverse.T, turning @ self._ball], axis=-1)


class _Nearest:
    """Any other joints: least squares, see `NearestPose`."""

    def __init__(self, joints: CompoundJoints, links: tuple[int, ...], length: float) -> None:
        group = [joints.joints[link] for link in links]
        self.links = links
        self.indices = np.unique(np.concatenate([joint.indices for joint in group]))
        self._problem = NearestPose(group, self.indices, len(joints.reference), length)

    def __call__(self, poses: MovingPoses) -> tuple[Floats, Floats | None]:
        links = list(self.links)
        rotation, translation = poses.rotation.as_matrix()[..., links, :, :], poses.translation[..., links, :]
        offset = self._problem.solve(rotation, translation)
        if poses.omega is None or poses.velocity is None:
            return offset, None
        rates = self._problem.rates(
            offset, rotation, translation, poses.omega[..., links, :], poses.velocity[..., links, :]
        )
        return offset, rates


def _solver(joints: CompoundJoints, links: tuple[int, ...], length: float) -> _Solver:
    joint = joints.joints[links[0]]
    if len(links) == 1 and _RevolutePrismatic.fits(joint):
        return _RevolutePrismatic(joint, links[0])
    if len(links) == 1 and _SixFreedoms.fits(joint):
        return _SixFreedoms(joint, links[0])
    return _Nearest(joints, links, length)


def _sharing(joints: CompoundJoints) -> list[tuple[int, ...]]:
    """Links in groups that have no coordinate in common."""
    groups: list[tuple[set[int], tuple[int, ...]]] = []
    for link, joint in enumerate(joints.joints):
        mine: set[int] = set(joint.indices.tolist())
        joined = [group for group in groups if group[0] & mine]
        groups = [group for group in groups if not group[0] & mine]
        links = tuple(sorted({link, *(member for group in joined for member in group[1])}))
        groups.append((mine.union(*(group[0] for group in joined)), links))
    return [links for _, links in groups]
