"""Rollouts as recordings for Rerun's viewer: the moving arm among its obstacles, and curves over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial.transform import Rotation

from lieednn_sim._mujoco import geom_colours, kinematics_along, mujoco
from lieednn_sim.exports.formats import samples
from lieednn_sim.lie.se3 import same_signs
from lieednn_sim.simulation import Rollout


def write(rollouts: Mapping[str, Rollout], folder: Path, rate: float | None = None) -> None:
    """Write ``<name>.rrd`` for each rollout; see `formats.export`.

    The entities are ``/scene/<body>`` with the geoms of each body, without floors; ``/target`` and ``/planned_path`` of
    the end effector; and over time ``/joints/<coordinate>/planned`` and ``/measured`` [rad, m], ``/tracking_error`` of
    the end effector [m], and the number of ``/contacts``. A file is written, and nothing is sent anywhere.
    """
    # The scene beside the curves; without a layout, the viewer would make a plot for each curve.
    plots = (rrb.TimeSeriesView(origin=f"/{name}", name=name) for name in ("joints", "tracking_error", "contacts"))
    scene = rrb.Spatial3DView(origin="/", contents=["/scene/**", "/planned_path", "/target"], name="scene")
    shown = rrb.Horizontal(scene, rrb.Vertical(*plots, row_shares=[3, 1, 1]), column_shares=[3, 2])
    for name, rollout in rollouts.items():
        with rr.RecordingStream("lieednn_sim", recording_id=name, send_properties=False) as stream:
            stream.save(folder / f"{name}.rrd", rrb.Blueprint(shown))
            stream.send_recording_name(name)
            _write(stream, rollout, samples(rollout, rate))
            stream.flush()
            stream.disconnect()


def _write(stream: rr.RecordingStream, rollout: Rollout, rows: slice) -> None:
    arm, model = rollout.arm, rollout.arm.model
    times = [rr.TimeColumn("time", duration=rollout.t[rows])]

    def curve(path: list[object], values: Any) -> None:
        stream.send_columns(rr.new_entity_path(path), times, rr.Scalars.columns(scalars=values))

    for j, joint in enumerate(arm.joint_names):
        curve(["joints", joint, "planned"], rollout.q_ref[rows, j])
        curve(["joints", joint, "measured"], rollout.q[rows, j])
    planned = arm.tip(rollout.q_ref[rows])
    curve(["tracking_error"], np.linalg.norm(planned - rollout.link_position[rows, -1], axis=-1))
    curve(["contacts"], rollout.contacts[rows].astype(float))
    stream.log("planned_path", rr.LineStrips3D([planned]), static=True)
    stream.log("target", rr.Points3D([arm.tip(rollout.target)], radii=0.02), static=True)  # [m]
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    positions, quaternions = kinematics_along(model, rollout.qpos[rows], "xpos", "xquat")
    quaternions = same_signs(quaternions[..., [1, 2, 3, 0]])  # (x, y, z, w)
    # Mocap bodies are markers, or pull the arm; a rollout does not hold their poses. Those of a view stand still.
    for body in np.flatnonzero((model.body_mocapid < 0) | (arm.state is not None)).tolist():
        path = ["scene", model.body(body).name or f"body {body}"]
        _log_geoms(stream, path, model, body)
        if model.body_weldid[body]:
            poses = rr.Transform3D.columns(translation=positions[:, body], quaternion=quaternions[:, body])
            stream.send_columns(rr.new_entity_path(path), times, poses)
        else:
            pose = rr.Transform3D(translation=positions[0, body], quaternion=quaternions[0, body])
            stream.log(path, pose, static=True)


def _log_geoms(stream: rr.RecordingStream, path: list[object], model: mujoco.MjModel, body: int) -> None:
    """Log the visible geoms of a body in its frame: one entity for all geoms of a type, and one for each mesh."""
    colours = np.round(255.0 * geom_colours(model)).astype(np.uint8)
    first = model.body_geomadr[body]
    geoms = np.arange(first, first + model.body_geomnum[body])
    # By default, MuJoCo shows geoms of the groups 0, 1 and 2.
    geoms = geoms[(model.geom_group[geoms] <= 2) & (colours[geoms, 3] > 0)]
    for number in np.unique(model.geom_type[geoms]):
        kind, alike = mujoco.mjtGeom(number), geoms[model.geom_type[geoms] == number]
        size, centre, quaternion = (values[alike] for values in (model.geom_size, model.geom_pos, model.geom_quat))
        turn = Rotation.from_quat(quaternion, scalar_first=True)
        look = {"quaternions": turn.as_quat(), "colors": colours[alike], "fill_mode": rr.components.FillMode.Solid}
        result: Any = None
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            result = rr.Boxes3D(half_sizes=size, centers=centre, **look)
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            result = rr.Cylinders3D(lengths=2.0 * size[:, 1], radii=size[:, 0], centers=centre, **look)
        elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            # A capsule of Rerun begins at its origin.
            lower = centre - turn.apply(np.array([0.0, 0.0, 1.0])) * size[:, 1:2]
            result = rr.Capsules3D(lengths=2.0 * size[:, 1], radii=size[:, 0], translations=lower, **look)
        elif kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
            round_ = kind == mujoco.mjtGeom.mjGEOM_SPHERE
            result = rr.Ellipsoids3D(half_sizes=size[:, [0, 0, 0]] if round_ else size, centers=centre, **look)
        elif kind == mujoco.mjtGeom.mjGEOM_MESH:
            for geom in alike:
                stream.log([*path, f"mesh {geom}"], _mesh(model, geom, colours[geom]), static=True)
        if result is not None:
            stream.log([*path, kind.name.removeprefix("mjGEOM_").lower()], result, static=True)


def _mesh(model: mujoco.MjModel, geom: int, colour: Any) -> rr.Mesh3D:
    mesh = model.mesh(model.geom_dataid[geom])
    vertices = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
    turn = Rotation.from_quat(model.geom_quat[geom], scalar_first=True)
    triangles = model.mesh_face[mesh.faceadr[0] :][: mesh.facenum[0]]
    placed = turn.apply(vertices) + model.geom_pos[geom]
    return rr.Mesh3D(vertex_positions=placed, triangle_indices=triangles, albedo_factor=colour)
