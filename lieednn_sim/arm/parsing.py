"""Reads the fields of an `Arm` from a compiled model: frames, compound joints, coordinates and limits."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from lieednn_sim._mujoco import kinematics_at, mujoco, scratch_data
from lieednn_sim.arm.checks import check_numbers, joint_kind, joint_label
from lieednn_sim.arm.compound_joints import Couplings
from lieednn_sim.arm.coordinates import Coordinates, Line
from lieednn_sim.arm.dependents import Dependents, independent_joints
from lieednn_sim.arm.equalities import joint_range
from lieednn_sim.arm.forces import DRIVABLE, actuator_moments, drivable, driving, force_ranges, tangent_basis
from lieednn_sim.arm.frames import BodyFrames, Frame, joint_groups, site_frame
from lieednn_sim.arm.joint_ranges import narrow_to_servos
from lieednn_sim.arm.kinematics import CompoundJoint, CompoundJoints, Factor, least_singular_value
from lieednn_sim.arm.limits import RATES, read_numeric
from lieednn_sim.arm.surroundings import home_data
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform


@dataclass(frozen=True, eq=False)
class Chain:
    """Link frames and the joints between them."""

    frames: tuple[Frame, ...]  # N + 1, that of the base first
    groups: tuple[tuple[int, ...], ...]  # N tuples of joints, each from the base outwards


def read_arm(
    model: mujoco.MjModel,
    arm: str,
    chain: Chain | None = None,
    *,
    rest: Floats | None = None,
    couplings: Couplings | None = None,
    ranges: Mapping[int, Floats] | None = None,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """The fields of an `Arm` that its model determines; ``arm`` is its name, for messages.

    Without a chain, the one of the sites base_frame, link1_frame, ... is read, with the model's ranges and equalities.
    `InputError` if the model is not an arm.

    Args:
        rest: ``(nq,)``, at which the other joints stay; by default the keyframe ``home``.
        couplings: how joints, of the chain or others, follow joints of the chain.
        ranges: the range ``(2,)`` of each joint of a chain.
        notes: which of the ranges were made or narrowed.
    """
    check_numbers(model)
    # MuJoCo would silently integrate split steps, as of controllers, by Euler's method.
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        raise InputError(
            f"arm {arm!r} asks for the integrator RK4, which can neither be stepped in halves nor inverted; set "
            'its <option integrator="..."> to implicitfast, implicit or Euler'
        )
    viewed = chain is not None
    chain = read_chain(model, arm) if chain is None else chain
    group = [joint for group in chain.groups for joint in group]
    if ranges is None:
        if bare := [joint for joint in group if not model.jnt_limited[joint]]:
            raise InputError(f"{joint_label(model, arm, bare[0])} has no position limits; give it a range")
        ranges = {joint: joint_range(model, joint) for joint in group}
    couplings = Couplings(_leaders(model, arm, group)) if couplings is None else couplings
    rest, said = home_data(model).qpos if rest is None else rest, list(notes)
    space = read_coordinates(model, chain, rest, couplings)
    limits = narrow_to_servos(model, rest, space, read_position_limits(model, chain, space, ranges), said)
    moving = driving(actuator_moments(model), tangent_basis(space))
    if unknown := [model.actuator(a).name or f"number {a}" for a in np.flatnonzero(moving & ~drivable(model)).tolist()]:
        said.append(f"no controller can drive {', '.join(unknown)}: they need {DRIVABLE}")
    joints, base, mounts, tips = read_joints(model, arm, chain, space, ranges)
    weakest, strongest = force_ranges(model, tangent_basis(space)).T
    unlimited = np.full(len(space), np.inf)
    return {
        "space": space,
        "joints": joints,
        "base": base,
        "mounts": mounts,
        "tips": tips,
        "position_limits": limits,
        "notes": tuple(said),
        **{f"{rate}_limits": read_numeric(model, arm, f"{rate}_limit", unlimited, viewed) for rate in RATES},
        "force_limits": np.minimum(-weakest, strongest),  # the force that is available in both directions
        "length_scale": float(read_numeric(model, arm, "length_scale", np.ones(1), viewed)[0]),
        "frames": BodyFrames.of(chain.frames[1:]),
    }


def read_chain(model: mujoco.MjModel, arm: str) -> Chain:
    """Follow the sites base_frame, link1_frame, link2_frame, ...; `InputError` when they do not form a chain."""
    names = ["base_frame", *(f"link{i}_frame" for i in range(1, model.nsite + 1))]
    sites = (mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) for name in names)
    frames = tuple(site_frame(model, site) for site in itertools.takewhile(lambda site: site >= 0, sites))
    if len(frames) < 2:
        raise InputError(f"arm {arm!r} has no sites base_frame, link1_frame, link2_frame, ... at its link frames")
    return Chain(frames, joint_groups(model, frames))


def read_coordinates(model: mujoco.MjModel, chain: Chain, rest: Floats, couplings: Couplings) -> Coordinates:
    """Coordinates of the chain's joints in qpos order; others than these and their followers stay at ``rest``."""
    led = couplings.lines.keys() | couplings.sums.keys()
    joints = sorted({joint for group in chain.groups for joint in group} | led)
    names: list[str] = []
    units: list[str] = []
    index: dict[int, NDArray[np.int_]] = {}
    for joint in (joint for joint in joints if joint not in led):
        name, ball = model.joint(joint).name, joint_kind(model, joint) == "ball"
        index[joint] = len(names) + np.arange(3 if ball else 1)
        names += [f"{name}_{axis}" for axis in "xyz"] if ball else [name]
        units += ["m"] if joint_kind(model, joint) == "slide" else ["rad"] * len(index[joint])
    coupling, rates, offset = np.zeros((model.nq, len(names))), np.zeros((model.nv, len(names))), rest.copy()
    for joint in joints:
        address = model.jnt_qposadr[joint]
        if joint_kind(model, joint) == "ball":
            offset[address : address + 4] = 0.0
            continue
        for leader, ratio in couplings.ratios(joint).items():
            coupling[address, index[leader]] = rates[model.jnt_dofadr[joint], index[leader]] = ratio
        offset[address] = couplings.sums[joint][1] if joint in couplings.sums else couplings.line(joint)[2]
    scalars = [joint for joint in index if joint_kind(model, joint) != "ball"]
    balls = [joint for joint in index if joint_kind(model, joint) == "ball"]
    return Coordinates(
        names=tuple(names),
        units=tuple(units),
        coupling=coupling,
        rates=rates,
        offset=offset,
        scalars=np.array([index[joint][0] for joint in scalars], dtype=int),
        scalar_addresses=model.jnt_qposadr[scalars].astype(int),
        scalar_rate_addresses=model.jnt_dofadr[scalars].astype(int),
        balls=np.array([index[joint] for joint in balls], dtype=int).reshape(-1, 3),
        ball_addresses=model.jnt_qposadr[balls][:, None] + np.arange(4),
        ball_rate_addresses=model.jnt_dofadr[balls][:, None] + np.arange(3),
    )


