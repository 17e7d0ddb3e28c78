"""Staging of an arm for rendering: light, sky, target marker and camera, where they are missing."""

from __future__ import annotations

import copy
from itertools import product

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.checks import ancestry
from lieednn_sim.arm.importer.loading import unused
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.simulation import Rollout
from lieednn_sim.values import Floats

_PLANE, _NO_MARKER = int(mujoco.mjtGeom.mjGEOM_PLANE), -1
_OVERVIEW = "overview"  # the camera of the package's own scenes
_UNSEEN = {"contype": 0, "conaffinity": 0, "group": 2, "mass": 0.0}  # no effect on contacts and dynamics


def reached(arm: Arm) -> Floats:
    """Points ``(P, 3)`` that the link frames reach, at home and at random configurations with a fixed seed."""
    low, high = arm.position_limits.T
    configurations = np.random.default_rng(0).uniform(low, high, (64, arm.n_joints))
    places = arm.link_poses(np.vstack([arm.keyframe("home"), arm.within_angles(configurations)])).translation
    return np.vstack([arm.base.translation, np.asarray(places).reshape(-1, 3)])


def planned_frames(run: Rollout) -> Floats:
    """Planned link frames ``(K, N, 4, 4)``, the last of which is the end effector's; of a view only that one."""
    links = slice(None) if run.arm.state is None else slice(-1, None)
    return run.arm.link_poses(run.q_ref).as_matrix()[:, links]


def load_path(run: Rollout) -> Floats:
    """Where the centre of mass of what hangs was, ``(K, 3)``; ``(0, 3)`` where nothing does."""
    model, places = run.arm.model, np.empty((len(run.t), 3))
    mass = model.body_mass * PassiveJoints(run.arm).bodies
    if not mass.any():
        return places[:0]
    data = mujoco.MjData(model)
    for point, data.qpos[:] in zip(places, run.qpos, strict=True):
        mujoco.mj_kinematics(model, data)
        point[:] = mass @ data.xipos / mass.sum()
    return places


def occupied(run: Rollout) -> Floats:
    """Points ``(P, 3)`` that a picture must contain: the base, the target, and all that the links pass.

    In the model of a view, which may hold more than an arm, these are around the geoms of what moves by a millimetre at
    some instants, and of the bodies that carry the end effector.
    """
    arm, model = run.arm, run.arm.model
    if arm.state is None:
        ends = [arm.base.translation, arm.link_poses(run.target).translation[-1]]
        return np.vstack([*ends, run.link_position.reshape(-1, 3)])
    data, results = mujoco.MjData(model), []
    shown = np.isin(model.geom_bodyid, ancestry(model, int(arm.frames.bodies[-1]))[1:])
    for data.qpos[:] in run.qpos[np.linspace(0, len(run.t) - 1, 25, dtype=int)]:
        mujoco.mj_kinematics(model, data)
        results.append(_corners(model, data))
    shown |= np.ptp(results, axis=0).max(axis=(1, 2)) > 1e-3
    return np.array(results)[:, shown & (model.geom_type != _PLANE)].reshape(-1, 3)


def _corners(model: mujoco.MjModel, data: mujoco.MjData) -> Floats:
    """Corners ``(G, 8, 3)`` of the boxes around geoms; those of planes are the planes' origins."""
    centre, half = model.geom_aabb[:, None, :3], model.geom_aabb[:, None, 3:].copy()
    half[model.geom_type == _PLANE] = 0.0
    inside = centre + half * np.array(list(product((-1.0, 1.0), repeat=3)))
    turns = data.geom_xmat.reshape(-1, 3, 3)
    return np.asarray(data.geom_xpos[:, None] + inside @ turns.transpose(0, 2, 1))


def place(arm: Arm) -> str:
    """Name of the arm, and of its scene if there are obstacles, for captions."""
    return arm.name if arm.scene == "free" else f"{arm.name}, {arm.scene}"


def caption(run: Rollout, time: float) -> list[str]:
    """What a run is of, the step of a sequence at a time [s] or the controller, and what is proved of its clearance."""
    proof = [] if run.clearance is None else [run.clearance.at(time)]
    return [place(run.arm), run.step_at(time) or run.controller, *proof]


def cameras(arm: Arm) -> list[str]:
    """Names of the cameras of the scene."""
    return [arm.model.camera(i).name for i in range(arm.model.ncam)]


def camera(arm: Arm, name: str | None, points: Floats) -> mujoco.MjvCamera:
    """A camera of the scene by its name; by default ``overview`` if there is one, else one that frames the points.

    That one has room for a hand beyond the points ``(P, 3)``, unless the arm is a view.
    """
    name = name or (_OVERVIEW if _OVERVIEW in cameras(arm) else None)
    result = mujoco.MjvCamera()
    if name is not None:
        result.type, result.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, arm.model.camera(name).id
        return result
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = 1.15 * float(np.linalg.norm(points - centre, axis=1).max())
    radius += _hand(arm) if arm.state is None else 0.0
    result.type = mujoco.mjtCamera.mjCAMERA_FREE
    result.lookat[:] = centre
    result.distance = radius / np.sin(0.5 * np.deg2rad(arm.model.vis.global_.fovy))
    result.azimuth, result.elevation = 125.0, -20.0
    return result


