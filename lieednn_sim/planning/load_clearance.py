"""How near what hangs comes to what does not move, while it swings by the linear model of the passive joints.

With these joints as coordinates the load is moved by an arm, whose distances are bounded at every instant as those of
any motion (`clearance`), with what the linear model may be off as the joints' deviation (`SwingModel.swing`). Before
the motion the load hangs at rest; after it a period of the slowest oscillation is looked at. The arm's own joints are
where they are planned.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.arm.checks import ancestry, joints_of
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.errors import InputError, NoSolutionError, PlanError, TooFastError
from lieednn_sim.planning.clearance import FAR, Clearance, proved_clearance
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.swing_model import SwingModel, longest_step
from lieednn_sim.values import Floats


def load_clearance(arm: Arm, motion: Motion, *, swinging: bool = True) -> Clearance | None:
    """What is proved of the distances of what hangs, at most 0.1 m or the arm's clearance; None if nothing swings.

    It swings as the motion makes it, or would hang at rest all the way.
    """
    passive = PassiveJoints(arm)
    if not passive.bodies.any() or np.ptp(motion.q, axis=0).max() <= 1e-8:
        return None
    try:
        if not (modes := passive.modes(motion.q[-1])):
            return None
        end = float(motion.t[-1])
        model = SwingModel([arm], CubicHermiteSpline(motion.t / end, motion.q, end * motion.qd))
        law = CubicHermiteSpline([0.0, end], [0.0, 1.0], [1.0 / end, 1.0 / end])
        t, rows, off = model.swing(law, longest_step(modes), swinging / modes[0].frequency)
        if not swinging:
            rows, off = model.hung(law(t)), 0.0 * off
        return min(_bounds(passive, t, rows, off), key=lambda each: (each.proved, each.bound))
    except (InputError, NoSolutionError) as error:  # it rests nowhere, or its joints are no arm's
        return Clearance(-np.inf, 0.0, (), motion.t[None, [0, -1]], 0.0, f"no proof of clearance: {error}")


def check_load(arm: Arm, motion: Motion) -> None:
    """Check that what hangs keeps the arm's clearance; arguments are as for `load_clearance`.

    Raises:
        TooFastError: it does not, since it swings; slower it swings less.
        PlanError: it does not though it hangs at rest. Both messages name what, near to what, and when.
    """
    for swinging in (True, False):
        found = load_clearance(arm, motion, swinging=swinging)
        if found is None or found.reason or (found.proved and found.bound >= arm.clearance):
            break
        other, load = (found.pair if found.proved else found.doubtful) or ("what does not move", "what hangs")
        time, near = found.t if found.proved else found.unproved[0, 0], 1e3 * arm.clearance
        message = f"{load!r}, which hangs, would come within {near:g} mm of {other!r} at t = {time:.2f} s"
    else:
        raise PlanError(f"{message} even at rest: go another way")
    if not swinging:
        raise TooFastError(f"{message} as it swings; slower it swings less", 1.1 * float(motion.t[-1]))


def _bounds(passive: PassiveJoints, t: Floats, rows: Floats, off: Floats) -> list[Clearance]:
    """The bound of each end of what hangs at positions ``(K, nq)`` from which passive joints may be off ``(K, m)``.

    The joints on the way there are an arm, in a model in which it alone collides.
    """
    arm, model, found = passive.arm, passive.load_model, []
    moving = model.dof_jntid[[*arm.space.own_rate_addresses, *passive.dofs]]
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
        view = replace(Arm.of(own, arm.data(), names), clearance=arm.clearance)
        q, balls, error = view.coordinates(rows), view.space.balls, np.zeros((len(rows), model.nv))
        error[:, passive.dofs] = off
        error = error[:, view.space.own_rate_addresses]
        # Rotation vectors of less than half a turn change by at most so much more than what is turned.
        error[:, balls] = 0.5 * np.pi * np.linalg.norm(error[:, balls], axis=-1, keepdims=True)
        rates = np.gradient(q, t[1], axis=0)
        found.append(proved_clearance(view, t, q, rates, error, far=max(FAR, 1.1 * arm.clearance)))
    return found
