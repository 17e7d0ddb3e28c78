"""A free body that a hand holds: for a plan it is part of the hand, and may touch what it stands on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE, ContactFinder, colliding_geoms
from lieednn_sim.arm.frames import find_frame
from lieednn_sim.arm.importer.loading import unused
from lieednn_sim.arm.importer.locking import pose
from lieednn_sim.errors import InputError
from lieednn_sim.validation import quoted
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

# How much further than at the start the held body may sink into what it stands on [m].
_DEPTH = 5e-4
# Least size of a shrunk geom [m].
_THIN = 1e-5
# A bit that no geom's contype has: geoms with it meet others in explicit pairs only.
_PAIRS_ONLY = 1 << 30
_FREE, _MESH = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtGeom.mjGEOM_MESH)
# The entries of a geom's size that are distances from its middle, by its type.
_SIZES = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): 1,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): 1,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): 2,
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): 3,
    int(mujoco.mjtGeom.mjGEOM_BOX): 3,
}


@dataclass(frozen=True, eq=False)
class Grasp:
    """A free body fixed to the body that carries it.

    Attributes:
        body: its id.
        bodies: ids of it and of all bodies that hang from it.
        carrier: id of the body that carries it.
        place: its pose in the carrier's frame.
        supports: how much a geom of the held body is shrunk [m] where it meets a geom that the held body may touch, by
            the ids of both.
    """

    body: int
    bodies: tuple[int, ...]
    carrier: int
    place: RigidTransform
    supports: dict[tuple[int, int], float]


def find_grasp(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    holding: str,
    tip: str | None,
    touching: Sequence[str],
    clearance: float,
) -> Grasp:
    """The grasp of a free body at its present pose.

    The held body may touch what it is nearer to than the clearance now, and the bodies of ``touching``, but sink into
    them no deeper than now. These pairs of geoms are tested with a geom of the held body that is smaller by as much.

    Args:
        model: a compiled model.
        data: its state.
        holding: name of a body with a free joint.
        tip: name of the body or site that carries it.
        touching: names of bodies that the held body may touch as well, such as where it is put.
        clearance: distance that other pairs keep [m].

    Raises:
        InputError: there is no such free body, no tip, or no body to touch.
    """
    free = {
        model.body(model.jnt_bodyid[j]).name: int(model.jnt_bodyid[j]) for j in np.flatnonzero(model.jnt_type == _FREE)
    }
    if holding not in free:
        names = ", ".join(sorted(filter(None, free))) or "none"
        raise InputError(f"nothing to hold is called {quoted(holding)}; bodies with a free joint are: {names}")
    if tip is None:
        raise InputError(f"to hold {quoted(holding)}, name the tip, the body or site that carries it")
    body: int = free[holding]
    carrier: int = find_frame(model, tip).body
    root = int(model.body_rootid[carrier])
    if root == body:
        raise InputError(f"{quoted(holding)} carries the tip {quoted(tip)}, and cannot be held by it")
    bodies = tuple(map(int, np.flatnonzero(model.body_rootid == body)))
    allowed = {_body(model, name) for name in touching}
    now = _kinematics(model, data)
    place = pose(now.xpos[carrier], now.xquat[carrier]).inv() * pose(now.xpos[body], now.xquat[body])
    supports: dict[tuple[int, int], float] = {}
    mine = np.isin(model.geom_bodyid, bodies)
    # What moves with the arm's base may not be touched: neither the arm itself nor its hand stands below the body.
    robot = (model.body_rootid == root) & (model.body_weldid != 0)
    for distance, geoms in zip(*ContactFinder(model, clearance + _DEPTH, mocap=data).geoms(data.qpos), strict=True):
        first, second = (int(geom) for geom in (geoms if mine[geoms[0]] else geoms[::-1]))
        if mine[first] and not mine[second] and not robot[model.geom_bodyid[second]]:
            depth = max(-float(distance), 0.0)
            supports[first, second] = max(supports.get((first, second), 0.0), clearance + depth + _DEPTH)
    solid = colliding_geoms(model)
    named = np.isin(model.geom_bodyid, list(allowed)) & solid
    for pair in product(np.flatnonzero(mine & solid).tolist(), np.flatnonzero(named).tolist()):
        supports.setdefault(pair, clearance + _DEPTH)
    return Grasp(body, bodies, carrier, place, supports)


def _body(model: mujoco.MjModel, name: str) -> int:
    result = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name))
    if result < 0:
        known = ", ".join(filter(None, (model.body(k).name for k in range(model.nbody))))
        raise InputError(f"no body {quoted(name)} to touch; bodies are: {known}")
    return result


def _kinematics(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    moved = mujoco.MjData(model)
    moved.qpos[:], moved.mocap_pos[:], moved.mocap_quat[:] = data.qpos, data.mocap_pos, data.mocap_quat
    mujoco.mj_kinematics(model, moved)
    return moved


def in_order(model: mujoco.MjModel, grasp: Grasp | None) -> list[int]:
    """All bodies, parents before children, depth first, with a held body as the last child of its carrier."""
    if grasp is None:
        return list(range(model.nbody))
    children: list[list[int]] = [[] for _ in range(model.nbody)]
    for body in range(1, model.nbody):
        if body != grasp.body:
            children[model.body_parentid[body]].append(body)
    children[grasp.carrier].append(grasp.body)
    order, waiting = [], [0]
    while waiting:
        order.append(waiting.pop())
        waiting += reversed(children[order[-1]])
    return order


def add_supports(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    grasp: Grasp,
    name: Callable[[str, int], str],
    copied: Callable[..., Any],
) -> None:
    """Let the held body touch what supports it, by pairs of geoms of which its own is smaller.

    Args:
        spec: the spec, with all geoms, which is changed.
        model: the model that it was made of.
        grasp: what is held.
        name: the name in the spec of an element, by its kind and id.
        copied: adds a geom like that of an id to a body of the spec, and returns it.
    """
    taken = {geom.name for geom in spec.geoms}
    bodies = {(int(model.geom_bodyid[a]), int(model.geom_bodyid[b])) for a, b in grasp.supports}
    for body, other in sorted(bodies):
        spec.add_exclude(bodyname1=name("body", body), bodyname2=name("body", other))
    solid = np.flatnonzero(colliding_geoms(model))
    kind, affinity = model.geom_contype, model.geom_conaffinity
    for a in solid.tolist():
        for b in solid.tolist():
            if (int(model.geom_bodyid[a]), int(model.geom_bodyid[b])) not in bodies:
                continue
            if not ((kind[a] & affinity[b]) | (kind[b] & affinity[a])):
                continue
            first = name("geom", a)
            if (shrunk := grasp.supports.get((a, b))) is not None:
                core = copied(a, unused(f"{first}_core", taken))
                taken.add(core.name)
                core.contype, core.conaffinity, core.group = 0, _PAIRS_ONLY, 5
                _shrink(spec, model, core, a, shrunk)
                first = core.name
            spec.add_pair(geomname1=first, geomname2=name("geom", b))


def _shrink(spec: mujoco.MjSpec, model: mujoco.MjModel, core: Any, geom: int, by: float) -> None:
    """Make a copy of a geom smaller on all sides."""
    shape = int(model.geom_type[geom])
    if shape == _MESH:
        mesh = int(model.geom_dataid[geom])
        rows = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        points = centre + (model.mesh_vert[rows] - centre) * np.maximum(half - by, _THIN) / np.maximum(half, _THIN)
        result = spec.add_mesh(name=f"{core.name}", uservert=np.asarray(points).ravel())
        result.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        core.meshname = result.name
        return
    size: Floats = np.array(core.size)
    entries = _SIZES.get(shape, 0)
    size[:entries] = np.maximum(size[:entries] - by, _THIN)
    core.size = size


def keep_from_last_link(spec: mujoco.MjSpec, held: Sequence[str]) -> None:
    """Let held bodies meet the link before the one that carries them, which MuJoCo's filter would leave out.

    Left out all the same are pairs that are excluded, and those of geoms that are too near at the keyframe ``home``.

    Args:
        spec: an imported arm's spec, which is changed.
        held: names of the held bodies.
    """
    model = spec.copy().compile()
    data = kinematics_at(model, model.key("home").qpos)
    ids = [model.body(name).id for name in held]
    part = int(model.body_weldid[ids[0]])
    before = int(model.body_weldid[model.body_parentid[part]])
    if not part or not before:
        return
    kind, affinity, bodies = model.geom_contype, model.geom_conaffinity, model.geom_bodyid
    mine = np.isin(bodies, ids) & colliding_geoms(model) & (affinity != _PAIRS_ONLY)
    theirs = (model.body_weldid[bodies] == before) & colliding_geoms(model)
    excluded = {divmod(int(signature), 1 << 16) for signature in model.exclude_signature}
    for a, b in product(np.flatnonzero(mine).tolist(), np.flatnonzero(theirs).tolist()):
        pair = (int(min(bodies[a], bodies[b])), int(max(bodies[a], bodies[b])))
        meets = (kind[a] & affinity[b]) | (kind[b] & affinity[a])
        if meets and pair not in excluded and mujoco.mj_geomDistance(model, data, a, b, 1.0, None) > PLANNED_CLEARANCE:
            spec.add_pair(geomname1=model.geom(a).name, geomname2=model.geom(b).name)
