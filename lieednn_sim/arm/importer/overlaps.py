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
from lieednn_sim.arm.checks import ancestry, joints_of
from lieednn_sim.arm.contacts import ContactFinder
from lieednn_sim.arm.importer.configurations import MARGIN, place_home
from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.arm.importer.loading import unused
from lieednn_sim.values import Floats

# Two ids, the smaller one first: of geoms or of bodies.
_Pair = tuple[int, int]
_Distances = Mapping[_Pair, float]
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
# Planned motions keep 2 mm between geoms that may collide: parts that are closer by design could not move at all [m].
_CLOSE = 0.0025
_FRACTIONS = np.linspace(0.02, 1.0, 50)  # of a range by which home is moved


def ignore_overlaps(draft: Draft) -> None:
    """Ignore contacts between parts of one robot that overlap by design, and move home away from other overlaps.

    Three kinds of bodies overlap by design: stages of one telescope (with only parallel slides between them) that
    overlap at any of the draft's configurations; neighbours (with one coordinate between them) that overlap at home;
    and bodies that overlap at every configuration, of which only the geoms that always overlap are ignored, if there
    are any. Where other bodies overlap at home, the nearest free configuration becomes home, since no motion could
    start; if none is found, contacts of the geoms that overlap there are ignored.
    """
    overlaps = _Overlaps(draft)
    bodies = overlaps.bodies
    seen = [overlaps.at(qpos) for qpos in draft.configurations([*draft.samples, *draft.extremes])]
    nearest: dict[_Pair, float] = {}
    for solution in seen:
        for geoms, distance in solution.items():
            nearest[geoms] = min(distance, nearest.get(geoms, np.inf))
    ignored: dict[_Pair, set[_Pair]] = {}
    reasons: dict[str, list[str]] = {}

    def ignore(pair: _Pair, chosen: set[_Pair], why: str) -> None:
        ignored[pair] = ignored.get(pair, set()) | chosen
        deepest = min(nearest[geoms] for geoms in chosen & set(nearest))
        reasons.setdefault(why, []).append(f"{overlaps.names(pair)} ({_depth(deepest)})")

    for pair in sorted(set(map(bodies, nearest)), key=overlaps.names):
        near = [{geoms for geoms in result if bodies(geoms) == pair} for result in seen]
        always = set.intersection(*near)
        if overlaps.telescopic(pair):
            ignore(pair, overlaps.geoms(pair), "stages of a telescope that overlap")
        elif near[0] and overlaps.neighbours(pair):
            ignore(pair, overlaps.geoms(pair), "neighbours that overlap at home")
        elif all(near):
            ignore(pair, always or overlaps.geoms(pair), "they overlap in every configuration")

    def collisions(qpos: Floats) -> _Distances:
        return {geoms: d for geoms, d in overlaps.at(qpos).items() if geoms not in ignored.get(bodies(geoms), ())}

    at_home = collisions(draft.configurations(draft.samples[:1])[0])
    if at_home:
        touching = {pair: min(d for g, d in at_home.items() if bodies(g) == pair) for pair in map(bodies, at_home)}
        shown = ", ".join(f"{overlaps.names(pair)} ({_depth(depth)})" for pair, depth in touching.items())
        home = next((q for q in _nearby(draft) if not collisions(draft.configurations([q])[0])), None)
        if home is None:
            for pair in touching:
                chosen = {geoms for geoms in at_home if bodies(geoms) == pair}
                ignore(pair, chosen, "they overlap at home, and no configuration near it is free")
        else:
            before = draft.samples[0]
            moved = [
                f"{draft.original.joint(joint).name} from {_listed(before[joint])} to {_listed(q)}"
                for joint, q in home.items()
                if not np.array_equal(q, before[joint])
            ]
            draft.notes.append(f"home moved, since {shown} collide there: {', '.join(moved)}")
            place_home(draft, home)
    _exclude(draft, overlaps, ignored)
    draft.notes += [f"contacts ignored between {', '.join(result)}: {why}" for why, result in reasons.items()]