def read_joints(
    model: mujoco.MjModel, arm: str, chain: Chain, coordinates: Coordinates, ranges: Mapping[int, Floats]
) -> tuple[CompoundJoints, RigidTransform, RigidTransform, RigidTransform]:
    """Compound joints, and the fixed poses base, mounts and tips around them, at the model's reference position."""
    reference = coordinates.from_qpos(model.qpos0)
    data = kinematics_at(model, coordinates.to_qpos(reference), scratch_data(model))
    places, turns = BodyFrames.of(chain.frames).poses(data.xpos, data.xmat)
    oriented, posed = scipy.spatial.transform.Rotation.from_matrix, scipy.spatial.transform.RigidTransform
    world = posed.from_components(places, oriented(turns))
    # The joint frame sits on the last axis that turns and takes the axes of the first moving body.
    last = [sorted(group, key=lambda joint: joint_kind(model, joint) != "slide")[-1] for group in chain.groups]
    turned = oriented(data.xmat[model.jnt_bodyid[[group[0] for group in chain.groups]]].reshape(-1, 3, 3))
    frames = posed.from_components(data.xanchor[last], turned)
    inside = frames.inv()
    factors = _factors(model, data, chain, inside, coordinates)
    joints = [CompoundJoint(tuple(factor for joint in group for factor in factors[joint])) for group in chain.groups]
    for i, (compound, group) in enumerate(zip(joints, chain.groups, strict=True), start=1):
        shared = any(np.isin(compound.indices, other.indices).any() for other in joints if other is not compound)
        if compound.screw is None or shared:
            for joint in group:
                _check_turn(model, arm, joint, ranges[joint])
        if not shared:
            _check_independent(compound, len(coordinates), f"link {i} of arm {arm!r}")
    around = (posed.from_matrix(poses.as_matrix()) for poses in (world[:-1].inv() * frames, inside * world[1:]))
    return CompoundJoints(tuple(joints), reference), world[0], *around


