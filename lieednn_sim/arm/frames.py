"""Frames fixed to bodies of a model, by name or by body and pose."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError
from lieednn_sim.validation import quoted
from lieednn_sim.values import Floats


@dataclass(frozen=True, eq=False)
class Frame:
    """A named frame fixed to a body: a site, or the body's own origin.

    Attributes:
        name: name of the body or site.
        body: its id.
        pos: ``(3,)`` in the body [m].
        quat: ``(4,)`` in the body, scalar first.
    """

    name: str
    body: int
    pos: Floats
    quat: Floats


@dataclass(frozen=True, eq=False)
class BodyFrames:
    """N frames fixed to bodies of a model.

    Attributes:
        names: of the bodies or sites.
        bodies: ``(N,)`` ids.
        positions: ``(N, 3)`` in the bodies [m].
        rotations: ``(N, 3, 3)`` in the bodies.
    """

    names: tuple[str, ...]
    bodies: NDArray[np.int_]
    positions: Floats
    rotations: Floats

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
        turn = xmat.take(self.bodies, axis=-2).reshape(*xmat.shape[:-2], -1, 3, 3)
        place = xpos.take(self.bodies, axis=-2) + np.matvec(turn, self.positions)
        return place, turn @ self.rotations

    def jacobian(
        self, model: mujoco.MjModel, data: mujoco.MjData, k: int, out: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Jacobians ``(3, nv)`` of position and rotation of frame k; data holds the kinematics, with ``mj_comPos``.

        They are written to ``out`` ``(2, 3, nv)``, if that is given.
        """
        linear, angular = np.empty((2, 3, model.nv)) if out is None else out
        body = int(self.bodies[k])
        point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ self.positions[k]
        mujoco.mj_jac(model, data, linear, angular, point, body)
        return linear, angular


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
