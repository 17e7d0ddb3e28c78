"""Staging of an arm for rendering: adds lights, sky, target marker and camera where they are missing."""

from __future__ import annotations

import copy
from itertools import product

import numpy as np

from lieednn_sim._mujoco import geom_colours, kinematics_at, kinematics_each, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.checks import ancestry
from lieednn_sim.arm.importer.floor import GREY
from lieednn_sim.arm.importer.loading import unused
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.rendering.viewpoint import around, free_side
from lieednn_sim.simulation import Rollout
from lieednn_sim.values import Floats

_PLANE, _NO_MARKER = int(mujoco.mjtGeom.mjGEOM_PLANE), -1
_OVERVIEW = "overview"  # the camera of the package's own scenes
_UNSEEN = {"contype": 0, "conaffinity": 0, "group": 2, "mass": 0.0}  # no effect on contacts and dynamics


def reached(arm: Arm) -> Floats:
    """Points ``(P, 3)`` around all that frames and hand reach at home and at random configurations of a fixed seed."""
    low, high = arm.position_limits.T
    configurations = np.random.default_rng(0).uniform(low, high, (64, arm.n_joints))
    places = arm.link_poses(np.vstack([arm.keyframe("home"), arm.within_angles(configurations)])).translation
    room = 0.5 * float(np.linalg.norm(_hand(arm)))
    ends = np.asarray(places)[:, -1:] + room * np.vstack([np.eye(3), -np.eye(3)])
    return np.vstack([arm.base.translation, np.asarray(places).reshape(-1, 3), ends.reshape(-1, 3)])


def planned_frames(run: Rollout) -> Floats:
    """Planned link frames ``(K, N, 4, 4)``, of which the last one is the end effector's; only this one for a view."""
    links = slice(None) if run.arm.state is None else slice(-1, None)
    return run.arm.link_poses(run.q_ref).as_matrix()[:, links]


def load_path(run: Rollout) -> Floats:
    """Path ``(K, 3)`` of the centre of mass of a hanging load; ``(0, 3)`` without one."""
    mass = run.arm.model.body_mass * PassiveJoints(run.arm).bodies
    if not mass.any():
        return np.empty((0, 3))
    return np.array([mass @ data.xipos / mass.sum() for data in kinematics_each(run.arm.model, run.qpos)])


def occupied(run: Rollout) -> Floats:
    """Points ``(P, 3)`` that a picture must contain: the base, the target, and all places that the arm passes.

    These are corners of boxes around the geoms that carry the end effector or move by more than a millimetre, which in
    a view may be more than the arm; and corners around other geoms near these, clipped to the region of the former.
    """
    arm, model = run.arm, run.arm.model
    shown = np.isin(model.geom_bodyid, ancestry(model, int(arm.frames.bodies[-1]))[1:])
    some = run.qpos[np.linspace(0, len(run.t) - 1, 25, dtype=int)]
    results = [_corners(model, data) for data in kinematics_each(model, some)]
    shown |= np.ptp(results, axis=0).max(axis=(1, 2)) > 1e-3
    drawn = (model.geom_type != _PLANE) & (model.body_mocapid[model.geom_bodyid] < 0)
    ends = [] if arm.state is not None else [arm.base.translation, arm.link_poses(run.target).translation[-1]]
    passed = np.vstack([*ends, np.array(results)[:, shown & drawn].reshape(-1, 3), run.link_position[:, -1]])
    others, room = results[0][~shown & drawn], 0.25 * np.ptp(passed, axis=0)
    low, high = passed.min(axis=0) - room, passed.max(axis=0) + room
    among = (others.min(axis=1) < high).all(axis=1) & (others.max(axis=1) > low).all(axis=1)
    return np.vstack([passed, np.clip(others[among].reshape(-1, 3), low, high)])


