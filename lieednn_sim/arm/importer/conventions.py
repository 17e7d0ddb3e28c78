"""Edits that give a spec this package's conventions: frame sites, ties, ranges, gravity compensation, length unit."""

from __future__ import annotations

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.frames import Frame
from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.arm.importer.loading import unused
from lieednn_sim.arm.parsing import read_arm, read_chain
from lieednn_sim.lie import log

_SITE = mujoco.mjtObj.mjOBJ_SITE
_LEAST_INERTIA = 1e-6  # of the largest moment of a body, or [kg m^2]
_UNIT_FIELD = "length_scale"


def mend_inertias(draft: Draft) -> None:
    """Give inertias to moving links of a URDF without any, and enlarge impossible ones: A + B >= C > 0 must hold.

    Other simulators accept both; links without an inertia are usual in mobile bases.
    """
    if draft.source is None or draft.source.suffix.lower() != ".urdf":
        return
    mended, massless = [], []
    for body in draft.spec.bodies:
        if body.joints and not body.explicitinertial and not body.geoms:
            # As light as MuJoCo's solver bears between links of some kilograms.
            body.mass, body.inertia, body.explicitinertial = 0.01, [1e-5] * 3, True
            massless.append(body.name)
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
            mended.append(body.name)
    if massless:
        draft.notes.append(f"links without <inertial> got a mass of 10 g: {', '.join(massless)}")
    if mended:
        draft.notes.append(f"physically impossible inertias made larger: {', '.join(mended)}")


def replace_integrator(draft: Draft) -> None:
    """Replace RK4 by implicitfast, see `arm.checks.check_integrator`."""
    if draft.spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        draft.spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        draft.notes.append("integrator implicitfast in place of RK4, which has no inverse dynamics in discrete time")


def add_frames(draft: Draft) -> None:
    """Add the sites ``base_frame``, ``link1_frame``, ... at the frames; rename other sites with these names."""
    spec, model, frames = draft.spec, draft.original, draft.frames
    names = ("base_frame", *(f"link{i}_frame" for i in range(1, len(frames))))
    # By name: a spec forgets the ids of a compiled model as soon as something is added to it.
    bodies = {body.name: body for body in spec.bodies}
    missing = {name: frame for name, frame in zip(names, frames, strict=True) if not _is_there(model, name, frame)}
    for name in (*missing, f"link{len(frames)}_frame"):
        site = spec.site(name)
        if site is not None:
            other = unused(f"original_{name}", {site.name for site in spec.sites})
            _rename_site(spec, site, other)
            draft.notes.append(f"the site {name!r} of the model is now called {other!r}")
    for name, frame in missing.items():
        body = bodies[model.body(frame.body).name]
        site = body.add_site(name=name, pos=frame.pos, quat=frame.quat, size=[0.008, 0.0, 0.0], group=4)
        site.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        site.fromto = np.full(6, np.nan)


def tie_stages(draft: Draft) -> None:
    """Tie the stages of a telescope to their leaders by equalities that are nearly as stiff as rigid belts.

    Stages tied by a tendon alone get an equality, and softer ones of the model are made as stiff: by MuJoCo's default a
    light stage hangs on a spring of a few hundred newtons per metre, and friction of a few newtons leaves it
    centimetres behind the others, unseen by any servo.
    """
    spec, model, couplings = draft.spec, draft.original, draft.couplings
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
        # Negative numbers are a stiffness and a damping that were chosen explicitly.
        if equality.solref[0] > reference[0] or equality.solref[0] == 0.0:
            equality.solref, equality.solimp = reference, impedance
            stiffened.append(equality.name1)
    if stiffened:
        draft.notes.append(f"ties of {', '.join(stiffened)} made stiff, with solref {reference[0]:g} s")


def set_ranges(draft: Draft) -> None:
    """Limit the arm's joints to their ranges, in the spec's unit."""
    for identifier in draft.joints:
        joint = draft.spec.joint(draft.original.joint(identifier).name)
        degrees = joint.compiler.degree and joint.type != mujoco.mjtJoint.mjJNT_SLIDE
        joint.range = np.rad2deg(draft.ranges[identifier]) if degrees else draft.ranges[identifier]
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE


def compensate_gravity(draft: Draft) -> None:
    """Switch gravity compensation on for every body that moves with the arm, unless one of these has it already."""
    model = draft.original
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY) or not np.any(model.opt.gravity):
        return
    first = int(model.jnt_bodyid[draft.joints[0]])
    moving = {first}
    for body in range(first + 1, model.nbody):
        if int(model.body_parentid[body]) in moving:
            moving.add(body)
    if np.any(model.body_gravcomp[list(moving)]):
        draft.notes.append("gravity compensation is the model's own")
        return
    names = {model.body(body).name for body in moving}
    for body in draft.spec.bodies:
        if body.name in names:
            body.gravcomp = 1.0
    draft.notes.append(f"gravity compensation switched on for {len(moving)} moving bodies")


def _is_there(model: mujoco.MjModel, name: str, frame: Frame) -> bool:
    site = mujoco.mj_name2id(model, _SITE, name)
    return (
        site >= 0
        and int(model.site_bodyid[site]) == frame.body
        and np.allclose(model.site_pos[site], frame.pos, rtol=0.0, atol=1e-12)
        and abs(float(model.site_quat[site] @ frame.quat)) > 1.0 - 1e-12
    )


def _rename_site(spec: mujoco.MjSpec, site: mujoco.MjsSite, name: str) -> None:
    for sensor in spec.sensors:
        if sensor.objtype == _SITE and sensor.objname == site.name:
            sensor.objname = name
        if sensor.reftype == _SITE and sensor.refname == site.name:
            sensor.refname = name
    for equality in spec.equalities:
        if equality.objtype == _SITE:
            equality.name1 = name if equality.name1 == site.name else equality.name1
            equality.name2 = name if equality.name2 == site.name else equality.name2
    site.name = name


def set_length_unit(draft: Draft) -> None:
    """Give a large arm a unit of length in which its joints move by about one at most.

    The activation of the network saturates at one, whatever the unit: a crane's stroke in metres is beyond its range,
    and hardly any target could be certified. A custom numeric ``length_scale`` of the model stays.
    """
    if draft.spec.numeric(_UNIT_FIELD) is not None:
        return
    model, configurations = draft.bare, draft.configurations([*draft.samples, *draft.extremes])
    chain = read_chain(model, "imported")
    fields = read_arm(model, "imported", chain, rest=model.qpos0)
    space, joints = fields["space"], fields["joints"]
    largest = float(np.abs(log(joints.poses(space.from_qpos(configurations)))[..., 3:]).max())
    if largest > 1.0:
        unit = float(f"{largest:.2g}")
        draft.spec.add_numeric(name=_UNIT_FIELD, data=[unit], size=1)
        draft.notes.append(f"unit of length in the network's coordinates: {unit:g} m, the furthest that a link moves")


def length_unit(draft: Draft) -> float:
    """The unit of length [m] of the arm's network coordinates."""
    field = draft.spec.numeric(_UNIT_FIELD)
    return 1.0 if field is None else float(field.data[0])
