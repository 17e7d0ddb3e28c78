"""Staging of an arm for rendering: light, sky, target marker and camera, where its model lacks them."""

from __future__ import annotations

import copy

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.importer.loading import unused
from lieednn_sim.simulation import Rollout
from lieednn_sim.values import Floats

_LIGHTS = (((-0.33, 0.43, -0.84), 0.45, True), ((-0.45, -0.72, -0.54), 0.2, False))  # direction, diffuse, shadow
# Colours of the target marker: its axes, and the ball around them.
_AXES = ((0.87, 0.20, 0.20, 1.0), (0.20, 0.68, 0.28, 1.0), (0.18, 0.40, 0.88, 1.0))
_GLASS = (0.08, 0.75, 0.70, 0.35)
_AZIMUTH, _ELEVATION = 125.0, -20.0  # of the default camera [degrees]
_CONFIGURATIONS = 64  # number of random configurations from which the arm's workspace is estimated
_OVERVIEW = "overview"  # the camera of the package's own scenes
_LARGE = 1.3  # extent of the view [m] from which on what is drawn around the arm has its full size
_UNSEEN = {"contype": 0, "conaffinity": 0, "group": 2, "mass": 0.0}  # no effect on contacts and dynamics


def reached(arm: Arm) -> Floats:
    """Points ``(P, 3)`` that the link frames reach, at home and at random configurations with a fixed seed."""
    low, high = arm.position_limits.T
    configurations = np.random.default_rng(0).uniform(low, high, (_CONFIGURATIONS, arm.n_joints))
    places = arm.link_poses(np.vstack([arm.keyframe("home"), arm.within_angles(configurations)])).translation
    return np.vstack([arm.base.translation, np.asarray(places).reshape(-1, 3)])


def occupied(rollout: Rollout) -> Floats:
    """Points ``(P, 3)`` that a view of a rollout must contain: the base, the target, and all that the links pass."""
    ends = [rollout.arm.base.translation, rollout.arm.link_poses(rollout.target).translation[-1]]
    return np.vstack([*ends, rollout.link_position.reshape(-1, 3)])


def place(arm: Arm) -> str:
    """Name of the arm, and of its scene if there are obstacles, for captions."""
    return arm.name if arm.scene == "free" else f"{arm.name}, {arm.scene}"


def cameras(arm: Arm) -> list[str]:
    """Names of the cameras of the arm's scene."""
    return [arm.model.camera(i).name for i in range(arm.model.ncam)]


def camera(arm: Arm, name: str | None, points: Floats) -> mujoco.MjvCamera:
    """A camera of the scene by its name; by default ``overview`` if there is one, else one that frames the points."""
    name = name or (_OVERVIEW if _OVERVIEW in cameras(arm) else None)
    if name is None:
        return framing(arm, points)
    fixed = mujoco.MjvCamera()
    fixed.type, fixed.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, arm.model.camera(name).id
    return fixed


def scale(arm: Arm, points: Floats) -> float:
    """Scale of lengths and widths that are drawn around an arm: 1 in the package's scenes, less for small arms."""
    return 1.0 if _OVERVIEW in cameras(arm) else min(1.0, float(np.linalg.norm(np.ptp(points, axis=0))) / _LARGE)


def framing(arm: Arm, points: Floats) -> mujoco.MjvCamera:
    """A camera that frames the points ``(P, 3)`` of the arm, with room for a hand beyond them."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = 1.15 * float(np.linalg.norm(points - centre, axis=1).max()) + _hand(arm)
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = centre
    camera.distance = radius / np.sin(0.5 * np.deg2rad(arm.model.vis.global_.fovy))
    camera.azimuth, camera.elevation = _AZIMUTH, _ELEVATION
    return camera


def staged(arm: Arm, points: Floats) -> tuple[mujoco.MjModel, int]:
    """A copy of the arm's model, completed for rendering, and the mocap id of its target marker.

    Args:
        arm: the arm; joints and their order are the same in the copy.
        points: ``(P, 3)`` points that determine the size of the marker.
    """
    model = arm.model
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "target")
    marked = body >= 0 and model.body_mocapid[body] >= 0
    sky = bool((model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any())
    if marked and sky and model.nlight and arm.import_report is None:
        return copy.deepcopy(model), int(model.body_mocapid[body])
    spec = arm.spec.copy()
    spec.compiler.discardvisual = False  # with the default of URDF files, all of this would vanish
    names = {element.name for kind in (spec.textures, spec.materials, spec.bodies) for element in kind}
    own = arm.import_report is None
    if not own:
        # Robots bring a spotlight at most, around which all is dark.
        for light in list(spec.lights):
            spec.delete(light)
        spec.visual.map.shadowclip, spec.visual.map.shadowscale = 1.4, 0.6
    if not (own and model.nlight):
        spec.visual.headlight.ambient = [0.4] * 3
        spec.visual.headlight.diffuse = [0.4] * 3
        for direction, diffuse, shadow in _LIGHTS:
            light = spec.worldbody.add_light(pos=-4.0 * np.array(direction), dir=direction, castshadow=shadow)
            light.type, light.diffuse = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, [diffuse] * 3
    if not sky:
        spec.add_texture(
            name=unused("sky", names),
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.26, 0.44, 0.68],
            rgb2=[0.90, 0.93, 0.95],
            width=256,
            height=1536,
        )
    name = "target" if marked else unused("target", names)
    if not marked:
        size = 0.06 * float(np.linalg.norm(np.ptp(points, axis=0)))
        # As large as the hand, which would hide it on arrival.
        radius = float(np.clip(1.1 * _hand(arm), 0.35 * size, 0.9 * size))
        marker = spec.worldbody.add_body(name=name, mocap=True)
        marker.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0], rgba=_GLASS, **_UNSEEN)
        for axis, colour in zip(np.eye(3), _AXES, strict=True):
            ends = [0.0, 0.0, 0.0, *((radius + 0.65 * size) * axis)]
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            marker.add_geom(type=kind, fromto=ends, size=[0.04 * size, 0.0, 0.0], rgba=colour, **_UNSEEN)
    made = spec.compile()
    return made, int(made.body_mocapid[made.body(name).id])


def mark(arm: Arm, data: mujoco.MjData, marker: int, target: Floats | None) -> None:
    """Put the marker, by its mocap id, at a joint target ``(n,)``, or without one into the base, which hides it."""
    pose = arm.base if target is None else arm.link_poses(target)[-1]
    data.mocap_pos[marker] = pose.translation
    data.mocap_quat[marker] = pose.rotation.as_quat(scalar_first=True)


def _hand(arm: Arm) -> float:
    """Upper bound on how far the last body extends beyond the last link's frame [m]."""
    model, site = arm.model, int(arm.site_ids[-1])
    mine = model.body_weldid[model.geom_bodyid] == model.body_weldid[model.site_bodyid[site]]
    data = kinematics_at(model, model.qpos0)
    return float(
        (np.linalg.norm(data.geom_xpos - data.site_xpos[site], axis=1) + model.geom_rbound)[mine].max(initial=0.0)
    )
