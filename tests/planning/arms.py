"""Arms in simulations of longer steps: motions of fewer samples are planned in less time."""

from functools import cache

from lieednn_sim.arm import Arm


@cache
def coarse(name: str = "telescopic_pr", scene: str = "free", seed: int = 0, timestep: float = 0.01) -> Arm:
    """An arm in its scene, with this time step [s]."""
    fine = Arm.load(name)
    spec = fine.spec.copy()
    spec.option.timestep = timestep
    return Arm.from_spec(spec, fine.source, fine.name).with_scene(scene, seed)
