"""Obstacles from the user's own files: MJCF, or a list of shapes in YAML or JSON, placed in the world's frame."""

from __future__ import annotations

import os
import warnings
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lieednn_sim import io
from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE, ContactFinder, colliding_geoms, geom_name, moving_geoms
from lieednn_sim.arm.fingerprint import model_fingerprint
from lieednn_sim.arm.importer.floor import AUTO, FLOOR, NONE, add_plane, as_floor, collision_bits
from lieednn_sim.arm.importer.loading import compile_spec, load_spec, unused
from lieednn_sim.arm.model_arm import ModelArm
from lieednn_sim.arm.scenes import GOAL_PREFIX, PREFIX
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.io import is_file
from lieednn_sim.registry import SCENES
from lieednn_sim.validation import TURN, as_choice, as_floats, as_path, as_positive, quoted
from lieednn_sim.values import Floats, StrPath

SCENE_SUFFIXES = (".xml", ".yaml", ".yml", ".json")  # suffixes that tell a file from the name of a scene
# Largest number of entries in a list of obstacles or of goals; and the prefix of goals.
_MOST = 10_000
_GOAL = GOAL_PREFIX.removeprefix(PREFIX)
_HIDDEN = 5  # MuJoCo draws groups 0 to 2 by default
_FARTHEST, _LARGE = 200.0, 10.0  # largest distances from the origin and from the own centre [m]
_REACHES = 20.0  # largest distance of an obstacle without a warning [reaches of the arm]
# The entries of each shape, besides its pose.
_SHAPES = {
    "box": {"size"},
    "sphere": {"radius"},
    "cylinder": {"radius", "length"},
    "capsule": {"radius", "length"},
    "mesh": {"file", "scale"},
    "plane": set(),
}


def is_scene_file(scene: object) -> bool:
    """Whether a scene is a file, by its suffix, rather than the name of one of the package's."""
    return isinstance(scene, str | os.PathLike) and Path(scene).suffix.lower() in SCENE_SUFFIXES


def scene_label(path: StrPath) -> str:
    """The name of a file's scene, its stem; `InputError` if the package has a scene of that name."""
    label = as_path("the name of a scene", path).stem
    if label in SCENES:
        raise InputError(f"{path} has the name of the package's scene {label!r}; rename the file")
    return label


def load_obstacles(path: StrPath) -> mujoco.MjSpec:
    """Read a file of obstacles; lengths are in metres, angles in radians, poses in the world's frame.

    An MJCF file holds bodies without joints; its sites ``goal...`` are boxes in which targets are drawn. A YAML or JSON
    file holds a list ``obstacles``, each with a ``shape`` (``box``, ``sphere``, ``cylinder``, ``capsule``, ``mesh``, or
    ``plane``: everything below it, along its z) and its entries, as in `docs/howto/own_scene.md`; optionally a list
    ``goals`` of boxes, and the ``floor`` of an imported arm, a height or ``none``.

    Raises:
        FileError: the file or one of its meshes is missing, or it cannot be read.
        InputError: an entry is invalid; the message names it.
    """
    source = as_path("the name of a scene", path)
    mjcf = source.suffix.lower() == ".xml"
    spec = load_spec(source) if mjcf else shapes(io.load_description(source, "scene"), source)
    for key in spec.keys:
        spec.delete(key)
    for site in spec.sites:
        if site.name.startswith(_GOAL):
            site.group = _HIDDEN  # if drawn, it would look like an obstacle
    try:
        model = compile_spec(spec)
    except FileError as error:
        raise FileError(f"{source}: {error}") from None
    if moving := [model.joint(j).name for j in range(model.njnt)]:
        raise InputError(f"{source}: obstacles must not move, but it has joints: {', '.join(moving[:5])}")
    for body in spec.bodies:
        body.mocap = False  # bodies that are attached to others cannot be mocap bodies
    away = np.linalg.norm(kinematics_at(model, model.qpos0).geom_xpos, axis=-1) * colliding_geoms(model)
    if away.max(initial=0.0) > _FARTHEST:
        name = geom_name(model, int(away.argmax()))
        raise InputError(f"{source}: {name!r} is {away.max():.3g} m away; lengths are in metres, not millimetres")
    if not colliding_geoms(model).any() and not spec.texts:
        raise InputError(f"{source} holds no obstacle: no geom of it collides with anything")
    if flat := [model.site(s).name for s in _goals(model) if model.site_type[s] != mujoco.mjtGeom.mjGEOM_BOX]:
        raise InputError(f"{source}: goals must be boxes, which these are not: {', '.join(flat)}")
    return spec


