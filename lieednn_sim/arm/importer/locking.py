"""Joint locking: every joint that is not the arm's is removed, together with all references to it."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.contacts import colliding_geoms
from lieednn_sim.arm.importer.coupled_joints import tendon_joints
from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

_EQ, _OBJ = mujoco.mjtEq, mujoco.mjtObj


def pose(pos: Floats, quat: Floats) -> RigidTransform:
    """A pose from a position ``(..., 3)`` and a quaternion ``(..., 4)``, scalar first."""
    rotation = scipy.spatial.transform.Rotation.from_quat(quat, scalar_first=True)
    return scipy.spatial.transform.RigidTransform.from_components(pos, rotation)


def lock_other_joints(draft: Draft) -> None:
    """Remove all joints but the arm's from the spec, leaving their bodies at the configuration of the draft.

    The equalities, tendons, sensors and tuples that refer to them go too, and all actuators and keyframes. Pairs of
    bodies that MuJoCo did not let collide, as parent and child, are excluded where locking would change that: its
    filter does not apply to the fixed parts of the world.

    Raises:
        InputError: an equality closes a loop over the arm.
    """
    spec, model, chain = draft.spec, draft.original, set(draft.joints)
    data = kinematics_at(model, draft.qpos)
    locked = [joint for joint in spec.joints if joint.id not in chain]
    draft.locked = tuple(joint.name for joint in locked)
    for body_id in {joint.parent.id for joint in locked}:
        _place(spec, spec.bodies[body_id], model, data)
    rigid = _rigid_parts(model, chain)
    draft.notes += _unlink(spec, model, {joint.id for joint in locked}, rigid)
    for joint in locked:
        spec.delete(joint)
    _keep_contact_filter(spec, model, rigid)


def _place(spec: mujoco.MjSpec, body: mujoco.MjsBody, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Fix a body at its present pose in its parent."""
    parent = int(model.body_parentid[body.id])
    now = pose(data.xpos[parent], data.xquat[parent]).inv() * pose(data.xpos[body.id], data.xquat[body.id])
    quat = np.array(body.quat)
    if body.alt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT:
        units = body.compiler
        quat = np.array(spec.resolve_orientation(degree=units.degree, sequence=units.eulerseq, orientation=body.alt))
    # The spec's pose may be one in a <frame>, the model's is one in the parent body: move the former like the latter.
    compiled = pose(model.body_pos[body.id], model.body_quat[body.id])
    local = pose(np.array(body.pos), quat) * compiled.inv() * now
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.pos, body.quat = local.translation, local.rotation.as_quat(scalar_first=True)


def _rigid_parts(model: mujoco.MjModel, chain: Collection[int]) -> NDArray[np.int_]:
    """For each body the root of the rigid part that it belongs to once only ``chain`` moves; 0 is the world."""
    part = np.arange(model.nbody)
    moved = {int(model.jnt_bodyid[joint]) for joint in chain}
    for body in range(1, model.nbody):
        if body not in moved:
            part[body] = part[model.body_parentid[body]]
    return part


def _unlink(spec: mujoco.MjSpec, model: mujoco.MjModel, locked: set[int], rigid: NDArray[np.int_]) -> list[str]:
    """Delete what refers to locked joints, all actuators and all keyframes; return remarks."""
    tendons = {t for t in range(model.ntendon) if locked.intersection(tendon_joints(model, t))}
    equalities, notes = _superfluous_equalities(model, locked, tendons, rigid)
    gone = {
        int(_OBJ.mjOBJ_JOINT): locked,
        int(_OBJ.mjOBJ_TENDON): tendons,
        int(_OBJ.mjOBJ_ACTUATOR): set(range(model.nu)),
    }
    sensors = {s for s in range(model.nsensor) if model.sensor_objid[s] in gone.get(int(model.sensor_objtype[s]), ())}
    tuples = set()
    for i in range(model.ntuple):
        entries = range(model.tuple_adr[i], model.tuple_adr[i] + model.tuple_size[i])
        if any(model.tuple_objid[e] in gone.get(int(model.tuple_objtype[e]), ()) for e in entries):
            tuples.add(i)
    doomed = [
        *spec.keys,
        *spec.actuators,
        *(e for e in spec.tuples if e.id in tuples),
        *(e for e in spec.sensors if e.id in sensors),
        *(e for e in spec.equalities if e.id in equalities),
        *(e for e in spec.tendons if e.id in tendons),
    ]
    if sensors:
        notes.append(f"removed {len(sensors)} sensors of locked joints and old actuators")
    for element in doomed:
        spec.delete(element)
    return notes


def _superfluous_equalities(
    model: mujoco.MjModel, locked: set[int], tendons: set[int], rigid: NDArray[np.int_]
) -> tuple[set[int], list[str]]:
    """Equalities that refer to locked joints or hold bodies that are rigid anyway, and remarks on them."""
    result, notes = set(), []
    for e in range(model.neq):
        kind, first, second = int(model.eq_type[e]), int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        name = model.equality(e).name or f"number {e}"
        if not model.eq_active0[e]:
            result.add(e)
            notes.append(f"removed the inactive equality {name!r}")
        elif kind == int(_EQ.mjEQ_JOINT):
            if locked.intersection((first, second)):
                result.add(e)
                if first not in locked:
                    notes.append(f"joint {model.joint(first).name!r} followed a locked joint and is free of it now")
        elif kind == int(_EQ.mjEQ_TENDON):
            if not tendons.intersection((first, second)):
                raise InputError(
                    f"equality {name!r} between tendons holds the arm; tie its joints by equalities instead"
                )
            result.add(e)
        elif kind in (int(_EQ.mjEQ_CONNECT), int(_EQ.mjEQ_WELD)):
            site = model.eq_objtype[e] == int(_OBJ.mjOBJ_SITE)
            bodies = [int(model.site_bodyid[b]) if site else max(b, 0) for b in (first, second)]
            if any(model.body_mocapid[model.body_rootid[b]] >= 0 for b in bodies):
                notes.append(f"removed the equality {name!r} to a mocap body")
            elif rigid[bodies[0]] != rigid[bodies[1]]:
                raise InputError(
                    f"equality {name!r} closes a loop between bodies {model.body(bodies[0]).name!r} and "
                    f"{model.body(bodies[1]).name!r}, which the arm moves apart; delete it, or choose links beside it"
                )
            result.add(e)
    return result, notes


def _keep_contact_filter(spec: mujoco.MjSpec, model: mujoco.MjModel, rigid: NDArray[np.int_]) -> None:
    """Exclude the pairs of bodies that MuJoCo filtered as parent and child before, but would no longer filter."""
    solid = np.unique(model.geom_bodyid[colliding_geoms(model)]).tolist()
    known = {frozenset((exclude.bodyname1, exclude.bodyname2)) for exclude in spec.excludes}
    weld = model.body_weldid
    for first, second in itertools.combinations(solid, 2):
        pair = frozenset((model.body(first).name, model.body(second).name))
        if pair in known or not _filtered(model, weld, first, second) or _filtered(model, rigid, first, second):
            continue
        spec.add_exclude(bodyname1=model.body(first).name, bodyname2=model.body(second).name)


def _filtered(model: mujoco.MjModel, part: NDArray[np.int_], first: int, second: int) -> bool:
    """MuJoCo's rule: no contact within a rigid part, nor with its parent part unless that is the world."""
    a, b = int(part[first]), int(part[second])
    if a == b:
        return True
    carriers = int(part[model.body_parentid[a]]), int(part[model.body_parentid[b]])
    return bool(a and b and (a == carriers[1] or b == carriers[0]))
