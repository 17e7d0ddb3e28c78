"""A compiled model as a spec: what the importer needs of a model whose file nobody has."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import geom_colours, mujoco
from lieednn_sim.arm.forces import ON_JOINTS
from lieednn_sim.arm.frames import Frame, body_frame, find_frame
from lieednn_sim.arm.importer.coupled_joints import tendon_joints
from lieednn_sim.arm.importer.holding import Grasp, add_supports, in_order
from lieednn_sim.arm.importer.loading import unused
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice

_EQ, _GEOM, _OBJ, _TRN = mujoco.mjtEq, mujoco.mjtGeom, mujoco.mjtObj, mujoco.mjtTrn
_EQUALITIES = tuple(map(int, (_EQ.mjEQ_CONNECT, _EQ.mjEQ_WELD, _EQ.mjEQ_JOINT)))
# Fields that an element of a spec and its row of the compiled model share, by the prefix of the model's names.
_JOINT = ("type", "pos", "axis", "range", "margin", "group", "solref_limit=solref", "solimp_limit=solimp")
_GEOM_FIELDS = (
    *("type", "size", "pos", "quat", "contype", "conaffinity", "condim", "priority", "solmix", "solref", "solimp"),
    *("margin", "gap", "friction", "group"),
)
# Entries of qpos and qvel of joints that have more than one.
_FREE, _BALL, _HINGE, _SLIDE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{kind}")) for kind in ("FREE", "BALL", "HINGE", "SLIDE")
)
_WIDTHS, _RATES = {_BALL: 4}, {_BALL: 3}
_ACTUATOR = ("gear", "ctrlrange", "forcerange", "trntype", "gaintype", "biastype", "gainprm", "biasprm")


def spec_of(model: mujoco.MjModel, data: mujoco.MjData, grasp: Grasp | None = None) -> mujoco.MjSpec:
    """A spec that compiles to the bodies, joints, geoms and actuators of a model, with a keyframe at its present state.

    It has what planning and a simulation of one arm need: bodies with their inertias, joints, geoms with meshes and
    height fields in plain colours, sites, equalities, fixed tendons, actuators on joints and fixed tendons, rules of
    contact, and numbers of ``<custom>``. Left out are what the arm cannot touch, and what only draws: flexes, skins,
    sensors, spatial tendons, textures, lights and cameras. Elements without a name get one, and a hinge without a range
    gets one turn either way from where it is.

    Args:
        model: any compiled model.
        data: its state: the keyframe ``home`` gets its `qpos`, mocap bodies stand where it has them, and equalities
            that are off in it are left out.

    Raises:
        InputError: the positions are not finite, or the data is of another model.
    """
    check_data(model, data)
    if not np.isfinite(data.qpos).all():
        raise InputError("data holds NaN or infinite positions: reset it, or set its qpos")
    spec = mujoco.MjSpec()
    spec.compiler.degree, spec.compiler.autolimits = False, False
    for name in dir(model.opt):
        if not name.startswith("_"):
            setattr(spec.option, name, getattr(model.opt, name))
    names = _Names(model)
    _add_assets(spec, model, names)
    bodies, order = {0: spec.worldbody}, in_order(model, grasp)
    for body in order[1:]:
        held = grasp is not None and body == grasp.body
        parent = grasp.carrier if grasp is not None and held else int(model.body_parentid[body])
        bodies[body] = _add_body(bodies[parent], model, data, body, names, grasp if held else None)
    _add_parts(spec, bodies, model, names)
    if grasp is not None:
        add_supports(spec, model, grasp, names, partial(_add_geom, bodies, model, names, geom_colours(model)))
    _add_tendons(spec, model, names)
    _add_equalities(spec, model, data, names)
    _add_actuators(spec, model, names)
    _add_contact_rules(spec, model, names)
    for i in range(model.nnumeric):
        start = model.numeric_adr[i]
        spec.add_numeric(name=model.numeric(i).name, data=model.numeric_data[start : start + model.numeric_size[i]])
    spec.add_key(name="home", qpos=data.qpos[_entries(model, order, grasp)])
    return spec


def _entries(model: mujoco.MjModel, order: list[int], grasp: Grasp | None) -> list[int]:
    """Which entries of qpos the joints of bodies in an order have, without the free joint of a held body."""
    result: list[int] = []
    for body in order:
        if grasp is not None and body == grasp.body:
            continue
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            first = int(model.jnt_qposadr[joint])
            result += range(first, first + {_FREE: 7, _BALL: 4}.get(int(model.jnt_type[joint]), 1))
    return result


class _Names:
    """Names of a model's elements; those without one get one."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._of: dict[tuple[str, int], str] = {}
        counts = {
            **{"body": model.nbody, "joint": model.njnt, "geom": model.ngeom, "site": model.nsite},
            **{"mesh": model.nmesh, "hfield": model.nhfield, "tendon": model.ntendon, "actuator": model.nu},
        }
        for kind, count in counts.items():
            given = [mujoco.mj_id2name(model, getattr(_OBJ, f"mjOBJ_{kind.upper()}"), i) for i in range(count)]
            taken = set(filter(None, given))
            for i, name in enumerate(given):
                self._of[kind, i] = name or unused(f"{kind}{i}", taken)
                taken.add(self._of[kind, i])

    def __call__(self, kind: str, number: int) -> str:
        return self._of[kind, int(number)]


