"""Causes of an arm's final error, from its model: contacts, ranges, dry friction, loads, force limits, slow servos."""

from __future__ import annotations

import copy

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.contacts import fixed_body, geom_name
from lieednn_sim.arm.equalities import equality_name
from lieednn_sim.arm.forces import (
    constant_moments,
    control_ranges,
    dry_friction,
    required_forces,
    servo_gains,
    tangent_basis,
)
from lieednn_sim.arm.limits import largest_inertia
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.evaluation.evaluation import SETTLED_ROTATION, SETTLED_TRANSLATION
from lieednn_sim.planning.statics import TooWeakError, check_held
from lieednn_sim.simulation import Rollout
from lieednn_sim.simulation.controllers.base import NATURAL_FREQUENCY
from lieednn_sim.values import Floats, distances, rounded

# Least fraction of a joint's error that a cause must explain to be reported.
_LEAST_EXPLAINED = 0.25
# Controllers that use the feedback of the arm's servos.
_SERVO_CONTROLLERS = ("position-servo", "inverse-dynamics")


def error_causes(rollout: Rollout) -> tuple[str, ...]:
    """Reasons why joints do not end at their targets, for the joint that matters most first, and then remedies.

    A servo at rest exerts kp (q_ref - q): dry friction F holds it anywhere within F / kp, and a load without
    feedforward pulls it off by load / kp. A servo that still moves at the speed v, with an error that decays as
    exp(-r t), has v / r to go. Arms led by mocap bodies instead of servos have no such causes. No servo is at fault if
    the reference itself ends elsewhere, such as that of a policy that has not arrived.

    A joint is reported if its error alone displaces a link too far to count as settled. Links that end off where the
    joints put them, as on a base that falls, are reported first; if nothing is reported so, the worst joint is.
    """
    arm, target, error = rollout.arm, rollout.target, rollout.q[-1] - rollout.target
    if rollout.controller not in (*_SERVO_CONTROLLERS, "computed-torque", "feedback-linearisation"):
        return ()
    alone = arm.link_poses(target).inv() * arm.link_poses(target + np.diag(error))
    distance = np.linalg.norm(alone.translation, axis=-1).max(axis=1)
    angle = np.asarray(alone.rotation.magnitude()).max(axis=1)
    matters = np.maximum(distance / SETTLED_TRANSLATION, angle / SETTLED_ROTATION)
    carried, lines = arm.link_poses(rollout.q[-1]).inv() * rollout.link_poses()[-1], list[str]()
    off = np.linalg.norm(carried.translation, axis=-1).max(), float(carried.rotation.magnitude().max())
    if off[0] > SETTLED_TRANSLATION or off[1] > SETTLED_ROTATION:
        far = f"a link ends {distances(*off)} from where the joints have it"
        lines = [f"{far}: what carries the arm has moved, or an equality of the model gives way"]
    ranked = np.argsort(-matters, kind="stable")[: max(1 - len(lines), int((matters > 1.0).sum()))]
    slower = "a longer duration"
    try:
        check_held(arm, np.stack([target, rollout.q_ref[-1]]), ["the target", "the end of its reference"])
    except TooWeakError as weak:  # in any time
        lines, slower = [*lines, str(weak)], "another target, or a smaller load"
    except NoSolutionError:  # a loop does not close there
        pass
    result, helpful = _reasons(rollout, error, slower)
    lines += [
        f"joint {arm.joint_names[j]!r} ends {arm.amount(j, error[j])} off, which alone moves a link by "
        f"{distances(distance[j], angle[j])}: "
        + ("; ".join(result[j]) or "no contact, range, friction, load or force limit of the model explains it")
        for j in map(int, ranked)
    ]
    help_with = dict.fromkeys(item for j in ranked for item in helpful[j])
    return (*lines, f"what helps: {', or '.join(help_with)}") if help_with else tuple(lines)


