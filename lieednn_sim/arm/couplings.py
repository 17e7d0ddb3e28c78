"""Joints that follow others by MuJoCo's joint equalities: qpos = ratio * (qpos of the leader) + shift."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError

# Leader, ratio, shift [rad, m].
Line = tuple[int, float, float]


def line_of(model: mujoco.MjModel, equality: int) -> Line | None:
    """The line of an equality between two joints; None when it is not linear, or its ratio is zero.

    MuJoCo's equality is y - y0 = a0 + a1 (x - x0) + a2 (x - x0)^2 + ..., y the first joint and x the second.
    """
    follower, leader = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    constant, ratio, *curved = map(float, model.eq_data[equality, :5])
    if any(curved) or ratio == 0.0:
        return None
    y0, x0 = (float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (follower, leader))
    return leader, ratio, y0 + constant - ratio * x0


def to_independent_leaders(direct: Mapping[int, Line], label: Callable[[int], str]) -> dict[int, Line]:
    """Resolve chains of followers: each follower's line to a leader that follows no other joint.

    Raises:
        InputError: joints follow each other in a circle; ``label`` names a joint in the message.
    """
    resolved: dict[int, Line] = {}
    for follower, (leader, ratio, shift) in direct.items():
        seen = {follower}
        while leader in direct:
            if leader in seen:
                raise InputError(f"{label(follower)} is coupled in a circle of equalities")
            seen.add(leader)
            leader, further, constant = direct[leader]
            ratio, shift = ratio * further, ratio * constant + shift
        resolved[follower] = leader, ratio, shift
    return resolved
