"""Joint limits proved for a whole transient by an invariant box: there the filter has no position to limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.network import LieEDNN
from lieednn_sim.validation import as_floats


def limits_proved(arm: Arm, network: LieEDNN, start: ArrayLike) -> bool:
    """Whether it is proved that the joints keep their position limits on the network's way from ``start`` ``(n, 6)``.

    The box that no trajectory leaves (`ComponentwiseNetwork.invariant_box`) is carried to the joints where each
    compound joint has six freedoms, three slides below a ball: the angle of the ball is |omega|, and the slides' way is
    V(omega) v with |V(omega) v - v| <= |omega| |v| / 2. Other joints take the nearest position to a pose that they
    cannot meet, which no box bounds tightly: for them nothing is proved, and the filter has to work.

    Raises:
        InputError: start is malformed.
    """
    origin = as_floats("start", start, (arm.n_links, 6))
    if not arm.exact:
        return False
    try:
        lower, upper = map(network.visible, network.invariant_box(network.start(origin)))
    except LieEDNNError:
        return False
    largest = np.maximum(np.abs(lower), np.abs(upper))
    angles = np.linalg.norm(largest[:, :3], axis=1)
    lengths = arm.length_scale * np.linalg.norm(largest[:, 3:], axis=1)
    low, high = arm.position_limits.T - arm.joints.reference
    for link, joint in enumerate(arm.joints.joints):
        *slides, ball = joint.factors
        if angles[link] > high[ball.indices].min() or angles[link] >= np.pi:
            return False
        columns = np.linalg.inv(np.column_stack([slide.ratio * slide.axes[:, 0] for slide in slides]))
        ends = arm.length_scale * np.stack([lower[link, 3:], upper[link, 3:]])
        middle, half = columns @ ends.mean(axis=0), np.abs(columns) @ (0.5 * np.diff(ends, axis=0)[0])
        half += 0.5 * np.linalg.norm(columns, axis=1) * angles[link] * lengths[link]
        indices = np.concatenate([slide.indices for slide in slides])
        if (middle - half < low[indices]).any() or (middle + half > high[indices]).any():
            return False
    return True