def _corners(model: mujoco.MjModel, data: mujoco.MjData) -> Floats:
    """Corners ``(G, 8, 3)`` of the boxes around geoms; the corners of a plane are its origin."""
    centre, half = model.geom_aabb[:, None, :3], model.geom_aabb[:, None, 3:].copy()
    half[model.geom_type == _PLANE] = 0.0
    inside = centre + half * np.array(list(product((-1.0, 1.0), repeat=3)))
    turns = data.geom_xmat.reshape(-1, 3, 3)
    return np.asarray(data.geom_xpos[:, None] + inside @ turns.transpose(0, 2, 1))


def place(arm: Arm) -> str:
    """Name of the arm, and of its scene if there are obstacles, for captions."""
    return arm.name if arm.scene == "free" else f"{arm.name}, {arm.scene}"


def caption(run: Rollout, time: float) -> list[str]:
    """Arm and scene of a run, the step of a sequence at a time [s] or the controller, and its proved clearance."""
    proof = [] if run.clearance is None else [run.clearance.at(time)]
    return [place(run.arm), run.step_at(time) or run.controller, *proof]


def cameras(arm: Arm) -> list[str]:
    """Names of the cameras of the scene."""
    return [arm.model.camera(i).name for i in range(arm.model.ncam)]


def camera(
    arm: Arm, name: str | None, points: Floats, run: Rollout | None = None, ratio: float = 16.0 / 9.0
) -> mujoco.MjvCamera:
    """A camera of the scene by its name; by default ``overview`` if there is one, else one that frames the points.

    A picture of width / height ``ratio`` has the points ``(P, 3)`` in it, and shows most of the path of a ``run``.
    """
    name = name or (_OVERVIEW if _OVERVIEW in cameras(arm) else None)
    result = mujoco.MjvCamera()
    if name is not None:
        result.type, result.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, arm.model.camera(name).id
        return result
    angle, side = float(np.deg2rad(arm.model.vis.global_.fovy)), (125.0, -20.0)
    if run is not None:
        path, instants = (np.linspace(0, len(run.t) - 1, count, dtype=int) for count in (25, 3))
        side = free_side(arm.model, run.qpos[instants], run.link_position[path, -1], points, angle, ratio)
    view = around(points, *side, angle, ratio)
    result.type, result.lookat[:] = mujoco.mjtCamera.mjCAMERA_FREE, view.look_at
    result.distance = np.linalg.norm(view.look_at - view.position)
    result.azimuth, result.elevation = side
    return result


def scale(arm: Arm, points: Floats) -> float:
    """Scale of lengths and widths drawn around an arm: 1 in the package's scenes, and for extents from 1.3 m on."""
    return 1.0 if _OVERVIEW in cameras(arm) else min(1.0, float(np.linalg.norm(np.ptp(points, axis=0))) / 1.3)


