"""Closed forms of the nearest configuration: one screw, a hinge and a slide, three slides below a ball joint.

Each is solved for all of its links at once. Except for the first, the distance is that of
`nearest.NearestPose`, 4 sin^2(angle / 2) + ||shift||^2 / length^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lieednn_sim.arm.deviations import Deviations, Group
from lieednn_sim.arm.kinematics import CompoundJoint
from lieednn_sim.lie.se3 import exp, hat, left_jacobian_so3, rotation_vectors, rotations, spatial_twist
from lieednn_sim.values import Floats


@dataclass(frozen=True, eq=False)
class MovingPoses:
    """The exponentials of twists ``(..., N, 6)``, moving at ``twist_rate``; None for poses at rest."""

    twist: Floats
    twist_rate: Floats | None

    @property
    def rotation(self) -> Floats:
        """Matrices of the poses, ``(..., N, 3, 3)``."""
        return self._pose[..., :3, :3]

    @property
    def translation(self) -> Floats:
        """Translations of the poses, ``(..., N, 3)``."""
        return self._pose[..., :3, 3]

    @cached_property
    def rates(self) -> tuple[Floats, Floats] | None:
        """Angular and linear velocity in the joint frame, both ``(..., N, 3)``, by the left Jacobian of SE(3)."""
        if self.twist_rate is None:
            return None
        spatial = spatial_twist(self.twist, self.twist_rate)
        omega = spatial[..., :3]
        return omega, spatial[..., 3:] + np.cross(omega, self.translation)

    @cached_property
    def _pose(self) -> Floats:
        return exp(self.twist).as_matrix()


class HingeSlide:
    """Rot(n, theta) Trans(s d), or the two factors swapped; coupled stages together have one direction s.

    With e = s / |s|, the best slide for an angle is the projection m(theta) = e . Rot(theta)^T p (of p itself if the
    slide comes first). It remains to maximise a trigonometric polynomial of degree two,

        g(theta) = x cos theta + y sin theta + (m(theta) / length)^2,  m(theta) = a + b cos theta + c sin theta,

    where tr(Rot(theta)^T R) = x cos theta + y sin theta + const. Rotating (cos, sin) by atan2(c, b) turns it into a
    quadratic form on the unit circle. Its maximisation is a trust-region subproblem in the plane, solved by a root of a
    secular equation beyond the largest eigenvalue, where that is convex (More and Sorensen, SIAM JSSC 4(3), 1983).

    The maximum is unique and smooth in the pose except on the cut locus, where two angles are equally near: the
    rotation is half a turn away from those of the joint, or a translation against the slide outweighs the rotation.
    There the configuration jumps; `motion.check_motion` rejects motions that cross it.
    """

    def __init__(self, joints: Sequence[CompoundJoint], links: list[int], length: float) -> None:
        self._links, self._length = links, length
        self.indices, self._stretch = np.empty((len(links), 2), int), np.empty(len(links))
        # x, y, a, b, c are linear in the pose: rows for R, flattened, and for p.
        self._rows = np.zeros((len(links), 5, 12))
        for k, joint in enumerate(joints):
            hinge = next(factor for factor in joint.factors if factor.kind == "hinge")
            slides = [factor for factor in joint.factors if factor.kind == "slide"]
            self.indices[k] = np.concatenate([hinge.indices, slides[0].indices])
            n = hinge.axes[:, 0]
            direction = np.sum([slide.ratio * slide.axes[:, 0] for slide in slides], axis=0)
            self._stretch[k] = np.linalg.norm(direction)
            e = direction / self._stretch[k]
            along = (n @ e) * n if joint.factors[0] is hinge else e
            self._rows[k, :2, :9] = np.stack([np.eye(3) - np.outer(n, n), hat(n)]).reshape(2, 9)
            self._rows[k, 2:, 9:] = np.stack([along, e - along, np.cross(n, e - along)]) / length

    @staticmethod
    def fits(joint: CompoundJoint) -> bool:
        """Whether the joint is of this kind, with the hinge at one end and its axis through the origin."""
        kinds = [factor.kind for factor in joint.factors]
        hinges = [factor for factor in joint.factors if factor.kind == "hinge"]
        return (
            len(hinges) == 1
            and hinges[0].ratio == 1.0
            and np.abs(hinges[0].anchor).max() < 1e-12
            and kinds.count("slide") == len(kinds) - 1
            and "hinge" in (kinds[0], kinds[-1])
            and len(joint.indices) == 2
        )

    def __call__(self, poses: MovingPoses, near: Floats | None = None) -> tuple[Floats, Floats | None]:
        """Displacements ``(..., L, 2)`` (angle, slide) and their rates by the implicit function theorem.

        Angles that the pose does not determine have a rate of zero.
        """
        links = self._links
        rotation = poses.rotation[..., links, :, :]
        x, y, a, b, c = self._coefficients(rotation, poses.translation[..., links, :])
        angle = _highest(x + 2.0 * a * b, y + 2.0 * a * c, b, c)
        cos, sin = np.cos(angle), np.sin(angle)
        m, slope, bend = a + b * cos + c * sin, c * cos - b * sin, -(b * cos + c * sin)
        unit = self._length / self._stretch
        offset = np.stack([angle, unit * m], axis=-1)
        if poses.rates is None:
            return offset, None
        omega, velocity = poses.rates
        spin = hat(omega[..., links, :]) @ rotation
        x_rate, y_rate, a_rate, b_rate, c_rate = self._coefficients(spin, velocity[..., links, :])
        m_rate, slope_rate = a_rate + b_rate * cos + c_rate * sin, c_rate * cos - b_rate * sin
        curvature = x * cos + y * sin - 2.0 * (slope**2 + m * bend)
        pull = y_rate * cos - x_rate * sin + 2.0 * (m_rate * slope + m * slope_rate)
        scale = np.abs(x) + np.abs(y) + 2.0 * (a**2 + b**2 + c**2)
        angle_rate = np.divide(pull, curvature, out=np.zeros_like(pull), where=curvature > 1e-12 * scale)
        return offset, np.stack([angle_rate, unit * (m_rate + slope * angle_rate)], axis=-1)

    @property
    def groups(self) -> list[Group]:
        """Angle and slide of each link."""
        return [(index, np.ones(1)) for index in self.indices.reshape(-1, 1)]

    def spread(self, deviations: Deviations) -> Floats:
        """Bounds ``(K, 2 L)`` of the changes of angles and slides.

        At the highest point u = (cos theta, sin theta) is parallel to the gradient of g, of length lambda, and unique
        where lambda > 2 (b^2 + c^2) (More and Sorensen). With h = (b, c), its parts h_u along u and h_t across, and
        changes dR and dp of the pose, the implicit function theorem gives

            |d theta| <= (2 |dR| + 2 (|h_t| + f |m|) |dp| / length) / (lambda - 2 h_t^2),

        f being the part of the slide that turns with the hinge, and |dm| <= |dp| / length + |h_t d theta|.
        """
        links, length = self._links, self._length
        poses = MovingPoses(deviations.twist, None)
        x, y, a, b, c = self._coefficients(poses.rotation[..., links, :, :], poses.translation[..., links, :])
        angle = _highest(x + 2.0 * a * b, y + 2.0 * a * c, b, c)
        cos, sin = np.cos(angle), np.sin(angle)
        along, across, size = b * cos + c * sin, np.abs(c * cos - b * sin), np.hypot(b, c)
        m, level, beside = a + along, x * cos + y * sin, np.abs(y * cos - x * sin)
        f = np.linalg.norm(self._rows[:, 3], axis=1) * length
        wide, far = deviations.wide[:, links], deviations.far[:, links] / length

        def turned(most: Floats, turn: Floats, shift: Floats) -> tuple[Floats, Floats]:
            """Bounds of |h_t| and |d theta| for angles that change by up to ``most``; infinite where u may jump."""
            swung = 0.5 * np.abs(along) * most**2 + across * most
            higher, longer = np.abs(m) + far + swung, size + f * far
            off = across + f * far + longer * most
            left = level + 2.0 * m * along - 2.0 * wide - 0.5 * np.abs(level) * most**2 - beside * most
            left -= 2.0 * (higher * (f * far + swung) + (far + swung) * np.abs(along))
            unique = left > 2.0 * longer**2
            pull = 2.0 * turn + 2.0 * (off + f * higher) * shift
            return off, np.where(unique, pull / np.where(unique, left - 2.0 * off**2, 1.0), np.inf)

        most = np.minimum(1.5 * turned(np.zeros_like(wide), wide, far)[1], np.pi)
        kept = (turned(most, wide, far)[1] <= most) & (np.abs(angle) + most < np.pi)
        shift = deviations.shift[:, links] / length
        off, turn = turned(most, np.broadcast_to(deviations.turn[links], wide.shape), shift)
        slide = (shift + off * np.where(kept, turn, 0.0)) * length / self._stretch
        return np.where(kept[..., None], np.stack([turn, slide], axis=-1), np.inf).reshape(len(kept), -1)

    def _coefficients(self, rotation: Floats, translation: Floats) -> tuple[Floats, ...]:
        """x, y and, in units of ``length``, a, b, c, each ``(...)``; linear in ``(..., 3, 3)`` and ``(..., 3)``."""
        pose = np.concatenate([rotation.reshape(*rotation.shape[:-2], 9), translation], axis=-1)
        return tuple(np.moveaxis(np.matvec(self._rows, pose), -1, 0))


def _highest(p: Floats, q: Floats, b: Floats, c: Floats) -> Floats:
    """The angle in (-pi, pi] where p cos + q sin + (b cos + c sin)^2 is highest; zero where it is constant.

    Turned by atan2(c, b), it is alpha X + beta Y + strength X^2 on the unit circle. At the maximum X = alpha / (2 t)
    and Y = beta / (2 (t + strength)), with the multiplier t >= 0 for which X^2 + Y^2 = 1. Newton's method on (X^2 +
    Y^2)^(-1/2) = 1, concave and increasing in t, converges monotonically to the root from any t below it.
    """
    turn, strength = np.arctan2(c, b), b**2 + c**2
    alpha, beta = p * np.cos(turn) + q * np.sin(turn), q * np.cos(turn) - p * np.sin(turn)
    half, other = 0.5 * np.abs(alpha), 0.5 * np.abs(beta)
    t = np.maximum(half, other - strength)
    for _ in range(50):
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = half / t, other / (t + strength)
            square = u**2 + v**2
            step = square * (np.sqrt(square) - 1.0) / (u**2 / t + v**2 / (t + strength))
        # If alpha vanishes, t may be zero: then Y is determined, but X only up to its sign.
        step = np.where(np.isfinite(step), step, 0.0)
        t = t + step
        if (step <= 1e-12 * t).all():
            break
    positive = t > 0.0
    y = np.clip(0.5 * beta / np.where(t + strength > 0.0, t + strength, 1.0), -1.0, 1.0)
    x = np.where(positive, 0.5 * alpha / np.where(positive, t, 1.0), np.copysign(np.sqrt(1.0 - y**2), alpha))
    angle = np.where(positive | (strength > 0.0), np.arctan2(y, x), 0.0) + turn
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))


class OneScrew:
    """Exp(z q): orthogonal projection of the twist onto the line of z, with lengths in units of ``length``.

    Since the twist itself is projected, there is no cut locus, and a joint may turn any number of times. The result
    agrees with the nearest pose to second order in the residual.
    """

    def __init__(self, joints: Sequence[CompoundJoint], links: list[int], length: float) -> None:
        self._links = links
        self.indices = np.array([joint.indices for joint in joints])
        screws = np.array([joint.screw for joint in joints])
        dual = screws / np.repeat([1.0, length**2], 3)
        self._dual = dual / np.vecdot(dual, screws)[:, None]

    @staticmethod
    def fits(joint: CompoundJoint) -> bool:
        """Whether the joint is of this kind."""
        return joint.screw is not None

    def __call__(self, poses: MovingPoses, near: Floats | None = None) -> tuple[Floats, Floats | None]:
        """Displacements ``(..., L, 1)`` and their rates."""
        given = [poses.twist] if poses.twist_rate is None else [poses.twist, poses.twist_rate]
        offset, *rate = (np.vecdot(twist[..., self._links, :], self._dual)[..., None] for twist in given)
        return offset, rate[0] if rate else None

    @property
    def groups(self) -> list[Group]:
        """Each coordinate."""
        return [(index, np.ones(1)) for index in self.indices]

    def spread(self, deviations: Deviations) -> Floats:
        """Bounds ``(K, L)`` of their changes, which are linear in those of the twists."""
        lengths = np.linalg.norm(self._dual.reshape(-1, 2, 3), axis=2)
        return np.tile(np.vecdot(lengths, deviations.size[self._links]), (len(deviations.twist), 1))


class SixDof:
    """Trans(S s) Rot(A w), three slides below a ball joint, which meet every pose exactly."""

    def __init__(self, joints: Sequence[CompoundJoint], links: list[int], _: float) -> None:
        self._links = links
        self.indices = np.array([joint.coordinates for joint in joints])
        slides = [[slide.ratio * slide.axes[:, 0] for slide in joint.factors[:3]] for joint in joints]
        self._inverse = np.linalg.inv(np.swapaxes(slides, 1, 2))
        self._ball = np.array([joint.factors[3].axes.T for joint in joints])

    @staticmethod
    def fits(joint: CompoundJoint) -> bool:
        """Whether the joint is of this kind."""
        if [factor.kind for factor in joint.factors] != ["slide", "slide", "slide", "ball"]:
            return False
        if len(joint.indices) != 6 or np.abs(joint.factors[-1].anchor).max() > 1e-12:
            return False
        axes = np.column_stack([factor.axes[:, 0] for factor in joint.factors[:3]])
        return abs(float(np.linalg.det(axes))) > 1e-3

    def __call__(self, poses: MovingPoses, near: Floats | None = None) -> tuple[Floats, Floats | None]:
        """Displacements ``(..., L, 6)`` and their rates."""
        links = self._links
        rotvec = rotation_vectors(rotations(poses.rotation[..., links, :, :]))
        parts = np.matvec(self._inverse, poses.translation[..., links, :]), np.matvec(self._ball, rotvec)
        offset = np.concatenate(parts, axis=-1)
        if poses.rates is None:
            return offset, None
        omega, velocity = poses.rates
        turning = np.linalg.solve(left_jacobian_so3(rotvec), omega[..., links, :, None])[..., 0]
        parts = np.matvec(self._inverse, velocity[..., links, :]), np.matvec(self._ball, turning)
        return offset, np.concatenate(parts, axis=-1)

    @property
    def groups(self) -> list[Group]:
        """The three slides and the ball joint of each link."""
        return [(indices, np.ones(3)) for indices in self.indices.reshape(-1, 3)]

    def spread(self, deviations: Deviations) -> Floats:
        """Bounds ``(K, 2 L)`` of the changes of slides and of rotation vectors, omega below half a turn."""
        links = self._links
        slide = np.linalg.norm(self._inverse, 2, axis=(1, 2)) * deviations.shift[:, links]
        turn = np.where(deviations.angle[:, links] < np.pi, deviations.turn[links], np.inf)
        return np.stack([slide, turn], axis=-1).reshape(len(slide), -1)
