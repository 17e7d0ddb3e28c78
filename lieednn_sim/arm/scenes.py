"""Obstacles around an arm, random but reproducible and scaled to it: a wall with a window, a shelf, a field of poles.

All stand on the floor in front of the arm, in the direction of its tip at the keyframe ``home``, at least
`HOME_CLEARANCE` away from the arm there. Sites ``obstacle_goal<i>`` are boxes for targets: behind the window, in the
compartments of the shelf, between the poles (`targets.draw_target`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.contacts import colliding_geoms
from lieednn_sim.arm.model_arm import ModelArm
from lieednn_sim.errors import InputError
from lieednn_sim.registry import SCENES
from lieednn_sim.values import Floats

HOME_CLEARANCE = 0.05  # distance that every obstacle keeps from the arm at home [m]
PREFIX = "obstacle_"
GOAL_PREFIX = "obstacle_goal"

_BOX, _CYLINDER = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
_DRAWN = {"contype": 0, "conaffinity": 0}  # options of a geom that touches nothing
_MATERIALS = {
    # Obstacles that the arm goes behind are transparent.
    "obstacle_panel": (0.83, 0.80, 0.74, 0.35),
    "obstacle_side": (0.13, 0.30, 0.42, 0.45),
    "obstacle_trim": (0.13, 0.30, 0.42, 1.0),
    "obstacle_wood": (0.72, 0.54, 0.35, 1.0),
    "obstacle_pole": (0.90, 0.72, 0.18, 1.0),
}


@dataclass(frozen=True)
class _Surroundings:
    """The arm's dimensions [m] in a frame on the floor below the base, with x towards the tip at home."""

    arm: ModelArm  # without obstacles
    origin: Floats  # ``(3,)`` world position of the frame
    yaw: float  # its rotation about the vertical [rad]
    scale: float  # factor for the sizes of obstacles, 1 for an arm of the nominal reach
    front: float  # how far the arm extends along x at home
    tip: Floats  # ``(3,)`` position of the end effector at home
    reach: float  # horizontal reach of the end effector near its height at home

    @property
    def place(self) -> dict[str, Any]:
        """Pose of the frame in the world, for a body."""
        return {"pos": self.origin, "quat": [np.cos(self.yaw / 2.0), 0.0, 0.0, np.sin(self.yaw / 2.0)]}


def add_obstacles(spec: mujoco.MjSpec, arm: ModelArm, scene: str, seed: int) -> None:
    """Add the obstacles of a scene of `SCENES`, not ``free``, to a copy of the spec of an arm without any.

    New bodies, geoms, materials and sites are named ``obstacle_...``; visible geoms are in group 2. The same seed gives
    the same positions and sizes. `InputError` if there is no place around this arm.
    """
    rng = np.random.default_rng([seed, list(SCENES).index(scene)])
    room = _surroundings(arm)
    for name, colour in _MATERIALS.items():
        spec.add_material(name=name, rgba=colour, specular=0.25, shininess=0.35)
    SCENES[scene].load()(spec, spec.worldbody.add_body(name=f"{PREFIX}{scene}", **room.place), room, rng)


def window(spec: mujoco.MjSpec, body: mujoco.MjsBody, room: _Surroundings, rng: np.random.Generator) -> None:
    """A wall across x with an opening, which need not be in front of the tip at home."""
    s = room.scale
    thickness, width = 0.03 * s, 1.3 * s
    depth = room.reach - room.front
    near = room.front + HOME_CLEARANCE + rng.uniform(0.05, 0.2) * depth
    half = s * rng.uniform((0.22, 0.2), (0.34, 0.32))
    middle = np.array([0.0, room.tip[2]]) + s * rng.uniform((-0.42, -0.3), (0.42, 0.2))
    top = max(room.tip[2] + 0.9 * s, middle[1] + half[1] + 0.15 * s)
    x, (y, z) = near + thickness, middle
    bottom = z - half[1]
    sides = width - y - half[0], width + y - half[0]
    panels = {
        "below": ((x, 0.0, bottom / 2.0), (thickness, width, bottom / 2.0)),
        "above": ((x, 0.0, (top + z + half[1]) / 2.0), (thickness, width, (top - z - half[1]) / 2.0)),
        "left": ((x, width - sides[0] / 2.0, z), (thickness, sides[0] / 2.0, half[1])),
        "right": ((x, -width + sides[1] / 2.0, z), (thickness, sides[1] / 2.0, half[1])),
    }
    for name, (pos, size) in panels.items():
        _geom(body, f"wall_{name}", pos, size, "panel", group=3)  # not rendered
    # Transparent panels would show the faces between them: one wall with a hole is rendered instead.
    outline = np.array([(-width, 0.0), (width, 0.0), (width, top), (-width, top)])
    opening = np.array([y, z]) + half * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    mesh, origin = PREFIX + "wall", (0.0, 0.0, 0.0)
    spec.add_mesh(name=mesh, **_pierced_plate(x, thickness, outline, opening))
    _geom(body, "wall", origin, origin, "panel", mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, **_DRAWN)
    # The frame encloses the panels' edges without coplanar faces, and only shows where the opening is.
    bar, inset = 0.025 * s, 0.002
    away, across, along = bar + inset, half[0] + inset, half[1] + inset + 2.0 * bar
    for name, dy, dz, wide, high in (
        ("left", half[0] + away, 0.0, bar, along),
        ("right", -half[0] - away, 0.0, bar, along),
        ("upper", 0.0, half[1] + away, across, bar),
        ("lower", 0.0, -half[1] - away, across, bar),
    ):
        _geom(body, f"frame_{name}", (x, y + dy, z + dz), (thickness + 0.004, wide, high), "trim", **_DRAWN)
    far = near + 2.0 * thickness
    ends = far + 0.06 * s, max(room.reach - 0.1 * s, far + 0.16 * s)
    _goal(body, 0, ((ends[0] + ends[1]) / 2.0, y, z), ((ends[1] - ends[0]) / 2.0, 0.5 * half[0], 0.5 * half[1]))


