"""Checks of import reports against the imported models, without any of the importer's code."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer import ImportReport

# Thresholds of the importer plus the rounding of a report: largest deviation of a joint by friction that is not
# reported [rad, m], and largest distance of bodies at home between which contacts are ignored [m].
_SAG = 3.1e-4
_CLOSE = 0.0026
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def wrong_in_report(arm: Arm, original: mujoco.MjModel, qpos: np.ndarray, file: Path) -> list[str]:
    """Wrong or missing statements of a report; none if it is right.

    Args:
        arm: the imported arm, with its report.
        original: the original model.
        qpos: ``(nq,)`` configuration of the original model that the report names.
        file: the model's file, from which limits of a URDF are read.
    """
    report = arm.import_report
    assert report is not None
    return [
        *_joints(report, original),
        *_ranges(arm, report, original),
        *_limits(arm, report, original, file),
        *_contacts(arm, report, original),
        *_servos(arm, report, original),
        *_home(arm, report, original, qpos),
    ]


def _joints(report: ImportReport, model: mujoco.MjModel) -> list[str]:
    """Check that every joint is either in one group or locked, and that the arm's form one chain, cut at the links."""
    wrong = []
    named = [*(joint for group in report.groups for joint in group), *report.locked]
    every = [model.joint(j).name for j in range(model.njnt)]
    if sorted(named) != sorted(every):
        wrong.append(f"joints in no place or in two: {set(named) ^ set(every)}")
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, report.base)
    for link, group in zip(report.links, report.groups, strict=True):
        tip = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, link)
        if min(tip, body) < 0:
            break  # frames at sites are checked by the forward map
        path: list[str] = []
        at = tip
        while at not in (body, 0):
            path[:0] = [model.joint(model.body_jntadr[at] + k).name for k in range(model.body_jntnum[at])]
            at = int(model.body_parentid[at])
        if tuple(path) != group or at != body:
            wrong.append(f"{link} is moved by {path}, not {group}")
        body = tip
    return wrong


def _ranges(arm: Arm, report: ImportReport, model: mujoco.MjModel) -> list[str]:
    """Check that ranges are the model's, or that a note reports the change."""
    wrong = []
    for k, name in enumerate(arm.joint_names):
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if joint < 0 or model.jnt_type[joint] not in (_HINGE, _SLIDE):
            continue
        given = model.jnt_range[joint] if model.jnt_limited[joint] else [-np.inf, np.inf]
        told = any(re.match(rf"{re.escape(name)}: (had no )?range", note) for note in report.notes)
        if np.allclose(arm.position_limits[k], given, atol=1e-9) == told:
            wrong.append(f"{name}: range {given} became {arm.position_limits[k]}, {'' if told else 'not '}told")
    return wrong


def _limits(arm: Arm, report: ImportReport, model: mujoco.MjModel, file: Path) -> list[str]:
    """Check limits: forces against actuators or URDF, velocities against the URDF, accelerations against forces."""
    wrong = []
    urdf = {} if file.suffix != ".urdf" else {j.get("name"): j.find("limit") for j in _elements(file)}
    held = np.diag(_inertia(arm))
    for k, (name, servo) in enumerate(zip(arm.joint_names, report.servos, strict=True)):
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if joint < 0:
            continue
        limit = urdf.get(name)
        force, velocity = np.inf, np.inf
        if limit is not None:
            force = float(limit.get("effort", "0")) or np.inf
            velocity = float(limit.get("velocity", "0")) or np.inf
        for a in range(model.nu):
            if model.actuator_trnid[a, 0] == joint and model.actuator_trntype[a] == int(mujoco.mjtTrn.mjTRN_JOINT):
                gear = abs(model.actuator_gear[a, 0])
                if model.actuator_forcelimited[a]:
                    force = min(force, gear * np.abs(model.actuator_forcerange[a]).min())
                elif model.actuator_biastype[a] == 0 and model.actuator_ctrllimited[a]:
                    motor = gear * model.actuator_gainprm[a, 0] * np.abs(model.actuator_ctrlrange[a]).min()
                    force = min(force, motor or np.inf)
        if model.jnt_actfrclimited[joint]:
            force = min(force, np.abs(model.jnt_actfrcrange[joint]).min() or np.inf)
        followers = any(coupling.leader == name for coupling in report.couplings)
        if not followers and not np.isclose(min(np.abs(servo.force_range)), force, rtol=1e-6):
            wrong.append(f"{name}: force limit {force:g}, the report says {servo.force_range}")
        if limit is not None and not followers and not np.isclose(arm.velocity_limits[k], velocity):
            wrong.append(f"{name}: velocity limit {velocity:g}, the arm has {arm.velocity_limits[k]:g}")
        numeric = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, "acceleration_limit") >= 0
        if not numeric and np.isfinite(arm.acceleration_limits[k]):
            # At most half of the force over the inertia at home: the importer takes the largest inertia of several.
            told = any(f"{servo.name} {arm.acceleration_limits[k]:.3g}" in note for note in report.notes)
            if not told or arm.acceleration_limits[k] > 0.5 * force / held[k] * (1.0 + 1e-6):
                wrong.append(f"{name}: acceleration limit {arm.acceleration_limits[k]:g} of force {force:g}")
    return wrong


