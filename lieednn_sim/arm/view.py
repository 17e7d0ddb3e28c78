"""Some joints of a compiled model, read as an arm; everything else in the model is its surroundings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco, scratch_data
from lieednn_sim.arm.checks import FREE, ancestry, check_numbers, joints_of
from lieednn_sim.arm.compound_joints import Couplings, along_tendons, cut
from lieednn_sim.arm.contacts import without_clearance
from lieednn_sim.arm.coordinates import Coordinates
from lieednn_sim.arm.dependents import Dependents, independent_joints
from lieednn_sim.arm.equalities import dof_addresses, involved_joints, names
from lieednn_sim.arm.forces import tangent_basis
from lieednn_sim.arm.frames import Frame, body_frame, chosen_joints, find_frame, joint_groups, named_frames
from lieednn_sim.arm.joint_ranges import drop_endless_ranges, joint_ranges
from lieednn_sim.arm.limits import Stops, check_rates, spare_acceleration
from lieednn_sim.arm.parsing import Chain, read_arm
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.errors import InputError
from lieednn_sim.lie import log
from lieednn_sim.validation import as_choice, quoted
from lieednn_sim.values import Floats


@dataclass(frozen=True, eq=False)
class View:
    """Some joints of a model as an arm, as `read_view` finds them."""

    fields: dict[str, Any]  # those of an `Arm` that some joints of a model determine
    held: str | None  # name of a free body that the end effector holds by an active weld, if any
    chain: Chain
    couplings: Couplings


def read_view(
    own: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    joints: Sequence[str] | None = None,
    links: Sequence[str] | None = None,
    tip: str | None = None,
    base: str | None = None,
    limits: Mapping[str, Mapping[str, float]] | None = None,
    name: str = "arm",
) -> View:
    """Read some joints of a model as an arm, by their names or those of their links.

    Arguments and errors are as for `Arm.of`; ``name`` is the arm's name in messages.
    """
    if (joints is None) == (links is None) or (links is not None and tip is not None):
        raise InputError(
            "name the arm's joints (joints=[...]), and its tip if you like, or its links (links=[...]), not both"
        )
    if not (joints if links is None else links):
        raise InputError("joints must name at least one joint, or links at least one body or site")
    check_rates(limits)
    check_numbers(own)
    notes: list[str] = []
    drop_endless_ranges(own, notes)
    notes += filter(None, [without_clearance(own)])
    frames = () if links is None else named_frames(own, links, base)
    groups = joint_groups(own, frames) if frames else ()
    chosen = chosen_joints(own, joints) if joints is not None else [joint for group in groups for joint in group]
    independent = independent_joints(own, chosen)
    dependents = Dependents(own, data, independent)
    qpos = dependents.to_qpos(data.qpos)
    if frames:
        (inner, *_, end), path, joints_of_chain = frames, ancestry(own, frames[-1].body), tuple(chosen)
    else:
        inner, path, joints_of_chain = _chain(own, dependents, qpos, chosen, tip, base)
        last = body_frame(own, path[-1])
        end = last if tip is None else find_frame(own, tip)
        if last.body not in ancestry(own, end.body):
            raise InputError(f"the tip {tip!r} is not carried by the last link, {last.name!r}")
    held, weld = _welded(own, dependents, end.body)
    if held is not None:
        # The body is carried as a rigid part of the hand, without solving the weld.
        state = mujoco.MjData(own)
        mujoco.mj_copyData(state, own, data)
        state.eq_active[weld] = 0
        dependents = Dependents(own, state, independent)
    on_way = {joint for body in (*path, *ancestry(own, end.body)) for joint in joints_of(own, body)}
    for joint in sorted(on_way.intersection(dependents.moved).difference(joints_of_chain)):
        raise InputError(
            f"joint {names(own, [joint])}, on the way to the end effector, is moved by "
            f"{names(own, dependents.independent)} through a closed loop or a curve; joints of a chain may only "
            "follow others in a straight line, so choose joints and a tip before it"
        )
    couplings = along_tendons(own, joints_of_chain, Couplings(dependents.lines, sums=dependents.sums))
    within = dict(zip(own.dof_jntid[dependents.dofs].tolist(), dependents.follower_limits(), strict=True))
    if not frames:
        whole = joint_ranges(own, [[joint] for joint in joints_of_chain], couplings, [], qpos, within)
        groups = cut(own, kinematics_at(own, qpos, scratch_data(own)), joints_of_chain, whole, couplings)
        ends = [body_frame(own, int(own.jnt_bodyid[group[-1]])) for group in groups[:-1]]
        frames = (inner, *ends, end)
    _check_links(own, groups, couplings)
    ranges = joint_ranges(own, groups, couplings, notes, qpos, within)
    chain = Chain(tuple(frames), groups)
    fields = read_arm(own, name, chain, rest=qpos, couplings=couplings, ranges=ranges, notes=notes)
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
        # The furthest that a link moves [m], to two digits, if that is more than a metre.
        furthest = float(np.abs(log(fields["joints"].poses(_samples(fields, 64)))[..., 3:]).max())
        fields["length_scale"] = max(1.0, float(f"{furthest:.2g}"))
    return View(fields, held, chain, couplings)


def _chain(
    model: mujoco.MjModel, dependents: Dependents, qpos: Floats, chosen: list[int], tip: str | None, base: str | None
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
                f"moves {names(model, moved)} there, so name that in its place: coordinates are joints of the chain, "
                "but targets may be given by others, see `coordinates_at`"
            )
    for joint in chosen:
        if paths[joint] != longest[: len(paths[joint])]:
            raise InputError(
                f"joint {model.joint(joint).name!r} is not on the way to body {model.body(longest[-1]).name!r}: an arm "
                "is one chain; leave out the joints of its hand"
            )
    # The last stages of a telescope may follow the named one.
    path = max((paths[joint] for joint in paths if paths[joint][: len(longest)] == longest), key=len)
    arm = {*dependents.independent, *dependents.lines, *dependents.sums}
    chain = tuple(joint for body in path for joint in joints_of(model, body) if joint in arm)
    first = int(model.jnt_bodyid[chain[0]])
    if base is None:
        return body_frame(model, int(model.body_parentid[first])), path, chain
    start = find_frame(model, base)
    if start.body not in path or path.index(start.body) >= path.index(first):
        raise InputError(f"joint {model.joint(chain[0]).name!r} does not move against the base {base!r}")
    return start, path, chain


def _check_links(model: mujoco.MjModel, groups: Sequence[Sequence[int]], couplings: Couplings) -> None:
    """Raise `InputError` if joints that follow a single other one move a different link than it does."""
    link = {joint: i for i, group in enumerate(groups, start=1) for joint in group}
    for follower, (leader, _, _) in couplings.lines.items():
        if link.get(follower, link.get(leader)) != link.get(leader):
            raise InputError(
                f"joint {model.joint(follower).name!r} moves link {link[follower]} and follows joint "
                f"{model.joint(leader).name!r}, which moves link {link[leader]}; "
                "choose links so that coupled joints move the same link"
            )


def _welded(model: mujoco.MjModel, dependents: Dependents, end: int) -> tuple[str | None, int]:
    """The name of a free body that one weld alone ties, to the end effector's link, and the weld's id."""
    group = moved_together(model, dof_addresses(model, [*dependents.independent, *dependents.moved]))
    active = np.flatnonzero(model.eq_active0).tolist()
    for weld in [equality for equality in active if model.eq_type[equality] == int(mujoco.mjtEq.mjEQ_WELD)]:
        pair = [int(model.eq_obj1id[weld]), int(model.eq_obj2id[weld])]
        if model.eq_objtype[weld] == int(mujoco.mjtObj.mjOBJ_SITE):
            pair = [int(model.site_bodyid[site]) for site in pair]
        for body, hand in (pair, pair[::-1]):
            joint = int(model.body_jntadr[body])
            ties = [equality for equality in active if joint in involved_joints(model, equality)]
            if ties == [weld] and model.jnt_type[joint] == FREE and model.body(body).name and group[hand] == group[end]:
                return model.body(body).name, weld
    return None, -1


def _samples(fields: Mapping[str, Any], count: int) -> Floats:
    """Random configurations ``(count, n)`` within the limits."""
    low, high = fields["position_limits"].T
    shrink = 0.57 if len(fields["space"].balls) else 1.0  # puts half of a ball joint's box inside of its largest angle
    return np.random.default_rng(0).uniform(shrink * low, shrink * high, (count, len(low)))


def _acceleration_limits(model: mujoco.MjModel, fields: Mapping[str, Any]) -> Floats:
    """The model's limits ``(n,)``; where it has none, those that its actuators' forces allow."""
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
    return np.where(np.isfinite(given), given, spare_acceleration(model, configurations, rates, force))