class _Overlaps:
    """Parts of one robot that come closer to each other than `_CLOSE`."""

    def __init__(self, draft: Draft) -> None:
        self._draft, self._model = draft, draft.bare
        self._finder = ContactFinder(draft.bare, _CLOSE)
        self._data = kinematics_at(draft.bare, draft.configurations(draft.samples[:1])[0])
        original = draft.original
        names = [draft.bare.body(body).name for body in range(draft.bare.nbody)]
        # The original model, with all joints, tells which bodies are one robot.
        self._robot = [int(original.body_rootid[original.body(name).id]) for name in names]

    def at(self, qpos: Floats) -> _Distances:
        """Pairs of geoms of one robot that are near each other, and their distances [m]."""
        near: dict[_Pair, float] = {}
        for distance, result in zip(*self._finder.geoms(qpos), strict=True):
            geoms = _pair(*result)
            first, second = self.bodies(geoms)
            if self._robot[first] and self._robot[first] == self._robot[second]:
                near[geoms] = min(float(distance), near.get(geoms, np.inf))
        return near

    def bodies(self, geoms: _Pair) -> _Pair:
        """The bodies of two geoms."""
        return _pair(*self._model.geom_bodyid[list(geoms)])

    def geoms(self, pair: _Pair) -> set[_Pair]:
        """All geoms of two bodies that may collide, in pairs."""
        model = self._model
        mine, others = (range(model.body_geomadr[b], model.body_geomadr[b] + model.body_geomnum[b]) for b in pair)
        kind, affinity = model.geom_contype, model.geom_conaffinity
        return {_pair(g, h) for g, h in product(mine, others) if kind[g] & affinity[h] or kind[h] & affinity[g]} | {
            geoms for geoms in map(_pair, model.pair_geom1, model.pair_geom2) if self.bodies(geoms) == pair
        }

    def names(self, pair: _Pair) -> str:
        """Names of two bodies, for a note."""
        first, second = sorted(self._model.body(body).name for body in pair)
        return f"{first!r} and {second!r}"

    def telescopic(self, pair: _Pair) -> bool:
        """Whether only slides along one line move the bodies against each other."""
        between = self._between(pair)
        if not between or any(self._model.jnt_type[joint] != _SLIDE for joint in between):
            return False
        axes = self._data.xaxis[between]
        parallel = 1e-6
        return bool(np.all(np.abs(axes @ axes[0]) > 1.0 - parallel))

    def neighbours(self, pair: _Pair) -> bool:
        """Whether a single coordinate moves the bodies against each other."""
        original = self._draft.original
        joints = (original.joint(self._model.joint(joint).name).id for joint in self._between(pair))
        return len({self._draft.couplings.leader(joint) for joint in joints}) == 1

    def _between(self, pair: _Pair) -> list[int]:
        """The joints that move just one of the bodies against the world."""
        model = self._model
        first, second = ({joint for b in ancestry(model, body) for joint in joints_of(model, b)} for body in pair)
        return sorted(first ^ second)


def _nearby(draft: Draft) -> Iterator[dict[int, Floats]]:
    """Configurations away from the limits, nearest to home first: one joint moved, then on lines to random ones."""
    home = draft.samples[0]
    scalar = [joint for joint in draft.independent if not draft.is_ball(joint)]
    for fraction, joint, side in product(_FRACTIONS, scalar, (-1.0, 1.0)):
        low, high = draft.ranges[joint]
        value = home[joint] + side * fraction * (high - low)
        if abs(value[0] - 0.5 * (low + high)) <= (0.5 - MARGIN) * (high - low):
            yield {**home, joint: value}
    for fraction, sample in product(_FRACTIONS, draft.samples[1:]):
        middle = {joint: 0.0 if draft.is_ball(joint) else np.mean(draft.ranges[joint]) for joint in home}
        inside = {joint: m + (1.0 - 2.0 * MARGIN) * (sample[joint] - m) for joint, m in middle.items()}
        yield {joint: q + fraction * (inside[joint] - q) for joint, q in home.items()}


def _exclude(draft: Draft, overlaps: _Overlaps, ignored: Mapping[_Pair, Collection[_Pair]]) -> None:
    """Exclude pairs of bodies; MuJoCo cannot exclude single geoms, so the bodies' other geoms become explicit pairs."""
    spec, model = draft.spec, draft.bare
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
    return f"{1e3 * abs(distance):.3g} mm {'deep' if distance < 0.0 else 'apart'}"


def _listed(values: Floats) -> str:
    return " ".join(f"{value:.3g}" for value in values)
