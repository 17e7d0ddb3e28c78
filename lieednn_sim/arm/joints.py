"""Compound joints: one revolute and one prismatic axis as a pose T(q) in SE(3), and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim.lie import exp, left_jacobian_se3, left_jacobian_so3, log

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Retraction:
    """Joint motion nearest to given per-joint poses, with what the mechanism cannot follow.

    Attributes:
        q: ``(..., 2N)`` joint positions [rad, m], in the arm's order.
        qd: ``(..., 2N)`` their rates; zero for poses at rest.
        gap_translation: ``(..., N)`` distance between given and feasible pose [m].
        gap_rotation: ``(..., N)`` angle between them [rad].
    """

    q: Floats
    qd: Floats
    gap_translation: Floats
    gap_rotation: Floats


@dataclass(frozen=True)
class CompoundJoints:
    """N compound joints, each T(theta, s) = Rot(axis, theta) Trans(direction s), or the two factors swapped.

    Attributes:
        axis: ``(N, 3)`` unit revolute axes through the joint frame's origin.
        direction: ``(N, 3)`` unit prismatic directions.
        revolute_first: ``(N,)`` whether the revolute axis comes first along the chain.
        revolute: ``(N,)`` index of each revolute coordinate in q.
        prismatic: ``(N,)`` index of each prismatic coordinate in q.
        reference: ``(2N,)`` q at which every T is the identity.
    """

    axis: Floats
    direction: Floats
    revolute_first: NDArray[np.bool_]
    revolute: NDArray[np.int_]
    prismatic: NDArray[np.int_]
    reference: Floats

    def poses(self, q: Floats) -> RigidTransform:
        """T_i(q), ``(..., 2N)`` to poses of shape ``(..., N)``."""
        offset = q - self.reference
        rotation = Rotation.from_rotvec(offset[..., self.revolute, None] * self.axis)
        slide = offset[..., self.prismatic, None] * self.direction
        translation = np.where(self.revolute_first[:, None], rotation.apply(slide), slide)
        return RigidTransform.from_components(translation, rotation)

    def encode(self, q: Floats) -> Floats:
        """xi_i = Log T_i(q), ``(..., 2N)`` to ``(..., N, 6)``."""
        return log(self.poses(q))

    def retract(self, xi: Floats, xi_dot: Floats | None = None) -> Retraction:
        """Nearest joint position to exp(xi_i), in closed form, with its derivative along xi_dot.

        The revolute coordinate is the twist angle of the swing-twist decomposition about the axis, which minimises the
        rotational distance; the prismatic one is the projection of the translation onto its direction.

        Args:
            xi: ``(..., N, 6)``.
            xi_dot: ``(..., N, 6)``, or None for poses at rest.
        """
        pose = exp(xi)
        p = np.asarray(pose.translation)
        quaternion = pose.rotation.as_quat(canonical=True)
        real, imaginary = quaternion[..., 3], quaternion[..., :3]
        twist = (imaginary * self.axis).sum(axis=-1)
        angle = 2.0 * np.arctan2(twist, real)
        turn = Rotation.from_rotvec(angle[..., None] * self.axis)
        local = np.where(self.revolute_first[:, None], turn.inv().apply(p), p)
        slide = (local * self.direction).sum(axis=-1)

        q = np.empty((*xi.shape[:-2], 2 * len(self.axis)))
        q[..., self.revolute] = angle + self.reference[self.revolute]
        q[..., self.prismatic] = slide + self.reference[self.prismatic]
        gap_translation = np.linalg.norm(local - slide[..., None] * self.direction, axis=-1)
        gap_rotation = np.asarray((turn.inv() * pose.rotation).magnitude())
        if xi_dot is None:
            return Retraction(q, np.zeros_like(q), gap_translation, gap_rotation)

        omega_body = (left_jacobian_so3(-xi[..., :3]) @ xi_dot[..., :3, None])[..., 0]
        real_rate = -0.5 * (imaginary * omega_body).sum(axis=-1)
        imaginary_rate = 0.5 * (real[..., None] * omega_body + np.cross(imaginary, omega_body))
        twist_rate = (imaginary_rate * self.axis).sum(axis=-1)
        angle_rate = 2.0 * (real * twist_rate - twist * real_rate) / (real**2 + twist**2)
        spatial = (left_jacobian_se3(xi) @ xi_dot[..., None])[..., 0]
        velocity = spatial[..., 3:] + np.cross(spatial[..., :3], p)
        carried = turn.inv().apply(velocity) - angle_rate[..., None] * np.cross(self.axis, local)
        local_rate = np.where(self.revolute_first[:, None], carried, velocity)
        qd = np.empty_like(q)
        qd[..., self.revolute] = angle_rate
        qd[..., self.prismatic] = (local_rate * self.direction).sum(axis=-1)
        return Retraction(q, qd, gap_translation, gap_rotation)
