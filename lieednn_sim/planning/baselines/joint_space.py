"""What planners in joint space share: a fast test of clearance, units of path length, the checked motion of a path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.contacts import ContactFinder, moving_geoms
from lieednn_sim.lie import continued
from lieednn_sim.planning.motion import Motion, check_joints
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.values import Floats

# Degree of the curves that planners follow: the least with which their curvature is continuous, and so is the jerk of a
# spline in time.
SPLINE_DEGREE = 5
# Where start or target are nearer than that, this share of their distance is kept.
_SHARE = 0.8
# Enough for the most at random postures to come within a few percent of the most there is.
_POSTURES = 64


class ClearanceTest:
    """Whether everything is further apart than a margin, by MuJoCo's collision pass.

    It says yes or no, and is an order of magnitude faster than measuring distances (`Collisions`).

    Args:
        arm: the arm, in its scene.
        margin: smallest allowed distance [m].
        own: of parts of the arm from each other [m]; by default the same.

    Attributes:
        tests: postures tested so far, a measure of work that does not depend on the machine.
    """

    def __init__(self, arm: Arm, margin: float, own: float | None = None) -> None:
        self._arm = arm
        self._margin, self._own = margin, margin if own is None else own
        # What touches nothing would make up most of the cost.
        model = arm.without_visuals.model
        self._finder, self._moving = ContactFinder(model, max(self._margin, self._own)), moving_geoms(model)
        self.tests = 0

    def __call__(self, q: Floats) -> bool:
        """True when nothing is closer than the margin at ``q`` ``(n,)``."""
        return self.first_blocked(q[None]) is None

    def first_blocked(self, q: Floats) -> int | None:
        """Index of the first of the positions ``(K, n)`` at which something is closer than the margin, or None."""
        # One conversion for all, unchecked: it would cost as much as a posture's collision pass.
        for index, position in enumerate(self._arm.space.to_qpos(q)):
            self.tests += 1
            if self._blocked(position):
                return index
        return None

    def _blocked(self, qpos: Floats) -> bool:
        """Whether something is; with one margin for all any contact tells."""
        return self._finder.any(qpos) if self._own == self._margin else len(self._lacking(qpos)[0]) > 0

    def lack(self, q: Floats) -> Floats:
        """By how much pairs of geoms are closer than the margin, summed over them, at ``q`` ``(K, n)`` [m], ``(K,)``.

        Deeper in something means more, up to half of its thickness; zero is what a call says yes to.
        """
        total = np.zeros(len(q))
        for index, position in enumerate(self._arm.qpos(q)):
            self.tests += 1
            lack, geoms = self._lacking(position)
            # Two geoms touch at several points, of which the deepest counts.
            deepest = dict(sorted(zip(map(tuple, geoms.tolist()), lack.tolist(), strict=True)))
            total[index] = sum(deepest.values())
        return total

    def _lacking(self, qpos: Floats) -> tuple[Floats, NDArray[np.int_]]:
        """What geoms lack of their margins ``(C,)`` [m], and their ids ``(C, 2)``."""
        distance, geoms = self._finder.geoms(qpos)
        lack = np.where(self._moving[geoms].all(axis=1), self._own, self._margin) - distance
        return lack[lack > 0.0], geoms[lack > 0.0]


class Workspace:
    """The problem's clearance: a margin that start and target keep themselves, and tests with it.

    Args:
        problem: its start and target may be closer to something than the margin, which then is smaller.
        margin: to plan with [m].
        own: of parts of the arm from each other [m]; by default the same.

    Attributes:
        clear: test with the margin.
        collisions: signed distances.
    """

    def __init__(self, problem: PlanningProblem, margin: float, own: float | None = None) -> None:
        self.collisions = Collisions(problem.arm)
        margins = np.array([margin, margin if own is None else own])
        for q in (problem.start, problem.target):
            near = self.collisions.distances(q, 2.0 * margins.max())
            of_arm = moving_geoms(problem.arm.model)[near.pairs].all(axis=1)
            nearest = [near.distance[which].min(initial=np.inf) for which in (~of_arm, of_arm)]
            # With one margin for all, all count for it. What motions are checked for is kept at both ends.
            most = _SHARE * (np.full(2, min(nearest)) if own is None else np.array(nearest))
            margins = np.minimum(margins, np.maximum(most, problem.arm.clearance))
        self.clear = ClearanceTest(problem.arm, *margins)


def clamped_knots(count: int) -> Floats:
    """Knots on [0, 1] of a B-spline of `SPLINE_DEGREE` with ``count`` control points, from the first to the last."""
    inner = np.linspace(0.0, 1.0, count - SPLINE_DEGREE + 1)
    return np.concatenate([np.zeros(SPLINE_DEGREE), inner, np.ones(SPLINE_DEGREE)])


def joint_scale(arm: Arm) -> Floats:
    """Unit ``(n,)`` of each joint in path lengths: its way in a second at its velocity limit, or its range."""
    return np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, arm.ranges)


def sweeps(arm: Arm) -> Floats:
    """How far a unit of each joint ``(n,)`` may move a link frame [m/rad, m/m]: the most at random postures."""
    low, high = arm.position_limits.T
    step = 1e-3 * arm.ranges
    q = np.random.default_rng(0).uniform(low + step, high - step, (_POSTURES, 1, arm.n_joints))
    ahead, behind = (np.asarray(arm.link_poses(q + side * np.diag(step)).translation) for side in (1.0, -1.0))
    moved = np.linalg.norm(ahead - behind, axis=-1).max(axis=(0, 2))
    return np.asarray(moved / (2.0 * step))


def joint_motion(problem: PlanningProblem, q: Floats, qd: Floats, progress: Floats) -> Motion:
    """The checked motion through joint positions ``(K, n)`` at `PlanningProblem.times`.

    Its poses are the joints' own: there is no mechanism gap.

    Args:
        problem: where it starts and ends.
        q: ``(K, n)`` [rad, m], from start to target up to rounding.
        qd: ``(K, n)`` [rad/s, m/s], zero at both ends up to rounding.
        progress: ``(K,)`` from 0 to 1.

    Raises:
        PlanError: the motion breaks a limit of the arm.
    """
    check_joints(problem.arm, problem.times(), *_at_rest(problem, q, qd))
    return unchecked_motion(problem, q, qd, progress)


def unchecked_motion(problem: PlanningProblem, q: Floats, qd: Floats, progress: Floats) -> Motion:
    """As `joint_motion`, at whatever pace and through whatever is in the way."""
    (q, qd), arm = _at_rest(problem, q, qd), problem.arm
    none, xi = np.zeros((len(q), arm.n_links)), continued(arm.encode(q))
    return Motion(problem.times(), progress, xi, xi[-1], q, qd, none, none.copy())


def _at_rest(problem: PlanningProblem, q: Floats, qd: Floats) -> tuple[Floats, Floats]:
    """With both ends as they are asked for: a rounding may miss them and leave a limit there."""
    q, qd = q.copy(), qd.copy()
    q[0], q[-1] = problem.start, problem.target
    qd[[0, -1]] = 0.0
    return q, qd
