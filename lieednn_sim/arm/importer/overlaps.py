"""Parts of a robot that overlap by design, such as the tubes of a telescope: their contacts are ignored.

MuJoCo ignores contacts of a body with its parent only, and not where that is fixed to the world. But the third tube of
a telescope sits in the first as well, and a first link in its base.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from itertools import product
from typing import Any

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.checks import SLIDE, ancestry, joints_of
from lieednn_sim.arm.contacts import ContactFinder
from lieednn_sim.arm.importer.home import MARGIN
from lieednn_sim.arm.importer.loading import unused
from lieednn_sim.arm.model_arm import ModelArm
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.values import Floats, rounded

# Two ids, the smaller one first: of geoms or of bodies.
_Pair = tuple[int, int]
_Distances = Mapping[_Pair, float]
# Planned motions keep 2 mm between geoms that may collide: parts that are closer by design could not move at all [m].
_CLOSE = 0.0025
_FRACTIONS = np.linspace(0.02, 1.0, 50)  # of a range by which home is moved


def ignore_overlaps(spec: mujoco.MjSpec, arm: ModelArm, home: Floats, samples: Floats, notes: list[str]) -> Floats:
    """Ignore contacts between parts of one robot that overlap by design, and move home away from other overlaps.

    Four kinds of bodies overlap by design: those that overlap at home and that the arm does not move apart, such as
    fingers; stages of one telescope (with only parallel slides between them) that overlap anywhere; neighbours (with
    one coordinate between them) that overlap at home; and bodies that overlap at every configuration, of which only the
    geoms that always overlap are ignored, if there are any. Where other bodies overlap at home, the nearest free
    configuration becomes home, since no motion could start; if none is found, contacts of the geoms that overlap there
    are ignored. The spec, that of the arm with nothing ignored, is changed; ``samples`` are random configurations
    ``(S, n)``. Returns home ``(n,)``, moved if need be.
    """
    overlaps = _Overlaps(arm, home)
    bodies = overlaps.bodies
    slides = np.array([unit == "m" for unit in arm.space.units])
    extremes = [np.where(slides, ends, home) for ends in arm.position_limits.T]
    seen = [overlaps.at(qpos) for qpos in arm.qpos(np.array([home, *samples, *extremes]), strict=False)]
    nearest: dict[_Pair, float] = {}
    ignored: dict[_Pair, set[_Pair]] = {}
    reasons: dict[str, list[str]] = {}
    for solution in (*seen, fixed := overlaps.unmoved()):
        for geoms, distance in solution.items():
            nearest[geoms] = min(distance, nearest.get(geoms, np.inf))

    def ignore(pair: _Pair, chosen: set[_Pair], why: str) -> None:
        ignored[pair] = ignored.get(pair, set()) | chosen
        deepest = min(nearest[geoms] for geoms in chosen & set(nearest))
        reasons.setdefault(why, []).append(f"{overlaps.names(pair)} ({_depth(deepest)})")

    for pair in sorted(set(map(bodies, nearest)), key=overlaps.names):
        near = [{geoms for geoms in result if bodies(geoms) == pair} for result in seen]
        always = set.intersection(*near)
        still = {geoms for geoms in fixed if bodies(geoms) == pair}
        if still:
            ignore(pair, still, "they overlap, and the arm does not move them apart")
        elif overlaps.telescopic(pair):
            ignore(pair, overlaps.geoms(pair), "stages of a telescope that overlap")
        elif near[0] and overlaps.neighbours(pair):
            ignore(pair, overlaps.geoms(pair), "neighbours that overlap at home")
        elif all(near):
            ignore(pair, always or overlaps.geoms(pair), "they overlap in every configuration")

    def collisions(q: Floats) -> _Distances:
        found = overlaps.at(arm.qpos(q, strict=False))
        return {geoms: d for geoms, d in found.items() if geoms not in ignored.get(bodies(geoms), ())}

    at_home = collisions(home)
    if at_home:
        touching = {pair: min(d for g, d in at_home.items() if bodies(g) == pair) for pair in map(bodies, at_home)}
        shown = ", ".join(f"{overlaps.names(pair)} ({_depth(depth)})" for pair, depth in touching.items())
        free = next((q for q in _nearby(arm, home, samples) if not collisions(q)), None)
        if free is None:
            for pair in touching:
                chosen = {geoms for geoms in at_home if bodies(geoms) == pair}
                ignore(pair, chosen, "they overlap at home, and no configuration near it is free")
        else:
            places = zip(arm.joint_names, home, free, strict=True)
            moved = [f"{name} from {before:.3g} to {after:.3g}" for name, before, after in places if before != after]
            notes.append(f"home moved, since {shown} collide there: {', '.join(moved)}")
            home = free
    _exclude(spec, overlaps, ignored)
    notes += [f"contacts ignored between {', '.join(result)}: {why}" for why, result in reasons.items()]
    return home


class _Overlaps:
    """Parts of one robot that come closer to each other than `_CLOSE`."""

    def __init__(self, arm: ModelArm, home: Floats) -> None:
        self.model, self._arm, self._home = arm.model, arm, home
        self._finder = arm.contact_finder(_CLOSE)
        self._data = kinematics_at(arm.model, arm.qpos(home))
        self._moved = {int(arm.model.dof_jntid[dof]) for dof in arm.dofs}
        # For each coordinate, the joints that it moves.
        rates = arm.unit_rates(home).T
        self._movers = [{int(arm.model.dof_jntid[dof]) for dof in np.flatnonzero(row)} for row in rates]

    def at(self, qpos: Floats) -> _Distances:
        """Pairs of geoms of one robot that are near each other, and their distances [m]; none where loops are open."""
        return {} if np.isnan(qpos).any() else self._of_one_robot(*self._finder.geoms(qpos))

    def unmoved(self) -> _Distances:
        """Pairs that overlap at home and that the arm does not move against each other."""
        group = moved_together(self.model, self._arm.dofs)
        found = self._of_one_robot(*ContactFinder(self.model).geoms(self._arm.qpos(self._home)))
        return {geoms: d for geoms, d in found.items() if len({int(group[body]) for body in self.bodies(geoms)}) == 1}

    def _of_one_robot(self, distances: Floats, pairs: Any) -> dict[_Pair, float]:
        near: dict[_Pair, float] = {}
        root = self.model.body_rootid
        for distance, result in zip(distances, pairs, strict=True):
            geoms = _pair(*result)
            first, second = self.bodies(geoms)
            if min(result) >= 0 and root[first] and root[first] == root[second]:  # not a flex, whose id is -1
                near[geoms] = min(float(distance), near.get(geoms, np.inf))
        return near

    def bodies(self, geoms: _Pair) -> _Pair:
        """The bodies of two geoms."""
        return _pair(*self.model.geom_bodyid[list(geoms)])

    def geoms(self, pair: _Pair) -> set[_Pair]:
        """All geoms of two bodies that may collide, in pairs."""
        model = self.model
        mine, others = (range(model.body_geomadr[b], model.body_geomadr[b] + model.body_geomnum[b]) for b in pair)
        kind, affinity = model.geom_contype, model.geom_conaffinity
        return {_pair(g, h) for g, h in product(mine, others) if kind[g] & affinity[h] or kind[h] & affinity[g]} | {
            geoms for geoms in map(_pair, model.pair_geom1, model.pair_geom2) if self.bodies(geoms) == pair
        }

    def names(self, pair: _Pair) -> str:
        """Names of two bodies, for a note."""
        first, second = sorted(self.model.body(body).name for body in pair)
        return f"{first!r} and {second!r}"

    def telescopic(self, pair: _Pair) -> bool:
        """Whether only slides along one line move the bodies against each other."""
        between = self._between(pair)
        if not between or any(self.model.jnt_type[joint] != SLIDE for joint in between):
            return False
        axes = self._data.xaxis[between]
        return bool(np.all(np.abs(axes @ axes[0]) > 1.0 - 1e-6))

    def neighbours(self, pair: _Pair) -> bool:
        """Whether a single coordinate moves the bodies against each other."""
        between = set(self._between(pair))
        # Three coordinates of a ball move the same joint.
        return len({frozenset(joints) for joints in self._movers if joints & between}) == 1

    def _between(self, pair: _Pair) -> list[int]:
        """The joints of the arm, followers included, that move just one of the bodies against the world."""
        model = self.model
        first, second = ({joint for b in ancestry(model, body) for joint in joints_of(model, b)} for body in pair)
        return sorted((first ^ second) & self._moved)


def _nearby(arm: ModelArm, home: Floats, samples: Floats) -> Iterator[Floats]:
    """Configurations well off the limits, nearest to home first: one joint moved, then on lines to random samples."""
    low, high = arm.position_limits.T
    middle = 0.5 * (low + high)
    scalar = [k for k in range(arm.n_joints) if k not in arm.space.balls]
    for fraction, k, side in product(_FRACTIONS, scalar, (-1.0, 1.0)):
        q = home.copy()
        q[k] += side * fraction * (high[k] - low[k])
        if abs(q[k] - middle[k]) <= (0.5 - MARGIN) * (high[k] - low[k]):
            yield q
    for fraction, sample in product(_FRACTIONS, samples):
        yield home + fraction * (middle + (1.0 - 2.0 * MARGIN) * (sample - middle) - home)


def _exclude(spec: mujoco.MjSpec, overlaps: _Overlaps, ignored: Mapping[_Pair, Collection[_Pair]]) -> None:
    """Exclude pairs of bodies; MuJoCo cannot exclude single geoms, so the bodies' other geoms become explicit pairs."""
    model = overlaps.model
    kept = {geoms for pair, gone in ignored.items() for geoms in overlaps.geoms(pair) - set(gone)}
    names = {geom.name for geom in spec.geoms}
    # By name: a spec forgets the ids of a compiled model as soon as something is added to it.
    for geom in spec.geoms:
        if not geom.name and any(geom.id in geoms for geoms in kept):
            geom.name = unused(f"{geom.parent.name}_geom{geom.id}", names)
            names.add(geom.name)
    name = {geom.id: geom.name for geom in spec.geoms}
    explicit = set()
    for pair in list(spec.pairs):
        geoms = _pair(*(model.geom(geom).id for geom in (pair.geomname1, pair.geomname2)))
        explicit.add(geoms)
        if geoms in ignored.get(overlaps.bodies(geoms), ()):
            spec.delete(pair)
    for first, second in ignored:
        spec.add_exclude(bodyname1=model.body(first).name, bodyname2=model.body(second).name)
    for first, second in sorted(kept - explicit):
        spec.add_pair(geomname1=name[first], geomname2=name[second], **_contact(model, [first, second]))