def describe(obstacles: mujoco.MjSpec) -> tuple[str, str]:
    """A summary of a file's obstacles, and their fingerprint."""
    model = compile_spec(obstacles)
    kinds = map(mujoco.mjtGeom, model.geom_type[colliding_geoms(model)].tolist())
    counts = [f"{n} {kind.name.removeprefix('mjGEOM_').lower()}" for kind, n in Counter(kinds).items()]
    goals = len(_goals(model))
    where = f"targets in {goals} goal{'s' if goals > 1 else ''}" if goals else "targets anywhere"
    return f"{', '.join(counts)}; {where}", model_fingerprint(model)


def add_own_obstacles(spec: mujoco.MjSpec, arm: ModelArm, obstacles: mujoco.MjSpec, label: str) -> None:
    """Attach obstacles to a copy of an arm's spec; they collide with every colliding geom of the arm."""
    bits = collision_bits(arm.model)
    for text in list(obstacles.texts):
        if text.name == FLOOR:
            _replace_floor(spec, arm, text.data, bits)
            obstacles.delete(text)
    for geom in obstacles.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype = geom.conaffinity = bits
    holder = unused(PREFIX + label, {PREFIX + body.name for body in obstacles.bodies})
    body = spec.worldbody.add_body(name=holder)
    spec.attach(obstacles, prefix=PREFIX, frame=body.add_frame())
    # MuJoCo keeps all pairs of bodies at once; its own default is too small for 1700 bodies.
    if len(spec.bodies) > 500:
        spec.memory = max(spec.memory, 2**24 + 5 * len(spec.bodies) ** 2)


def _replace_floor(spec: mujoco.MjSpec, arm: ModelArm, asked: str, bits: int) -> None:
    """Put another floor, or none, in the place of that of an imported arm."""
    floor = spec.body(FLOOR)
    if floor is None and any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.geoms):
        raise InputError(f"arm {arm.name!r} has a floor in its own model, which a scene cannot replace")
    if floor is not None:
        spec.delete(floor)
    if asked not in (AUTO, NONE):
        add_plane(spec, FLOOR, float(asked), bits)


def check_home(arm: ModelArm, scene: str) -> None:
    """Raise `InputError` where an arm at ``home`` touches one of the obstacles around it; warn of one far away."""
    model, home = arm.model, kinematics_at(arm.model, arm.qpos(arm.keyframe("home")))
    near = ContactFinder(model, PLANNED_CLEARANCE).geoms(home.qpos)[1]
    moving, roots = moving_geoms(model), model.body_rootid[model.geom_bodyid]
    for pair in near:
        if moving[pair].sum() == 1 and any(model.body(root).name.startswith(PREFIX) for root in roots[pair]):
            names = [model.geom(g).name or model.body(model.geom_bodyid[g]).name for g in pair]
            part, obstacle = names if moving[pair[0]] else names[::-1]
            what = f"obstacle {obstacle.removeprefix(PREFIX)!r} of scene {scene!r}"
            near_what = f"{1e3 * PLANNED_CLEARANCE:g} mm of {part!r} of arm {arm.name!r} at home"
            unit = " (are its lengths, or its mesh's, in millimetres?)" * bool(model.geom_rbound[pair].max() > _LARGE)
            raise InputError(f"{what} is within {near_what}; move it, or give the arm another home{unit}")
    away = np.linalg.norm(home.geom_xpos - arm.base.translation, axis=-1) - model.geom_rbound
    away *= model.geom_rbound > 0.0  # planes have none
    if (far := away.max()) > _REACHES * arm.reach:
        said = f"scene {scene!r}: {geom_name(model, int(away.argmax()))!r} is {far:.3g} m from arm {arm.name!r}, which"
        warnings.warn(f"{said} reaches {arm.reach:.2g} m; lengths are in metres, not millimetres", stacklevel=5)


def _goals(model: mujoco.MjModel) -> list[int]:
    return [site for site in range(model.nsite) if model.site(site).name.startswith(_GOAL)]


