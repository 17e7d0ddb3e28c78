"""How near the arm is to where it shall be, as a number in [0, 1], of many environments at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.values import Floats

# Errors [m], [rad] at which the near part of a reward is down to a tenth; the far part's are half the reach and pi.
_NEAR = (0.05, 0.1)


class Closeness:
    """1 within the tolerances, else less: the mean of what is seen from afar and of what only counts near by.

    Each is a product of a term for the distance and one for the angle, which fall to a tenth where the error is beyond
    its tolerance by the margin.

    Args:
        position_tolerance: [m].
        rotation_tolerance: [rad].
        reach: of the arm [m].
        more: tolerances and margins of other errors that a task judges with them.
    """

    def __init__(
        self, position_tolerance: float, rotation_tolerance: float, reach: float, *more: tuple[float, float]
    ) -> None:
        self._position, self._rotation = position_tolerance, rotation_tolerance
        margins = (0.5 * reach, np.pi, *_NEAR)
        allowed = 2 * (position_tolerance, rotation_tolerance)
        self._allowed, self._margins = np.array([*zip(allowed, margins, strict=True), *more]).T

    def __call__(self, distance: Floats | float, angle: Floats | float, *more: Floats | float) -> list[Floats]:
        """Closeness ``(B,)`` at distances [m] and angles [rad] ``(B,)`` or of one, and the terms of other errors."""
        errors = np.array([distance, angle, distance, angle, *more]).T
        far, far_turn, near, near_turn, *others = closeness(errors, self._allowed, self._margins).T
        return [0.5 * (far * far_turn + near * near_turn), *others]

    def within(self, distance: Floats | float, angle: Floats | float) -> NDArray[np.bool_]:
        """Whether both are within their tolerances."""
        return np.asarray((distance <= self._position) & (angle <= self._rotation))


def closeness(error: Floats | float, allowed: Floats | float, margin: Floats | float) -> Floats:
    """1 up to the allowed error, 1 / (1 + 9 x^2) beyond it by x margins; dm_control's tolerance with a long tail."""
    beyond = np.maximum(error - allowed, 0.0) / margin
    return np.asarray(1.0 / (1.0 + 9.0 * beyond * beyond))
