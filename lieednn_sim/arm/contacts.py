"""Which geoms and bodies are near contact at a configuration, by MuJoCo's collision detection."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats, quoted
from lieednn_sim.values import Floats

#: Distance [m] that planned motions keep from obstacles and between the arm's own parts by default. It allows for
#: tracking errors of a millimetre or two.
PLANNED_CLEARANCE = 0.002


class ContactFinder:
    """Finds geoms and bodies closer than a margin, about ten times faster than all distances (`Collisions`).

    Holds a `mujoco.MjData` of its own: one instance for each thread.

    Args:
        model: the compiled model, which is not changed.
        margin: distance [m] below which geoms count as touching.
        mocap: where mocap bodies are; by default where the model has them.
    """

    def __init__(self, model: mujoco.MjModel, margin: float = 0.0, mocap: mujoco.MjData | None = None) -> None:
        self._margin = margin
        self._model = copy.deepcopy(model)
        # Overridden rather than written into the geoms, whose bounding volumes were built for the old margins.
        self._model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
        self._model.opt.o_margin = margin
        self._data = mujoco.MjData(self._model)
        if mocap is not None:
            self._data.mocap_pos[:], self._data.mocap_quat[:] = mocap.mocap_pos, mocap.mocap_quat

    def move(self, places: Mapping[str, ArrayLike]) -> None:
        """See `move_bodies`."""
        move_bodies(self._model, places)

    def geoms(self, qpos: Floats) -> tuple[Floats, NDArray[np.int_]]:
        """Distances ``(C,)`` and ids ``(C, 2)`` of geoms closer than the margin at MuJoCo's positions ``(nq,)``."""
        self._found(qpos)
        return self._near()

    def _near(self) -> tuple[Floats, NDArray[np.int_]]:
        """As `geoms`, where contacts have been found."""
        contact = self._data.contact
        # MuJoCo may also report pairs that are not nearer than the margin.
        near = contact.dist < self._margin
        return contact.dist[near], contact.geom[near]

    def any(self, qpos: Floats) -> bool:
        """Whether some geoms are closer than the margin at MuJoCo's positions ``(nq,)``."""
        return self._found(qpos) > 0 and bool(self._data.contact.dist.min() < self._margin)

    def _found(self, qpos: Floats) -> int:
        """The number of contacts, which are then in ``_data``."""
        model, data = self._model, self._data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        return int(data.ncon)

    def bodies(self, qpos: Floats) -> list[tuple[str, str]]:
        """Names of the bodies closer than the margin at MuJoCo's positions ``(nq,)``."""
        model = self._model
        # Nearly always, so without making arrays.
        if not self._found(qpos):
            return []
        near = self._near()[1]
        pairs = model.geom_bodyid[near]
        return list(dict.fromkeys((model.body(a).name, model.body(b).name) for a, b in pairs))


def moving_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which geoms ``(ngeom,)`` belong to moving bodies, not to the world or to what is welded to it."""
    moving: NDArray[np.bool_] = model.body_weldid[model.geom_bodyid] != 0
    return moving


def colliding_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which geoms ``(ngeom,)`` collide with any others; the rest are only drawn."""
    colliding: NDArray[np.bool_] = (model.geom_contype | model.geom_conaffinity) != 0
    return colliding


def moved_by(model: mujoco.MjModel, body: int) -> NDArray[np.bool_]:
    """Which degrees of freedom ``(nv,)`` move a body."""
    moved = np.zeros(model.nv, dtype=bool)
    while body > 0:
        first = model.body_dofadr[body]
        moved[first : first + model.body_dofnum[body]] = True
        body = int(model.body_parentid[body])
    return moved


def fixed_body(model: mujoco.MjModel, name: str) -> int:
    """The id of a body that no joint moves and that carries no joint; `InputError` lists the names of such bodies."""
    result = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name))
    jointed = model.body_weldid != 0
    # Children come after their parents.
    for body in range(model.nbody - 1, 0, -1):
        jointed[model.body_parentid[body]] |= jointed[body]
    if result <= 0 or jointed[result]:
        fixed = sorted(filter(None, (model.body(k).name for k in np.flatnonzero(~jointed) if k)))
        raise InputError(
            f"no obstacle {quoted(name)} can move; bodies that neither move nor carry an arm are: "
            f"{', '.join(fixed) or 'none'}"
        )
    return result


def move_bodies(model: mujoco.MjModel, places: Mapping[str, ArrayLike]) -> None:
    """Put bodies without joints at positions ``(3,)`` in the frames of their parents [m], by name, in a model.

    Raises:
        InputError: there is no such body, or a value is malformed.
    """
    for name, place in places.items():
        model.body_pos[fixed_body(model, name)] = as_floats(f"the place of {quoted(name)}", place, (3,))