def scale(arm: Arm, points: Floats) -> float:
    """Scale of lengths and widths that are drawn around an arm: 1 in the package's scenes and from 1.3 m on."""
    return 1.0 if _OVERVIEW in cameras(arm) else min(1.0, float(np.linalg.norm(np.ptp(points, axis=0))) / 1.3)


def staged(arm: Arm, points: Floats) -> tuple[mujoco.MjModel, int]:
    """A copy of the arm's model, completed for rendering, and the mocap id of its target marker.

    Joints and their order are the same in the copy. The points ``(P, 3)`` determine the size of the marker. The model
    of a view gets no marker, and a brighter headlight if it has no other lights.
    """
    model = arm.model
    if arm.spec is None:
        result = copy.deepcopy(model)
        if not result.nlight:
            result.vis.headlight.ambient[:] = result.vis.headlight.diffuse[:] = 0.45
        return result, _NO_MARKER
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "target")
    marked = body >= 0 and model.body_mocapid[body] >= 0
    if marked and arm.import_report is None:
        return copy.deepcopy(model), int(model.body_mocapid[body])
    spec = arm.spec.copy()
    spec.compiler.discardvisual = False  # with the default of URDF files, all of this would vanish
    names = {element.name for kind in (spec.textures, spec.materials, spec.bodies) for element in kind}
    # Robots bring a spotlight at most, around which all is dark.
    for light in list(spec.lights):
        spec.delete(light)
    spec.visual.map.shadowclip, spec.visual.map.shadowscale = 1.4, 0.6
    spec.visual.headlight.ambient = spec.visual.headlight.diffuse = [0.4] * 3
    lights = (((-0.33, 0.43, -0.84), 0.45, True), ((-0.45, -0.72, -0.54), 0.2, False))  # direction, diffuse, shadow
    for direction, diffuse, shadow in lights:
        light = spec.worldbody.add_light(pos=-4.0 * np.array(direction), dir=direction, castshadow=shadow)
        light.type, light.diffuse = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, [diffuse] * 3
    if not (model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any():
        sky = {"type": mujoco.mjtTexture.mjTEXTURE_SKYBOX, "builtin": mujoco.mjtBuiltin.mjBUILTIN_GRADIENT}
        look = {"rgb1": [0.26, 0.44, 0.68], "rgb2": [0.90, 0.93, 0.95], "width": 256, "height": 1536}
        spec.add_texture(name=unused("sky", names), **sky, **look)
    name = "target" if marked else unused("target", names)
    # Colours of the target marker: the ball, and the axes in it.
    glass = (0.08, 0.75, 0.70, 0.35)
    axes = ((0.87, 0.20, 0.20, 1.0), (0.20, 0.68, 0.28, 1.0), (0.18, 0.40, 0.88, 1.0))
    if not marked:
        size = 0.06 * float(np.linalg.norm(np.ptp(points, axis=0)))
        # As large as the hand, which would hide it on arrival.
        radius = float(np.clip(1.1 * _hand(arm), 0.35 * size, 0.9 * size))
        marker = spec.worldbody.add_body(name=name, mocap=True)
        marker.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0], rgba=glass, **_UNSEEN)
        for axis, colour in zip(np.eye(3), axes, strict=True):
            ends = [0.0, 0.0, 0.0, *((radius + 0.65 * size) * axis)]
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            marker.add_geom(type=kind, fromto=ends, size=[0.04 * size, 0.0, 0.0], rgba=colour, **_UNSEEN)
    result = spec.compile()
    return result, int(result.body_mocapid[result.body(name).id])


def mark(arm: Arm, data: mujoco.MjData, marker: int, target: Floats | None) -> None:
    """Put the marker, by its mocap id, at a joint target ``(n,)``, or without one into the base, which hides it."""
    if marker == _NO_MARKER:
        return
    pose = arm.base if target is None else arm.link_poses(target)[-1]
    data.mocap_pos[marker] = pose.translation
    data.mocap_quat[marker] = pose.rotation.as_quat(scalar_first=True)


def _hand(arm: Arm) -> float:
    """Upper bound on how far the last body extends beyond the last link's frame [m]."""
    model, tip = arm.model, arm.frames[-1:]
    mine = model.body_weldid[model.geom_bodyid] == model.body_weldid[tip.bodies[0]]
    data = kinematics_at(model, model.qpos0)
    place = tip.poses(data.xpos, data.xmat)[0]
    return float((np.linalg.norm(data.geom_xpos - place, axis=1) + model.geom_rbound)[mine].max(initial=0.0))
