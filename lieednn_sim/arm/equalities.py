"""Equality constraints of a MuJoCo model: their residuals, the joints that they involve, and names for messages."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.checks import FREE, ancestry, joints_of
from lieednn_sim.errors import InputError
from lieednn_sim.values import Floats, weakly_cached

Indices = NDArray[np.int_]

# A residual below this [m, rad] is rounding.
EXACT = 1e-12


def least_squares(matrix: Floats, right: Floats) -> tuple[Floats, Floats]:
    """The least x ``(n, ...)`` with the least |A x - b| of A ``(m, n)`` and b ``(m, ...)``, and singular values of A.

    As `numpy.linalg.lstsq`, whose checks take most of its time for matrices this small; redundant rows do no harm.
    """
    solution, singular = np.zeros((max(matrix.shape), *right.shape[1:])), np.zeros(0)
    solution[: len(right)] = right
    if solution.size and matrix.size:
        _, solution, singular, *_ = scipy.linalg.lapack.dgelss(matrix, solution, 1e-10)
    return solution[: matrix.shape[1]], singular


class Residuals:
    """The residuals of a set of equalities, and the dependent joints that can change them.

    Args:
        model: the compiled model, which is not changed.
        data: data with the places of its mocap bodies; copied.
        equalities: ids of the equalities.
        joints: ids of the dependent joints.

    Attributes:
        dofs: ``(D,)`` addresses in qvel of the dependent joints.
        known: addresses of the other dofs on which the residual depends.
        involved: both.
        turning: those of the involved dofs that are angles.
        given: addresses in qpos of all joints but the dependent ones.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, equalities: Sequence[int], joints: Sequence[int]
    ) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._data.mocap_pos[:], self._data.mocap_quat[:] = data.mocap_pos, data.mocap_quat
        self._data.eq_active[:] = np.isin(np.arange(model.neq), equalities)
        self._sparse = bool(mujoco.mj_isSparse(model))
        self.dofs = dof_addresses(model, joints)
        self.given = np.setdiff1d(np.arange(model.nq), position_addresses(model, joints))
        involved = set(joints).union(*(involved_joints(model, equality) for equality in equalities))
        self.involved = dof_addresses(model, involved)
        self.known = np.setdiff1d(self.involved, self.dofs)
        self.turning = self.involved[turns(model, self.involved)]

    @property
    @weakly_cached
    def _own(self) -> mujoco.MjData:
        return copy.copy(self._data)

    def at(self, qpos: Floats) -> tuple[Floats, Floats]:
        """Residual ``(E,)`` [m, rad] of the loops' equalities and its Jacobian ``(E, nv)``."""
        model, data = self._model, kinematics_at(self._model, qpos, self._own)
        mujoco.mj_comPos(model, data)
        if model.ntendon:
            mujoco.mj_tendon(model, data)
        mujoco.mj_makeConstraint(model, data)
        count = data.ne
        if not self._sparse:
            return data.efc_pos[:count].copy(), data.efc_J.reshape(-1, model.nv)[:count].copy()
        jacobian = np.zeros((count, model.nv))
        if count:
            row = data.efc_J_rownnz[:count], data.efc_J_rowadr[:count]
            mujoco.mju_sparse2dense(jacobian, data.efc_J.ravel(), *row, data.efc_J_colind.ravel())
        return data.efc_pos[:count].copy(), jacobian

    def least_squares(self, jacobian: Floats, residual: Floats) -> tuple[Floats, Floats]:
        """The change ``(D, ...)`` of the dependent dofs that undoes a residual, and the Jacobian's singular values."""
        return least_squares(jacobian[:, self.dofs], -residual)

    def move(self, qpos: Floats, step: Floats) -> None:
        """Move the dependent dofs of ``(nq,)`` by a step ``(D,)``, in place."""
        motion = np.zeros(self._model.nv)
        motion[self.dofs] = step
        mujoco.mj_integratePos(self._model, qpos, motion, 1.0)

    def difference(self, start: Floats, end: Floats) -> Floats:
        """The motion ``(nv,)`` from one position ``(nq,)`` to another."""
        change = np.empty(self._model.nv)
        mujoco.mj_differentiatePos(self._model, change, 1.0, start, end)
        return change

    def settle(self, qpos: Floats) -> tuple[Floats, Floats]:
        """The least residual near a configuration, by damped least squares (Levenberg-Marquardt), and where it is."""
        damping = 1e-6
        residual, jacobian = self.at(qpos)
        for _ in range(100):
            if np.abs(residual).max(initial=0.0) < EXACT or damping > 1e6:
                break
            columns = jacobian[:, self.dofs]
            normal = columns.T @ columns + damping * np.eye(len(self.dofs))
            trial = qpos.copy()
            self.move(trial, np.asarray(np.linalg.solve(normal, -columns.T @ residual), dtype=float))
            trial_residual, trial_jacobian = self.at(trial)
            if np.linalg.norm(trial_residual) < np.linalg.norm(residual):
                qpos, residual, jacobian, damping = trial, trial_residual, trial_jacobian, max(0.1 * damping, 1e-12)
            else:
                damping *= 10.0
        return residual, qpos

    def gap(self, residual: Floats) -> str:
        """Which equality a residual ``(E,)`` leaves open the most, and by how much."""
        worst = np.abs(residual) == np.abs(residual).max()
        return f"{self.owners(worst)} stays open by {np.abs(residual).max():.3g} (m or rad)"

    def owners(self, rows: NDArray[np.bool_]) -> str:
        """The equalities of some rows ``(E,)`` of the residual."""
        ids = self._own.efc_id[np.flatnonzero(rows)]
        return ", ".join(dict.fromkeys(equality_name(self._model, int(equality)) for equality in ids))


