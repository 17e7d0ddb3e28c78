"""Errors of link frames: distances and angles between poses, and when they have settled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from lieednn_sim.values import Floats

# A frame has settled when it stays this close to its target.
SETTLED_TRANSLATION = 1e-3
SETTLED_ROTATION = float(np.deg2rad(0.1))


@dataclass(frozen=True)
class FrameErrors:
    """Errors of one link frame.

    ``final_*`` compares the last simulated frame with the target, ``tracking_*`` the simulated with the planned frame
    of the same instant over the whole rollout. ``settling_s`` is the time from which the frame stays within 1 mm and
    0.1 deg of its target, None when it does not.
    """

    name: str
    final_mm: float
    final_deg: float
    tracking_rms_mm: float
    tracking_rms_deg: float
    tracking_max_mm: float
    tracking_max_deg: float
    settling_s: float | None

    @property
    def arrived(self) -> bool:
        """Whether it ends within 1 mm and 0.1 deg of its target."""
        return self.final_mm <= 1e3 * SETTLED_TRANSLATION and self.final_deg <= np.rad2deg(SETTLED_ROTATION)


def pose_errors(actual: RigidTransform, wanted: RigidTransform) -> tuple[Floats, Floats]:
    """Distance [m] and angle [rad] between poses whose shapes broadcast."""
    difference = wanted.inv() * actual
    return np.linalg.norm(difference.translation, axis=-1), np.asarray(difference.rotation.magnitude())


def frame_errors(
    i: int, name: str, t: Floats, tracking: tuple[Floats, Floats], arrival: tuple[Floats, Floats]
) -> FrameErrors:
    """Errors of link ``i`` at times ``(K,)``; both pairs are distances [m] and angles [rad] ``(K, N)``."""
    distance, angle = 1e3 * tracking[0][:, i], np.rad2deg(tracking[1][:, i])
    return FrameErrors(
        name=name,
        final_mm=float(1e3 * arrival[0][-1, i]),
        final_deg=float(np.rad2deg(arrival[1][-1, i])),
        tracking_rms_mm=float(np.sqrt(np.mean(distance**2))),
        tracking_rms_deg=float(np.sqrt(np.mean(angle**2))),
        tracking_max_mm=float(distance.max()),
        tracking_max_deg=float(angle.max()),
        settling_s=settled(t, arrival[0][:, i : i + 1], arrival[1][:, i : i + 1]),
    )


def settled(t: Floats, distance: Floats, angle: Floats) -> float | None:
    """Time from which errors ``(K, N)`` stay within the bounds, None when they do not."""
    outside = np.flatnonzero(((distance > SETTLED_TRANSLATION) | (angle > SETTLED_ROTATION)).any(axis=1))
    if outside.size == 0:
        return float(t[0])
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else None