def staged(arm: Arm, points: Floats) -> tuple[mujoco.MjModel, int]:
    """A copy of the arm's model, completed for rendering, and the mocap id of its target marker.

    The copy has the same joints in the same order. The marker is no larger than the hand or, if the hand has no shape,
    in proportion to the points ``(P, 3)``. Links that all have one colour get tones of it. The model of a view gets no
    marker, and a brighter headlight if it has no other lights.
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
    spec.compiler.discardvisual = False  # the default of URDF files would remove all that is added here
    names = {element.name for kind in (spec.textures, spec.materials, spec.bodies) for element in kind}
    # Models of robots have at most a spotlight, which leaves the surroundings dark.
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
    _lay_squares(spec, unused("squares", names))
    name = "target" if marked else unused("target", names)
    # Colours of the target marker: the ball, and the axes in it.
    glass = (0.08, 0.75, 0.70, 0.35)
    axes = ((0.87, 0.20, 0.20, 1.0), (0.20, 0.68, 0.28, 1.0), (0.18, 0.40, 0.88, 1.0))
    if not marked:
        size = 0.06 * float(np.linalg.norm(np.ptp(points, axis=0)))
        radius = min(0.5 * float(np.median(_hand(arm))) or 0.25 * size, 0.5 * size)
        reach = max(2.0 * radius, 0.5 * size)  # length of the axes; a hand at the target would hide shorter ones
        marker = spec.worldbody.add_body(name=name, mocap=True)
        marker.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0], rgba=glass, **_UNSEEN)
        for axis, colour in zip(np.eye(3), axes, strict=True):
            ends = [0.0, 0.0, 0.0, *(reach * axis)]
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            marker.add_geom(type=kind, fromto=ends, size=[0.04 * size, 0.0, 0.0], rgba=colour, **_UNSEEN)
    result = spec.compile()
    _tone_links(result, int(arm.frames.bodies[-1]))
    return result, int(result.body_mocapid[result.body(name).id])


def _lay_squares(spec: mujoco.MjSpec, name: str) -> None:
    """Give floors that the importer has added squares of half a metre, as the package's own floors have."""
    look = {"rgb1": [0.60, 0.60, 0.585], "rgb2": [0.555, 0.555, 0.545], "markrgb": [0.69, 0.69, 0.68], "width": 512}
    kind = {"builtin": mujoco.mjtBuiltin.mjBUILTIN_CHECKER, "mark": mujoco.mjtMark.mjMARK_EDGE, "height": 512}
    spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, **kind, **look)
    material = spec.add_material(name=name, texuniform=True, specular=0.1, shininess=0.2)
    material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = name
    for geom in spec.geoms:
        if geom.type == _PLANE and np.allclose(geom.rgba, GREY):
            geom.material, geom.rgba = name, (0.5, 0.5, 0.5, 1.0)  # MuJoCo's default, which takes the material's


def mark(arm: Arm, data: mujoco.MjData, marker: int, target: Floats | None) -> None:
    """Put the marker, given by its mocap id, at a joint target ``(n,)``; without one, into the base, which hides it."""
    if marker == _NO_MARKER:
        return
    pose = arm.base if target is None else arm.link_poses(target)[-1]
    data.mocap_pos[marker] = pose.translation
    data.mocap_quat[marker] = pose.rotation.as_quat(scalar_first=True)


def _tone_links(model: mujoco.MjModel, last: int) -> None:
    """Give the links up to a body tones of their colour, from dark to light, if all have the same colour."""
    chain = ancestry(model, last)[1:]
    ranks = {body: len(set(model.body_weldid[chain[:place]])) for place, body in enumerate(chain, start=1)}
    nearest = [max((ranks.get(a, 0) for a in ancestry(model, body)), default=0) for body in range(model.nbody)]
    of_link = np.array(nearest)[model.geom_bodyid]
    colours, mine = geom_colours(model), (of_link > 0) & (model.geom_group <= 2)
    textured = (model.mat_texid[model.geom_matid[mine & (model.geom_matid >= 0)]] >= 0).any()
    if textured or len(np.unique(colours[mine], axis=0)) != 1:
        return
    colour, share = colours[mine][0, :3], (of_link[mine, None] - 1.0) / max(of_link.max() - 1.0, 1.0)
    model.geom_rgba[mine, :3] = 0.5 * colour + share * 0.5 * (1.0 - 0.1 * colour)
    model.geom_rgba[mine, 3], model.geom_matid[mine] = colours[mine, 3], -1


def _hand(arm: Arm) -> Floats:
    """Extents ``(3,)`` of the last body's geoms along its axes [m]; zero without any."""
    model, body = arm.model, int(arm.frames.bodies[-1])
    mine = model.body_weldid[model.geom_bodyid] == model.body_weldid[body]
    data = kinematics_at(model, model.qpos0)
    corners = _corners(model, data)[mine].reshape(-1, 3) @ data.xmat[body].reshape(3, 3)
    return np.asarray(np.ptp(corners, axis=0)) if len(corners) else np.zeros(3)