def _contact(model: mujoco.MjModel, geoms: list[int]) -> dict[str, Any]:
    """Parameters of an explicit pair that make it touch as the two geoms would by MuJoCo's own rule for contacts.

    The geom of higher priority decides; at equal priority the larger dimension and friction count, and of the rest the
    mean weighted by `solmix`, unless a stiffness is given directly. NaN lets the compiler take the geoms' values.
    """
    ranks = model.geom_priority[geoms]
    deciding = np.array(geoms)[ranks == ranks.max()]
    weights = model.geom_solmix[deciding] + mujoco.mjMINVAL
    weights = weights / weights.sum()
    reference = model.geom_solref[deciding]
    direct = bool((reference[:, 0] <= 0.0).any())
    return {
        "condim": int(model.geom_condim[deciding].max()),
        "friction": model.geom_friction[deciding].max(axis=0)[[0, 0, 1, 2, 2]],
        "solref": reference.min(axis=0) if direct else weights @ reference,
        "solimp": weights @ model.geom_solimp[deciding],
        "margin": np.nan,
        "gap": np.nan,
    }


def _pair(first: int, second: int) -> _Pair:
    return min(int(first), int(second)), max(int(first), int(second))


def _depth(distance: float) -> str:
    return f"{rounded(1e3 * abs(distance))} mm {'deep' if distance < 0.0 else 'apart'}"
