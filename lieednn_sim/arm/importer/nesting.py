"""Parts of a robot that overlap by design, as the tubes of a telescope do: their contacts are ignored.

MuJoCo lets a body overlap its parent only. The third tube of a telescope sits in the first as well.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.contacts import ContactFinder
from lieednn_sim.arm.importer.draft import Draft

Floats = NDArray[np.float64]
_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
# Planned motions keep 2 mm between all that may collide; what is designed to be closer cannot be moved at all [m].
_CLOSE = 0.0025
_PARALLEL = 1e-6


def ignore_nested(draft: Draft) -> None:
    """Exclude contacts between parts of one robot that overlap, and say which.

    Stages of one telescope, bodies with nothing but parallel slides between them, overlap by design where they do at
    one of the draft's postures. Any other two bodies of one kinematic tree do where they overlap at home: no motion
    could start there.
    """
    spec, original, model = draft.spec, draft.original, draft.bare
    home, *further = draft.postures([*draft.samples, *draft.extremes])
    touching = ContactFinder(model, _CLOSE)
    start = _pairs(touching.bodies(home))
    ever = start.union(*(_pairs(touching.bodies(qpos)) for qpos in further))
    data = mujoco.MjData(model)
    data.qpos[:] = home
    mujoco.mj_kinematics(model, data)
    stages, others = [], []
    for pair in sorted(ever):
        one, other = (model.body(name).id for name in pair)
        # What is one robot the model with all joints says.
        root, same = (int(original.body_rootid[original.body(name).id]) for name in pair)
        if root != same or not root:
            continue
        if _telescopic(model, data, one, other):
            stages.append(pair)
        elif pair in start:
            others.append(pair)
    for one_name, other_name in (*stages, *others):
        spec.add_exclude(bodyname1=one_name, bodyname2=other_name)
    _drop_pairs(spec, model, {frozenset(pair) for pair in (*stages, *others)})
    draft.notes += [
        f"contacts ignored between {', '.join(f'{a!r} and {b!r}' for a, b in found)}: {why}"
        for found, why in ((stages, "stages of a telescope that overlap"), (others, "they overlap at home"))
        if found
    ]


def _pairs(contacts: Sequence[tuple[str, str]]) -> set[tuple[str, str]]:
    return {(min(pair), max(pair)) for pair in contacts}


def _telescopic(model: mujoco.MjModel, data: mujoco.MjData, one: int, other: int) -> bool:
    """Whether only slides along one line move the bodies against each other."""
    between = list(_carriers(model, one) ^ _carriers(model, other))
    if not between or any(model.jnt_type[joint] != _SLIDE for joint in between):
        return False
    axes = data.xaxis[between]
    return bool(np.all(np.abs(axes @ axes[0]) > 1.0 - _PARALLEL))


def _carriers(model: mujoco.MjModel, body: int) -> set[int]:
    """The joints that move a body against the world."""
    joints: set[int] = set()
    while body:
        joints.update(range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]))
        body = int(model.body_parentid[body])
    return joints


def _drop_pairs(spec: mujoco.MjSpec, model: mujoco.MjModel, nested: Collection[frozenset[str]]) -> None:
    """Delete the explicit contact pairs between nested bodies, which excludes don't concern."""
    for pair in list(spec.pairs):
        geoms = (model.geom(name) for name in (pair.geomname1, pair.geomname2))
        if frozenset(model.body(int(geom.bodyid[0])).name for geom in geoms) in nested:
            spec.delete(pair)
