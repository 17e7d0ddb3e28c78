"""Closeness of the arm to its target, as a number in [0, 1], for many environments at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.values import Floats

# Errors [m, rad] at which the near part of a reward falls to a tenth; for the far part, half the reach and pi.
_NEAR = (0.05, 0.1)


class Closeness:
    """1 within the tolerances, otherwise less: the mean of a part that guides from afar and one that matters nearby.

    Each is the product of a term for the distance and one for the angle. A term falls to a tenth where its error
    exceeds the tolerance by the margin.

    Args:
        position_tolerance: tolerance of the distance [m].
        rotation_tolerance: tolerance of the angle [rad].
        reach: reach of the arm [m].
        more: tolerances and margins of further errors of a task.
    """

    def __init__(
        self, position_tolerance: float, rotation_tolerance: float, reach: float, *more: tuple[float, float]
    ) -> None:
        self._position, self._rotation = position_tolerance, rotation_tolerance
        margins = (0.5 * reach, np.pi, *_NEAR)
        allowed = 2 * (position_tolerance, rotation_tolerance)
        self._allowed, self._margins = np.array([*zip(allowed, margins, strict=True), *more]).T

    def __call__(self, distance: Floats | float, angle: Floats | float, *more: Floats | float) -> list[Floats]:
        """Closeness ``(...)`` at distances [m] and angles [rad] ``(...)``, and the terms of further errors."""
        errors = np.array([distance, angle, distance, angle, *more]).T
        far, far_turn, near, near_turn, *others = closeness(errors, self._allowed, self._margins).T
        return [0.5 * (far * far_turn + near * near_turn), *others]

    def within(self, distance: Floats | float, angle: Floats | float) -> NDArray[np.bool_]:
        """Whether both are within their tolerances."""
        return np.asarray((distance <= self._position) & (angle <= self._rotation))


def closeness(error: Floats | float, allowed: Floats | float, margin: Floats | float) -> Floats:
    """1 up to the allowed error, then 1 / (1 + 9 x^2) at x margins beyond; dm_control's ``tolerance``, long tail."""
    beyond = np.maximum(error - allowed, 0.0) / margin
    return np.asarray(1.0 / (1.0 + 9.0 * beyond * beyond))
