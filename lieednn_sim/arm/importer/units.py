"""The unit of length of a foreign arm's network coordinates."""

from __future__ import annotations

import numpy as np

from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.arm.parsing import read_chain, read_coordinates, read_joints
from lieednn_sim.lie import log

_FIELD = "length_scale"


def set_length_unit(draft: Draft) -> None:
    """Give a large arm a unit of length in which its joints move by about one at most.

    The activation of the network saturates at one, whatever the unit: a crane's stroke in metres is beyond its range,
    and hardly any target could be certified. A custom numeric ``length_scale`` of the model stays.
    """
    if draft.spec.numeric(_FIELD) is not None:
        return
    model, postures = draft.bare, draft.postures([*draft.samples, *draft.extremes])
    chain = read_chain(model, "imported")
    space = read_coordinates(model, "imported", chain, model.qpos0)
    joints, *_ = read_joints(model, "imported", chain, space)
    largest = float(np.abs(log(joints.poses(space.from_qpos(postures)))[..., 3:]).max())
    if largest > 1.0:
        unit = float(f"{largest:.2g}")
        draft.spec.add_numeric(name=_FIELD, data=[unit], size=1)
        draft.notes.append(f"unit of length in the network's coordinates: {unit:g} m, the furthest that a link moves")


def length_unit(draft: Draft) -> float:
    """The unit of length [m] of the arm's network coordinates."""
    field = draft.spec.numeric(_FIELD)
    return 1.0 if field is None else float(field.data[0])