def shelf(_: mujoco.MjSpec, body: mujoco.MjsBody, room: _Surroundings, rng: np.random.Generator) -> None:
    """A shelf of two columns and two rows, open towards the arm, which points into one compartment at home."""
    s = room.scale
    board = 0.015 * s
    depth = rng.uniform(0.16, 0.22) * s
    wide, high = s * rng.uniform((0.6, 0.54), (0.76, 0.68))
    near = room.front + HOME_CLEARANCE + rng.uniform(0.15, 0.26) * s
    facing = rng.integers(2, size=2)
    y = wide * (0.5 - facing[0] + rng.uniform(-0.15, 0.15))
    bottom = max(room.tip[2] - high * (0.5 + facing[1] + rng.uniform(-0.15, 0.15)), 0.1 * s)
    x, middle = near + depth, bottom + high
    for row in range(3):
        # The uprights cover the ends of the boards.
        _geom(body, f"board{row}", (x, y, bottom + row * high), (depth - 0.002, wide - 0.002, board), "wood")
    for column in range(3):
        top = middle + high + board
        _geom(body, f"upright{column}", (x, y + (column - 1) * wide, top / 2.0), (depth, board, top / 2.0), "side")
    _geom(body, "back", (x + depth + board, y, middle), (board, wide + board, high + board), "panel")
    # No goals straight above or below: these are easy, and hardly ever blocked.
    cells = [(column, row) for column in range(2) for row in range(2) if column != facing[0] or row == facing[1]]
    for number, (column, row) in enumerate(cells):
        inside = (near + 0.25 * depth, y + (column - 0.5) * wide, middle + (row - 0.5) * high)
        _goal(body, number, inside, (0.25 * depth, 0.2 * wide, 0.2 * high))


def poles(_: mujoco.MjSpec, body: mujoco.MjsBody, room: _Surroundings, rng: np.random.Generator) -> None:
    """Vertical poles in a sector of a ring, with gaps that the arm fits through."""
    s, most, trials = room.scale, 7, 60
    radius = s * rng.uniform(0.02, 0.04, trials)
    distance = room.reach * np.sqrt(rng.uniform(0.4**2, 0.95**2, trials))
    angle = rng.uniform(-1.5, 1.5, trials)
    spots = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)
    half = (room.tip[2] + 0.8 * s) / 2.0
    away = _pole_clearances(room, spots, radius, half) > HOME_CLEARANCE + 0.05
    chosen: list[int] = []
    for index in map(int, np.flatnonzero(away)):
        gaps = [np.linalg.norm(spots[index] - spots[other]) for other in chosen]
        if min(gaps, default=np.inf) > 0.42 * s and len(chosen) < most:
            chosen.append(index)
    if not chosen:
        raise InputError(f"no place for poles around arm {room.arm.name!r} at home; use another scene or seed")
    for number, index in enumerate(chosen):
        _geom(body, f"pole{number}", (*spots[index], half), (radius[index], half, 0.0), "pole", _CYLINDER)
        flat = 0.006 * s
        _geom(body, f"foot{number}", (*spots[index], flat), (0.07 * s, flat, 0.0), "trim", _CYLINDER, **_DRAWN)
    for number, side in enumerate((-1.0, 1.0)):
        # Left and right of where the arm points at home, between the poles and beyond them.
        turned = side * 0.75
        middle = 0.68 * room.reach * np.array([np.cos(turned), np.sin(turned)])
        _goal(body, number, (*middle, room.tip[2]), (0.22 * room.reach, 0.3 * room.reach, 0.4 * s))


