"""The serial chain of a foreign MJCF: its frames, and which joints are the arm."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import FREE, ancestry, joints_of
from lieednn_sim.arm.compound_joints import coefficients, driven_directly, driven_tendons
from lieednn_sim.arm.dependents import freely_moving, tied_joints
from lieednn_sim.arm.equalities import involved_joints, loop_closures
from lieednn_sim.arm.frames import Frame, body_frame, chain_joints, find_frame, joint_groups, listed
from lieednn_sim.arm.importer.report import ImportOptions
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats

_TOOL = re.compile(r"tcp|tool|(^|_)ee($|_)|end.?effector|flange|grasp|pinch|attachment", re.IGNORECASE)
_FINGER = re.compile(r"jaw|finger|fngr|claw|pincer", re.IGNORECASE)
_GRIPPER = re.compile(_FINGER.pattern + r"|grip", re.IGNORECASE)  # a body of that name may be the one it is fixed to


def choose_chain(
    model: mujoco.MjModel, qpos: Floats, options: ImportOptions, planar: Mapping[str, str], notes: list[str]
) -> dict[str, Any]:
    """The arguments of `Arm.of` that name the arm: the options, the sites of the package's arms, or the longest chain.

    A chain that is found here omits joints that closed loops move, judged at the closed configuration ``qpos``
    ``(nq,)``, and those of planar joints, whose names are the values of ``planar``. `InputError` if there is no such
    arm, or the choice is ambiguous.
    """
    named: dict[str, Any] = {what: options[what] for what in ("joints", "links", "tip", "base") if options.get(what)}
    if not named:
        sites = {model.site(i).name for i in range(model.nsite)}
        links = [*itertools.takewhile(sites.__contains__, (f"link{i}_frame" for i in itertools.count(1)))]
        named = {"links": links, "base": "base_frame"} if links and "base_frame" in sites else {}
    if "links" in named or "joints" in named:
        return named
    base, tip = named.get("base"), named.get("tip")
    inner, last = longest_chain(model, base, None if tip is None else find_frame(model, tip).body)
    behind = (joint for joint in range(model.njnt) if model.body_parentid[model.jnt_bodyid[joint]] == last)
    if hands := [model.joint(joint).name for joint in behind if is_gripper(model, joint)]:
        notes.append(f"taken for a gripper, and no part of the arm: {', '.join(hands)}; name the links to move it")
    (chain,) = joint_groups(model, (inner, body_frame(model, last)))
    way, free = {*ancestry(model, last)}, np.flatnonzero(model.jnt_type == FREE).tolist()
    idle = sorted({*range(model.njnt)} - _driven_joints(model) - {*chain, *free})
    paths = ((model.joint(k).name, {*ancestry(model, int(model.jnt_bodyid[k]))}) for k in idle)
    if left := [name for name, path in paths if path <= way or way <= path]:
        notes.append(f"without an actuator, and so no part of the arm: {', '.join(left)}; name the joints to move it")
    fixed = np.flatnonzero(model.body_weldid == model.body_weldid[last])
    names = [model.body(body).name for body in fixed if body != last]
    names += [model.site(site).name for site in np.flatnonzero(np.isin(model.site_bodyid, fixed))]
    if tip is None and (tools := [name for name in names if _TOOL.search(name)]):
        notes.append(
            f"the end effector is {body_frame(model, last).name!r}; tip={tools[0]!r} (--tip) would choose that, of the "
            f"frames named like a tool: {', '.join(tools)}"
        )
    # Where nothing moves freely, `read_view` names the equality.
    moving = [model.joint(joint).name for joint in freely_moving(model, qpos, chain) or chain]
    if held := dict.fromkeys(planar[name] for name in moving if name in planar and not planar.keys() >= {*moving}):
        moving = [name for name in moving if name not in planar]
        notes.append(
            f"planar joints, which have no ranges, are held: {', '.join(held)}; to move one, convert the file to MJCF, "
            "and give its slides ranges"
        )
    return {**named, "joints": moving}


def longest_chain(model: mujoco.MjModel, base: str | None, tip: int | None = None) -> tuple[Frame, int]:
    """Base frame and last moving body of the chain with the most driven joints, or of the chain to the body of a tip.

    A joint counts when an actuator drives it, directly or through a fixed tendon, or when an equality ties it to such a
    joint, or closes a loop with it; in a model without such actuators all joints count. A hand at the end of a path is
    cut off: the part beyond a fork if it is shorter than the part before and another branch is at least half as long,
    and a last joint that joints off the path follow, as the fingers of a gripper do, or that is named like a gripper
    (`is_gripper`). `InputError` if there is no such joint, or several chains are equally long.
    """
    driven = _driven_joints(model)
    start = None if base is None else find_frame(model, base)
    weight = np.array([len(driven.intersection(chain_joints(model, b))) for b in range(model.nbody)], dtype=int)
    heaviest = weight.copy()  # the most driven joints on a path outwards from a body, its own included
    for body in range(model.nbody - 1, 0, -1):
        parent = model.body_parentid[body]
        heaviest[parent] = max(heaviest[parent], weight[parent] + heaviest[body])
    tips: dict[int, int] = {}
    for outermost in np.flatnonzero(weight) if tip is None else [tip]:
        path = ancestry(model, int(outermost))
        if start is not None:
            if start.body not in path[:-1]:
                continue
            path = path[path.index(start.body) + 1 :]
        if tip is None:
            path = _without_hand(model, path, weight, heaviest)
        elif weight[path].any():
            path = path[: 1 + max(i for i, body in enumerate(path) if chain_joints(model, body))]
        if path and weight[path].any():
            tips[path[-1]] = int(weight[path].sum())
    if not tips:
        beyond = "" if base is None else f" beyond {base!r}"
        raise InputError(f"the model has no hinge, slide or ball joint{beyond} that could be an arm's")
    best = [tip for tip, count in tips.items() if count == max(tips.values())]
    if len(best) > 1:
        ends = listed([model.body(tip).name for tip in best])
        if _closed_together(model, best):
            raise InputError(
                f"the robot is parallel: loops close its {len(best)} chains, which end in {ends}, but an arm is one "
                "serial chain, with loops at its side; name the tip of one of them (tip=..., --tip), which is possible "
                "where its joints determine all others"
            )
        raise InputError(
            f"{len(best)} chains have {max(tips.values())} joints each, they end in {ends}; name the tip or links "
            "of one of them, or its base (tip=, --tip)"
        )
    path = ancestry(model, best[0])
    first = next(body for body in (path if start is None else path[path.index(start.body) + 1 :]) if weight[body])
    return start or body_frame(model, int(model.body_parentid[first])), best[0]


def _closed_together(model: mujoco.MjModel, tips: list[int]) -> bool:
    """Whether `connect` and `weld` close loops between the chains to all of some bodies."""
    paths = [{joint for body in ancestry(model, tip) for joint in joints_of(model, body)} for tip in tips]
    shared = set.intersection(*paths)
    ties, reached = [involved_joints(model, e) - shared for e in loop_closures(model)], paths[0] - shared
    while more := {joint for tie in ties if tie & reached for joint in tie} - reached:
        reached |= more
    return all(path & reached for path in paths)


def is_gripper(model: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint opens a gripper, judging by its name, its actuators' names, and its body's (a finger or jaw)."""
    on_joints = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    driving = [model.actuator(a).name for a in np.flatnonzero(on_joints & (model.actuator_trnid[:, 0] == joint))]
    body = model.body(model.jnt_bodyid[joint]).name
    return any(map(_GRIPPER.search, (model.joint(joint).name, *driving))) or bool(_FINGER.search(body))