def _reasons(rollout: Rollout, error: Floats, slower: str) -> tuple[list[list[str]], list[list[str]]]:
    """For each coordinate, the causes of its error ``(n,)`` by the model, and their remedies; ``slower`` is one."""
    arm, model, basis = rollout.arm, rollout.arm.model, tangent_basis(rollout.arm.space)
    kp, _ = servo_gains(model, basis)
    load = np.abs(required_forces(model, rollout.qpos[-1:])[0] @ basis)
    (pace, mass), limits = _pace(rollout), arm.force_limits
    # Feedback linearisation uses the feedback of servos, if there are any.
    plain, linearised = (rollout.controller == name for name in ("position-servo", "feedback-linearisation"))
    served = (kp > 0.0) & ((rollout.controller in _SERVO_CONTROLLERS) | linearised)
    stiffness, held = np.where(served, kp, mass * NATURAL_FREQUENCY**2), _held(rollout)
    friction = dry_friction(model, basis) * (plain or linearised)
    # In models that are not the package's, and with a payload, the load is fed forward.
    sag = load * (plain and arm.qpos_home is None and arm.payload == 0.0)
    compensates = f"the controller {'inverse-dynamics' if (kp > 0.0).all() else 'computed-torque'}"
    slow = np.abs(rollout.qd[-1]) > _LEAST_EXPLAINED * pace * np.abs(error)
    # A slow servo has more than this part of an error left at the end of the hold.
    slow &= (np.exp(-pace * rollout.hold) > 0.05) & served
    full = np.abs(rollout.force) >= 0.999 * limits
    low, high = control_ranges(model).T
    ends = (rollout.ctrl[-1] == low) | (rollout.ctrl[-1] == high)  # MuJoCo clips the control there
    ended = np.abs(constant_moments(model) @ basis) * (ends & (model.actuator_biasprm[:, 1] < 0.0))[:, None] > 1e-9
    reasons: list[list[str]] = [[] for _ in error]
    helpful: list[list[str]] = [[] for _ in error]
    design = "designed servos (servos='design', --servos design)"
    for j, off in enumerate(np.abs(error)):
        if abs(aim := rollout.q_ref[-1, j] - rollout.target[j]) > _LEAST_EXPLAINED * off:
            reasons[j].append(f"its reference ends {arm.amount(j, aim)} off")
            helpful[j] += [slower, "the end of the reference as the target, if it was to go there"]
            continue
        unit = "N" if arm.unit(j) == "m" else "N m"
        stiffer = [design] if arm.import_report is not None and arm.import_report.servos[j].kept else []
        pull = min(stiffness[j] * off, limits[j])
        if blocks := [item for item in held if abs(item[1][j]) > _LEAST_EXPLAINED * pull]:
            for what, exerted, remedy in blocks:
                reasons[j].append(f"{what} holds it off with {abs(exerted[j]):.3g} {unit}")
                helpful[j].append(remedy)
            continue
        if load[j] > limits[j]:
            reasons[j].append(f"its load is {load[j]:.3g} {unit}, its force limit {limits[j]:.3g}")
            helpful[j].append("another target")
        elif full[:, j].any():
            share, first = f"{rounded(100.0 * full[:, j].mean())} %", rollout.t[full[:, j].argmax()]
            reached = f"is reached in {share} of the time, first at t = {first:.2f} s"
            reasons[j].append(f"its force limit of {limits[j]:.3g} {unit} {reached}")
            helpful[j].append(slower)
        for a in np.flatnonzero(ended[:, j] & (rollout.controller != "computed-torque")):
            reasons[j].append(f"its servo's control is at the end of its control range [{low[a]:.4g}, {high[a]:.4g}]")
            helpful[j].append("another target")
        for force, says, does in (
            (friction[j], "dry friction of", "holds it anywhere within"),
            (sag[j], "its load of", "pulls it off by"),
        ):
            if force > _LEAST_EXPLAINED * stiffness[j] * off:
                far, gain = arm.amount(j, force / stiffness[j]), "kp" if served[j] else "M w^2"
                reasons[j].append(f"{says} {force:.3g} {unit} / {gain} {stiffness[j]:.4g} {does} {far}")
                helpful[j] += [compensates] * (arm.dependents is None) + stiffer
        if slow[j]:
            reasons[j].append(f"its servo is slow: it still moves, and halves its error in {np.log(2) / pace[j]:.2g} s")
            helpful[j] += ["a longer hold (hold=, --hold)", *stiffer]
        if unknown := rollout.disturbances.unknown_loads:
            reasons[j].append(f"the controller knows nothing of {' and '.join(unknown)}")
    return reasons, helpful


def _held(rollout: Rollout) -> list[tuple[str, Floats, str]]:
    """Contacts, ranges and equalities that MuJoCo finds at the end: in words, their forces ``(n,)``, and a remedy."""
    arm, basis = rollout.arm, tangent_basis(rollout.arm.space)
    model = copy.deepcopy(arm.model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    for obstacle in rollout.disturbances.obstacles:
        model.body_pos[fixed_body(model, obstacle.body)] = obstacle.at(float(rollout.t[-1]))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = rollout.qpos[-1], arm.qvel(rollout.q[-1], rollout.qd[-1])
    data.qfrc_applied[:] = np.linalg.pinv(basis).T @ rollout.force[-1]
    mujoco.mj_forward(model, data)
    found, exerted = dict[tuple[str, str], Floats](), np.zeros(model.nv)
    for row, (number, which) in enumerate(zip(data.efc_type.tolist(), data.efc_id.tolist(), strict=True)):
        kind, _, what = mujoco.mjtConstraint(number).name.removeprefix("mjCNSTR_").lower().partition("_")
        if kind == "equality":
            key = equality_name(model, which), "a target that it allows"
        elif kind == "limit":
            name = getattr(model, what)(which).name or f"number {which}"
            key = f"the range of {what} {name!r}", "a target that it allows"
        elif kind == "contact":
            first, second = (geom_name(model, geom) for geom in data.contact.geom[which].tolist())
            key = f"the contact of {first!r} and {second!r}", "a motion planned with what it touches in the arm's scene"
        else:
            continue
        mujoco.mj_mulJacTVec(model, data, exerted, data.efc_force * (np.arange(data.nefc) == row))
        found[key] = found.get(key, 0.0) + exerted @ basis
    return [(what, force, remedy) for (what, remedy), force in found.items()]


def _pace(rollout: Rollout) -> tuple[Floats, Floats]:
    """Decay rates ``(n,)`` [1/s] of errors under the servos, with other joints held, and the inertia M of each.

    The rates are the slower roots of M r^2 + (kv + D) r + kp = 0.
    """
    model, basis = rollout.arm.model, tangent_basis(rollout.arm.space)
    mass = largest_inertia(model, rollout.qpos[-1:], basis)
    kp, kv = servo_gains(model, basis)
    damping = (kv + model.dof_damping @ basis**2) / (2.0 * mass)
    roots = -damping + np.sqrt((damping**2 - kp / mass).astype(complex))
    return np.maximum(-roots.real, 1e-9), mass
