"""How near a hanging load comes to what does not move, while it swings by the linear model of the passive joints.

The passive joints are taken as further joints of an arm, whose distances are bounded at every instant as for any motion
(`clearance`); the error of the linear model (`SwingModel.swing`) is taken as a deviation of the joints. Before the
motion the load hangs at rest; after it, one period of the slowest oscillation is checked. The arm's own joints are
where they are planned to be.
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
    """The proved clearance of a hanging load, up to 0.1 m or the arm's clearance; None if nothing swings.

    The load swings as the motion drives it or, if not ``swinging``, hangs at rest all the way.
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
    except (InputError, NoSolutionError) as error:  # no position of rest, or its joints form no arm
        return Clearance(-np.inf, 0.0, (), motion.t[None, [0, -1]], 0.0, f"no proof of clearance: {error}")


def check_load(arm: Arm, motion: Motion) -> None:
    """Check that a hanging load keeps the arm's clearance; arguments are as for `load_clearance`.

    `TooFastError` if it comes too near as it swings, which it does less in a slower motion; `PlanError` if it does even
    if it hangs at rest. Both messages name the two parts and the time.
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
    """The clearance of each hanging end, at positions ``(K, nq)`` that passive joints may miss by ``(K, m)``.

    The joints on the chain to each end form an arm, in a model in which only this chain collides.
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
        # A rotation vector of less than half a turn changes by at most pi / 2 times what the rotation changes.
        error[:, balls] = 0.5 * np.pi * np.linalg.norm(error[:, balls], axis=-1, keepdims=True)
        rates = np.gradient(q, t[1], axis=0)
        found.append(proved_clearance(view, t, q, rates, error, far=max(FAR, 1.1 * arm.clearance)))
    return found
