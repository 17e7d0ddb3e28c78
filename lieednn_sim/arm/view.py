"""Some joints of a compiled model, read as an arm; everything else in the model is its surroundings."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.checks import ancestry, check_numbers, joints_of
from lieednn_sim.arm.contacts import colliding_geoms
from lieednn_sim.arm.coordinates import Coordinates
from lieednn_sim.arm.dependents import Dependents
from lieednn_sim.arm.equalities import names
from lieednn_sim.arm.forces import tangent_basis
from lieednn_sim.arm.frames import Frame, body_frame, find_frame
from lieednn_sim.arm.importer.compound_joints import cut
from lieednn_sim.arm.importer.coupled_joints import Couplings, along_tendons, tied_joints
from lieednn_sim.arm.importer.limits import check_rates, spare_acceleration
from lieednn_sim.arm.importer.mechanism import joint_ranges, tip_frame
from lieednn_sim.arm.importer.serial_chain import chain_base, chosen_joints, common_path
from lieednn_sim.arm.parsing import Chain, read_arm
from lieednn_sim.arm.stops import Stops
from lieednn_sim.errors import InputError
from lieednn_sim.lie import log
from lieednn_sim.validation import as_choice, quoted
from lieednn_sim.values import Floats


def check_data(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Raise `InputError` for data of another model, or with positions that are not finite."""
    if len(data.qpos) != model.nq or data.xpos.shape[0] != model.nbody or len(data.ctrl) != model.nu:
        raise InputError("data must be of the model: make it by mujoco.MjData(model)")
    if not all(np.isfinite(values).all() for values in (data.qpos, data.mocap_pos, data.mocap_quat)):
        raise InputError("data holds positions that are NaN or infinite")


def name_of(model: mujoco.MjModel) -> str:
    """The model's own name, or ``arm`` if nobody gave it one."""
    name = model.names[: model.names.index(b"\0")].decode("utf-8", "replace")
    return "arm" if name in ("", "MuJoCo Model") else name


