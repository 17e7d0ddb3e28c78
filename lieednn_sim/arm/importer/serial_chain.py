"""The serial chain of a foreign MJCF: its frames, and which joints are the arm."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import ancestry, joints_of
from lieednn_sim.arm.frames import Frame, body_frame, find_frame, listed
from lieednn_sim.arm.importer.coupled_joints import driven_directly, driven_tendons, tendon_joints, tied_joints
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_FINGER = re.compile(r"jaw|finger|fngr|claw|pincer", re.IGNORECASE)
_GRIPPER = re.compile(_FINGER.pattern + r"|grip", re.IGNORECASE)  # a body of that name may be the one it is fixed to


def named_frames(model: mujoco.MjModel, links: Sequence[str], base: str | None) -> tuple[Frame, ...]:
    """Base and link frames by name, base first; the base may be left out.

    Raises:
        InputError: a name is unknown or comes twice.
    """
    results = [find_frame(model, name) for name in links]
    inboard = results[0] if base is None else find_frame(model, base)
    if base is None:
        moved = [body for body in ancestry(model, results[0].body) if _chain_joints(model, body)]
        if not moved:
            raise InputError(f"no hinge, slide or ball joint moves {links[0]!r}; name a link that moves")
        inboard = body_frame(model, int(model.body_parentid[moved[0]]))
    frames = (inboard, *results)
    for first, second in itertools.combinations(frames, 2):
        same = np.allclose(first.pos, second.pos, atol=1e-12) and abs(first.quat @ second.quat) > 1.0 - 1e-12
        if first.body == second.body and same:
            raise InputError(f"{first.name!r} and {second.name!r} are the same frame; every link needs its own")
    return frames


def joint_groups(model: mujoco.MjModel, frames: Sequence[Frame]) -> tuple[tuple[int, ...], ...]:
    """The joints between consecutive frames, each group from the base outwards.

    Raises:
        InputError: the frames are not on one chain, there is no joint between two of them, or a joint is free.
    """
    groups = []
    for inner, outer in itertools.pairwise(frames):
        path = ancestry(model, outer.body)
        if inner.body not in path:
            raise InputError(
                f"{outer.name!r} does not descend from {inner.name!r}; "
                f"name links along one chain, from the base outwards"
            )
        group = [joint for body in path[path.index(inner.body) + 1 :] for joint in joints_of(model, body)]
        if not group:
            raise InputError(f"no joint is between {inner.name!r} and {outer.name!r}; leave one of them out")
        for joint in group:
            if model.jnt_type[joint] == _FREE:
                raise InputError(
                    f"joint {model.joint(joint).name!r} between {inner.name!r} and {outer.name!r} is free; "
                    f"choose a base beyond it, such as {model.body(model.jnt_bodyid[joint]).name!r}"
                )
        groups.append(tuple(group))
    return tuple(groups)


def chosen_joints(model: mujoco.MjModel, joints: Sequence[str]) -> list[int]:
    """Ids of the named hinges, slides and ball joints; `InputError` where a name is unknown or comes twice."""
    known = {model.joint(joint).name: joint for joint in range(model.njnt) if model.jnt_type[joint] != _FREE}
    chosen = [known[as_choice("joint of the arm", name, known)] for name in joints]
    if len(set(chosen)) < len(chosen):
        raise InputError(f"joints must differ, got {listed(joints)}")
    return chosen


def named_chain(model: mujoco.MjModel, joints: Sequence[str], base: str | None) -> tuple[Frame, tuple[int, ...]]:
    """Base frame and joints of the chain that named joints form, from the base outwards, with the joints tied to them.

    Raises:
        InputError: a name is unknown, comes twice, or is a free joint's; the joints are not on one chain; or they are
            not beyond the base.
    """
    chosen = chosen_joints(model, joints)
    tied, ties = set[int](), tied_joints(model)
    while more := {joint for pair in ties if tied.union(chosen).intersection(pair) for joint in pair} - {
        *tied,
        *chosen,
    }:
        tied |= more
    paths = {joint: ancestry(model, int(model.jnt_bodyid[joint])) for joint in (*chosen, *tied)}
    path = common_path(model, chosen)
    # A telescope's last stages may follow the one that is named.
    path = max((other for other in paths.values() if other[: len(path)] == path), key=len)
    arm = {joint for joint, other in paths.items() if other == path[: len(other)]}
    chain = tuple(joint for body in path for joint in joints_of(model, body) if joint in arm)
    return chain_base(model, path, chain, base), chain


def common_path(model: mujoco.MjModel, joints: Sequence[int]) -> list[int]:
    """The bodies from the world to the one that all of some joints move; `InputError` where they are on branches."""
    paths = {joint: ancestry(model, int(model.jnt_bodyid[joint])) for joint in joints}
    path = max(paths.values(), key=len)
    for joint in joints:
        if paths[joint] != path[: len(paths[joint])]:
            raise InputError(
                f"joint {model.joint(joint).name!r} is not on the way to body {model.body(path[-1]).name!r}: an arm is "
                "one chain; leave out the joints of its hand"
            )
    return path


def chain_base(model: mujoco.MjModel, path: Sequence[int], chain: Sequence[int], base: str | None) -> Frame:
    """The frame of the base that is named, or that a chain's first joint moves its body against."""
    if base is None:
        return body_frame(model, int(model.body_parentid[model.jnt_bodyid[chain[0]]]))
    start = find_frame(model, base)
    if start.body not in path or path.index(start.body) >= path.index(int(model.jnt_bodyid[chain[0]])):
        raise InputError(f"joint {model.joint(chain[0]).name!r} does not move against the base {base!r}")
    return start


