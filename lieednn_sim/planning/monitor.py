"""Whether a run stays within the proof of its plan's clearance, checked while it goes on.

Before the run, it is computed for intervals of the motion by how much the joints may be off without any contact. At an
instant within that a comparison is enough; beyond it, the bound is evaluated again for the actual errors.

The statements are about measured joints, however they were disturbed. Between two instants, each joint's error is
assumed to be no larger than the larger one of the two.
"""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import kinematics_at, scratch_data
from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.clearance import FAR, NEAR, Cubics, bounds_of, proved_clearance
from lieednn_sim.planning.motion import Motion
from lieednn_sim.values import Floats

MOVED = 2e-3  # by how much other joints may bring geoms nearer to each other [m]


class ClearanceMonitor:
    """The errors of the joints for which a motion's clearance stays proved.

    Args:
        arm, t, q, qd: as for `clearance.check_clearance`.

    Attributes:
        clearance: what is proved of the motion itself.
        edges: ``(I + 1,)`` boundaries of the intervals, in steps of the motion.
        allowed: ``(I,)`` largest Euclidean norm of the joints' errors in each interval [rad, m]; 0 if there is none.
    """

    def __init__(self, arm: Arm, t: Floats, q: Floats, qd: Floats) -> None:
        self.clearance = proved_clearance(arm, t, q, qd)
        self._arm, self._step, self._last, bounds = arm, float(t[1] - t[0]), len(t) - 1, bounds_of(arm, own=True)
        self._off, self._bounds = np.zeros_like(q), bounds
        self._cubics = Cubics(self._step, q, qd, self._off)
        self._before: tuple[float, Floats] | None = None
        self.edges = np.unique(np.linspace(0, self._last, 129).round())
        self._middle, self._way, rest = self._cubics.around(self.edges[:-1], self.edges[1:])
        self._rest, self.allowed = rest[:, 0], np.zeros(len(rest))
        if not isinstance(bounds, str):
            self.allowed = bounds(self._middle, self._way, rest, np.ones((len(rest), 1)), FAR)[0]

    @classmethod
    def of(cls, arm: Arm, motion: Motion) -> ClearanceMonitor:
        """The monitor of a run along a motion; `InputError` where the motion itself is not proved."""
        monitor = cls(arm, motion.t, motion.q, motion.qd)
        if not monitor.clearance.proved:
            raise InputError(f"no run can be stopped outside of a proof that does not exist: {monitor.clearance}")
        return monitor

    def holds(self, q: Floats) -> bool:
        """Whether joints ``(n,)`` are so near to some instant of the motion that they are proved to be clear."""
        off, length = q - self._middle, np.square(self._way).sum(axis=1)
        along = np.clip((off * self._way).sum(axis=1) / np.maximum(length, 1e-300), -1.0, 1.0)
        left = np.maximum(np.abs(off - along[:, None] * self._way) - self._rest, 0.0)
        return bool((np.linalg.norm(left, axis=1) < self.allowed).any())

    def left(self, at: float, q: Floats, qpos: Floats | None = None) -> str:
        """Why a run left the proof between the instant of the last call and this one; empty while it is inside.

        Args:
            at: time since the motion began, in its steps; no earlier than in the last call.
            q: ``(n,)`` measured joints [rad, m].
            qpos: ``(nq,)`` positions of everything in the model, if they are known.
        """
        leaves = f"the run leaves the proof of its plan's clearance at t = {self._step * at:.3f} s:"
        slack = 0.0 if qpos is None else 2.0 * displaced(self._arm, q[None], qpos[None])
        if not slack < MOVED:
            return f"{leaves} more has moved than the arm; if other joints sag, make the arm of a state at rest"
        if isinstance(bounds := self._bounds, str):
            return f"{leaves} {bounds}"
        end = min(at, self._last)
        error = np.abs(q - self._cubics.at([end])[0][0])
        begin, before = self._before or (end, error)
        self._before, widest = (end, error), np.maximum(before, error)
        first, last = np.clip(self.edges.searchsorted([begin, end], "right") - 1, 0, len(self.allowed) - 1)
        allowed = float(self.allowed[first : last + 1].min())
        if slack == 0.0 and np.linalg.norm(widest) < allowed:
            return ""
        begin = min(begin, self._last - 1.0)
        self._off[int(begin) : int(np.ceil(end)) + 1] = widest
        middle, way, rest = self._cubics.around([begin], [end])
        least, _, pairs = bounds.least(middle, way, rest, NEAR + slack)
        if least[0] > slack:
            return ""
        # The joint to blame: the one without whose error the bound would be largest.
        n = len(q)
        without = bounds.least(middle.repeat(n, 0), way.repeat(n, 0), rest - np.diag(widest)[:, None], FAR)[0]
        joint, near = int(without.argmax()), ""
        if pairs[0, 0] >= 0:
            others = f", other joints bring parts up to {1e3 * slack:.2g} mm nearer" if slack > 0.0 else ""
            near = "{}, and {!r} may touch {!r}".format(others, *bounds.names(pairs[0]))
        return (
            f"{leaves} joint {self._arm.joint_names[joint]!r} is {error[joint]:.3g} {self._arm.unit(joint)} off{near}; "
            f"all errors up to {allowed:.3g} are proved there (Euclidean norm, [rad, m])"
        )


def displaced(arm: Arm, q: Floats, qpos: Floats) -> float:
    """How far points of geoms are at positions ``(K, nq)`` from where the joints ``(K, n)`` have them, at most [m]."""
    model, implied, most = arm.model, arm.qpos(q, strict=False), 0.0
    for k in np.flatnonzero(~(np.abs(qpos - implied) < 1e-9).all(axis=1)).tolist():
        data, frames = scratch_data(model), list[Floats]()
        for row in (qpos[k], implied[k]):
            kinematics_at(model, row, data)
            frames.append(np.hstack([data.geom_xpos, model.geom_rbound[:, None] * data.geom_xmat]))
        shift, turn = np.split(frames[1] - frames[0], [3], axis=1)
        most = np.maximum(most, (np.linalg.norm(shift, axis=1) + np.linalg.norm(turn, axis=1)).max(initial=0.0))
    return float(most)