def standing(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjModel:
    """A copy of a model in which mocap bodies are where a state has them, and equalities are on that are on there."""
    own = copy.deepcopy(model)
    for body in np.flatnonzero(model.body_mocapid >= 0):
        mocap = model.body_mocapid[body]
        own.body_pos[body], own.body_quat[body] = data.mocap_pos[mocap], data.mocap_quat[mocap]
    own.eq_active0[:] = data.eq_active
    return own


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> Floats:
    """The whole state of ``data``, controls and applied forces included, at time 0, as ``mjSTATE_INTEGRATION``."""
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    state[0] = 0.0  # the time is its first entry
    return state


def read_view(
    own: mujoco.MjModel,
    data: mujoco.MjData,
    joints: Sequence[str],
    tip: str | None,
    base: str | None,
    limits: Mapping[str, Mapping[str, float]] | None,
) -> tuple[dict[str, Any], str | None]:
    """The fields of an `Arm` that some joints of a model determine; others stay as ``data`` has them.

    Returns:
        The fields, and the name of a free body that the end effector holds by an active weld, if any.

    Raises:
        InputError: the joints are not an arm's, or a name is unknown.
        NoSolutionError: the state is not near a solution of the equalities, or at a dead centre.
    """
    if not joints:
        raise InputError("joints must name at least one joint")
    check_rates(limits)
    check_numbers(own)
    chosen = chosen_joints(own, joints)
    independent = _independent(own, chosen)
    dependents = Dependents(own, data, independent)
    qpos = dependents.to_qpos(data.qpos)
    inner, path, joints_of_chain = _chain(own, dependents, qpos, chosen, tip, base)
    last = body_frame(own, path[-1])
    end = last if tip is None else tip_frame(own, tip, last)
    held, weld = _welded(own, data, dependents, end.body)
    if held is not None:
        # It is carried: a rigid part of the hand, without any iterations.
        state = mujoco.MjData(own)
        mujoco.mj_copyData(state, own, data)
        state.eq_active[weld] = 0
        dependents = Dependents(own, state, independent)
    _check_chain(own, dependents, [*path, *ancestry(own, end.body)], joints_of_chain)
    couplings = along_tendons(own, joints_of_chain, Couplings(dependents.lines, sums=dependents.sums))
    within = dict(zip(own.dof_jntid[dependents.dofs].tolist(), dependents.follower_limits(), strict=True))
    whole = joint_ranges(own, [[joint] for joint in joints_of_chain], couplings, [], qpos, within)
    groups = cut(own, kinematics_at(own, qpos), joints_of_chain, whole, couplings)
    ends = [body_frame(own, int(own.jnt_bodyid[group[-1]])) for group in groups[:-1]]
    ranges = joint_ranges(own, groups, couplings, [], qpos, within)
    fields = read_arm(
        own,
        "arm",
        Chain((inner, *ends, end), groups),
        rest=qpos,
        lines=couplings.lines,
        sums=couplings.sums,
        ranges=ranges,
    )
    space: Coordinates = fields["space"]
    bounded = [joint for joint in dependents.moved if joint not in dependents.lines]
    solved = [joint for joint in bounded if joint not in dependents.sums]
    stops = Stops(own, bounded, [*joints_of_chain, *dependents.moved], loops=bool(solved) and dependents.has_loops)
    fields |= {"qpos_home": qpos, "stops": stops if len(stops) else None}
    fields["dependents"] = dependents if solved else None
    fields["acceleration_limits"] = _acceleration_limits(own, fields)
    for coordinate, given in (limits or {}).items():
        index = space.names.index(as_choice("coordinate", coordinate, space.names))
        for what, value in given.items():
            fields[f"{what}_limits"][index] = value
    if fields["length_scale"] == 1.0:
        fields["length_scale"] = _length_scale(fields)
    return fields, held


def _independent(model: mujoco.MjModel, chosen: Sequence[int]) -> list[int]:
    """The chosen joints but those that equalities make followers of others of them."""
    leaders = dict(tied_joints(model))
    result = []
    for joint in chosen:
        above, seen = leaders.get(joint), {joint}
        while above is not None and above not in chosen and above not in seen:
            seen.add(above)
            above = leaders.get(above)
        if above not in chosen or above == joint:
            result.append(joint)
    return result


def _chain(
    model: mujoco.MjModel,
    dependents: Dependents,
    qpos: Floats,
    chosen: Sequence[int],
    tip: str | None,
    base: str | None,
) -> tuple[Frame, list[int], tuple[int, ...]]:
    """The base's frame, the bodies from the world to the last link, and the chain's joints from the base outwards."""
    followers = (*dependents.lines, *dependents.sums)
    paths = {joint: ancestry(model, int(model.jnt_bodyid[joint])) for joint in (*chosen, *followers)}
    longest = max((paths[joint] for joint in chosen), key=len)
    way = longest if tip is None else ancestry(model, find_frame(model, tip).body)
    on_way = [joint for body in way for joint in joints_of(model, body)]
    rates = dependents.basis(qpos)
    for joint in [joint for joint in chosen if joint not in on_way and joint in dependents.independent]:
        along = rates[:, np.searchsorted(dependents.dofs, model.jnt_dofadr[joint])]
        moved = [other for other in dependents.moved if other in on_way and along[model.jnt_dofadr[other]]]
        if moved:
            raise InputError(
                f"joint {names(model, [joint])} is not on the way to {quoted(tip or model.body(way[-1]).name)}; it "
                f"moves {names(model, moved)} there, so name that in its place: an arm's coordinates are joints of its "
                "chain"
            )
    path = common_path(model, chosen)
    # A telescope's last stages may follow the one that is named.
    path = max((paths[joint] for joint in paths if paths[joint][: len(path)] == path), key=len)
    arm = {*dependents.independent, *dependents.lines, *dependents.sums}
    chain = tuple(joint for body in path for joint in joints_of(model, body) if joint in arm)
    return chain_base(model, path, chain, base), path, chain


def _check_chain(model: mujoco.MjModel, dependents: Dependents, bodies: Sequence[int], chain: Sequence[int]) -> None:
    """Raise `InputError` for joints from the base to the end effector that others move, but not in a straight line."""
    on_way = {joint for body in bodies for joint in joints_of(model, body)}
    for joint in sorted(on_way.intersection(dependents.moved).difference(chain)):
        raise InputError(
            f"joint {names(model, [joint])}, on the way to the end effector, is moved by "
            f"{names(model, dependents.independent)} through a closed loop or a curve; joints of a chain may only "
            "follow others in a straight line, so choose joints and a tip before it"
        )


def _welded(model: mujoco.MjModel, data: mujoco.MjData, dependents: Dependents, end: int) -> tuple[str | None, int]:
    """The name of a free body that an active weld fixes to the end effector's link, and the weld's id."""
    moving = np.isin(np.arange(model.njnt), [*dependents.independent, *dependents.moved])
    for weld in np.flatnonzero((model.eq_type == int(mujoco.mjtEq.mjEQ_WELD)) & (data.eq_active != 0)).tolist():
        pair = [int(model.eq_obj1id[weld]), int(model.eq_obj2id[weld])]
        if model.eq_objtype[weld] == int(mujoco.mjtObj.mjOBJ_SITE):
            pair = [int(model.site_bodyid[site]) for site in pair]
        for body, hand in (pair, pair[::-1]):
            free = model.jnt_type[joints_of(model, body)] == int(mujoco.mjtJoint.mjJNT_FREE)
            if free.any() and model.body(body).name and _mover(model, moving, hand) == _mover(model, moving, end):
                return model.body(body).name, weld
    return None, -1


def _mover(model: mujoco.MjModel, moving: NDArray[np.bool_], body: int) -> int:
    """The nearest body, outwards from the world to one, that some joints move against its parent."""
    while body and not moving[joints_of(model, body)].any():
        body = int(model.body_parentid[body])
    return body


def _samples(fields: Mapping[str, Any], count: int) -> Floats:
    """Random configurations ``(count, n)`` within the limits."""
    low, high = fields["position_limits"].T
    shrink = 0.57 if len(fields["space"].balls) else 1.0  # half of a ball joint's box is inside of its largest angle
    return np.random.default_rng(0).uniform(shrink * low, shrink * high, (count, len(low)))


def _acceleration_limits(model: mujoco.MjModel, fields: Mapping[str, Any]) -> Floats:
    """The model's limits ``(n,)``, or where it has none those that its actuators' forces leave."""
    given, force = fields["acceleration_limits"], fields["force_limits"]
    if np.isfinite(given).all() or not np.isfinite(force).any():
        return np.array(given)
    space: Coordinates = fields["space"]
    configurations, rates = space.to_qpos(_samples(fields, 16)), tangent_basis(space)
    dependents: Dependents | None = fields["dependents"]
    if dependents is not None:
        configurations = dependents.to_qpos(np.vstack([fields["qpos_home"], configurations]), strict=False)
        configurations = configurations[~np.isnan(configurations).any(axis=1)]
        rates = dependents.basis(configurations) @ rates[dependents.dofs]
    spare = spare_acceleration(model, configurations, rates, force)
    return np.where(np.isfinite(given), given, spare)


def _length_scale(fields: Mapping[str, Any]) -> float:
    """The furthest that a link moves [m], to two digits, if that is more than a metre; else 1."""
    largest = float(np.abs(log(fields["joints"].poses(_samples(fields, 64)))[..., 3:]).max())
    return float(f"{largest:.2g}") if largest > 1.0 else 1.0


def moved_together(model: mujoco.MjModel, dofs: NDArray[np.int_]) -> NDArray[np.int_]:
    """For each body ``(nbody,)`` the first of those that some dofs move as one with it; zero for what they leave."""
    moving, group = np.zeros(model.nv, dtype=bool), np.arange(model.nbody)
    moving[dofs] = True
    # Parents come before their children.
    for body, parent in enumerate(model.body_parentid):
        first = int(model.body_dofadr[body])
        if not moving[first : first + int(model.body_dofnum[body])].any():
            group[body] = group[parent]
    return group


def rigid_groups(
    model: mujoco.MjModel, dofs: NDArray[np.int_], carried: Sequence[int] = ()
) -> tuple[mujoco.MjModel, dict[tuple[int, int], float]]:
    """A copy of a model for distances, and pairs of geoms that do not count in it.

    What the arm does not move is fixed in the copy: welded to the world, by ``body_weldid``, which MuJoCo's collision
    filter uses and kinematics do not. Pairs that move together, such as the fingers of a hand, do not count, nor those
    that the filter leaves out in the model: a link and its parent, even if that is fixed now.

    Args:
        model: the model.
        dofs: those that the arm moves.
        carried: ids of a body with a free joint that is carried, and of those that hang from it.

    Returns:
        The copy, and the offset -inf (`contacts.ContactOffsets`) of the pairs.
    """
    group = moved_together(model, dofs)
    group[list(carried)] = carried[0] if len(carried) else 0
    result, weld = copy.deepcopy(model), model.body_weldid
    # Mocap bodies stand still, and can be moved as other bodies without joints are.
    result.body_mocapid[:] = -1
    result.body_weldid[:] = np.where(group == 0, 0, weld)
    result.body_weldid[list(carried)] = carried[0] if len(carried) else 0
    bodies, solid = model.geom_bodyid, colliding_geoms(model)
    explicit = {*zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)}
    left_out: dict[tuple[int, int], float] = {}
    for body in np.unique(group[group > 0]).tolist():
        parts = np.flatnonzero(solid & (group[bodies] == body)).tolist()
        left_out |= {(a, b): -np.inf for a, b in combinations(parts, 2) if weld[bodies[a]] != weld[bodies[b]]}
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        return result, left_out
    for root in np.unique(weld[(group > 0)]).tolist():
        above = weld[model.body_parentid[root]]
        if above and group[above] == 0:
            mine, parents = (np.flatnonzero(solid & (weld[bodies] == part)).tolist() for part in (root, above))
            left_out |= {pair: -np.inf for pair in product(mine, parents) if not explicit & {pair, pair[::-1]}}
    return result, left_out
