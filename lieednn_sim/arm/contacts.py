"""Which geoms and bodies are near contact at a configuration, by MuJoCo's collision detection."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats, quoted
from lieednn_sim.values import Floats

#: Distance [m] that planned motions keep from obstacles and between the arm's own parts by default. It allows for
#: tracking errors of a millimetre or two.
PLANNED_CLEARANCE = 0.002
# Change of qpos within which an arm must leave what it is too near to [rad, m]; and rounding of distances [m].
_LEFT, _ROUNDING = 0.1, 1e-9
# Types of geoms whose sizes say where their surfaces are.
_SIZED = [
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX")
]
Offsets = Mapping[tuple[int, int], float]
_NOTHING = np.zeros(0), np.zeros((0, 2), dtype=int)


class ContactOffsets:
    """Distances at which geoms begin to push each other: margins of a model, and those that a view sets for some pairs.

    MuJoCo's margin of two geoms is the sum of their own, or that of their explicit pair; in a gap there is no force.

    ``given`` are offsets [m] that replace the model's for some pairs of geoms, by the ids of both.
    """

    def __init__(self, model: mujoco.MjModel, given: Offsets) -> None:
        # In contacts with a flex, the other geom's id is -1, which is here the last entry.
        self._margins = np.append(model.geom_margin, model.flex_margin.max(initial=0.0))
        own = np.array(model.pair_margin)
        if model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_OVERRIDE):
            self._margins[:], own[:] = 0.5 * model.opt.o_margin, model.opt.o_margin
        pairs = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), own.tolist(), strict=True)
        self._special = {(min(a, b), max(a, b)): margin for a, b, margin in pairs}
        self._special |= {(min(pair), max(pair)): offset for pair, offset in given.items()}
        #: Whether all offsets are zero.
        self.none = not self._margins.any() and not any(self._special.values())
        #: The largest of all [m].
        self.largest = max([*(2.0 * self._margins), *self._special.values(), 0.0])

    def __call__(self, pairs: NDArray[np.int_]) -> Floats:
        """Offsets ``(P,)`` of pairs of geoms ``(P, 2)`` [m]."""
        offsets = self._margins[pairs].sum(axis=1)
        if self._special:
            for k, (a, b) in enumerate(pairs.tolist()):
                offsets[k] = self._special.get((min(a, b), max(a, b)), offsets[k])
        return np.asarray(offsets)


class ContactFinder:
    """Finds geoms and bodies closer than a margin, about ten times faster than all distances (`Collisions`).

    Holds a `mujoco.MjData` of its own: one instance for each thread.

    Args:
        model: copied.
        margin: distance [m] beyond their offset (`ContactOffsets`) below which geoms count as touching.
        offsets: as for `ContactOffsets`.
        leaving: positions ``(nq,)`` at which a motion begins, if they are too near to something. Geoms closer than the
            margin there may be as close at first, and less so with the distance from there in qpos.
    """

    def __init__(
        self, model: mujoco.MjModel, margin: float = 0.0, offsets: Offsets | None = None, leaving: Floats | None = None
    ) -> None:
        self._margin, self._offsets = margin, ContactOffsets(model, offsets or {})
        self._model, bits = copy.deepcopy(model), mujoco.mjtDisableBit
        # What is near counts, as for proofs, also in a model whose simulations are without contact.
        self._model.opt.disableflags &= ~int(bits.mjDSBL_CONTACT | bits.mjDSBL_CONSTRAINT)
        # Margins are overridden, not written into the geoms, whose bounding volumes were built for the old margins.
        self._model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
        self._model.opt.o_margin = margin + self._offsets.largest
        # MuJoCo's midphase, trees of boxes around bodies' geoms, pays if many geoms do not move and those that move are
        # not all spheres; otherwise switching it off saves up to a fifth.
        fixed, moving = model.body_geomnum[model.body_weldid == 0], model.geom_type[moving_geoms(model)]
        if fixed.sum() < 10 or (fixed.max() < 20 and (moving == int(mujoco.mjtGeom.mjGEOM_SPHERE)).all()):
            self._model.opt.disableflags |= int(bits.mjDSBL_MIDPHASE)
        self._data = mujoco.MjData(self._model)
        self._left: dict[tuple[int, ...], int] = {}
        self._begin, self._lack = leaving, np.zeros(0)
        if leaving is not None:
            pairs = np.unique(np.sort(self.geoms(leaving)[1]), axis=0)
            self._left = {tuple(pair): k for k, pair in enumerate(pairs.tolist())}
            self._lack = margin - self.left(leaving) + _ROUNDING

    def left(self, qpos: Floats) -> Floats:
        """Distances ``(L,)`` at ``(nq,)``, up to the margin, of the pairs of geoms that a motion has to leave."""
        least = np.full(len(self._left), self._margin)
        self._found(qpos)
        contact = self._data.contact
        which, distance = self._leaving(contact.geom), contact.dist - self._offsets(contact.geom)
        np.minimum.at(least, which[which >= 0], distance[which >= 0])
        return least

    def _leaving(self, geoms: NDArray[np.int_]) -> NDArray[np.int_]:
        """The number of each of ``(C, 2)`` among the pairs to be left, or -1."""
        return np.array([self._left.get((min(a, b), max(a, b)), -1) for a, b in geoms.tolist()], dtype=int)

    def move(self, places: Mapping[str, ArrayLike]) -> None:
        """See `move_bodies`."""
        move_bodies(self._model, places)

    def put(self, bodies: NDArray[np.int_], places: Floats) -> None:
        """`move` without checks: bodies by their ids ``(B,)``, to positions ``(B, 3)``."""
        self._model.body_pos[bodies] = places

    def geoms(self, qpos: Floats) -> tuple[Floats, NDArray[np.int_]]:
        """Distances ``(C,)`` and ids ``(C, 2)`` of geoms closer than the margin at MuJoCo's positions ``(nq,)``.

        Distances count from where the geoms begin to push each other.
        """
        # There are nearly never any, and making arrays takes as long as finding that out.
        if not self._found(qpos):
            return _NOTHING
        distance = self._distances()
        # MuJoCo may also report pairs that are not nearer than the margin.
        near = distance < self._margin
        return distance[near], self._data.contact.geom[near]

    def _distances(self) -> Floats:
        """Distances ``(C,)`` of the contacts found; those of pairs to be left are increased by what they may lack."""
        contact = self._data.contact
        distance: Floats = contact.dist if self._offsets.none else contact.dist - self._offsets(contact.geom)
        if not self._left:
            return distance
        still = max(1.0 - float(np.linalg.norm(self._data.qpos - self._begin)) / _LEFT, 0.0)
        # The last entry is for all other pairs.
        return distance + still * np.append(self._lack, 0.0)[self._leaving(contact.geom)]

    def first(self, qpos: Floats) -> int:
        """Index of the first of MuJoCo's positions ``(K, nq)`` at which geoms are closer than the margin, or K."""
        model, data, position = self._model, self._data, self._data.qpos
        # `_found` is written out, since its call would add a twentieth.
        for index, position[:] in enumerate(qpos):
            mujoco.mj_kinematics(model, data)
            if model.nflex:
                mujoco.mj_flex(model, data)
            mujoco.mj_collision(model, data)
            # For so few numbers, Python finds the least in a fifth of NumPy's time.
            if data.ncon and min(self._distances().tolist()) < self._margin:
                return index
        return len(qpos)

    def _found(self, qpos: Floats) -> int:
        """The number of contacts, which are then in ``_data``."""
        mujoco.mj_collision(self._model, kinematics_at(self._model, qpos, self._data))
        return int(self._data.ncon)

    def bodies(self, qpos: Floats) -> list[tuple[str, str]]:
        """Names, or ``body`` and id, of bodies and flexes closer than the margin at MuJoCo's positions ``(nq,)``."""
        if not self._found(qpos):
            return []
        model, kinds, contact, near = self._model, mujoco.mjtObj, self._data.contact, self._distances() < self._margin
        sides = zip(contact.geom[near].ravel().tolist(), contact.flex[near].ravel().tolist(), strict=True)
        owners = [(kinds.mjOBJ_BODY, model.geom_bodyid[k]) if k >= 0 else (kinds.mjOBJ_FLEX, j) for k, j in sides]
        # `model.body(...).name` would take as long as twenty collision passes.
        names = [mujoco.mj_id2name(model, kind, k) or f"{kind.name[6:].lower()} {k}" for kind, k in owners]
        return list(dict.fromkeys(zip(names[::2], names[1::2], strict=True)))