def involved_joints(model: mujoco.MjModel, equality: int) -> set[int]:
    """The joints on whose positions an equality's residual depends; none for those of flexes."""
    kind, ids = model.eq_type[equality], (int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality]))
    if kind == int(mujoco.mjtEq.mjEQ_JOINT):
        return {joint for joint in ids if joint >= 0}
    if kind == int(mujoco.mjtEq.mjEQ_TENDON):
        return set().union(*(tendon_joints(model, tendon) for tendon in ids if tendon >= 0))
    if kind in (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)):
        sites = model.eq_objtype[equality] == int(mujoco.mjtObj.mjOBJ_SITE)
        return _between(model, [int(model.site_bodyid[i]) if sites else i for i in ids])
    return set()


def equalities_hold(option: mujoco.MjOption) -> bool:
    """Whether no flag of a model's options, or of a spec's, disables its equalities."""
    return not option.disableflags & (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_EQUALITY)


def loop_closures(model: mujoco.MjModel) -> list[int]:
    """The equalities that hold bodies together, `connect` and `weld`, of those that are active at the beginning."""
    kinds = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)
    return [int(equality) for equality in np.flatnonzero(model.eq_active0 & np.isin(model.eq_type, kinds))]


def equality_name(model: mujoco.MjModel, equality: int) -> str:
    """The name of an equality in messages."""
    kind = mujoco.mjtEq(int(model.eq_type[equality])).name.removeprefix("mjEQ_").lower()
    name = model.equality(equality).name
    if name:
        return f"equality {name!r} ({kind})"
    sites = model.eq_objtype[equality] == int(mujoco.mjtObj.mjOBJ_SITE)
    item = {"joint": model.joint, "tendon": model.tendon}.get(kind, model.site if sites else model.body)
    ids = [int(i) for i in (model.eq_obj1id[equality], model.eq_obj2id[equality]) if i >= 0]
    ends = [item(i).name or f"number {i}" for i in ids]
    return f"the {kind} equality of {' and '.join(map(repr, ends))}"


def names(model: mujoco.MjModel, joints: Iterable[int]) -> str:
    """Names of joints in messages, with the body of a joint that is free or has no name."""

    def named(joint: int) -> str:
        name, body = model.joint(joint).name, model.body(model.jnt_bodyid[joint]).name
        told = repr(name) if name else f"number {joint}"
        return told if name and model.jnt_type[joint] != FREE else f"{told} of body {body!r}"

    return ", ".join(map(named, sorted(joints)))


def dof_addresses(model: mujoco.MjModel, joints: Iterable[int]) -> Indices:
    """Addresses in qvel of all dofs of joints, in the model's order."""
    return np.flatnonzero(np.isin(model.dof_jntid, list(joints)))


def position_addresses(model: mujoco.MjModel, joints: Iterable[int]) -> Indices:
    """Addresses in qpos of all numbers of joints, in the model's order."""
    ends = np.append(model.jnt_qposadr[1:], model.nq)
    return np.concatenate([np.arange(0), *(np.arange(model.jnt_qposadr[j], ends[j]) for j in sorted(joints))])


def turns(model: mujoco.MjModel, dofs: Indices) -> NDArray[np.bool_]:
    """Which dofs are angles; the first three of a free joint are lengths."""
    joints = model.dof_jntid[dofs]
    kinds, first = model.jnt_type[joints], dofs - model.jnt_dofadr[joints]
    free = kinds == int(mujoco.mjtJoint.mjJNT_FREE)
    return (kinds != int(mujoco.mjtJoint.mjJNT_SLIDE)) & ~(free & (first < 3))


def _between(model: mujoco.MjModel, bodies: Iterable[int]) -> set[int]:
    """Joints that move some of the bodies but not all of them: what moves all changes no distance between them."""
    above: list[set[int]] = [
        {joint for part in ancestry(model, body) for joint in joints_of(model, part)} for body in bodies
    ]
    shared = above[0].intersection(*above[1:]) if above else set()
    return set().union(*above) - shared


def free_ranges(ranges: Floats, margins: Floats) -> Floats:
    """Ranges ``(K, 2)`` of joints or tendons, reduced by the margins ``(K,)`` in which MuJoCo pushes back.

    What has no margin keeps its range to the last bit; `InputError` if a margin leaves nothing.
    """
    for (low, high), margin in zip(ranges, margins, strict=True):
        if margin > 0.0 and 2.0 * margin >= high - low:
            raise InputError(f"a margin of {margin:g} leaves nothing of the range [{low:g}, {high:g}]; make it smaller")
    return np.where(margins[:, None] > 0.0, ranges + margins[:, None] * [1.0, -1.0], ranges)


def joint_range(model: mujoco.MjModel, joint: int) -> Floats:
    """The range ``(2,)`` of a joint, see `free_ranges`; that of a ball joint begins at 0."""
    return free_ranges(model.jnt_range[[joint]], model.jnt_margin[[joint]])[0]


def tendon_joints(model: mujoco.MjModel, tendon: int) -> set[int]:
    """Joints that change the length of a fixed or spatial tendon."""
    wraps, kinds = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon]), mujoco.mjtWrap
    places = {int(kinds.mjWRAP_SITE): model.site_bodyid}
    places |= dict.fromkeys((int(kinds.mjWRAP_SPHERE), int(kinds.mjWRAP_CYLINDER)), model.geom_bodyid)
    items = list(zip(model.wrap_type[wraps].tolist(), model.wrap_objid[wraps].tolist(), strict=True))
    bodies = [int(places[kind][item]) for kind, item in items if kind in places]
    return {item for kind, item in items if kind == int(kinds.mjWRAP_JOINT)} | _between(model, bodies)
