"""Arms in simulations of longer steps: motions of fewer samples are planned in less time."""

import math
from functools import cache

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm


@cache
def coarse(name: str = "telescopic_pr", scene: str = "free", seed: int = 0, timestep: float = 0.01) -> Arm:
    """An arm in its scene, with this time step [s]."""
    fine = Arm.load(name)
    spec = fine.spec.copy()
    spec.option.timestep = timestep
    return Arm.from_spec(spec, fine.source, fine.name).with_scene(scene, seed)


def posted(angle: float, half: float) -> Arm:
    """`coarse` with a post at an angle of its turn [rad], of this half width [m]."""
    arm = coarse()
    spec = arm.spec.copy()
    post = spec.worldbody.add_body(name="post", pos=(0.95 * math.cos(angle), 0.95 * math.sin(angle), 1.0))
    post.add_geom(name="post", type=mujoco.mjtGeom.mjGEOM_BOX, size=(half, half, 1.0))
    return Arm.from_spec(spec, arm.source, arm.name)