def longest_chain(model: mujoco.MjModel, base: str | None) -> tuple[Frame, int]:
    """Base frame and last moving body of the chain with the most driven joints.

    A joint counts when an actuator drives it, directly or through a fixed tendon, or when an equality ties it to such a
    joint; in a model without such actuators all joints count. A hand at the end of a path is cut off: what lies beyond
    a fork when it is shorter than what lies before it and another branch is at least half as long, and a last joint
    that joints off the path follow, as the fingers of a gripper do, or that is named like a gripper (`is_gripper`).

    Raises:
        InputError: there is no such joint, or several chains are equally long.
    """
    driven = _driven_joints(model)
    start = None if base is None else find_frame(model, base)
    weight = np.array([len(driven.intersection(_chain_joints(model, b))) for b in range(model.nbody)], dtype=int)
    heaviest = weight.copy()  # the most driven joints on a path outwards from a body, its own included
    for body in range(model.nbody - 1, 0, -1):
        parent = model.body_parentid[body]
        heaviest[parent] = max(heaviest[parent], weight[parent] + heaviest[body])
    tips: dict[int, int] = {}
    for outermost in np.flatnonzero(weight):
        path = ancestry(model, int(outermost))
        if start is not None:
            if start.body not in path[:-1]:
                continue
            path = path[path.index(start.body) + 1 :]
        path = _without_hand(model, path, weight, heaviest)
        if path:
            tips[path[-1]] = int(weight[path].sum())
    if not tips:
        beyond = "" if base is None else f" beyond {base!r}"
        raise InputError(f"the model has no hinge, slide or ball joint{beyond} that could be an arm's")
    best = [tip for tip, count in tips.items() if count == max(tips.values())]
    if len(best) > 1:
        raise InputError(
            f"{len(best)} chains have {max(tips.values())} joints each, they end in "
            f"{listed([model.body(tip).name for tip in best])}; name the links of one of them, or its base"
        )
    path = ancestry(model, best[0])
    first = next(body for body in (path if start is None else path[path.index(start.body) + 1 :]) if weight[body])
    return start or body_frame(model, int(model.body_parentid[first])), best[0]


def is_gripper(model: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint opens a gripper, judging by its name, its actuators' names, and its body's (a finger or jaw)."""
    driving = [
        model.actuator(a).name
        for a in range(model.nu)
        if model.actuator_trntype[a] == int(mujoco.mjtTrn.mjTRN_JOINT) and model.actuator_trnid[a, 0] == joint
    ]
    body = model.body(model.jnt_bodyid[joint]).name
    return any(map(_GRIPPER.search, (model.joint(joint).name, *driving))) or bool(_FINGER.search(body))


def _driven_joints(model: mujoco.MjModel) -> set[int]:
    usable = {joint for joint in range(model.njnt) if model.jnt_type[joint] != _FREE}
    driven = usable & driven_directly(model).union(*(tendon_joints(model, t) for t in driven_tendons(model)))
    if not driven:
        return usable
    ties = tied_joints(model)
    while more := {joint for pair in ties if driven.intersection(pair) for joint in pair} - driven:
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
        # At most one: the body that carries it may be named after a finger that does not move.
        gripper = not opened and weight[path[:-1]].any() and any(is_gripper(model, joint) for joint in last)
        if weight[path[-1]] and not leads_others and not gripper:
            break
        opened |= bool(gripper)
        path = path[:-1]
    return path


def _chain_joints(model: mujoco.MjModel, body: int) -> list[int]:
    return [joint for joint in joints_of(model, body) if model.jnt_type[joint] != _FREE]
