"""Retraction: the joint position nearest to given per-joint poses, in closed form if there is one.

All joints use one metric: for an angle and a shift between the given and the feasible pose, the squared distance is
4 sin^2(angle / 2) + ||shift||^2 / length^2, which equals angle^2 + ||shift||^2 / length^2 up to fourth order in the
angle, and is smooth at half a turn. A hinge with a slide, and joints with six dof, are solved in closed form
(`closed_forms`), other joints by least squares (`nearest`). If a link moves along one screw, as behind a single hinge,
its twist is projected instead, which extends beyond half a turn (`closed_forms.OneScrew`). Compound joints that share a
coordinate, such as coupled stages in several links, are retracted together.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import field, replace
from functools import cached_property, partial

import numpy as np

from lieednn_sim.arm.closed_forms import HingeSlide, MovingPoses, OneScrew, SixDof
from lieednn_sim.arm.deviations import Deviations, Group, spread_of_nearest
from lieednn_sim.arm.kinematics import CompoundJoints
from lieednn_sim.arm.nearest import NearestPose
from lieednn_sim.budget import check_time
from lieednn_sim.values import Floats, frozen


@frozen
class Retraction:
    """The joint coordinates whose poses are nearest to given poses of the links, and the distance: the mechanism gap.

    Attributes:
        q: ``(..., n)`` joint coordinates [rad, m].
        qd: ``(..., n)`` their rates; zero for poses at rest.
    """

    q: Floats
    qd: Floats
    _measure: Callable[[], tuple[Floats, Floats]] = field(repr=False, compare=False)

    @property
    def gap_translation(self) -> Floats:
        """``(..., N)`` distance between given and feasible pose [m]."""
        return self._gap[0]

    @property
    def gap_rotation(self) -> Floats:
        """``(..., N)`` angle between them [rad]."""
        return self._gap[1]

    @cached_property
    def _gap(self) -> tuple[Floats, Floats]:
        # Computed on demand, since it takes as long as the retraction.
        for part in (gap := self._measure()):
            part.setflags(write=False)
        return gap


class Retractor:
    """Retracts poses onto compound joints; in the distance, a ``length`` [m] counts as much as a radian."""

    def __init__(self, joints: CompoundJoints, length: float) -> None:
        self._joints = joints
        self._solvers = _solvers(joints, length)

    @property
    def exact(self) -> bool:
        """Whether every compound joint has six degrees of freedom, so that no pose leaves a gap."""
        return all(isinstance(solver, SixDof) for solver in self._solvers)

    def __call__(self, xi: Floats, xi_dot: Floats | None = None, start: Floats | None = None) -> Retraction:
        """Nearest joint position to exp(xi_i), with its derivative along xi_dot, both ``(..., N, 6)``.

        From a configuration ``start`` ``(n,)``, ``xi`` ``(K, ..., N, 6)`` are followed along their first axis, see
        `nearest.NearestPose.follow`; ``start`` may also be guesses ``(K, ..., n)`` of the result.
        """
        check_time()
        near = None if start is None else start - self._joints.reference
        given = MovingPoses(xi, xi_dot)
        reference = self._joints.reference
        q = np.broadcast_to(reference, (*xi.shape[:-2], len(reference))).copy()
        qd = np.zeros_like(q)
        for solver in self._solvers:
            offset, rate = solver(given, near)
            q[..., solver.indices] += offset
            if rate is not None:
                qd[..., solver.indices] = rate
        return Retraction(q, qd, partial(self._gap, given, q))

    @property
    def groups(self) -> list[Group]:
        """All coordinates in the groups whose changes `spread` bounds."""
        return [group for solver in self._solvers for group in solver.groups]

    def spread(self, deviations: Deviations) -> Floats:
        """Largest changes ``(K, G)`` of the `groups` when the twists deviate; infinite where nothing is proved.

        Smaller deviations change them in proportion or less.
        """
        offset = replace(deviations, q=deviations.q - self._joints.reference)
        return np.concatenate([solver.spread(offset) for solver in self._solvers], axis=1)

    def _gap(self, given: MovingPoses, q: Floats) -> tuple[Floats, Floats]:
        """Distances [m] and angles [rad] ``(..., N)`` of given poses from those at q ``(..., n)``."""
        rotation, translation = self._joints.matrices(q)
        # From the chord, ||R - R'||_F^2 / 2 = 4 sin^2(angle / 2); a product, since sums over short axes are slow.
        apart = (given.rotation - rotation).reshape(*rotation.shape[:-2], 9)
        chord = np.sqrt((apart * apart) @ np.full(9, 0.125))
        return np.linalg.norm(given.translation - translation, axis=-1), 2.0 * np.arcsin(np.minimum(chord, 1.0))


class _Nearest:
    """Solves other joints by least squares (`NearestPose`); groups with the same geometry are solved at once."""

    def __init__(self, joints: CompoundJoints, groups: list[tuple[int, ...]], length: float) -> None:
        self._links = np.array(groups)
        members = [[joints.joints[link] for link in links] for links in groups]
        coordinates = [np.unique(np.concatenate([joint.indices for joint in group])) for group in members]
        self.indices = np.concatenate(coordinates)
        self._coordinates = coordinates
        self._problem = NearestPose(members[0], coordinates[0], len(joints.reference), length)

    @property
    def groups(self) -> list[Group]:
        """Each group of links; slides in units of the length."""
        weights = np.where(self._problem.sliding, 1.0 / self._problem.length, 1.0)
        return [(indices, weights) for indices in self._coordinates]

    def spread(self, deviations: Deviations) -> Floats:
        """See `spread_of_nearest`."""
        each = zip(self._links, self._coordinates, strict=True)
        results = [spread_of_nearest(self._problem, links, deviations, deviations.q[:, mine]) for links, mine in each]
        return np.stack(results, axis=-1)

    def __call__(self, poses: MovingPoses, near: Floats | None) -> tuple[Floats, Floats | None]:
        rotation, translation = poses.rotation[..., self._links, :, :], poses.translation[..., self._links, :]
        flat = (*translation.shape[:-3], len(self.indices))
        straightened = None
        if near is None:
            offset = self._problem.solve(rotation, translation)
        else:
            offset, straightened = self._problem.follow(
                rotation, translation, near[..., self.indices].reshape(*near.shape[:-1], len(self._links), -1)
            )
        if poses.rates is None:
            return offset.reshape(flat), None
        omega, velocity = (part[..., self._links, :] for part in poses.rates)
        rates = self._problem.rates(offset, rotation, translation, omega, velocity)
        if straightened is not None and straightened.any():
            along = self._problem.rates_along(offset, rotation, translation, omega, velocity)
            rates = np.where(straightened[..., None], along, rates)
        return offset.reshape(flat), rates.reshape(flat)


def _solvers(joints: CompoundJoints, length: float) -> list[OneScrew | HingeSlide | SixDof | _Nearest]:
    """The solvers: closed forms, and others for all groups of links with the same geometry."""
    closed: dict[type[OneScrew | HingeSlide | SixDof], list[int]] = {OneScrew: [], HingeSlide: [], SixDof: []}
    searched: dict[Hashable, list[tuple[int, ...]]] = {}
    for links in _sharing(joints):
        members = [joints.joints[link] for link in links]
        kind = next((kind for kind in closed if kind.fits(members[0])), None) if len(links) == 1 else None
        if kind is not None:
            closed[kind].append(links[0])
        else:
            indices = np.unique(np.concatenate([joint.indices for joint in members]))
            searched.setdefault(tuple(joint.geometry(indices) for joint in members), []).append(links)
    made = [kind([joints.joints[link] for link in links], links, length) for kind, links in closed.items() if links]
    return [*made, *(_Nearest(joints, groups, length) for groups in searched.values())]


def _sharing(joints: CompoundJoints) -> list[tuple[int, ...]]:
    """Links in groups without common coordinates."""
    groups: list[tuple[set[int], tuple[int, ...]]] = []
    for link, joint in enumerate(joints.joints):
        mine: set[int] = set(joint.indices.tolist())
        joined = [group for group in groups if group[0] & mine]
        groups = [group for group in groups if not group[0] & mine]
        links = tuple(sorted({link, *(member for group in joined for member in group[1])}))
        groups.append((mine.union(*(group[0] for group in joined)), links))
    return [links for _, links in groups]