def read_position_limits(
    model: mujoco.MjModel, chain: Chain, coordinates: Coordinates, ranges: Mapping[int, Floats]
) -> Floats:
    """Limits ``(n, 2)``: the strictest of the joints that it alone moves; for a ball joint, its largest angle."""
    limits = np.tile([-np.inf, np.inf], (len(coordinates), 1))
    for joint in (joint for group in chain.groups for joint in group):
        address, span = model.jnt_qposadr[joint], ranges[joint]
        moving = np.flatnonzero(coordinates.coupling[address])
        if joint_kind(model, joint) == "ball":
            limits[coordinates.ball(address)] = [-span[1], span[1]]
        elif len(moving) == 1:
            (k,) = moving
            low, high = np.sort((span - coordinates.offset[address]) / coordinates.coupling[address, k])
            limits[k] = max(limits[k, 0], low), min(limits[k, 1], high)
    return limits


def _leaders(model: mujoco.MjModel, arm: str, joints: list[int]) -> dict[int, Line]:
    """For each joint of a chain that follows another one its leader and the line qpos = ratio * qpos_leader + shift."""
    independent = independent_joints(model, joints)
    dependents = Dependents(model, mujoco.MjData(model), independent)
    for joint in {*joints, *dependents.moved}.difference(independent):
        if joint not in joints or joint not in dependents.lines:
            raise InputError(
                f"{joint_label(model, arm, joint)} is tied by an equality that the arm cannot follow; the arm "
                "needs polycoef 'a0 a1 0 0 0' with a1 other than 0, between two joints of its chain"
            )
    return {joint: line for joint, line in dependents.lines.items() if joint in joints}


def _factors(
    model: mujoco.MjModel, data: mujoco.MjData, chain: Chain, inside: RigidTransform, coordinates: Coordinates
) -> dict[int, list[Factor]]:
    """Each joint as factors, one for each coordinate, whose motions commute; inverses of the N joint frames given."""
    joints = [joint for group in chain.groups for joint in group]
    local = inside[np.repeat(np.arange(len(chain.groups)), [*map(len, chain.groups)])]
    anchors, axes = local.apply(data.xanchor[joints]), local.rotation.apply(data.xaxis[joints])
    bodies = scipy.spatial.transform.Rotation.from_matrix(data.xmat[model.jnt_bodyid[joints]].reshape(-1, 3, 3))
    turned = (local.rotation * bodies).as_matrix()
    result: dict[int, list[Factor]] = {}
    for joint, anchor, axis, frame in zip(joints, anchors, axes, turned, strict=True):
        kind, ratios = joint_kind(model, joint), coordinates.coupling[model.jnt_qposadr[joint]]
        alone = [(np.array([k]), float(ratios[k])) for k in np.flatnonzero(ratios)]
        if kind == "ball":
            axis, alone = frame, [(coordinates.ball(model.jnt_qposadr[joint]), 1.0)]
        result[joint] = [Factor(kind, axis.reshape(3, -1), anchor, *where) for where in alone]
    return result


def _check_turn(model: mujoco.MjModel, arm: str, joint: int, span: Floats) -> None:
    """Raise `InputError` for a joint whose range ``span`` ``(2,)`` is too wide to be encoded by a logarithm."""
    label, kind = joint_label(model, arm, joint), joint_kind(model, joint)
    if kind == "slide":
        return
    reference = 0.0 if kind == "ball" else model.qpos0[model.jnt_qposadr[joint]]
    most = np.abs(span - reference).max()
    if most >= np.pi:
        raise InputError(
            f"{label} may turn by {most:.3g} rad from its reference; the logarithm needs less than pi where other "
            "joints move the same link"
        )


def _check_independent(joint: CompoundJoint, size: int, link: str) -> None:
    """Raise `InputError` for a compound joint whose pose determines its coordinates at none of a few configurations."""
    # They are tested at random configurations, and dependent where the singular value is below the last number.
    count, configurations, dependent = len(joint.indices), 8, 1e-6
    if count > 6:
        raise InputError(f"{link} is moved by {count} coordinates, but a pose determines six; name more links")
    frames, _ = joint.pose_and_slopes(np.random.default_rng(0).uniform(-1.0, 1.0, (configurations, size)))
    columns = np.swapaxes(joint.selection(joint.indices) @ frames[:, 1:].reshape(configurations, -1, 12), -1, -2)
    if least_singular_value(columns, dependent).max() < dependent:
        raise InputError(
            f"{link} is moved by {count} coordinates that are not independent; name more links to separate them"
        )
