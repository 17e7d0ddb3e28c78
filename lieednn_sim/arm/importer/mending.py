"""What a file needs before it can be an arm: possible inertias, a base that stands, stiff ties.

And what MuJoCo leaves out of a URDF: limits that lock a joint or are wrong, planar joints, limits of rates.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import scipy

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.checks import FREE, ancestry
from lieednn_sim.arm.compound_joints import Couplings
from lieednn_sim.arm.contacts import colliding_geoms
from lieednn_sim.errors import InputError
from lieednn_sim.validation import TURN
from lieednn_sim.values import Floats

Joints = Mapping[str, ElementTree.Element]

_LEAST_INERTIA = 1e-6  # fraction of a body's largest moment, or [kg m^2]


def read_joints(source: Path, notes: list[str]) -> Joints:
    """The joints of a URDF by name; empty for other files and, with a note, for one that cannot be read."""
    if source.suffix.lower() != ".urdf":
        return {}
    try:
        robot = ElementTree.parse(source).getroot()
    except ElementTree.ParseError as error:
        notes.append(f"limits of velocities, and joints without limits, could not be read of the URDF: {error}")
        return {}
    if robot.find(".//origin[@quat_xyzw]") is not None:
        raise InputError("an origin of the URDF has 'quat_xyzw', which MuJoCo ignores; write it as rpy")
    turns = [origin.get("rpy", "") for origin in robot.iter("origin")]
    if many := [turn for turn in turns if np.abs(np.array(turn.split(), dtype=float)).max(initial=0.0) > TURN]:
        notes.append(f"an origin of the URDF has rpy={many[0]!r}: are its angles in degrees?")
    joints = robot.findall("joint") if robot.tag == "robot" else []
    names = [joint.get("name", "") for joint in joints]
    if twice := ", ".join(sorted({repr(name) for name in names if names.count(name) > 1})):
        raise InputError(f"several joints of the URDF have one name: {twice}; give each its own")
    return dict(zip(names, joints, strict=True))


def mend_joints(spec: mujoco.MjSpec, joints: Joints, notes: list[str]) -> None:
    """Lock joints whose limits are equal, where MuJoCo would take them for unlimited; say which have, or get, none.

    `InputError` if a lower limit is above the upper one, or no joint is left.
    """
    locked: list[str] = []
    for name, element in joints.items():
        joint, kind, limit = spec.joint(name), element.get("type"), element.find("limit")
        if joint is not None and kind == "continuous" and np.any(joint.range):
            joint.range = 0.0, 0.0  # none; ROS ignores it, MuJoCo would keep it
            notes.append(f"{name}: continuous, so that its limits in the URDF do not count")
        if joint is None or kind not in ("revolute", "prismatic"):
            continue
        low, high = joint.range
        if low > high:
            raise InputError(f"joint {name!r} of the URDF has the lower limit {low:g} above the upper one, {high:g}")
        if (leader := element.find("mimic")) is not None and leader.get("joint") not in joints:
            notes.append(f"{name}: moves by itself: the URDF has no joint {leader.get('joint')!r} to mimic")
        if limit is None or not (given := {"lower", "upper"}.intersection(limit.keys())):
            notes.append(f"{name}: {kind}, but without limits in the URDF")
        elif low == high:
            _lock(spec, joint, low, locked)
        elif len(given) == 1:  # the other one is zero, but MuJoCo would have no limits
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    if locked:
        notes.append(f"locked by equal limits in the URDF: {', '.join(locked)}")
        if not spec.joints:
            raise InputError(f"equal limits in the URDF lock all of its joints: {', '.join(locked)}; correct them")


def _lock(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, value: float, locked: list[str]) -> None:
    """Fix the body of a hinge or slide at a joint position, and the bodies of joints that follow it."""
    locked.append(f"{joint.name} at {value:g}")
    for equality in [item for item in spec.equalities if joint.name in (item.name1, item.name2)]:
        follower, coefficients = equality.name1, np.array(equality.data[:5])
        spec.delete(equality)
        if follower != joint.name:
            _lock(spec, spec.joint(follower), float(np.polynomial.polynomial.polyval(value, coefficients)), locked)
    body, turn = joint.parent, scipy.spatial.transform.Rotation
    before, axis = turn.from_quat(body.quat, scalar_first=True), np.array(joint.axis) / np.linalg.norm(joint.axis)
    if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        body.quat = (before * turn.from_rotvec(value * axis)).as_quat(scalar_first=True)
    else:
        body.pos = body.pos + before.apply(value * axis)
    spec.delete(joint)


def rate_limits(joints: Joints, rate: str, notes: list[str]) -> dict[str, float]:
    """The limits of a rate of `limits.RATES`; zero counts as none; empty, with a note, if they are unreadable."""
    limits = {name: limit for name, element in joints.items() if (limit := element.find("limit")) is not None}
    both = [rate, "deceleration"] if rate == "acceleration" else [rate]
    try:
        found = {name: [float(limit.get(each, "0")) for each in both] for name, limit in limits.items()}
    except ValueError as error:
        notes.append(f"{rate} limits, if there are any, could not be read: {error}")
        return {}
    return {name: min(value for value in each if value > 0.0) for name, each in found.items() if max(each) > 0.0}


def mend_inertias(spec: mujoco.MjSpec, notes: list[str]) -> None:
    """Give inertias to moving links of a URDF without any, and enlarge impossible ones: A + B >= C > 0 must hold.

    Other simulators accept both. If MuJoCo guesses masses from shapes, their weight is compensated, so that no motor
    has to hold what nobody has weighed.
    """
    mended: dict[str, list[str]] = {}  # bodies by what was done
    for body in spec.bodies[1:]:
        if body.joints and body.explicitinertial and body.mass == 0.0:
            body.explicitinertial, body.ipos, body.fullinertia = False, np.full(3, np.nan), np.full(6, np.nan)
            notes.append(f"{body.name}: a mass of zero is taken as no <inertial>")
        if not body.explicitinertial and len(body.geoms):
            body.gravcomp = 1.0
            what = "links without <inertial> got the inertia of their shapes, but no weight"
            mended.setdefault(what, []).append(body.name)
        if body.joints and not body.explicitinertial and not body.geoms:
            # As light as MuJoCo's solver tolerates between links of some kilograms.
            body.mass, body.inertia, body.explicitinertial = 0.01, [1e-5] * 3, True
            mended.setdefault("links without <inertial> got a mass of 10 g", []).append(body.name)
            continue
        given = body.fullinertia
        if not np.isfinite(given).all():
            continue
        xx, yy, zz, xy, xz, yz = given
        moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        moments = np.maximum(moments, _LEAST_INERTIA * max(moments[2], _LEAST_INERTIA))
        lacking = (1.0 + _LEAST_INERTIA) * moments[2] - moments[0] - moments[1]
        if lacking > 0.0 or given[:3].min() <= 0.0:
            moments[:2] += 0.5 * max(lacking, 0.0)
            tensor = (axes * moments) @ axes.T
            body.fullinertia = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            mended.setdefault("physically impossible inertias made larger", []).append(body.name)
    notes += [f"{what}: {', '.join(bodies)}" for what, bodies in mended.items()]


def fix_base(spec: mujoco.MjSpec, model: mujoco.MjModel, carried: int, qpos: Floats, notes: list[str]) -> Floats:
    """Fix the free body that carries the arm where it is at ``qpos`` ``(nq,)``, since nothing would hold it up.

    ``model`` is what the spec compiles to, ``carried`` the first moving body of the arm. Returns the new ``qpos``.
    """
    free = [j for j in np.flatnonzero(model.jnt_type == FREE) if model.jnt_bodyid[j] in ancestry(model, carried)]
    if not free:
        return qpos
    (joint,) = free
    root = int(model.jnt_bodyid[joint])
    data = kinematics_at(model, qpos)
    _exclude_neighbours(spec, model, root)
    first, rate = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    coordinates, rates = slice(first, first + 7), slice(rate, rate + 6)
    keys = [(np.delete(key.qpos, coordinates), np.delete(key.qvel, rates)) for key in spec.keys]
    body = spec.bodies[root]
    _place(spec, body, model, data)
    notes.append(f"{body.name!r}, a free body that carries the arm, is fixed where it is at home")
    # MuJoCo 4 checks the keyframes here, and refuses those that are already without the joint.
    spec.delete(spec.joints[joint])
    body.sleep = mujoco.mjtSleepPolicy.mjSLEEP_AUTO  # MuJoCo allows others for moving bodies only
    for key, values in zip(spec.keys, keys, strict=True):
        key.qpos, key.qvel = values
    return np.delete(qpos, coordinates)


def tie_stages(spec: mujoco.MjSpec, model: mujoco.MjModel, couplings: Couplings, notes: list[str]) -> None:
    """Tie the stages of a telescope to their leaders by equalities that are nearly as stiff as rigid belts.

    Stages tied by a tendon alone get an equality, and softer ones of the model are made as stiff: by MuJoCo's default a
    light stage hangs on a spring of a few hundred newtons per metre, and friction of a few newtons leaves it
    centimetres behind the others, unseen by any servo.
    """
    # MuJoCo's least time constant is two timesteps.
    reference = np.array([max(0.004, 2.0 * model.opt.timestep), 1.0])
    impedance = np.array([0.99, 0.999, 0.001, 0.5, 2.0])
    for follower in couplings.added:
        leader, ratio, shift = couplings.lines[follower]
        y0, x0 = (float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (follower, leader))
        equality = spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT, name1=model.joint(follower).name, name2=model.joint(leader).name, active=True
        )
        equality.data = np.array([shift - y0 + ratio * x0, ratio, *np.zeros(len(equality.data) - 2)])
        equality.solref, equality.solimp = reference, impedance
    followers = {model.joint(follower).name for follower in couplings.lines if follower not in couplings.added}
    stiffened = []
    for equality in spec.equalities:
        if equality.type != mujoco.mjtEq.mjEQ_JOINT or not equality.active or equality.name1 not in followers:
            continue
        # Negative numbers are a stiffness and a damping that were set explicitly.
        if equality.solref[0] > reference[0] or equality.solref[0] == 0.0:
            equality.solref, equality.solimp = reference, impedance
            stiffened.append(equality.name1)
    if couplings.added:
        tied = ", ".join(model.joint(follower).name for follower in couplings.added)
        notes.append(f"ties added to {tied}, which only a tendon moved along")
    if stiffened:
        notes.append(f"ties of {', '.join(stiffened)} made stiff, with solref {reference[0]:g} s")


def _place(spec: mujoco.MjSpec, body: mujoco.MjsBody, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Put a child of the world where it is in a state."""

    def pose(pos: Floats, quat: Floats) -> scipy.spatial.transform.RigidTransform:
        turn = scipy.spatial.transform.Rotation.from_quat(quat, scalar_first=True)
        return scipy.spatial.transform.RigidTransform.from_components(pos, turn)

    quat = np.array(body.quat)
    if body.alt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT:
        units = body.compiler
        quat = np.array(spec.resolve_orientation(degree=units.degree, sequence=units.eulerseq, orientation=body.alt))
    # The spec's pose may be one in a <frame>, the model's is one in the world: move the former like the latter.
    compiled = pose(model.body_pos[body.id], model.body_quat[body.id])
    local = pose(np.array(body.pos), quat) * compiled.inv() * pose(data.xpos[body.id], data.xquat[body.id])
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.pos, body.quat = local.translation, local.rotation.as_quat(scalar_first=True)


def _exclude_neighbours(spec: mujoco.MjSpec, model: mujoco.MjModel, root: int) -> None:
    """Exclude pairs that MuJoCo filters as parent and child, but not any more once the parent is fixed to the world."""
    weld, solid = model.body_weldid, np.unique(model.geom_bodyid[colliding_geoms(model)]).tolist()
    known = {frozenset((exclude.bodyname1, exclude.bodyname2)) for exclude in spec.excludes}
    base = [body for body in solid if weld[body] == root]
    for child in (body for body in solid if weld[body] != root and weld[model.body_parentid[weld[body]]] == root):
        for body in base:
            pair = model.body(body).name, model.body(child).name
            if frozenset(pair) not in known:
                spec.add_exclude(bodyname1=pair[0], bodyname2=pair[1])
