"""The retraction for states that come one after another in real time: Newton's method from the last posture.

`Retractor` finds the nearest posture wherever the poses are, in milliseconds; here it is near the last one. All links
are worked out at once: the poses asked for and those of all joints are the exponentials of one stack of twists, and
with T = M_1 ... M_F of a link's joints and their twists Z_f the slopes of T are M_1 ... M_(f-1) Z_f M_f ... M_F.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from lieednn_sim.arm.arm import Arm
from lieednn_sim.lie import hat
from lieednn_sim.values import Floats

# Steps are taken until one is shorter than this [rad, m], whose square is what is left, and at most so many.
_SHORT, _MOST = 1e-3, 8
# Time over which a rate is looked at [s of the network's rates].
_AHEAD = 1e-6
# Coordinates that no pose determines stay; relative to 1 radian and one unit of length.
_DAMPING = 1e-12
_ONE = np.eye(4)
# Rows: the matrices hat(e_k) of twists, flat.
_HAT = hat(np.eye(6)).reshape(6, 16)


class LocalRetraction:
    """The posture nearest to per-joint poses near the last one: ||R_i(q) - R_i||^2 / 2 + ||p_i(q) - p_i||^2 / length^2.

    Args:
        arm: whose joints they are.
        q: ``(n,)`` where to begin.

    Attributes:
        q: ``(n,)`` the last posture [rad, m]; may be set to another one.
    """

    def __init__(self, arm: Arm, q: Floats) -> None:
        joints = [joint.factors for joint in arm.joints.joints]
        n_factors, links, n = max(map(len, joints)), len(joints), len(q)
        width = 3 if len(arm.space.balls) else 1
        # In this unit of length squares of entries of a pose weigh as they should.
        self._length = arm.length_scale / np.sqrt(2.0)
        self._units = arm.twist_units / np.repeat([1.0, self._length], 3)
        self._reference = arm.joints.reference
        # Twists of all joints at displacements; their coordinates' matrices Z; and whose coordinates they are.
        twists, self._turns = np.zeros((n_factors, links, 6, n)), np.zeros((n_factors, links, width, 4, 4))
        chosen = np.zeros((links, n_factors, width, n))
        self._balls = []
        for i, factors in enumerate(joints):
            for f, factor in enumerate(factors):
                columns = range(len(factor.indices))
                # Of a ball that is not turned, as of all others at any time.
                omega, v = factor.twists(np.zeros(n))
                twists[f, i][:, factor.indices] = np.concatenate([omega, v / self._length], axis=1).T
                self._turns[f, i, columns] = self._matrices(omega, v)
                chosen[i, f, columns, factor.indices] = 1.0
                if factor.kind == "ball":
                    self._balls.append((f, i, factor))
        self._twists = twists.reshape(-1, n)
        self._chosen = chosen.reshape(links, -1, n)
        self._stack = np.empty((2 + n_factors, links, 6))
        self._before, self._after = np.zeros((2, n_factors, links, 4, 4))
        self._before[0] = _ONE
        # What squares of entries make of rotation and translation.
        rotation = np.zeros((4, 4))
        rotation[:3, :3] = 0.5
        self._parts = np.stack([rotation, self._length**2 * np.outer([1, 1, 1, 0], _ONE[3])], axis=-1).reshape(16, 2)
        self._left = np.zeros(16 * links)
        self.q = q

    @property
    def gap(self) -> Floats:
        """``(N, 2)`` what was left there of rotation [rad] and translation [m]."""
        return np.sqrt((self._left * self._left).reshape(-1, 16).dot(self._parts))

    def __call__(self, xi: Floats, rate: Floats) -> tuple[Floats, Floats]:
        """Joint coordinates and, along ``rate``, their rates, both ``(n,)``, of network states ``(N, 6)``; unchecked.

        A posture that is not near is found where Newton's method leads in eight steps.
        """
        stack = self._stack
        stack[0] = xi * self._units
        stack[1] = stack[0] + (_AHEAD * self._units) * rate
        for _ in range(_MOST):
            offset = self.q - self._reference
            stack[2:] = self._twists.dot(offset).reshape(stack[2:].shape)
            poses = _exp(stack)
            posture, jacobian = self._linearised(offset, poses[2:])
            error = (poses[:2] - posture).reshape(2, -1)
            matrix = jacobian.T.dot(jacobian)
            matrix.flat[:: len(matrix) + 1] += _DAMPING
            _, steps, _ = dposv(matrix, jacobian.T.dot(error.T))
            step, ahead = steps.T
            self.q = self.q + step
            if max(map(abs, step.tolist())) < _SHORT:
                break
        self._left = error[0] - jacobian.dot(step)
        return self.q, (ahead - step) / _AHEAD

    def _linearised(self, offset: Floats, moved: Floats) -> tuple[Floats, Floats]:
        """Poses of the links ``(N, 4, 4)`` and their Jacobian ``(16 N, n)``, with ``(F, N, 4, 4)`` of their joints."""
        for f, i, ball in self._balls:
            self._turns[f, i] = self._matrices(*ball.twists(offset))
        before, after = self._before, self._after
        before[1:2], after[-1] = moved[: len(moved) > 1], moved[-1]
        for f in range(2, len(moved)):
            np.matmul(before[f - 1], moved[f - 1], out=before[f])
        for f in reversed(range(len(moved) - 1)):
            np.matmul(moved[f], after[f + 1], out=after[f])
        slopes = before[:, :, None] @ (self._turns @ after[:, :, None])
        links, columns, n = self._chosen.shape
        each = slopes.transpose(1, 3, 4, 0, 2).reshape(links, 16, columns)
        return after[0], (each @ self._chosen).reshape(-1, n)

    def _matrices(self, omega: Floats, v: Floats) -> Floats:
        """Of twists ``(c, 3)`` and ``(c, 3)``, ``(c, 4, 4)``."""
        return np.concatenate([omega, v / self._length], axis=1).dot(_HAT).reshape(-1, 4, 4)


def _exp(twists: Floats) -> Floats:
    """Poses ``(..., 4, 4)`` of twists ``(..., 6)``: I + X + (1 - cos)/angle^2 X^2 + (angle - sin)/angle^3 X^3."""
    flat = twists.reshape(-1, 6)
    matrix = flat.dot(_HAT).reshape(-1, 4, 4)
    double = matrix @ matrix
    omega = flat[:, :3]
    square = np.maximum(np.einsum("ki,ki->k", omega, omega), 1e-16)[:, None, None]
    angle = np.sqrt(square)
    sine = np.sin(0.5 * angle) / angle
    poses = (2.0 * sine * sine) * double
    poses += ((1.0 - np.sin(angle) / angle) / square) * (matrix @ double)
    poses += matrix
    poses += _ONE
    return poses.reshape(*twists.shape[:-1], 4, 4)
