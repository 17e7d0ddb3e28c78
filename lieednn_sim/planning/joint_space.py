"""Common parts of planners in joint space: a fast clearance test, units of path length, motions along paths."""

from __future__ import annotations

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.lie.se3 import continued
from lieednn_sim.planning.clearance import check_contact
from lieednn_sim.planning.motion import Motion, check_joints, check_limits, interpolation
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, read_only, weakly_cached

# Degree of the planners' splines. Derivatives up to the fourth are continuous: curvature is smooth, and so is jerk,
# where the spline's parameter is time.
SPLINE_DEGREE = 5


class ClearanceTest:
    """A test whether all pairs of geoms are further apart than a margin, by MuJoCo's collision pass.

    The test is an order of magnitude faster than measuring the distances (`Collisions`). The margin is in metres.
    """

    def __init__(self, arm: Arm, margin: float) -> None:
        self._arm, self._margin = arm, margin
        # Visual geoms, which touch nothing, would take most of the time.
        self._finder = arm.without_visuals.contact_finder(margin)
        self.tests = 0  # configurations tested so far: a measure of work that does not depend on the machine

    def __call__(self, q: Floats) -> bool:
        """True when nothing is closer than the margin at ``q`` ``(n,)``, and `Arm.stops` are kept."""
        return self.first_blocked(q[None]) is None

    def first_blocked(self, q: Floats) -> int | None:
        """Index of the first of the positions ``(K, n)`` at which something is closer than the margin, or None.

        A position beyond the arm's stops, or at which loops cannot be closed, counts as well.
        """
        positions = self._arm.to_qpos(q, strict=False)
        beyond = self._beyond(positions)
        end = len(q) if beyond is None else int(np.append(beyond > 0.0, True).argmax())
        first = self._finder.first(positions[:end])
        self.tests += min(first + 1, len(q))
        return first if first < len(q) else None

    def _beyond(self, positions: Floats) -> Floats | None:
        """How far the arm's stops, if it has any, are exceeded at MuJoCo's positions ``(K, nq)``."""
        return None if self._arm.stops is None else self._arm.stops.excess(positions).max(axis=1)

    def lack(self, q: Floats) -> Floats:
        """Missing clearance ``(K,)`` [m] at ``q`` ``(K, n)``: the sum over pairs of geoms of margin minus distance.

        Only pairs closer than the margin count, so the sum, with what `Arm.stops` are exceeded by, is zero where a call
        returns True. It grows with the depth of a penetration up to half the thickness of a geom.
        """
        positions = self._arm.qpos(q, strict=False)
        # What is beyond a range of the arm's stops lacks as much; where loops cannot be closed, a metre.
        beyond = self._beyond(positions)
        total = np.zeros(len(q)) if beyond is None else np.clip(beyond, 0.0, 1.0)
        for index, position in enumerate(positions):
            self.tests += 1
            if np.isnan(position).any():
                continue
            distance, geoms = self._finder.geoms(position)
            # Of several contact points of two geoms the deepest counts.
            lack = sorted(zip(map(tuple, geoms.tolist()), (self._margin - distance).tolist(), strict=True))
            total[index] += sum(max(deepest, 0.0) for deepest in dict(lack).values())
        return total


class ProblemClearance(ClearanceTest):
    """The clearance test of a problem, with a smaller margin [m] where start or target is closer to something.

    Attributes:
        collisions: the signed distances of its geoms.
        distances: those of start and target from everything [m].
    """

    def __init__(self, problem: PlanningProblem, margin: float) -> None:
        self.collisions = Collisions(problem.arm)
        self.distances = tuple(map(self.collisions.clearance, (problem.start, problem.target)))
        kept_fraction = 0.8  # of the distance of start and target, where these are closer than the margin
        # The clearance that motions are checked for is kept.
        super().__init__(problem.arm, min(margin, max(kept_fraction * min(self.distances), problem.arm.clearance)))


def clamped_knots(count: int) -> Floats:
    """Knots on [0, 1] of a B-spline of `SPLINE_DEGREE` with ``count`` control points, from the first to the last."""
    inner = np.linspace(0.0, 1.0, count - SPLINE_DEGREE + 1)
    return np.concatenate([np.zeros(SPLINE_DEGREE), inner, np.ones(SPLINE_DEGREE)])


@weakly_cached
def sweeps(arm: Arm) -> Floats:
    """Largest distance ``(n,)`` that a unit of each joint moves a link frame at random configurations [m/rad, m/m]."""
    low, high = arm.position_limits.T
    step = 1e-3 * arm.ranges
    n_configurations = 64  # enough for their largest sweep to come within a few percent of the largest of all
    q = np.random.default_rng(0).uniform(low + step, high - step, (n_configurations, 1, arm.n_joints))
    ahead, behind = (np.asarray(arm.link_poses(q + side * np.diag(step)).translation) for side in (1.0, -1.0))
    moved = np.linalg.norm(ahead - behind, axis=-1).max(axis=(0, 2))
    return read_only(moved / (2.0 * step))


def joint_motion(
    problem: PlanningProblem, q: Floats, qd: Floats, progress: Floats, *, checked: bool = True, guiding: bool = False
) -> Motion:
    """The motion through given joint positions at `PlanningProblem.times`, checked against the arm's limits.

    The poses are those of the joints, so there is no mechanism gap.

    Args:
        problem: start, target and times.
        q: ``(K, n)`` [rad, m], from start to target up to rounding.
        qd: ``(K, n)`` [rad/s, m/s], zero at both ends up to rounding.
        progress: ``(K,)`` from 0 to 1.
        checked: whether limits and contact are checked.
        guiding: whether a network is to follow the motion, whose own motion will be checked: then contact and limits
            are checked at some samples only, and states interpolated between some, to a nanometre.

    Raises:
        PlanError: the motion breaks a limit of the arm.
    """
    arm, t = problem.arm, problem.times()
    q, qd = (as_floats(name, value, (len(t), arm.n_joints)).copy() for name, value in (("q", q), ("qd", qd)))
    # The ends are set exactly, since rounding could exceed a limit there.
    q[0], q[-1], qd[[0, -1]] = problem.start, problem.target, 0.0
    if checked and not guiding:
        check_joints(arm, t, q, qd)
    elif checked:
        every = max(1, (len(t) - 1) // 256)
        check_limits(arm, t[::every], q[::every], qd[::every])
        check_contact(arm, t[:: 8 * every], q[:: 8 * every])
    known, all_of = interpolation(len(t), 250) if guiding else (slice(None), None)
    none, xi = np.zeros((len(q), arm.n_links)), continued(arm.encode(q[known]))
    if all_of is not None:
        xi = (all_of @ xi.reshape(len(xi), -1)).reshape(len(t), arm.n_links, 6)
    return Motion(t, as_floats("progress", progress, (len(q),)), xi, xi[-1], q, qd, none, none.copy())
