"""Rotation matrices as quaternions, many at once and with the bits of MuJoCo's `mju_mat2Quat`."""

from __future__ import annotations

import numpy as np

from lieednn_sim.values import Floats

# Signs of the matrix's diagonal in 4 q_i^2 = 1 +- m_00 +- m_11 +- m_22.
_SIGNS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
# Which of (0, wx, wy, wz, xy, xz, yz) are the products with each component.
_PRODUCTS = np.array([[0, 1, 2, 3], [1, 0, 4, 5], [2, 4, 0, 6], [3, 5, 6, 0]])
# Lengths that differ from 1 by less are left alone (mjMINVAL).
_LEAST_DEVIATION = 1e-15


def quaternions(matrices: Floats) -> Floats:
    """Unit quaternions ``(..., 4)``, (w, x, y, z), of rotation matrices ``(..., 3, 3)``.

    The largest component q_i is the root of (1 +- m_00 +- m_11 +- m_22) / 4, the others follow from the products
    4 q_i q_j, which are sums and differences of entries off the diagonal (Shepperd's method).
    """
    m = matrices.reshape(-1, 3, 3)
    x, y, z = np.diagonal(m, axis1=1, axis2=2).T
    largest = np.where(x + y + z > 0.0, 0, np.where((x > y) & (x > z), 1, np.where(y > z, 2, 3)))
    wx, wy, wz = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    xy, xz, yz = m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]
    products = np.array([np.zeros(len(m)), wx, wy, wz, xy, xz, yz])
    rows, sign = np.arange(len(m)), _SIGNS[largest].T
    size = 0.5 * np.sqrt(1.0 + sign[0] * x + sign[1] * y + sign[2] * z)
    q = 0.25 * products[_PRODUCTS[largest], rows[:, None]] / size[:, None]
    q[rows, largest] = size
    norm = np.sqrt(q[:, 0] * q[:, 0] + q[:, 1] * q[:, 1] + q[:, 2] * q[:, 2] + q[:, 3] * q[:, 3])[:, None]
    q = np.where(np.abs(norm - 1.0) > _LEAST_DEVIATION, q * (1.0 / norm), q)
    return q.reshape(*matrices.shape[:-2], 4)
