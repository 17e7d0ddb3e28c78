"""Random joint targets for a scene: free of contact and, if it has goals, behind, in or between its obstacles."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.scenes import GOAL_PREFIX
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.typecheck import typecheck_public
from lieednn_sim.validation import Seed, as_seed
from lieednn_sim.values import Floats

__all__ = ["draw_target"]

# Distances that the arm keeps from obstacles, and its parts from each other, at a target [m].
TARGET_CLEARANCE, OWN_CLEARANCE = 0.02, 0.0025
LIMIT_MARGIN = 0.05  # fraction of a joint's range that targets keep away from its limits
NETWORK_SPREAD = 0.8  # U(-0.8, 0.8) in the network's coordinates, where joints have six dofs (paper, section 5)
_ATTEMPTS = 400


def draw_target(arm: Arm, seed: Seed = 0) -> Floats:
    """Draw a random joint target ``(n,)`` at which everything keeps the arm's clearance.

    Without obstacles: uniform within the joint limits, or, where every compound joint has six dofs, uniform in the
    network's coordinates. With obstacles the arm keeps `TARGET_CLEARANCE` from them, or less where it is nearer at
    home; if the scene has goal boxes, the end effector is at a uniform point of one, not far from home.

    Raises:
        InputError: the seed is invalid.
        NoSolutionError: no target was found.
    """
    seed = as_seed("seed", seed)
    rng = np.random.default_rng([seed, 1])
    goals = [site for site in range(arm.model.nsite) if arm.model.site(site).name.startswith(GOAL_PREFIX)]
    if not goals:
        return _anywhere(arm, np.random.default_rng(seed))
    collisions = Collisions(arm)
    data = kinematics_at(arm.model, arm.model.qpos0)
    places, turns = data.site_xpos.copy(), data.site_xmat.reshape(-1, 3, 3).copy()
    low, high = arm.position_limits.T
    inset, home = LIMIT_MARGIN * arm.ranges, arm.keyframe("home")
    for _ in range(_ATTEMPTS):
        site = rng.choice(goals)
        inside = arm.model.site_size[site] * rng.uniform(-1.0, 1.0, 3)
        point = places[site] + turns[site] @ inside
        near = np.clip(home + 0.25 * rng.normal(size=arm.n_joints) * arm.ranges, low + inset, high - inset)
        q = _towards(arm, data, near, point, low + inset, high - inset)
        if q is None or arm.limit_excess(q).max() > 0.0:
            continue
        if collisions.is_free(q, TARGET_CLEARANCE, own=OWN_CLEARANCE, home=home):
            return q
    raise NoSolutionError(
        f"no target was found for arm {arm.name!r} among its obstacles: in {_ATTEMPTS} tries its end effector did not "
        f"reach a goal of scene {arm.scene!r} without coming near an obstacle; use another scene or seed"
    )


def goes_to_extended(arm: Arm) -> bool:
    """Whether the arm's usual target is its keyframe ``extended``; otherwise, as among obstacles, a random one is."""
    return arm.scene == "free" and "extended" in arm.keyframes


def reference_configuration(arm: Arm) -> Floats:
    """The keyframe ``extended`` ``(n,)``; without one, halfway from home to each joint's farther limit.

    It may touch something: it is for networks and demonstrations that do not depend on the scene.
    """
    if "extended" in arm.keyframes:
        return arm.keyframe("extended")
    home, (low, high) = arm.keyframe("home"), arm.position_limits.T
    return arm.within_angles(0.5 * (home + np.where(high - home >= home - low, high, low)))


def _anywhere(arm: Arm, rng: np.random.Generator) -> Floats:
    low, high = arm.position_limits.T
    inset = LIMIT_MARGIN * arm.ranges
    near, tight = Counter[tuple[str, str]](), 0
    collisions, home = None if arm.scene == "free" else Collisions(arm), arm.keyframe("home")
    for attempt in range(_ATTEMPTS):
        # If the joint ranges are too small for the paper's distribution, fall back to that of other arms.
        if arm.retractor.exact and attempt < _ATTEMPTS // 2:
            q = arm.decode(rng.uniform(-NETWORK_SPREAD, NETWORK_SPREAD, (arm.n_links, 6))).q
        else:
            q = rng.uniform(low + inset, high - inset)
        if arm.limit_excess(q).max() > 0.0:
            continue
        contacts = arm.near_contacts(q)
        if not contacts and (collisions is None or collisions.is_free(q, TARGET_CLEARANCE, own=0.0, home=home)):
            return q
        near.update(contacts)
        tight += not contacts
    shown = ", ".join(f"{first!r} and {second!r} in {count}" for (first, second), count in near.most_common(3))
    raise NoSolutionError(
        f"no target free of contact was found for arm {arm.name!r}; of {_ATTEMPTS} random configurations, "
        f"contacts: {shown or 'none'}; without contact, but something nearer than {1e3 * TARGET_CLEARANCE:g} mm, in "
        f"{tight}; give the joint coordinates or a position instead"
    )


def _towards(arm: Arm, data: Any, q: Floats, point: Floats, low: Floats, high: Floats) -> Floats | None:
    """A configuration between low and high near ``q`` whose end effector is at a point, by damped steps; or None."""
    weights = (high - low) ** 2
    tip = arm.frames[-1:]
    for _ in range(25):
        kinematics_at(arm.model, arm.space.to_qpos(q), data)
        away = point - tip.poses(data.xpos, data.xmat)[0][0]
        if np.linalg.norm(away) < 1e-3:  # any point near the drawn one will do
            return q
        mujoco.mj_comPos(arm.model, data)
        slope = tip.jacobian(arm.model, data, 0)[0]
        # Joints that would be pushed into their limits are left out, so that the others make up for them.
        jacobian = slope @ arm.space.to_qvel(np.broadcast_to(q, (len(q), len(q))), np.eye(len(q))).T
        pushed = jacobian.T @ away
        moving = weights * ~(((q <= low) & (pushed < 0.0)) | ((q >= high) & (pushed > 0.0)))
        gain = (jacobian * moving) @ jacobian.T + 1e-3 * np.eye(3)
        q = np.clip(q + moving * (jacobian.T @ np.linalg.solve(gain, away)), low, high)
    return None


typecheck_public(globals())