def _copy(element: Any, model: mujoco.MjModel, prefix: str, row: int, fields: tuple[str, ...]) -> None:
    """Copy ``model.PREFIX_FIELD[row]`` to the field of an element; ``mine=theirs`` where the names differ."""
    for field in fields:
        mine, _, theirs = field.partition("=")
        value = getattr(model, f"{prefix}_{theirs or mine}")[row]
        setattr(element, mine, value if np.ndim(value) else value.item())


def _limited(limited: bool) -> Any:
    return mujoco.mjtLimited.mjLIMITED_TRUE if limited else mujoco.mjtLimited.mjLIMITED_FALSE


def _add_assets(spec: mujoco.MjSpec, model: mujoco.MjModel, names: _Names) -> None:
    for i in range(model.nmesh):
        points, faces = (
            array[start : start + count]
            for array, start, count in (
                (model.mesh_vert, model.mesh_vertadr[i], model.mesh_vertnum[i]),
                (model.mesh_face, model.mesh_faceadr[i], model.mesh_facenum[i]),
            )
        )
        mesh = spec.add_mesh(name=names("mesh", i), uservert=points.ravel(), userface=faces.ravel())
        # Any surface has this kind of inertia, closed or not; bodies have their inertias from the model.
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    for i in range(model.nhfield):
        rows, columns, start = int(model.hfield_nrow[i]), int(model.hfield_ncol[i]), model.hfield_adr[i]
        spec.add_hfield(
            name=names("hfield", i),
            nrow=rows,
            ncol=columns,
            size=model.hfield_size[i],
            userdata=model.hfield_data[start : start + rows * columns],
        )


def _add_body(
    parent: mujoco.MjsBody,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    body: int,
    names: _Names,
    grasp: Grasp | None,
) -> mujoco.MjsBody:
    """Add a body with its inertia and joints; a mocap body stands still where it is, and a held one has no joint."""
    pos, quat = model.body_pos[body], model.body_quat[body]
    if grasp is not None:
        pos, quat = grasp.place.translation, grasp.place.rotation.as_quat(scalar_first=True)
    if (mocap := model.body_mocapid[body]) >= 0:
        pos, quat = data.mocap_pos[mocap], data.mocap_quat[mocap]
    result = parent.add_body(name=names("body", body), pos=pos, quat=quat, explicitinertial=True)
    result.mass, result.gravcomp = float(model.body_mass[body]), float(model.body_gravcomp[body])
    result.ipos, result.iquat, result.inertia = model.body_ipos[body], model.body_iquat[body], model.body_inertia[body]
    if grasp is None:
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            _add_joint(result, model, data, joint, names)
    return result


def _add_joint(body: mujoco.MjsBody, model: mujoco.MjModel, data: mujoco.MjData, joint: int, names: _Names) -> None:
    result = body.add_joint(name=names("joint", joint), align=0)
    _copy(result, model, "jnt", joint, _JOINT)
    dof, address = model.jnt_dofadr[joint], model.jnt_qposadr[joint]
    result.limited = _limited(model.jnt_limited[joint])
    if model.jnt_type[joint] == _HINGE and not model.jnt_limited[joint]:
        result.limited, result.range = _limited(True), data.qpos[address] + 2.0 * np.pi * np.array([-1.0, 1.0])
    result.stiffness = [model.jnt_stiffness[joint], *model.jnt_stiffnesspoly[joint]]
    result.damping = [model.dof_damping[dof], *model.dof_dampingpoly[dof]]
    result.armature, result.frictionloss = float(model.dof_armature[dof]), float(model.dof_frictionloss[dof])
    joint_forces = ("actfrcrange", "actgravcomp")
    if model.jnt_type[joint] in (_HINGE, _SLIDE):
        result.ref, result.springref = float(model.qpos0[address]), float(model.qpos_spring[address])
        _copy(result, model, "jnt", joint, joint_forces)
        result.actfrclimited = _limited(model.jnt_actfrclimited[joint])


def _add_geom(
    bodies: dict[int, mujoco.MjsBody], model: mujoco.MjModel, names: _Names, colours: Any, geom: int, name: str
) -> Any:
    """Add a copy of a geom to its body."""
    kind = int(model.geom_type[geom])
    result = bodies[int(model.geom_bodyid[geom])].add_geom(name=name)
    _copy(result, model, "geom", geom, _GEOM_FIELDS)
    result.rgba = colours[geom]
    if kind in (int(_GEOM.mjGEOM_MESH), int(_GEOM.mjGEOM_SDF)):
        result.meshname = names("mesh", model.geom_dataid[geom])
    elif kind == int(_GEOM.mjGEOM_HFIELD):
        result.hfieldname = names("hfield", model.geom_dataid[geom])
    return result