def moving_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which geoms ``(ngeom,)`` belong to moving bodies, not to the world or to what is welded to it."""
    return np.asarray(model.body_weldid[model.geom_bodyid] != 0)


def colliding_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which geoms ``(ngeom,)`` collide with others, by their types or in explicit pairs; the rest are only drawn."""
    colliding: NDArray[np.bool_] = (model.geom_contype | model.geom_conaffinity) != 0
    colliding[np.concatenate([model.pair_geom1, model.pair_geom2])] = True
    return colliding


def colliding_pairs(model: mujoco.MjModel) -> NDArray[np.int_]:
    """Geom pairs ``(P, 2)`` that pass MuJoCo's collision filter, and the explicit ones."""
    moves = moving_geoms(model)
    first, second = np.triu(moves[:, None] | moves, k=1).nonzero()
    kind, affinity = model.geom_contype, model.geom_conaffinity
    meets = ((kind[first] & affinity[second]) | (kind[second] & affinity[first])) != 0
    first, second = first[meets], second[meets]
    bodies, weld = model.geom_bodyid[[first, second]], model.body_weldid
    one, other = weld[bodies]
    apart = one != other
    if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        parent = weld[model.body_parentid[weld]]
        apart &= ((one != parent[other]) & (other != parent[one])) | (one == 0) | (other == 0)
    apart &= ~np.isin((bodies.min(axis=0).astype(np.int64) << 16) + bodies.max(axis=0), model.exclude_signature)
    implicit = np.stack([first[apart], second[apart]], axis=1)
    explicit = np.sort(np.stack([model.pair_geom1, model.pair_geom2], axis=1).astype(int), axis=1)
    numbers = np.sort(np.concatenate([implicit, explicit]) @ [model.ngeom, 1])
    pairs = np.stack(np.divmod(numbers[np.diff(numbers, prepend=-1) > 0], model.ngeom), axis=1)
    pairs.setflags(write=False)
    return pairs


