"""Which joints of a compiled model form a chain, and its frames, by the names of joints, bodies and sites."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import FREE, ancestry, joints_of
from lieednn_sim.arm.frames import Frame, body_frame, find_frame, listed
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice


def named_frames(model: mujoco.MjModel, links: Sequence[str], base: str | None) -> tuple[Frame, ...]:
    """Base and link frames by name, base first; the base may be left out.

    Raises:
        InputError: a name is unknown or comes twice.
    """
    results = [find_frame(model, name) for name in links]
    inboard = results[0] if base is None else find_frame(model, base)
    if base is None:
        moved = [body for body in ancestry(model, results[0].body) if chain_joints(model, body)]
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
            if model.jnt_type[joint] == FREE:
                raise InputError(
                    f"joint {model.joint(joint).name!r} between {inner.name!r} and {outer.name!r} is free; "
                    f"choose a base beyond it, such as {model.body(model.jnt_bodyid[joint]).name!r}"
                )
        groups.append(tuple(group))
    return tuple(groups)


def chosen_joints(model: mujoco.MjModel, joints: Sequence[str]) -> list[int]:
    """Ids of the named hinges, slides and ball joints; `InputError` where a name is unknown or comes twice."""
    known = {model.joint(joint).name: joint for joint in range(model.njnt) if model.jnt_type[joint] != FREE}
    chosen = [known[as_choice("joint of the arm", name, known)] for name in joints]
    if len(set(chosen)) < len(chosen):
        raise InputError(f"joints must differ, got {listed(joints)}")
    return chosen


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


def chain_joints(model: mujoco.MjModel, body: int) -> list[int]:
    """The hinges, slides and ball joints of a body."""
    return [joint for joint in joints_of(model, body) if model.jnt_type[joint] != FREE]
