"""Joint coordinates, their conversion to MuJoCo's and back, and joints that follow others by equalities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from lieednn_sim.lie.se3 import left_jacobian_so3, quaternion_parts
from lieednn_sim.values import Floats

# A joint that follows another by qpos = ratio * (qpos of the leader) + shift: leader, ratio, shift [rad, m].
Line = tuple[int, float, float]
# A joint that follows several by the sum of ratio * (qpos of the leader), plus a shift: ratios by leader, shift.
Sum = tuple[dict[int, float], float]


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates q in R^n: the angle of a hinge, the displacement of a slide, the rotation vector of a ball joint.

    Of coupled stages of a telescope only the leader has a coordinate: all scalar joints together are
    qpos = coupling @ q + offset. Joints that are not part of the arm keep their position in ``offset``.
    """

    names: tuple[str, ...]  # n names; a ball joint's three end in "_x", "_y", "_z"
    units: tuple[str, ...]  # n units, "rad" or "m"
    coupling: Floats  # (nq, n), zero in the rows of ball joints
    rates: Floats  # (nv, n), the same for velocities
    offset: Floats  # (nq,)
    scalars: NDArray[np.int_]  # indices in q of hinges and slides
    scalar_addresses: NDArray[np.int_]  # their addresses in qpos
    scalar_rate_addresses: NDArray[np.int_]  # their addresses in qvel
    balls: NDArray[np.int_]  # (B, 3) indices in q of the ball joints
    ball_addresses: NDArray[np.int_]  # (B, 4) their quaternions in qpos
    ball_rate_addresses: NDArray[np.int_]  # (B, 3) their angular velocities, in the moving body's frame, in qvel

    def __len__(self) -> int:
        """Return n."""
        return len(self.names)

    @property
    def addresses(self) -> NDArray[np.int_]:
        """Addresses in qpos of all joints that the coordinates move."""
        return np.union1d(np.flatnonzero(self.coupling.any(axis=1)), self.ball_addresses)

    @property
    def rate_addresses(self) -> NDArray[np.int_]:
        """Their addresses in qvel."""
        return np.union1d(np.flatnonzero(self.rates.any(axis=1)), self.ball_rate_addresses)

    @property
    def own_rate_addresses(self) -> NDArray[np.int_]:
        """Address in qvel of each coordinate's own joint ``(n,)``, the leader of those that follow it."""
        addresses = np.empty(len(self), dtype=int)
        addresses[self.scalars], addresses[self.balls] = self.scalar_rate_addresses, self.ball_rate_addresses
        return addresses

    def angles(self, q: Floats) -> Floats:
        """Angles ``(..., B)`` of the ball joints at ``(..., n)`` [rad]."""
        x, y, z = (q[..., each] for each in self.balls.T)
        return np.asarray(np.sqrt(x * x + y * y + z * z))

    def ball(self, address: int) -> NDArray[np.int_]:
        """Indices in q ``(3,)`` of the ball joint at an address in qpos."""
        return self.balls[np.flatnonzero(self.ball_addresses[:, 0] == address)[0]]

    def to_qpos(self, q: Floats) -> Floats:
        """``(..., n)`` to ``(..., nq)``."""
        qpos = q @ self.coupling.T + self.offset
        if len(self.balls):
            # This takes a quarter of the time of SciPy's `Rotation`.
            real, vector = quaternion_parts(self.angles(q)[..., None], q[..., self.balls])
            qpos[..., self.ball_addresses[:, :1]], qpos[..., self.ball_addresses[:, 1:]] = real, vector
        return qpos

    def from_qpos(self, qpos: Floats) -> Floats:
        """``(..., nq)`` to ``(..., n)``; for coupled joints, the leader's position."""
        scalars = qpos.take(self.scalar_addresses, axis=-1)
        if not len(self.balls):
            return scalars
        q = np.empty((*qpos.shape[:-1], len(self)))
        q[..., self.scalars] = scalars
        quaternions = qpos[..., self.ball_addresses[:, [1, 2, 3, 0]]]
        turns = scipy.spatial.transform.Rotation.from_quat(quaternions.reshape(-1, 4)).as_rotvec()
        q[..., self.balls] = turns.reshape(*qpos.shape[:-1], len(self.balls), 3)
        return q

    def to_qvel(self, q: Floats, qd: Floats) -> Floats:
        """Rates ``(..., n)`` at q to ``(..., nv)``; a ball turns at J_r(w) dw/dt in the frame of its body."""
        qvel = qd @ self.rates.T
        if q.shape != qd.shape:
            qvel = np.broadcast_to(qvel, (*np.broadcast_shapes(q.shape, qd.shape)[:-1], qvel.shape[-1])).copy()
        if len(self.balls):
            right = left_jacobian_so3(-q[..., self.balls])
            qvel[..., self.ball_rate_addresses] = (right @ qd[..., self.balls, None])[..., 0]
        return qvel

    def from_qvel(self, q: Floats, qvel: Floats) -> Floats:
        """Velocities ``(..., nv)`` at q to rates ``(..., n)``, the inverse of `to_qvel`."""
        scalars = qvel.take(self.scalar_rate_addresses, axis=-1)
        if not len(self.balls) and q.shape[:-1] == qvel.shape[:-1]:
            return scalars
        qd = np.empty((*np.broadcast_shapes(q.shape[:-1], qvel.shape[:-1]), len(self)))
        qd[..., self.scalars] = scalars
        if len(self.balls):
            right = left_jacobian_so3(-q[..., self.balls])
            qd[..., self.balls] = np.linalg.solve(right, qvel[..., self.ball_rate_addresses, None])[..., 0]
        return qd
