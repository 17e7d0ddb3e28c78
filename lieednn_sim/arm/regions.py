"""Task space regions (Berenson, Srinivasa and Kuffner, IJRR 30(12), 2011): boxes of poses of the end effector."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.lie.se3 import rotations, transforms
from lieednn_sim.validation import TURN, Seed, as_floats, as_generator, as_nonnegative
from lieednn_sim.values import Floats, frozen, set_fields

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform, Rotation

_FREE = np.full(3, np.inf)
_FARTHEST = 1e6  # bounds and frames are at most this far away [m], so that squares stay far from overflow


@frozen
class TaskSpaceRegion:
    """A region of poses: those whose displacement D from a frame W of the world has its coordinates within bounds.

    The end effector's pose is T = W D O with a fixed offset O. The coordinates of D are its translation along the axes
    of W, and angles about these axes: D rotates about x first, then about y, then about z, all of them fixed axes, so
    that the rotation is Rz Ry Rx. So the tilt of z depends on the first two angles alone; with a free third angle, the
    region contains all turns about z. Equal bounds fix a coordinate, and infinite ones leave it free.

    Attributes:
        pose: W, the region's frame in the world.
        lower: ``(6,)`` lower bounds of x, y, z [m] and of the angles about x, y, z [rad].
        upper: ``(6,)`` upper bounds.
        offset: O, the pose of the end effector in the displaced frame.

    Raises:
        InputError: a value is malformed, bounds cross, or an angle has one infinite bound, or one beyond a turn.
    """

    pose: RigidTransform
    lower: Floats
    upper: Floats
    offset: RigidTransform = field(default_factory=lambda: scipy.spatial.transform.RigidTransform.identity())

    def __post_init__(self) -> None:
        for name in ("pose", "offset"):
            as_floats(f"the translation of {name}", getattr(self, name).translation, (3,), largest=_FARTHEST)
        lower, upper = (_as_bounds(name, getattr(self, name)) for name in ("lower", "upper"))
        set_fields(self, lower=lower + 0.0, upper=upper + 0.0)  # no negative zeros
        coordinates = (turn + axis for turn in ("", "the rotation about ") for axis in "xyz")
        for what, low, high in zip(coordinates, lower, upper, strict=True):
            if not low <= high or np.inf in (low, -high):
                raise InputError(f"the lower bound of {what} must not be above the upper one, got {low:g} and {high:g}")
            if "rotation" in what and (np.isinf(low) != np.isinf(high) or TURN < max(-low, high) < np.inf):
                raise InputError(f"{what} must have two bounds within a turn [rad], or none, got {low:g} and {high:g}")

    def __repr__(self) -> str:
        units = np.repeat([1.0, 180.0 / np.pi], 3)
        bounds = zip(["x", "y", "z", "rx", "ry", "rz"], self.lower * units, self.upper * units, strict=True)
        parts = (f"{name} {low:.3g}" + (f" to {high:.3g}" if low < high else "") for name, low, high in bounds)
        return f"<TaskSpaceRegion: {', '.join(parts)} (m, degrees)>"

    @classmethod
    def line(
        cls,
        start: ArrayLike,
        end: ArrayLike,
        rotation: Rotation | None = None,
        *,
        tolerance: float = 0.0,
        angle: float = 0.0,
    ) -> TaskSpaceRegion:
        """The poses on a line between two points; x of the region's frame goes along it.

        Args:
            start: ``(3,)`` in the world [m].
            end: ``(3,)``, another point.
            rotation: orientation of the end effector on the line; free when omitted.
            tolerance: distance from the line in either direction across it [m].
            angle: deviation from the rotation about each axis [rad].

        Raises:
            InputError: a value is malformed, or both points are the same.
        """
        first, last = as_floats("start", start, (3,)), as_floats("end", end, (3,))
        length, across = float(np.linalg.norm(way := last - first)), as_nonnegative("tolerance", tolerance, _FARTHEST)
        if not length > 0.0:
            raise InputError("a line needs two different points, got the same start and end")
        frame = scipy.spatial.transform.Rotation.align_vectors(way[None], [[1.0, 0.0, 0.0]])[0]
        width = as_nonnegative("angle", angle, _FARTHEST)
        return cls._of(frame, first, [0.0, -across, -across], [length, across, across], rotation, width)

    @classmethod
    def orientation(
        cls, rotation: Rotation, tolerance: float = 0.0, *, axis: ArrayLike | None = None
    ) -> TaskSpaceRegion:
        """The poses at any place with an orientation, such as that of a cup that must not spill.

        Args:
            rotation: orientation of the end effector in the world.
            tolerance: deviation from it about each axis [rad].
            axis: ``(3,)`` axis of the world about which it may turn freely, z of the region's frame; by default none.
        """
        width = np.full(3, as_nonnegative("tolerance", tolerance, _FARTHEST))
        frame = scipy.spatial.transform.Rotation.identity()
        if axis is not None:
            along = as_floats("axis", axis, (3,))
            if not np.linalg.norm(along) > 0.0:
                raise InputError("axis must not be zero")
            frame = scipy.spatial.transform.Rotation.align_vectors(along[None], [[0.0, 0.0, 1.0]])[0]
            width[2] = np.inf
        return cls._of(frame, np.zeros(3), -_FREE, _FREE, rotation, width)

    @classmethod
    def box(
        cls, lower: ArrayLike, upper: ArrayLike, rotation: Rotation | None = None, *, angle: float = 0.0
    ) -> TaskSpaceRegion:
        """The poses with a position in a box along the world's axes.

        Args:
            lower: ``(3,)`` lower bounds of the end effector's position in the world [m]; infinite where there is none.
            upper: ``(3,)`` upper bounds.
            rotation: orientation of the end effector; free when omitted.
            angle: deviation from the rotation about each axis [rad].

        Raises:
            InputError: a value is malformed, or a lower bound is above the upper one.
        """
        low, high = (_as_bounds(name, value, 3) for name, value in (("lower", lower), ("upper", upper)))
        width = as_nonnegative("angle", angle, _FARTHEST)
        return cls._of(scipy.spatial.transform.Rotation.identity(), np.zeros(3), low, high, rotation, width)

    @classmethod
    def _of(
        cls, frame: Rotation, place: Floats, low: ArrayLike, high: ArrayLike, turn: Rotation | None, width: ArrayLike
    ) -> TaskSpaceRegion:
        """Positions within bounds ``(3,)`` along the axes of a frame, with a rotation and deviations of it, if any."""
        width = _FREE if turn is None else np.broadcast_to(np.asarray(width, dtype=float), 3)
        turned = np.eye(3) if turn is None else (frame.inv() * turn).as_matrix()
        return cls(
            transforms(frame.as_matrix(), place),
            np.concatenate([low, -width]),
            np.concatenate([high, width]),
            transforms(turned, np.zeros(3)),
        )

    def displacement(self, pose: RigidTransform) -> Floats:
        """Coordinates ``(..., 6)`` [m, rad] of D at poses of shape ``(...)``, with angles nearest to the bounds."""
        held, released = self._frames
        moved = held @ pose.as_matrix() @ released
        return np.concatenate([moved[..., :3, 3], self._angles(moved[..., :3, :3])], axis=-1)

    def excess(self, pose: RigidTransform) -> Floats:
        """How far the coordinates ``(..., 6)`` [m, rad] of poses are above or, negative, below their bounds."""
        return self._beyond(self.displacement(pose))

    def distance(self, pose: RigidTransform) -> tuple[Floats, Floats]:
        """Distance [m] and angle [rad], each ``(...)``, of D from that of `project`; both zero inside."""
        given = self.displacement(pose)
        beyond = self._beyond(given)
        turned = _matrix(given[..., 3:] - beyond[..., 3:])
        angle = rotations(np.swapaxes(turned, -1, -2) @ _matrix(given[..., 3:])).magnitude()
        return np.linalg.norm(beyond[..., :3], axis=-1), np.where(beyond[..., 3:].any(axis=-1), angle, 0.0)

    def project(self, pose: RigidTransform) -> RigidTransform:
        """The nearest poses of the region to poses of shape ``(...)``, with each coordinate at its nearest bound."""
        given = self.displacement(pose)
        return self._pose(given - self._beyond(given))

    def sample(self, seed: Seed) -> RigidTransform:
        """Draw a pose, uniform in the coordinates; `InputError` if a bound of the position is infinite."""
        rng, limits = as_generator("seed", seed), np.append(_FREE, np.full(3, np.pi))
        low = np.where(np.isinf(self.lower), -limits, self.lower)
        high = np.where(np.isinf(self.upper), limits, self.upper)
        if np.isinf([low, high]).any():
            raise InputError("a pose can be drawn only where x, y and z have finite bounds")
        return self._pose(rng.uniform(low, high))

    def within(self, margin: float) -> TaskSpaceRegion:
        """This region with bounds moved inwards by a margin [m, rad], or to their middle where they would cross."""
        inset = np.minimum(as_nonnegative("margin", margin, _FARTHEST), 0.5 * (self.upper - self.lower))
        return TaskSpaceRegion(self.pose, self.lower + inset, self.upper - inset, self.offset)

    def excess_slopes(self, pose: RigidTransform) -> Floats:
        """Derivatives ``(..., 6, 6)`` of `excess` along twists (omega, v) of the end effector, as in `Arm.jacobian`.

        They are zero where a coordinate is inside its bounds.
        """
        given, (held, released) = self.displacement(pose), self._frames
        to_frame = held[:3, :3]
        x, y, z = np.moveaxis(pose.as_matrix()[..., :3, :3] @ released[:3, 3], -1, 0)
        none = np.zeros_like(x)
        # v + omega x lever, along the axes of W.
        turn = np.stack([none, z, -y, -z, none, x, y, -x, none], axis=-1).reshape(*x.shape, 3, 3)
        slopes = np.zeros((*x.shape, 6, 6))
        slopes[..., :3, :3], slopes[..., :3, 3:] = to_frame @ turn, to_frame
        # omega = (cp cy, cp sy, -sp) roll' + (-sy, cy, 0) pitch' + (0, 0, 1) yaw', inverted.
        (cp, cy), (sp, sy) = np.cos(np.moveaxis(given[..., 4:], -1, 0)), np.sin(np.moveaxis(given[..., 4:], -1, 0))
        # At 90 degrees the other angles are not determined.
        cp = np.where(cp < 0.0, np.minimum(cp, -1e-3), np.maximum(cp, 1e-3))
        rates = [cy / cp, sy / cp, none, -sy, cy, none, sp * cy / cp, sp * sy / cp, np.ones_like(cp)]
        slopes[..., 3:, :3] = np.stack(rates, axis=-1).reshape(*x.shape, 3, 3) @ to_frame
        inside = (self._beyond(given) == 0.0) & (self.lower < self.upper)
        return np.where(inside[..., None], 0.0, slopes)

    def _beyond(self, displacement: Floats) -> Floats:
        return displacement - np.clip(displacement, self.lower, self.upper)

    @cached_property
    def _frames(self) -> tuple[Floats, Floats]:
        """The inverses of W and O."""
        return self.pose.inv().as_matrix(), self.offset.inv().as_matrix()

    def _angles(self, rotation: Floats) -> Floats:
        """Angles ``(..., 3)`` about x, y and z of rotations; of several triples, the one nearest to the bounds."""
        r = rotation
        level = np.hypot(r[..., 0, 0], r[..., 1, 0])
        clear = level > 1e-12
        pitch = np.arctan2(-r[..., 2, 0], level)
        roll = np.where(clear, np.arctan2(r[..., 2, 1], r[..., 2, 2]), 0.0)
        yaw = np.where(clear, np.arctan2(r[..., 1, 0], r[..., 0, 0]), np.arctan2(-r[..., 0, 1], r[..., 1, 1]))
        both = np.stack([np.stack([roll, pitch, yaw], -1), np.stack([roll + np.pi, np.pi - pitch, yaw + np.pi], -1)])
        low, high = self.lower[3:], self.upper[3:]
        middle = 0.5 * (np.maximum(low, -np.pi) + np.minimum(high, np.pi))
        both = middle + np.mod(both - middle + np.pi, 2.0 * np.pi) - np.pi
        off = np.linalg.norm(both - np.clip(both, low, high), axis=-1)
        return np.where((off[1] < off[0])[..., None], both[1], both[0])

    def _pose(self, displacement: Floats) -> RigidTransform:
        moved = transforms(_matrix(displacement[..., 3:]), displacement[..., :3]).as_matrix()
        result = self.pose.as_matrix() @ moved @ self.offset.as_matrix()
        return transforms(result[..., :3, :3], result[..., :3, 3])


def _matrix(angles: Floats) -> Floats:
    """Rz Ry Rx ``(..., 3, 3)`` for angles about x, y and z ``(..., 3)``."""
    flat = scipy.spatial.transform.Rotation.from_euler("xyz", angles.reshape(-1, 3)).as_matrix()
    return np.asarray(flat).reshape(*angles.shape[:-1], 3, 3)


def _as_bounds(name: str, value: ArrayLike, count: int = 6) -> Floats:
    """Bounds ``(count,)``, which may be infinite."""
    bounds = as_floats(name, value, (count,), largest=np.inf)
    as_floats(name, np.where(np.isinf(bounds), 0.0, bounds), (count,), largest=_FARTHEST)
    return bounds