def shapes(value: Mapping[str, Any], source: Path) -> mujoco.MjSpec:
    """The spec of lists of shapes and goals, as `load_obstacles` reads them from ``source``; errors as there."""
    if unknown := value.keys() - {"obstacles", "goals", FLOOR}:
        raise InputError(f"{source}: unknown entries {_listed(unknown)}; allowed: {FLOOR}, goals, obstacles")
    spec = mujoco.MjSpec()
    if FLOOR in value:
        # MuJoCo's own place for what a file says beyond its elements.
        spec.add_text(name=FLOOR, data=str(as_floor(value[FLOOR])))
    names: set[str] = set()
    for kind, add in (("obstacles", _add_obstacle), ("goals", _add_goal)):
        entries = value.get(kind, [])
        if not isinstance(entries, list):
            raise InputError(f"{source}: {kind} must be a list, got {type(entries).__name__}")
        if len(entries) > _MOST:
            raise InputError(f"{source}: at most {_MOST} {kind} can be read, got {len(entries)}")
        for number, entry in enumerate(entries):
            where = f"{source}: entry {number + 1} of {kind}"
            if not isinstance(entry, dict):
                raise InputError(f"{where} must be a mapping, got {type(entry).__name__}")
            try:
                add(spec, entry, number, source.parent, names)
            except (InputError, FileError) as error:
                raise type(error)(f"{where}: {error}") from None
    return spec


def _add_obstacle(spec: mujoco.MjSpec, entry: dict[str, Any], number: int, folder: Path, names: set[str]) -> None:
    if "shape" not in entry:
        raise InputError(f"it needs a shape: {', '.join(_SHAPES)}")
    shape = as_choice("shape", entry["shape"], _SHAPES)
    _check_entries(entry, {"shape", "name", *_SHAPES[shape]})
    name = entry.get("name", f"{shape}{number}")
    if not isinstance(name, str) or not name or not name.isprintable() or name in names or name == "world":
        raise InputError(f"name must be a printable text that no other obstacle has, got {quoted(name)}")
    names.add(name)
    body = spec.worldbody.add_body(name=name, **read_pose(entry))
    look = {"name": name, "rgba": (0.72, 0.54, 0.35, 1.0), "group": 2}
    if shape == "mesh":
        file = folder / as_path("file", entry["file"])
        if not is_file(file):
            raise FileError(f"no such file: {file}")
        scale = as_floats("scale", np.ones(3) * as_floats("scale", entry.get("scale", 1.0), (), batched=True), (3,))
        if not scale.all():
            raise InputError("scale must not be 0")
        spec.add_mesh(name=name, file=str(file.resolve()), scale=scale)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, **look)
    else:
        size = [0.0, 0.0, 0.05] if shape == "plane" else _half_sizes(entry, shape)
        body.add_geom(type=getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}"), size=size, **look)


def _add_goal(spec: mujoco.MjSpec, entry: dict[str, Any], number: int, folder: Path, _: set[str]) -> None:
    _check_entries(entry, {"size"})
    look = {"type": mujoco.mjtGeom.mjGEOM_BOX, "group": _HIDDEN, "rgba": (0.1, 0.8, 0.3, 0.15)}
    spec.worldbody.add_site(name=f"{_GOAL}{number}", size=_half_sizes(entry, "box"), **read_pose(entry), **look)


def _check_entries(entry: dict[str, Any], made_of: set[str]) -> None:
    allowed = made_of | {"position", "rpy", "quaternion"}
    if unknown := entry.keys() - allowed:
        raise InputError(f"unknown entries {_listed(unknown)}; allowed: {_listed(allowed)}")
    if missing := allowed - {"name", "rpy", "quaternion", "scale"} - entry.keys():
        raise InputError(f"it has no {_listed(missing)}")


def _half_sizes(entry: dict[str, Any], shape: str) -> Floats:
    """MuJoCo's sizes ``(3,)`` of a primitive."""
    if shape == "box":
        return np.array([0.5 * as_positive("each size", edge) for edge in as_floats("size", entry["size"], (3,))])
    length = 0.5 * as_positive("length", entry["length"]) if "length" in entry else 0.0
    return np.array([as_positive("radius", entry["radius"]), length, 0.0])


def read_pose(entry: dict[str, Any]) -> dict[str, Any]:
    """Position and orientation of an entry of a file, as ``pos`` and ``quat`` of a body or a site."""
    if "rpy" in entry and "quaternion" in entry:
        raise InputError("it has both rpy and quaternion; give one of them")
    pose: dict[str, Any] = {"pos": as_floats("position", entry["position"], (3,))}
    if "rpy" in entry:
        pose["quat"] = np.zeros(4)
        mujoco.mju_euler2Quat(pose["quat"], as_floats("rpy, in radians,", entry["rpy"], (3,), largest=TURN), "XYZ")
    elif "quaternion" in entry:
        pose["quat"] = as_floats("quaternion", entry["quaternion"], (4,))
        if not np.isclose(np.linalg.norm(pose["quat"]), 1.0, atol=1e-3):
            raise InputError(f"quaternion must have length 1, got {np.linalg.norm(pose['quat']):.3g}")
    return pose


def _listed(names: set[Any]) -> str:
    return ", ".join(sorted(map(str, names)))
