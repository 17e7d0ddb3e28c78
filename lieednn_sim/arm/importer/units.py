"""The unit of length of a foreign arm's network coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.parsing import read_chain, read_coordinates, read_joints
from lieednn_sim.lie import log

Floats = NDArray[np.float64]
_FIELD = "length_scale"


def set_length_unit(spec: Any, model: mujoco.MjModel, postures: Sequence[Floats]) -> list[str]:
    """Give a large arm a unit of length in which its joints move by no more than about one; return a remark on it.

    The activation of the network saturates at one, whatever the unit: the stroke of a crane in metres is out of its
    range, and hardly any target of it could be certified.

    Args:
        spec: changed, unless it has a custom numeric ``length_scale``.
        model: compiled from it, with the sites of the link frames.
        postures: ``(nq,)`` each.
    """
    if spec.numeric(_FIELD) is not None:
        return []
    chain = read_chain(model, "adopted")
    space = read_coordinates(model, "adopted", chain, model.qpos0)
    joints, *_ = read_joints(model, "adopted", chain, space)
    largest = float(np.abs(log(joints.poses(space.from_qpos(np.array(postures))))[..., 3:]).max())
    if largest <= 1.0:
        return []
    unit = float(f"{largest:.2g}")
    spec.add_numeric(name=_FIELD, data=[unit], size=1)
    return [f"unit of length in the network's coordinates: {unit:g} m, the furthest that a link moves"]
