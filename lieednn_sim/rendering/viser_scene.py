"""A MuJoCo model in a scene of viser, which a browser shows: for saved pages and for live views.

viser (https://viser.studio) is optional; its modules are imported when they are used.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.lie.se3 import rotations
from lieednn_sim.registry import optional_module
from lieednn_sim.values import Floats

# Faces that meet at less than this angle [rad] are shaded as one smooth surface, such as the sides of a cylinder.
_SMOOTH = 0.6
# Poses are rounded to multiples of this, 0.1 mm or 0.1 mrad, since recordings of few digits are small.
_RESOLUTION = 2.0**-13


class Shape(NamedTuple):
    """Surfaces of one colour, or one textured surface, of a body, in the frame of the body."""

    body: int  # its id
    mesh: Any  # a `trimesh.Trimesh`
    rgba: tuple[float, ...] | None  # four numbers from 0 to 1; None where the mesh has a texture


class Shapes:
    """The geometry of a model that a video shows: groups, colours and transparency are as MuJoCo renders them."""

    def __init__(self, model: mujoco.MjModel) -> None:
        conversions, trimesh_graph = optional_module("mjviser.conversions"), optional_module("trimesh.graph")
        data = kinematics_at(model, model.qpos0)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        self.model = model
        self.shapes: list[Shape] = []
        # Poses of planes, which are infinite floors, by their ids, and ids of tendons by their colour and radius [m].
        self.floors: dict[int, dict[str, Floats]] = {}
        self.tendons: dict[tuple[tuple[float, ...], float], list[int]] = {}
        parts: dict[tuple[int, tuple[float, ...] | None, int], list[int]] = {}
        # As MuJoCo would render them, with colours resolved from materials.
        scene = mujoco.MjvScene(model, maxgeom=model.ngeom + model.nsite + 1000)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene)
        for geom in scene.geoms[: scene.ngeom]:
            number, colour = int(geom.objid), tuple(np.round(geom.rgba.astype(float), 3))
            if geom.rgba[3] <= 0.0 or geom.objtype not in (mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_TENDON):
                continue
            if geom.objtype == mujoco.mjtObj.mjOBJ_TENDON:
                alike = self.tendons.setdefault((colour, float(geom.size[0])), [])
                # A tendon is drawn in pieces.
                if number not in alike:
                    alike.append(number)
            elif geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
                turn = rotations(data.geom_xmat[number].reshape(3, 3)).as_quat(scalar_first=True)
                self.floors[number] = {"position": data.geom_xpos[number].copy(), "wxyz": turn}
            else:
                texture = conversions.get_geom_texture_id(model, number)
                look = int(model.geom_bodyid[number]), colour if texture < 0 else None, texture
                parts.setdefault(look, []).append(number)
        still: list[Floats] = [np.zeros((0, 3))]
        for (body, rgba, _), geoms in parts.items():
            mesh = conversions.merge_geoms(model, geoms)
            if model.body_weldid[body] == 0 and model.body_mocapid[model.body_rootid[body]] < 0:
                still.append(mesh.bounds @ data.xmat[body].reshape(3, 3).T + data.xpos[body])
            if rgba is not None:
                # Without the colours of its parts, which are slow to handle.
                mesh = type(mesh)(*_parted(mesh, trimesh_graph), process=False)
            self.shapes.append(Shape(body, mesh, rgba))
        points = np.vstack(still)
        # (2, 3) least and largest coordinates of all static geometry except floors; (0, 3) if there is none.
        self.extent = np.array([points.min(axis=0), points.max(axis=0)]) if len(points) else points


def _parted(mesh: Any, trimesh_graph: Any) -> tuple[Floats, Any]:
    """Vertices and faces of a mesh in which faces that meet at `_SMOOTH` or more have no vertex in common.

    Browsers shade a vertex by the mean normal of its faces. ``trimesh.graph.smooth_shade`` takes six times as long.
    """
    close = mesh.face_adjacency[mesh.face_adjacency_angles < _SMOOTH]
    patches = trimesh_graph.connected_component_labels(close, node_count=len(mesh.faces))
    count = len(mesh.vertices)
    corners, faces = np.unique(patches[:, None] * count + mesh.faces, return_inverse=True)
    return mesh.vertices[corners % count], faces.reshape(-1, 3)


class ModelNodes:
    """The bodies of a model as nodes of a viser scene, translated by an offset ``(3,)`` [m].

    Several may share the same `Shapes`. The node above all others has the name ``root``, such as ``/arm``.
    """

    def __init__(self, scene: Any, shapes: Shapes, root: str, *, offset: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        self.model = model = shapes.model
        self.data = mujoco.MjData(model)
        scene.add_frame(root, show_axes=False, position=np.asarray(offset))
        # By ids of bodies: the node of each body with geometry, and those of its surfaces, whose `color` can be set.
        self.bodies: dict[int, Any] = {}
        self.surfaces: dict[int, list[Any]] = {}
        for shape in shapes.shapes:
            name = f"{root}/{model.body(shape.body).name or shape.body}"
            if shape.body not in self.bodies:
                self.bodies[shape.body] = scene.add_frame(name, show_axes=False)
            result = self.surfaces.setdefault(shape.body, [])
            name = f"{name}/{len(result)}"
            if shape.rgba is None:
                result.append(scene.add_mesh_trimesh(name, shape.mesh))
                continue
            *colour, alpha = shape.rgba
            solid = alpha >= 1.0
            given = {"color": tuple(colour), "opacity": None if solid else alpha, "cast_shadow": solid}
            result.append(scene.add_mesh_simple(name, shape.mesh.vertices, shape.mesh.faces, **given))
        # Nodes of tendons, which are lines, with the tendons' ids.
        self.tendons: list[tuple[Any, list[int]]] = []
        for (rgba, radius), tendons in shapes.tendons.items():
            name = f"{root}/tendons {len(self.tendons)}"
            self.tendons.append((add_path(scene, name, np.zeros((2, 3)), rgba, radius), tendons))

    def show(self, qpos: Floats) -> None:
        """Move the nodes to where the bodies are at positions ``(nq,)``, and to the mocap poses in ``data``."""
        data = kinematics_at(self.model, qpos, self.data)
        for body, node in self.bodies.items():
            node.position = np.round(data.xpos[body] / _RESOLUTION) * _RESOLUTION
            node.wxyz = np.round(data.xquat[body] / _RESOLUTION) * _RESOLUTION
        if self.tendons:
            mujoco.mj_comPos(self.model, data)
            mujoco.mj_tendon(self.model, data)
        for node, tendons in self.tendons:
            pieces = np.concatenate([_pieces(data, tendon) for tendon in tendons])
            node.points = np.round(pieces / _RESOLUTION) * _RESOLUTION


def add_floor(scene: Any, shapes: Shapes) -> None:
    """Draw a grid in place of each plane of the model, with shadows on it."""
    # Visible on a white and on a dark background.
    line = {"size": 0.5, "color": (158, 162, 168), "thickness": 0.6}
    lines = {f"{which}_{what}": value for which in ("cell", "section") for what, value in line.items()}
    for geom, pose in shapes.floors.items():
        scene.add_grid(f"/floor/{geom}", infinite_grid=True, fade_distance=25.0, shadow_opacity=0.3, **lines, **pose)


def segments(points: Floats) -> Floats:
    """The segments ``(K - 1, 2, 3)`` of a path ``(K, 3)``, but at least one, since viser needs it."""
    ends = points if len(points) > 1 else np.repeat(points, 2, axis=0)
    return np.stack([ends[:-1], ends[1:]], axis=1)


def add_path(scene: Any, name: str, points: Floats, rgba: tuple[float, ...], radius: float) -> Any:
    """Draw a path ``(K, 3)`` in the colour ``rgba`` and return its node, whose ``points`` are its `segments`."""
    return scene.add_line_segments(name, segments(points), rgba[:3], thickness=2.0 * radius)


def _pieces(data: mujoco.MjData, tendon: int) -> Floats:
    """The straight pieces ``(S, 2, 3)`` of a tendon; there is a gap at a pulley."""
    rows = slice(first := data.ten_wrapadr[tendon], first + data.ten_wrapnum[tendon])
    pulley = data.wrap_obj.ravel()[rows] == -2
    return segments(data.wrap_xpos.reshape(-1, 3)[rows])[~(pulley[:-1] | pulley[1:])]