def _driven_joints(model: mujoco.MjModel) -> set[int]:
    usable = {joint for joint in range(model.njnt) if model.jnt_type[joint] != FREE}
    driven = usable & driven_directly(model).union(*(coefficients(model, t) for t in driven_tendons(model)))
    if not driven:
        return usable
    # Actuators also act through ties and loops.
    ties = [involved_joints(model, int(equality)) & usable for equality in np.flatnonzero(model.eq_active0)]
    while more := {joint for tie in ties if driven & tie for joint in tie} - driven:
        driven |= more
    return driven


def _without_hand(
    model: mujoco.MjModel, path: list[int], weight: NDArray[np.int_], heaviest: NDArray[np.int_]
) -> list[int]:
    for i, (body, child) in enumerate(itertools.pairwise(path)):
        before, beyond = weight[path[: i + 1]].sum(), weight[path[i + 1 :]].sum()
        siblings = [b for b in np.flatnonzero(model.body_parentid == body) if b not in (child, 0)]
        rival = max((int(heaviest[sibling]) for sibling in siblings), default=0)
        if 0 < beyond < before and 2 * rival >= beyond:
            path = path[: i + 1]
            break
    ties, opened = tied_joints(model), False
    while path:
        last = joints_of(model, path[-1])
        on_path = {joint for body in path for joint in joints_of(model, body)}
        leads_others = any(leader in last and follower not in on_path for follower, leader in ties)
        # Cut off at most one by its name: the body that carries the gripper may be named after a finger that is fixed.
        gripper = not opened and weight[path[:-1]].any() and any(is_gripper(model, joint) for joint in last)
        if weight[path[-1]] and not leads_others and not gripper:
            break
        opened |= bool(gripper)
        path = path[:-1]
    return path
