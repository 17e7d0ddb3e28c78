"""What a state of a compiled model says about an arm's surroundings, and which bodies an arm moves as one."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.contacts import colliding_geoms, fit_bounds
from lieednn_sim.arm.equalities import equalities_hold
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats


def check_data(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Raise `InputError` for data of another model, or with positions that are not finite."""
    if len(data.qpos) != model.nq or data.xpos.shape[0] != model.nbody or len(data.ctrl) != model.nu:
        raise InputError("data must be of the model: make it by mujoco.MjData(model)")
    if not all(np.isfinite(values).all() for values in (data.qpos, data.mocap_pos, data.mocap_quat)):
        raise InputError("data holds positions that are NaN or infinite")


def home_data(model: mujoco.MjModel) -> mujoco.MjData:
    """Data at the keyframe ``home``, or at the reference position of a model without it."""
    data = mujoco.MjData(model)
    home = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    if home >= 0:
        mujoco.mj_resetDataKeyframe(model, data, home)
    return data


def standing(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjModel:
    """A copy of a model, with mocap bodies where a state has them, the equalities that hold in it, and `fit_bounds`."""
    own = copy.deepcopy(model)
    for body in np.flatnonzero(model.body_mocapid >= 0):
        mocap = model.body_mocapid[body]
        own.body_pos[body], own.body_quat[body] = data.mocap_pos[mocap], data.mocap_quat[mocap]
    own.eq_active0[:] = data.eq_active & equalities_hold(model.opt)
    fit_bounds(own)
    return own


def keep_awake(model: mujoco.MjModel, dofs: NDArray[np.int_], spec: mujoco.MjSpec | None) -> None:
    """Keep what some dofs move from sleeping, in a model and its spec; what sleeps ignores controls and contacts."""
    if not model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP):
        return
    following, trees = mujoco.MjData(model).tree_asleep, np.unique(model.dof_treeid[dofs]).tolist()
    for tree in trees:
        # Trees that begin asleep in contact with each other form a cycle; a negative number is awake.
        if following[tree] >= 0 and following[tree] not in trees:
            trees.append(int(following[tree]))
    model.tree_sleep_policy[trees] = mujoco.mjtSleepPolicy.mjSLEEP_NEVER
    if spec is not None:
        for body in model.tree_bodyadr[trees].tolist():
            spec.bodies[body].sleep = mujoco.mjtSleepPolicy.mjSLEEP_NEVER


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> Floats:
    """The whole state of ``data``, controls and applied forces included, at time 0, as ``mjSTATE_INTEGRATION``."""
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    state[0] = 0.0  # the time is its first entry
    return state


def moved_together(model: mujoco.MjModel, dofs: NDArray[np.int_]) -> NDArray[np.int_]:
    """For each body ``(nbody,)``, the first one that some dofs move as one with it; zero if they do not move it."""
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

    What the arm does not move is welded to the world in the copy, by ``body_weldid``, which MuJoCo's collision filter
    uses but kinematics do not. Pairs that move together, such as the fingers of a hand, do not count, nor do those that
    the filter leaves out in the model: a link and its parent, even if that is fixed now.

    The arm moves ``dofs``; ``carried`` are the ids of a body with a free joint that is carried, and of those that hang
    from it. The pairs have the offset -inf (`contacts.ContactOffsets`).
    """
    group = moved_together(model, dofs)
    group[list(carried)] = carried[0] if len(carried) else 0
    result, weld = copy.deepcopy(model), model.body_weldid
    # Mocap bodies stand still, and can be moved as other bodies without joints are.
    result.body_mocapid[:] = -1
    # Distances are as exact as by default, whatever is exact enough for a simulation.
    result.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    result.opt.ccd_tolerance = min(result.opt.ccd_tolerance, 1e-6)
    result.opt.ccd_iterations = max(result.opt.ccd_iterations, 35)
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
