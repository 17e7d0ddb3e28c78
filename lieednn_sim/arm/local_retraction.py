"""The retraction for states that come one after another in real time: Newton's method from the last posture.

`Retractor` finds the nearest posture wherever the poses are, in milliseconds; here it is near the last one, and
MuJoCo's own kinematics gives poses and Jacobians in compiled code.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.arm import Arm
from lieednn_sim.lie import hat
from lieednn_sim.values import Floats

# Steps are taken until one is shorter than this [rad, m], whose square is what is left, and at most so many.
_SHORT, _MOST = 1e-3, 8
# Time over which a rate is looked at [s of the network's rates].
_AHEAD = 1e-6
# Coordinates that no pose determines stay; relative to 1 radian and one unit of length.
_DAMPING = 1e-12
_ONE = np.eye(3)
# Rows: the matrices hat(e_k), flat.
_HAT = hat(_ONE).reshape(3, 9)


class LocalRetraction:
    """The posture nearest to per-joint poses near the last one, in the metric of `Retractor` to second order.

    Args:
        arm: whose joints they are; its model is not changed.
        q: ``(n,)`` where to begin.

    Attributes:
        q: ``(n,)`` the last posture [rad, m]; may be set to another one.
        gap: ``(N, 6)`` what was left there of rotation [rad] and translation [m].
    """

    def __init__(self, arm: Arm, q: Floats) -> None:
        self._arm, self._space, self._model, self._data = arm, arm.space, arm.model, mujoco.MjData(arm.model)
        self._sites = arm.site_ids
        mounts, tips = arm.mounts.as_matrix(), arm.tips.inv().as_matrix()
        self._mount, self._shift = mounts[:, :3, :3], mounts[:, :3, 3]
        self._tip, self._reach = tips[:, :3, :3], tips[:, :3, 3]
        self._units, self._weights = arm.twist_units, np.repeat([1.0, 1.0 / arm.length_scale], 3)
        # The base, which stays, and the links.
        self._turns, self._places = np.zeros((arm.n_links + 1, 3, 3)), np.zeros((arm.n_links + 1, 3))
        self._turns[0], self._places[0] = arm.base.as_matrix()[:3, :3], arm.base.as_matrix()[:3, 3]
        # Jacobians (angular, linear) of each link and of the one before it, at the link's own point.
        self._own, self._before = np.zeros((2, arm.n_links, 2, 3, arm.model.nv))
        bodies = [int(body) for body in arm.model.site_bodyid[arm.site_ids]]
        self._calls = [(self._own[i], i, body) for i, body in enumerate(bodies)]
        self._calls += [(self._before[i], i, body) for i, body in enumerate(bodies[:-1], start=1)]
        self._rates, self._identity = arm.space.rates, np.eye(len(q))
        self.q, self.gap = q, np.zeros((arm.n_links, 6))

    def __call__(self, xi: Floats, rate: Floats) -> tuple[Floats, Floats]:
        """Joint coordinates and, along ``rate``, their rates, both ``(n,)``, of network states ``(N, 6)``; unchecked.

        A posture that is not near is found where Newton's method leads in eight steps.
        """
        turned, moved = _exp(np.array([xi, xi + _AHEAD * rate]) * self._units)
        error = np.empty((2, *xi.shape))
        for _ in range(_MOST):
            rotation, translation, jacobian = self._linearised()
            relative = turned @ rotation.transpose(0, 2, 1)
            # Of the antisymmetric part, the sine of the angle.
            error[..., :3] = 0.5 * relative.reshape(2, -1, 9) @ _HAT.T
            error[..., 3:] = moved - translation
            matrix = jacobian.T @ jacobian
            matrix.flat[:: len(matrix) + 1] += _DAMPING
            _, steps, _ = dposv(matrix, jacobian.T @ (error * self._weights).reshape(2, -1).T)
            step, ahead = steps.T
            self.q = self.q + step
            if np.abs(step).max() < _SHORT:
                break
        self.gap = error[0] - (jacobian @ step).reshape(xi.shape) / self._weights
        return self.q, (ahead - step) / _AHEAD

    def _linearised(self) -> tuple[Floats, Floats, Floats]:
        """Joint poses at q, ``(N, 3, 3)`` and ``(N, 3)``, and their weighted spatial Jacobian ``(6 N, n)``."""
        model, data, q = self._model, self._data, self.q
        data.qpos[:] = self._space.to_qpos(q)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        turns, places = self._turns, self._places
        turns[1:], places[1:] = data.site_xmat[self._sites].reshape(-1, 3, 3), data.site_xpos[self._sites]
        # World frames of the joints, at the frame before, and the points that a pose's translation is of.
        frames = turns[:-1] @ self._mount
        origins = places[:-1] + (turns[:-1] @ self._shift[:, :, None])[:, :, 0]
        tips = places[1:] + (turns[1:] @ self._reach[:, :, None])[:, :, 0]
        back = frames.transpose(0, 2, 1)
        rotation = back @ turns[1:] @ self._tip
        translation = (back @ (tips - origins)[:, :, None])[:, :, 0]
        for (angular, linear), link, body in self._calls:
            mujoco.mj_jac(model, data, linear, angular, tips[link], body)
        moving = back[:, None] @ (self._own - self._before)
        rates = self._space.to_qvel(q, self._identity).T if len(self._space.balls) else self._rates
        jacobian = (moving.reshape(-1, 6, len(rates)) * self._weights[:, None]).reshape(-1, len(rates)) @ rates
        return rotation, translation, jacobian


def _exp(twist: Floats) -> tuple[Floats, Floats]:
    """Rotations ``(..., 3, 3)`` and translations ``(..., 3)`` of twists ``(..., 6)``: a third of `lie.exp`'s calls."""
    omega = twist[..., :3]
    square = np.maximum((omega * omega).sum(axis=-1), 1e-16)[..., None, None]
    angle = np.sqrt(square)
    a = np.sin(angle) / angle
    b = 2.0 * (np.sin(0.5 * angle) / angle) ** 2
    skew = (omega @ _HAT).reshape(*omega.shape, 3)
    double = skew @ skew
    translation = (_ONE + b * skew + (1.0 - a) / square * double) @ twist[..., 3:, None]
    return _ONE + a * skew + b * double, translation[..., 0]