def _contacts(arm: Arm, report: ImportReport, model: mujoco.MjModel) -> list[str]:
    """Check that the report names every pair of bodies whose contacts are newly ignored, and that these are close."""
    wrong = []
    notes = [note for note in report.notes if note.startswith("contacts ignored between")]
    named = {frozenset(pair) for note in notes for pair in re.findall(r"'([^']+)' and '([^']+)'", note)}
    before = {int(signature) for signature in model.exclude_signature}
    weld = model.body_weldid
    for signature in arm.model.exclude_signature:
        one, other = (arm.model.body(int(body)).name for body in (signature >> 16, signature & 0xFFFF))
        ids = sorted(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in (one, other))
        parents = [int(weld[model.body_parentid[weld[body]]]) for body in ids]
        related = weld[ids[0]] == parents[1] or weld[ids[1]] == parents[0]
        could = (ids[0] << 16) + ids[1] not in before and weld[ids[0]] != weld[ids[1]]
        if could and not (related and 0 not in (weld[ids[0]], weld[ids[1]])) and frozenset((one, other)) not in named:
            wrong.append(f"contacts of {one!r} and {other!r} are off, and the report does not say so")
    home = mujoco.MjData(arm.model)
    mujoco.mj_resetDataKeyframe(arm.model, home, arm.model.key("home").id)
    mujoco.mj_kinematics(arm.model, home)
    for note in notes:
        for one, other in re.findall(r"'([^']+)' and '([^']+)'", note):
            if "telescope" in note:
                continue  # these overlap at some extension, not necessarily at home
            geoms = [_geoms(arm.model, name) for name in (one, other)]
            nearest = min(mujoco.mj_geomDistance(arm.model, home, g, h, 1.0, None) for g in geoms[0] for h in geoms[1])
            if nearest > _CLOSE:
                wrong.append(f"contacts of {one!r} and {other!r} are off, {1e3 * nearest:.3g} mm apart at home")
    return wrong


def _servos(arm: Arm, report: ImportReport, model: mujoco.MjModel) -> list[str]:
    """Check that kept gains are the model's, and that exactly the friction above the threshold is reported."""
    wrong = []
    for name, servo in zip(arm.joint_names, report.servos, strict=True):
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if joint < 0:
            continue
        mine = [a for a in range(model.nu) if model.actuator_trnid[a, 0] == joint and model.actuator_trntype[a] == 0]
        if servo.kept and len(mine) == 1:
            gear = model.actuator_gear[mine[0], 0]
            gains = gear**2 * np.array([model.actuator_gainprm[mine[0], 0], -model.actuator_biasprm[mine[0], 2]])
            if not np.allclose(gains, [servo.kp, servo.kv], rtol=1e-6):
                wrong.append(f"{name}: gains {gains} are told to be {servo.kp:g}, {servo.kv:g}")
        if any(name in (coupling.leader, coupling.follower) for coupling in report.couplings):
            continue
        stuck = float(model.dof_frictionloss[model.jnt_dofadr[joint]]) / servo.kp
        told = any(note.startswith(f"{servo.name}: dry friction") for note in report.notes)
        if abs(stuck - 3e-4) > 1e-5 and (stuck > _SAG) != told:
            wrong.append(f"{name}: dry friction leaves it {stuck:.2g} off, {'' if told else 'not '}told")
    return wrong


def _home(arm: Arm, report: ImportReport, model: mujoco.MjModel, qpos: np.ndarray) -> list[str]:
    """Check that home is the configuration that the report names, except for joints that it reports as moved."""
    wrong = []
    for name, now in zip(arm.joint_names, arm.keyframe("home"), strict=True):
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if joint < 0 or any(name in (coupling.leader, coupling.follower) for coupling in report.couplings):
            continue
        given = qpos[model.jnt_qposadr[joint]]
        told = any(
            note.startswith(f"{name}: moved off its limits")
            or (note.startswith("home moved") and f"{name} from" in note)
            for note in report.notes
        )
        if (abs(now - given) > 1e-6) != told:
            said = "told" if told else "not told"
            wrong.append(f"{name}: at {given:g} in {report.configuration}, at {now:g} at home, {said}")
    return wrong


def _inertia(arm: Arm) -> np.ndarray:
    """Inertia matrix ``(n, n)`` of the coordinates at home."""
    data = mujoco.MjData(arm.model)
    mujoco.mj_resetDataKeyframe(arm.model, data, arm.model.key("home").id)
    mujoco.mj_forward(arm.model, data)
    full = np.zeros((arm.model.nv, arm.model.nv))
    mujoco.mj_fullM(arm.model, data, full)
    basis = arm.space.rates
    return basis.T @ full @ basis


def _elements(file: Path) -> Any:
    return ElementTree.parse(file).getroot().iterfind("joint")


def _geoms(model: mujoco.MjModel, body: str) -> list[int]:
    start, count = model.body(body).geomadr[0], model.body(body).geomnum[0]
    return [g for g in range(start, start + count) if model.geom_contype[g] or model.geom_conaffinity[g]]
