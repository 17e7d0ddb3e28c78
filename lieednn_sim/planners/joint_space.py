"""What planners in joint space share: a fast test of clearance, units of path length, the checked motion of a path."""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.errors import PlanError
from lieednn_sim.motion import Motion, check_motion
from lieednn_sim.planners.problem import PlanningProblem

Floats = NDArray[np.float64]

# What planners keep away from everything, unless start or target are closer to something [m].
_MARGIN = 0.01
# Share of the margin that the finished motion must keep: paths are planned with more, and rounded after.
_KEPT = 0.5
_STRIDE = 16
_POSTURES = 64


class ClearanceTest:
    """Whether everything is further apart than a margin, by MuJoCo's collision pass.

    It says yes or no, and is an order of magnitude faster than measuring distances (`Collisions`).

    Args:
        arm: the arm, in its scene.
        margin: smallest allowed distance [m].

    Attributes:
        tests: postures tested so far, a measure of work that does not depend on the machine.
    """

    def __init__(self, arm: Arm, margin: float) -> None:
        self._arm = arm
        # The margin of all contacts at once: margins of geoms changed after compiling leave out pairs, since the
        # bounding volumes of bodies keep the old ones. The arm's own model stays as it is.
        self._model = copy.copy(arm.model)
        self._model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
        self._model.opt.o_margin = margin
        self._data = mujoco.MjData(self._model)
        self.tests = 0

    def __call__(self, q: Floats) -> bool:
        """True when nothing is closer than the margin at ``q`` ``(n,)``."""
        return self.first_blocked(q[None]) is None

    def first_blocked(self, q: Floats) -> int | None:
        """Index of the first of the positions ``(K, n)`` at which something is closer than the margin, or None."""
        # One conversion for all: it costs as much as a posture's collision pass.
        for index, position in enumerate(self._arm.qpos(q)):
            self.tests += 1
            self._data.qpos[:] = position
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_collision(self._model, self._data)
            if self._data.ncon:
                return index
        return None


class Workspace:
    """The problem's clearance: a margin that start and target keep themselves, and tests with it.

    Attributes:
        margin: that paths are planned with [m].
        clear: test with the margin.
        collisions: signed distances.
    """

    def __init__(self, problem: PlanningProblem) -> None:
        self.collisions = Collisions(problem.arm)
        nearest = min(self.collisions.clearance(q) for q in (problem.start, problem.target))
        self.margin = max(0.0, min(_MARGIN, 0.5 * nearest))
        self.clear = ClearanceTest(problem.arm, self.margin)
        self._kept = ClearanceTest(problem.arm, _KEPT * self.margin)

    def check(self, t: Floats, q: Floats) -> None:
        """Check every one of the positions ``(K, n)`` at times ``(K,)``.

        Raises:
            PlanError: names what comes too close, and when.
        """
        # Far apart first: most of what is in the way is found with few tests.
        order = np.concatenate([np.arange(first, len(q), _STRIDE) for first in range(_STRIDE)])
        kept = _KEPT * self.margin
        while (found := self._kept.first_blocked(q[order])) is not None:
            index = order[found]
            distance, pair = self.collisions.nearest(q[index])
            # Contacts within a margin are found more roughly than distances are measured.
            if distance < kept:
                first, second = self.collisions.names(pair)
                raise PlanError(
                    f"{first!r} would come to {1e3 * distance:.2f} mm of {second!r} at t = {t[index]:.2f} s, "
                    f"{1e3 * kept:.2f} mm are to be kept; try another seed"
                )
            order = order[found + 1 :]


def joint_scale(arm: Arm) -> Floats:
    """Unit ``(n,)`` of each joint in path lengths: its way in a second at its velocity limit, or its range."""
    low, high = arm.position_limits.T
    return np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, high - low)


def sweeps(arm: Arm) -> Floats:
    """How far a unit of each joint ``(n,)`` may move a link frame [m/rad, m/m]: the most at random postures."""
    low, high = arm.position_limits.T
    step = 1e-3 * (high - low)
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
    arm, q, qd = problem.arm, q.copy(), qd.copy()
    # A rounding may miss the ends and leave a limit there.
    q[0], q[-1] = problem.start, problem.target
    qd[[0, -1]] = 0.0
    none = np.zeros((len(q), arm.n_links))
    t = problem.times()
    motion = Motion(t, progress, arm.encode(q), arm.encode(problem.target), q, qd, none, none.copy())
    check_motion(arm, motion)
    return motion