def without_clearance(model: mujoco.MjModel) -> str:
    """A warning about colliding geoms and flexes from which no clearance can be kept; empty without any."""
    blind = colliding_geoms(model) & (model.geom_type == int(mujoco.mjtGeom.mjGEOM_SDF))
    flexes = np.flatnonzero(model.flex_contype | model.flex_conaffinity)
    names = [geom_name(model, int(geom)) for geom in np.flatnonzero(blind)]
    names += [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, int(flex)) or "a flex" for flex in flexes]
    shown = ", ".join(map(repr, names))
    return shown and (
        f"MuJoCo measures no distance from flexes and geoms of the type sdf: motions keep no clearance of {shown}, and "
        "avoid contact at samples alone; other types, such as meshes, have one"
    )


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """The name of a geom in messages; a geom without a name is called after its body, a flex has the id -1."""
    return "a flex" if geom < 0 else model.geom(geom).name or f"a geom of {model.body(model.geom_bodyid[geom]).name}"


def fixed_body(model: mujoco.MjModel, name: str) -> int:
    """The id of a body that no joint moves and that carries no joint; `InputError` lists the names of such bodies."""
    result = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name))
    weld = model.body_weldid
    jointed = (weld != 0) & (model.body_mocapid[weld] < 0)
    # Children come after their parents.
    for body in range(model.nbody - 1, 0, -1):
        jointed[model.body_parentid[body]] |= jointed[body]
    if result <= 0 or jointed[result]:
        fixed = ", ".join(sorted(filter(None, (model.body(k).name for k in np.flatnonzero(~jointed) if k)))) or "none"
        raise InputError(f"no obstacle {quoted(name)} can move; bodies that neither move nor carry an arm are: {fixed}")
    return result


def move_bodies(model: mujoco.MjModel, places: Mapping[str, ArrayLike], grown: float = 0.0) -> None:
    """Put bodies without joints at positions ``(3,)`` in the frames of their parents [m], by name, in a model.

    The surfaces of their geoms move outwards by ``grown`` [m], except those of meshes and planes. `InputError` if there
    is no such body, or a value is malformed.
    """
    for name, place in places.items():
        model.body_pos[fixed_body(model, name)] = as_floats(f"the place of {quoted(name)}", place, (3,))
    if grown > 0.0:
        bodies = [model.body(name).id for name in places]
        geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies) & np.isin(model.geom_type, _SIZED))
        model.geom_size[geoms] += grown * (model.geom_size[geoms] > 0.0)
        fit_bounds(model)


def fit_bounds(model: mujoco.MjModel) -> None:
    """Fit a model's bounding volumes to geoms changed since it was compiled, whose contacts MuJoCo misses; in place."""
    fitted, solid = copy.deepcopy(model), model.geom_contype | model.geom_conaffinity
    # Geoms that collided with nothing then are in no tree of boxes, and MuJoCo refuses them here.
    late = (solid != 0) & ~np.isin(np.arange(model.ngeom), model.bvh_nodeid[: model.body_bvhnum.sum()])
    fitted.geom_contype[late] = fitted.geom_conaffinity[late] = 0
    mujoco.mj_setConst(fitted, mujoco.MjData(fitted))  # which changes other constants, too
    model.geom_rbound[:], model.geom_aabb[:], model.bvh_aabb[:] = fitted.geom_rbound, fitted.geom_aabb, fitted.bvh_aabb
    np.bitwise_or.at(model.body_contype, model.geom_bodyid, model.geom_contype)
    np.bitwise_or.at(model.body_conaffinity, model.geom_bodyid, model.geom_conaffinity)
    model.opt.disableflags |= int(late.any() and mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
