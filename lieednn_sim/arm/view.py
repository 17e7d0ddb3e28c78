"""Some joints of a compiled model, read as an arm; everything else in the model is its surroundings."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.checks import check_numbers
from lieednn_sim.arm.contacts import colliding_geoms
from lieednn_sim.arm.coordinates import Coordinates
from lieednn_sim.arm.forces import tangent_basis
from lieednn_sim.arm.frames import body_frame
from lieednn_sim.arm.importer.compound_joints import cut
from lieednn_sim.arm.importer.coupled_joints import find_couplings
from lieednn_sim.arm.importer.limits import check_rates, spare_acceleration
from lieednn_sim.arm.importer.mechanism import joint_ranges, tip_frame
from lieednn_sim.arm.importer.serial_chain import named_chain
from lieednn_sim.arm.parsing import Chain, read_arm
from lieednn_sim.errors import InputError
from lieednn_sim.lie import log
from lieednn_sim.validation import as_choice
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
    qpos: Floats,
    joints: Sequence[str],
    tip: str | None,
    base: str | None,
    limits: Mapping[str, Mapping[str, float]] | None,
) -> dict[str, Any]:
    """The fields of an `Arm` that some joints of a model determine; the others stay at ``qpos`` ``(nq,)``.

    Raises:
        InputError: the joints are not an arm's, or a name is unknown.
    """
    if not joints:
        raise InputError("joints must name at least one joint")
    check_rates(limits)
    check_numbers(own)
    notes: list[str] = []
    inner, joints_of_chain = named_chain(own, joints, base)
    couplings = find_couplings(own, joints_of_chain)
    whole = joint_ranges(own, [[joint] for joint in joints_of_chain], couplings, [], qpos)
    groups = cut(own, kinematics_at(own, qpos), joints_of_chain, whole, couplings)
    last = body_frame(own, int(own.jnt_bodyid[groups[-1][-1]]))
    ends = [body_frame(own, int(own.jnt_bodyid[group[-1]])) for group in groups[:-1]]
    chain = Chain((inner, *ends, last if tip is None else tip_frame(own, tip, last)), groups)
    ranges = joint_ranges(own, groups, couplings, notes, qpos)
    fields = read_arm(own, "arm", chain, rest=qpos, lines=couplings.lines, ranges=ranges)
    space: Coordinates = fields["space"]
    fields["acceleration_limits"] = _acceleration_limits(own, fields)
    for coordinate, given in (limits or {}).items():
        index = space.names.index(as_choice("coordinate", coordinate, space.names))
        for what, value in given.items():
            fields[f"{what}_limits"][index] = value
    if fields["length_scale"] == 1.0:
        fields["length_scale"] = _length_scale(fields)
    return fields


def _samples(fields: Mapping[str, Any], count: int) -> Floats:
    """Random configurations ``(count, nq)`` within the limits."""
    low, high = fields["position_limits"].T
    shrink = 0.57 if len(fields["space"].balls) else 1.0  # half of a ball joint's box is inside of its largest angle
    q = np.random.default_rng(0).uniform(shrink * low, shrink * high, (count, len(low)))
    return np.asarray(fields["space"].to_qpos(q))


def _acceleration_limits(model: mujoco.MjModel, fields: Mapping[str, Any]) -> Floats:
    """The model's limits ``(n,)``, or where it has none those that its actuators' forces leave."""
    given, force = fields["acceleration_limits"], fields["force_limits"]
    if np.isfinite(given).all() or not np.isfinite(force).any():
        return np.array(given)
    spare = spare_acceleration(model, _samples(fields, 16), tangent_basis(fields["space"]), force)
    return np.where(np.isfinite(given), given, spare)


def _length_scale(fields: Mapping[str, Any]) -> float:
    """The furthest that a link moves [m], to two digits, if that is more than a metre; else 1."""
    space: Coordinates = fields["space"]
    q = space.from_qpos(_samples(fields, 64))
    largest = float(np.abs(log(fields["joints"].poses(q))[..., 3:]).max())
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
