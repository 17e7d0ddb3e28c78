"""How near what hangs comes to what does not move, while it swings by the linear model of the passive joints.

With these joints as coordinates the load is moved by an arm, whose distances are bounded at every instant as those of
any motion (`clearance`), with what the linear model may be off as the joints' deviation (`SwingModel.swing`). Before
the motion the load hangs at rest; after it a period of the slowest oscillation is looked at. The arm's own joints are
where they are planned.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.arm.checks import ancestry, joints_of
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.errors import InputError, NoSolutionError, PlanError, TooFastError
from lieednn_sim.planning.clearance import FAR, Clearance, proved_clearance
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.swing_model import SwingModel, along, longest_step
from lieednn_sim.planning.time_laws import TimedCurve
from lieednn_sim.values import Floats


class SwingingLoad:
    """What hangs from an arm that follows a motion.

    Args:
        arm: the arm, in its scene.
        motion: the motion.
        model: its path's, if it is known.

    Raises:
        NoSolutionError: nothing hangs and swings about a rest, or the arm does not move.
        InputError: a joint that moves the load has no name.
    """

    def __init__(self, arm: Arm, motion: Motion, model: SwingModel | None = None) -> None:
        self._arm, self._passive = arm, PassiveJoints(arm)
        modes = self._passive.modes(motion.q[-1]) if self._passive.bodies.any() else ()
        if not modes or np.ptp(motion.q, axis=0).max() <= 1e-8:
            raise NoSolutionError(f"nothing swings in this motion of arm {arm.name!r}")
        self._curve = TimedCurve(arm, motion)
        self._model = model or SwingModel([arm], *along(arm, self._curve.q))
        own = self._curve.own
        self._t, self._rows, self._off = self._model.swing(own, longest_step(modes), 1.0 / modes[0].frequency)

    def clearance(self, *, swinging: bool = True) -> Clearance:
        """What is proved of its distances, at most 0.1 m or the arm's clearance; or if it hung at rest all the way."""
        rows, off = self._rows, self._off
        if not swinging:
            own = self._curve.own
            rows, off = self._model.hung(own(np.minimum(self._t, own.x[-1]))), 0.0 * off
        found = [self._bound(view, rows, off) for view in self._views()]
        return min(found, key=lambda each: (each.proved, each.bound))

    def check(self) -> None:
        """Check that it keeps the arm's clearance.

        Raises:
            TooFastError: it does not, since it swings; slower it swings less.
            PlanError: it does not though it hangs at rest. Both messages name what, near to what, and when.
        """
        for swinging in (True, False):
            found = self.clearance(swinging=swinging)
            if found.reason or (found.proved and found.bound >= self._arm.clearance):
                break
            other, load = found.pair if found.proved else found.doubtful
            time, near = found.t if found.proved else found.unproved[0, 0], 1e3 * self._arm.clearance
            message = f"{load!r}, which hangs, would come within {near:g} mm of {other!r} at t = {time:.2f} s"
        else:
            raise PlanError(f"{message} even at rest: go another way")
        if not swinging:
            raise TooFastError(f"{message} as it swings; slower it swings less", 1.1 * float(self._curve.own.x[-1]))

    def _views(self) -> Iterator[Arm]:
        """For each end of what hangs, the joints on the way to it as an arm, in a model in which it alone collides."""
        arm, passive, model = self._arm, self._passive, self._passive.load_model
        moving = {*model.dof_jntid[arm.space.own_rate_addresses].tolist(), *model.dof_jntid[passive.dofs].tolist()}
        hanging = np.unique(model.dof_bodyid[passive.dofs])
        chains = [ancestry(model, body) for body in hanging[passive.bodies[hanging]].tolist()]
        for chain in chains:
            if any(chain[-1] in other[:-1] for other in chains):
                continue
            names = [model.joint(joint).name for body in chain for joint in joints_of(model, body) if joint in moving]
            if not all(names):
                raise InputError(f"a joint before body {model.body(chain[-1]).name!r}, which hangs, needs a name")
            own = copy.deepcopy(model)
            own.geom_contype[~np.isin(model.body_weldid[model.geom_bodyid], chain)] = 0
            yield replace(Arm.of(own, arm.data(), names), clearance=arm.clearance)

    def _bound(self, view: Arm, rows: Floats, off: Floats) -> Clearance:
        """The bound of one of the views at positions ``(K, nq)`` from which passive joints may be off ``(K, m)``."""
        q, space = view.coordinates(rows), view.space
        error, dofs = np.zeros((len(rows), self._arm.model.nv)), space.own_rate_addresses
        error[:, self._passive.dofs] = off
        error = error[:, dofs]
        # Rotation vectors of less than half a turn change by at most so much more than what is turned.
        error[:, space.balls] = 0.5 * np.pi * np.linalg.norm(error[:, space.balls], axis=-1, keepdims=True)
        rates = np.gradient(q, self._t[1], axis=0)
        return proved_clearance(view, self._t, q, rates, error, max(FAR, 1.1 * self._arm.clearance))
