"""Passive joints, which swing and bend: where they rest, and their free oscillations, by MuJoCo's model.

They are the hinges, slides and balls in the arm's kinematic tree that no coordinate, actuator or equality moves, such
as a hook on a link, an elastic stage or a springy base. Driven joints are assumed to be held where they are; free
bodies, ranges of passive joints and dry friction are left out.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.equalities import involved_joints, names
from lieednn_sim.arm.forces import actuator_moments, required_forces
from lieednn_sim.arm.model_arm import ModelArm
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats

_Arm = TypeVar("_Arm", bound=ModelArm)


@dataclass(frozen=True)
class Mode:
    """A free oscillation about the rest at a configuration, with the driven joints held.

    Attributes:
        joint: name of the passive joint with the largest part of the energy.
        frequency: natural frequency [Hz].
        damping: fraction of the critical damping.
    """

    joint: str
    frequency: float
    damping: float

    def __str__(self) -> str:
        return f"{self.joint} {self.frequency:.3g} Hz, damped by {self.damping:.2%}"


@dataclass(frozen=True, eq=False)
class PassiveJoints:
    """The passive joints of an arm's model. Rows of positions ``(S, nq)`` are MuJoCo's, of the whole model."""

    arm: ModelArm

    @cached_property
    def dofs(self) -> NDArray[np.int_]:
        """Their addresses in qvel ``(m,)``."""
        model = self.arm.model
        passive = np.isin(model.dof_treeid, model.dof_treeid[self.arm.dofs])
        passive &= ~actuator_moments(model).any(axis=0)
        passive &= model.jnt_type[model.dof_jntid] != int(mujoco.mjtJoint.mjJNT_FREE)
        for equality in np.flatnonzero(model.eq_active0).tolist():
            passive &= ~np.isin(model.dof_jntid, [*involved_joints(model, equality)])
        passive[self.arm.dofs] = False
        return np.flatnonzero(passive)

    @cached_property
    def sprung(self) -> NDArray[np.bool_]:
        """Which of these dofs ``(m,)`` have a spring: they bend, the others swing."""
        model = self.arm.model
        return np.asarray(model.jnt_stiffness[model.dof_jntid[self.dofs]] > 0.0)

    @cached_property
    def bodies(self) -> NDArray[np.bool_]:
        """Which bodies ``(nbody,)`` hang, that is are behind a passive joint without a spring."""
        model, hanging = self.arm.model, np.zeros(self.arm.model.nbody, dtype=bool)
        hanging[model.dof_bodyid[self.dofs[~self.sprung]]] = True
        for body, parent in enumerate(model.body_parentid):  # parents come first
            hanging[body] |= hanging[parent]
        return hanging

    @cached_property
    def load_model(self) -> mujoco.MjModel:
        """A copy of the model in which only hanging bodies collide, and only with what does not move.

        Pairs are those of MuJoCo's filter. If a hanging body has no colliding geoms, those that MuJoCo draws, of groups
        0 to 2, collide with all geoms that collide and are drawn.
        """
        model, body = copy.deepcopy(self.arm.model), self.arm.model.geom_bodyid
        types, affinities = model.geom_contype.copy(), model.geom_conaffinity.copy()
        load, solid, drawn = self.bodies[body], (types | affinities) != 0, model.geom_group < 3
        still = moved_together(model, np.append(self.arm.dofs, self.dofs))[body] == 0
        shown = drawn & ~np.isin(body, body[solid])
        kinds, kind = np.unique(np.stack([types, affinities, solid & drawn])[:, still], axis=1, return_inverse=True)
        meets = (types[:, None] & kinds[1]) | (affinities[:, None] & kinds[0]) | (shown[:, None] & kinds[2])
        # Each kind of what does not move gets a bit of its own; any beyond the 31 of MuJoCo's filter share the last.
        bits = 1 << np.minimum(np.arange(kinds.shape[1]), 30)
        model.geom_contype[:] = load * np.bitwise_or.reduce(bits * (meets != 0), axis=1, initial=0)
        model.geom_conaffinity[:] = 0
        model.geom_conaffinity[still] = bits[kind.ravel()]
        return model

    def moved(self, qpos: Floats, by: Floats) -> Floats:
        """Positions ``(S, nq)`` moved by displacements ``(S, m)`` of the passive joints."""
        result, step = np.array(qpos), np.zeros(self.arm.model.nv)
        for row, step[self.dofs] in zip(result, by, strict=True):
            mujoco.mj_integratePos(self.arm.model, row, step, 1.0)
        return result

    def away(self, qpos: Floats, rest: Floats) -> Floats:
        """Displacements ``(S, m)`` of the passive joints from their ``rest`` ``(nq,)`` or ``(S, nq)``."""
        result, step = np.empty((len(qpos), len(self.dofs))), np.empty(self.arm.model.nv)
        for k, (there, here) in enumerate(zip(np.broadcast_to(rest, qpos.shape), qpos, strict=True)):
            mujoco.mj_differentiatePos(self.arm.model, step, 1.0, there, here)
            result[k] = step[self.dofs]
        return result

    def forces(self, qpos: Floats, qvel: Floats | float = 0.0, qacc: Floats | float = 0.0) -> Floats:
        """Forces ``(S, m)`` that a motion needs at these joints, by inverse dynamics; zero in a free motion."""
        return required_forces(self.arm.model, qpos, qvel, qacc)[:, self.dofs]

    def slopes(self, over: str, qpos: Floats, qvel: Floats | float = 0.0, qacc: Floats | float = 0.0) -> Floats:
        """Derivatives ``(S, m, m)`` of `forces` in passive ``position``, ``velocity`` or ``acceleration``."""
        count, m, which = len(qpos), len(self.dofs), ("position", "velocity", "acceleration").index(over)
        step = (1e-5, 1.0, 1.0)[which]  # forces are at most quadratic in velocities
        sides = np.tile(step * np.concatenate([np.eye(m), -np.eye(m)]), (count, 1))
        rates = [np.broadcast_to(part, (count, self.arm.model.nv)).repeat(2 * m, axis=0) for part in (qvel, qacc)]
        rows = qpos.repeat(2 * m, axis=0)
        if which == 0:
            rows = self.moved(rows, sides)
        else:
            rates[which - 1][:, self.dofs] += sides
        forces = self.forces(rows, *rates).reshape(count, 2, m, m)
        return np.swapaxes(forces[:, 0] - forces[:, 1], 1, 2) / (2.0 * step)

    def at_rest(self, qpos: Floats) -> Floats:
        """Positions ``(S, nq)`` with the passive joints at stable rest, by Newton's method on their energy.

        `NoSolutionError` if they have no position of rest, like a free slide on a slope.
        """
        result = np.array(qpos)
        if not len(self.dofs):
            return result
        for _ in range(50):
            curvature, axes = np.linalg.eigh(self.slopes("position", result))
            pull = np.vecmat(self.forces(result), axes)
            # Steps go downhill, also near an unstable rest; free motions have neither force nor stiffness.
            neutral = np.abs(curvature) < 1e-6 * np.abs(curvature).max(axis=1, keepdims=True) + 1e-9
            if (neutral & (np.abs(pull) > 1e-3)).any():
                break
            step = -np.matvec(axes, np.where(neutral, 0.0, pull / np.where(neutral, 1.0, np.abs(curvature))))
            largest = np.abs(step).max(axis=1, keepdims=True, initial=0.0)
            result = self.moved(result, step * np.minimum(1.0, 0.5 / np.maximum(largest, 1e-300)))
            if largest.max(initial=0.0) < 1e-8:
                return result
        joints = names(self.arm.model, dict.fromkeys(self.arm.model.dof_jntid[self.dofs].tolist()))
        raise NoSolutionError(f"nothing drives {joints}, which rest nowhere: hang, spring or drive them")

    def modes(self, q: ArrayLike) -> tuple[Mode, ...]:
        """Free oscillations at a configuration ``(n,)``, slowest first, without overdamped and neutral motions.

        They are the eigenvalues of M x'' + D x' + K x = 0, with the matrices of `slopes`. `NoSolutionError` as for
        `at_rest`.
        """
        position = as_floats("q", q, (self.arm.n_joints,))
        return self.modes_at(self.at_rest(self.arm.qpos(position)[None])[0]) if len(self.dofs) else ()

    def modes_at(self, rest: Floats) -> tuple[Mode, ...]:
        """`modes` at positions ``(nq,)`` of `at_rest`, if there is a passive joint."""
        m, kinds = len(self.dofs), ("position", "velocity", "acceleration")
        stiffness, damping, inertia = (self.slopes(kind, rest[None])[0] for kind in kinds)
        system = np.eye(2 * m, k=m)
        system[m:] = -np.linalg.solve(inertia, np.hstack([stiffness, damping]))
        values, shapes = np.linalg.eig(system)
        found = []
        for k in np.flatnonzero(values.imag > 1e-3 * np.abs(values)):
            dof = self.dofs[int((np.abs(shapes[:m, k]) ** 2 * np.diag(inertia)).argmax())]
            size, name = float(abs(values[k])), self.arm.model.joint(self.arm.model.dof_jntid[dof]).name
            found.append(Mode(name, size / (2.0 * np.pi), float(-values[k].real / size)))
        return tuple(sorted(found, key=lambda mode: mode.frequency))


def with_load(arm: _Arm, mass: float = 1.0, length: float = 1.0) -> _Arm:
    """An arm with another load, by factors on the mass of what hangs (`PassiveJoints.bodies`) and on how far it hangs.

    Distances from the joints that it hangs at change, but not sizes.
    """
    mass, length = as_positive("mass", mass), as_positive("length", length)
    model, passive = copy.deepcopy(arm.model), PassiveJoints(arm)
    model.body_mass[passive.bodies] *= mass
    model.body_inertia[passive.bodies] *= mass
    anchor = np.full((model.nbody, 3), np.nan)
    swinging = passive.dofs[~passive.sprung]
    anchor[model.dof_bodyid[swinging]] = model.jnt_pos[model.dof_jntid[swinging]]
    parts = (model.body_ipos, np.arange(model.nbody)), (model.body_pos, model.body_parentid)
    for places, bodies in (*parts, (model.geom_pos, model.geom_bodyid), (model.site_pos, model.site_bodyid)):
        places += np.nan_to_num((length - 1.0) * (places - anchor[bodies]))
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return replace(arm, model=model)
