"""Frames fixed to bodies of a model, by name or by body and pose, and the chains of joints between them."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import FREE, ancestry, joints_of
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice, quoted
from lieednn_sim.values import Floats


@dataclass(frozen=True, eq=False)
class Frame:
    """A named frame fixed to a body: a site, or the body's own origin."""

    name: str  # of the body or site
    body: int  # the body's id
    pos: Floats  # (3,) in the body [m]
    quat: Floats  # (4,) in the body, scalar first


@dataclass(frozen=True, eq=False)
class BodyFrames:
    """N frames fixed to bodies of a model."""

    names: tuple[str, ...]  # of the bodies or sites
    bodies: NDArray[np.int_]  # (N,) ids
    positions: Floats  # (N, 3) in the bodies [m]
    rotations: Floats  # (N, 3, 3) in the bodies

    @classmethod
    def of(cls, frames: Sequence[Frame]) -> BodyFrames:
        """The frames together."""
        matrices = np.empty((len(frames), 9))
        for frame, matrix in zip(frames, matrices, strict=True):
            mujoco.mju_quat2Mat(matrix, frame.quat)
        bodies = np.array([frame.body for frame in frames], dtype=int)
        names, positions = tuple(frame.name for frame in frames), np.array([frame.pos for frame in frames])
        return cls(names, bodies, positions, matrices.reshape(-1, 3, 3))

    def __len__(self) -> int:
        """Return N."""
        return len(self.bodies)

    def __getitem__(self, some: slice) -> BodyFrames:
        """Return a range of the frames."""
        return BodyFrames(self.names[some], self.bodies[some], self.positions[some], self.rotations[some])

    def poses(self, xpos: Floats, xmat: Floats) -> tuple[Floats, Floats]:
        """Positions ``(..., N, 3)`` and rotations ``(..., N, 3, 3)`` in the world.

        Args:
            xpos: positions ``(..., nbody, 3)`` of the model's bodies, as in MuJoCo's data.
            xmat: their rotation matrices ``(..., nbody, 9)``.
        """
        turn = xmat.take(self.bodies, axis=-2).reshape(*xmat.shape[:-2], len(self), 3, 3)
        place = xpos.take(self.bodies, axis=-2) + np.matvec(turn, self.positions)
        return place, turn @ self.rotations

    def jacobian(self, model: mujoco.MjModel, data: mujoco.MjData, k: int) -> Floats:
        """Jacobians ``(2, 3, nv)`` of position and rotation of frame k; data holds the kinematics and ``mj_comPos``."""
        result, body = np.empty((2, 3, model.nv)), int(self.bodies[k])
        point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ self.positions[k]
        mujoco.mj_jac(model, data, *result, point, body)
        return result


def find_frame(model: mujoco.MjModel, name: str) -> Frame:
    """The frame of a body or, when no body has the name, of a site; `InputError` lists both.

    A body without a name is called after its id, as in ``body 7``.
    """
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    unnamed = next((k for k in range(model.nbody) if name == f"body {k}" and not model.body(k).name), -1)
    if max(body, unnamed) >= 0:
        return body_frame(model, max(body, unnamed))
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    if site < 0:
        bodies = [model.body(i).name for i in range(model.nbody)]
        sites = [model.site(i).name for i in range(model.nsite)]
        raise InputError(
            f"no body or site {quoted(name)}; bodies: {listed(bodies)}; "
            f"sites: {listed(sites) if any(sites) else 'none'}"
        )
    return site_frame(model, site)


def body_frame(model: mujoco.MjModel, body: int) -> Frame:
    """The frame at a body's origin."""
    return Frame(model.body(body).name or f"body {body}", body, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


def site_frame(model: mujoco.MjModel, site: int) -> Frame:
    """The frame of a site."""
    return Frame(
        model.site(site).name, int(model.site_bodyid[site]), model.site_pos[site].copy(), model.site_quat[site].copy()
    )


def listed(names: Iterable[str]) -> str:
    """Names for a message; those that are empty are left out."""
    return ", ".join(repr(name) for name in names if name)


def named_frames(model: mujoco.MjModel, links: Sequence[str], base: str | None) -> tuple[Frame, ...]:
    """Base and link frames by name, the base, which may be left out, first; `InputError` for unknown or equal ones."""
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

    `InputError` if the frames are not on one chain, there is no joint between two of them, or a joint is free.
    """
    groups = []
    for inner, outer in itertools.pairwise(frames):
        path = ancestry(model, outer.body)
        if inner.body not in path:
            raise InputError(f"{outer.name!r} does not descend from {inner.name!r}; name links from the base outwards")
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


def chain_joints(model: mujoco.MjModel, body: int) -> list[int]:
    """The hinges, slides and ball joints of a body."""
    return [joint for joint in joints_of(model, body) if model.jnt_type[joint] != FREE]