def _add_parts(spec: mujoco.MjSpec, bodies: dict[int, mujoco.MjsBody], model: mujoco.MjModel, names: _Names) -> None:
    """Add geoms and sites."""
    colours = geom_colours(model)
    for geom in range(model.ngeom):
        _add_geom(bodies, model, names, colours, geom, names("geom", geom))
    for site in range(model.nsite):
        result = bodies[int(model.site_bodyid[site])].add_site(name=names("site", site))
        _copy(result, model, "site", site, ("pos", "quat", "size", "group", "rgba"))


def _add_tendons(spec: mujoco.MjSpec, model: mujoco.MjModel, names: _Names) -> None:
    """Add fixed tendons, which may drive the stages of a telescope."""
    for tendon in range(model.ntendon):
        if coefficients := tendon_joints(model, tendon):
            result = spec.add_tendon(name=names("tendon", tendon))
            for joint, coefficient in coefficients.items():
                result.wrap_joint(names("joint", joint), coefficient)


def _add_equalities(spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData, names: _Names) -> None:
    for equality in map(int, np.flatnonzero(data.eq_active)):
        kind = int(model.eq_type[equality])
        if kind not in _EQUALITIES:
            continue
        on_sites = model.eq_objtype[equality] == int(_OBJ.mjOBJ_SITE)
        sort = "joint" if kind == int(_EQ.mjEQ_JOINT) else "site" if on_sites else "body"
        result = spec.add_equality(name=model.equality(equality).name, type=model.eq_type[equality].item())
        result.objtype = model.eq_objtype[equality].item()
        result.name1 = names(sort, model.eq_obj1id[equality])
        if model.eq_obj2id[equality] >= 0:
            result.name2 = names(sort, model.eq_obj2id[equality])
        _copy(result, model, "eq", equality, ("data", "solref", "solimp"))


def _add_actuators(spec: mujoco.MjSpec, model: mujoco.MjModel, names: _Names) -> None:
    """Add actuators on joints and fixed tendons; where a gain is of another kind, they are motors with its force."""
    for actuator in range(model.nu):
        transmission, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
        on_tendon = transmission == int(_TRN.mjTRN_TENDON) and bool(tendon_joints(model, target))
        if not on_tendon and transmission not in ON_JOINTS:
            continue
        result = spec.add_actuator(
            name=names("actuator", actuator), target=names("tendon" if on_tendon else "joint", target)
        )
        _copy(result, model, "actuator", actuator, _ACTUATOR)
        result.ctrllimited = _limited(model.actuator_ctrllimited[actuator])
        result.forcelimited = _limited(model.actuator_forcelimited[actuator])


def _add_contact_rules(spec: mujoco.MjSpec, model: mujoco.MjModel, names: _Names) -> None:
    """Add excluded pairs of bodies, and explicit pairs of geoms."""
    for signature in model.exclude_signature:
        first, second = divmod(int(signature), 1 << 16)
        spec.add_exclude(bodyname1=names("body", first), bodyname2=names("body", second))
    for pair in range(model.npair):
        result = spec.add_pair(
            geomname1=names("geom", model.pair_geom1[pair]), geomname2=names("geom", model.pair_geom2[pair])
        )
        _copy(result, model, "pair", pair, ("margin", "gap", "solref", "solimp", "friction", "condim=dim"))


def name_in_spec(model: mujoco.MjModel, body: int) -> str:
    """The name of a body in `spec_of`."""
    return _Names(model)("body", body)


def check_data(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Raise `InputError` for data of another model."""
    if len(data.qpos) != model.nq or data.xpos.shape[0] != model.nbody or len(data.ctrl) != model.nu:
        raise InputError("data must be of the model: make it by mujoco.MjData(model)")


def shared_addresses(model: mujoco.MjModel, arm: mujoco.MjModel) -> tuple[NDArray[np.int_], ...]:
    """Where the joints of an arm from `spec_of` are in the model that it was made of.

    Returns:
        Addresses in qpos of the model and of the arm, and in qvel of the model and of the arm, one for each entry.

    Raises:
        InputError: the model lacks a joint of the arm.
    """
    names = _Names(model)
    qpos: list[tuple[int, int]] = []
    qvel: list[tuple[int, int]] = []
    theirs = {names("joint", joint): joint for joint in range(model.njnt)}
    for joint in range(arm.njnt):
        other = theirs[as_choice("joint of the arm in the model", arm.joint(joint).name, theirs)]
        for width, result, address in ((_WIDTHS, qpos, "jnt_qposadr"), (_RATES, qvel, "jnt_dofadr")):
            count = width.get(int(arm.jnt_type[joint]), 1)
            result += [(getattr(model, address)[other] + k, getattr(arm, address)[joint] + k) for k in range(count)]
    return (*np.array(qpos).T, *np.array(qvel).T)


def named_frame(model: mujoco.MjModel, name: str) -> Frame:
    """The frame of a body or site of a model, by its name there or in `spec_of`; `InputError` lists the model's."""
    names = _Names(model)
    for body in range(1, model.nbody):
        if not model.body(body).name and names("body", body) == name:
            return body_frame(model, body)
    return find_frame(model, name)