def _pole_clearances(room: _Surroundings, spots: Floats, radius: Floats, half: float) -> Floats:
    """Distances ``(P,)`` of poles at ``(P, 2)`` from the arm's colliding geoms at home."""
    arm, spec = room.arm, room.arm.spec.copy()
    body = spec.worldbody.add_body(name="trial", **room.place)
    for number, (spot, size) in enumerate(zip(spots, radius, strict=True)):
        body.add_geom(name=f"trial{number}", type=_CYLINDER, pos=(*spot, half), size=(size, half, 0.0))
    model = spec.compile()
    data = kinematics_at(model, arm.qpos(arm.keyframe("home")))
    trials = [model.geom(f"trial{k}").id for k in range(len(spots))]
    parts = np.setdiff1d(np.flatnonzero(colliding_geoms(model) & (model.geom_rbound > 0.0)), trials).tolist()
    return np.array([min(mujoco.mj_geomDistance(model, data, k, part, 0.5, None) for part in parts) for k in trials])


def _surroundings(arm: ModelArm) -> _Surroundings:
    home = arm.keyframe("home")
    base = np.asarray(arm.base.translation)
    tip = np.asarray(arm.link_poses(home).translation)[-1]
    yaw = float(np.arctan2(tip[1] - base[1], tip[0] - base[0])) if np.hypot(*(tip - base)[:2]) > 1e-6 else 0.0
    model = arm.model
    data = kinematics_at(model, arm.qpos(home))
    floors = [g for g in range(model.ngeom) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE]
    floor = min((float(data.geom_xpos[g, 2]) for g in floors), default=float(base[2]))
    origin = np.array([base[0], base[1], floor])
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    parts = np.flatnonzero(colliding_geoms(model) & (model.geom_rbound > 0.0))
    turns = data.geom_xmat[parts].reshape(-1, 3, 3)
    centers = data.geom_xpos[parts] + (turns @ model.geom_aabb[parts, :3, None])[:, :, 0]
    extents = np.abs(ahead @ turns) * model.geom_aabb[parts, 3:]
    front = float(((centers - origin) @ ahead + extents.sum(axis=1)).max())
    # Weighted towards the ends of the ranges: configurations in the middle do not reach far.
    draws = np.random.default_rng(0).beta(0.4, 0.4, (2048, arm.n_joints))
    tips = np.asarray(arm.link_poses(arm.position_limits[:, 0] + draws * arm.ranges).translation)[:, -1] - origin
    spread = np.linalg.norm(tips[:, :2], axis=1)
    level = np.abs(tips[:, 2] - (tip[2] - floor)) < 0.25 * spread.max()
    reach = float(np.quantile(spread[level] if level.sum() > 50 else spread, 0.99))
    turned = np.array([np.hypot(*(tip - origin)[:2]), 0.0, tip[2] - floor])
    # The sizes of obstacles are for an arm with a horizontal reach of 2.3 m.
    return _Surroundings(arm, origin, yaw, reach / 2.3, front, turned, max(reach, front + 0.15 * reach))


def _pierced_plate(x: float, thickness: float, outline: Floats, opening: Floats) -> dict[str, list[float]]:
    """Vertices and triangles of a plate across x with a hole, both with corners ``(4, 2)`` (y, z) counter-clockwise."""
    rings = [(x + side * thickness, corners) for side in (-1.0, 1.0) for corners in (outline, opening)]
    vertices = np.concatenate([np.column_stack([np.full(4, at), corners]) for at, corners in rings])
    # Corners of each quadrilateral are counter-clockwise from outside; rings: near outline and opening, then far ones.
    quadrilaterals = []
    for i in range(4):
        j = (i + 1) % 4
        faces = (i, i + 4, j + 4, j), (i + 8, j + 8, j + 12, i + 12)  # near and far
        edges = (i, j, j + 8, i + 8), (i + 4, i + 12, j + 12, j + 4)  # the outer one, and that of the opening
        quadrilaterals += [*faces, *edges]
    triangles = [(*q[:3], q[0], *q[2:]) for q in quadrilaterals]
    return {"uservert": vertices.ravel().tolist(), "userface": np.array(triangles).ravel().tolist()}


def _geom(
    body: mujoco.MjsBody, name: str, pos: Any, size: Any, material: str, kind: Any = _BOX, **options: Any
) -> None:
    # Geoms of group 2 are rendered.
    options = {"group": 2, "contype": 1, "conaffinity": 1, **options}
    body.add_geom(name=PREFIX + name, type=kind, pos=pos, size=size, material=PREFIX + material, **options)


def _goal(body: mujoco.MjsBody, number: int, pos: Any, size: Any) -> None:
    body.add_site(name=f"{GOAL_PREFIX}{number}", type=_BOX, pos=pos, size=size, group=5, rgba=(0.1, 0.8, 0.3, 0.15))
