"""The closed loop: a simulated arm behind anything that leads it, from what it sees of the arm and of the target."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.motion import count_steps
from lieednn_sim.simulation.disturbances import Disturbances
from lieednn_sim.simulation.log import ChannelSource, Log
from lieednn_sim.simulation.reference import Reference
from lieednn_sim.simulation.rollout import Rollout, as_rollout
from lieednn_sim.simulation.simulation import QuietWarnings, Simulation
from lieednn_sim.simulation.tracking import make_controlled
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats


def closed_loop(
    arm: Arm,
    lead: Callable[[Floats, Simulation], tuple[Floats, Floats]],
    target: Callable[[float], ArrayLike] | ArrayLike,
    duration: float,
    *,
    start: Floats,
    period: int,
    controller: str,
    disturbances: Disturbances | None = None,
    sources: Sequence[ChannelSource] = (),
) -> tuple[Rollout, Floats]:
    """Run the simulated arm behind anything that leads it; returns the rollout and the target ``(K, n)`` at its times.

    Args:
        arm: the arm.
        lead: called at every control period with the target's sample ``(n,)`` and the simulation, which it may
            measure; gives joint coordinates and rates ``(m, n)`` to follow after each of the period's m steps.
        target: as of `follow`.
        duration: [s].
        start: joint coordinates ``(n,)`` at rest.
        period: m.
        controller: a name of `CONTROLLERS`.
        disturbances: what the controller does not know of.
        sources: of more channels of the rollout.

    Raises:
        InputError: a value is malformed, or the target leaves the position limits.
        SimulationError: as `simulate`.
    """
    timestep = arm.timestep
    total = count_steps(duration, timestep) + 1
    changes = Disturbances() if disturbances is None else disturbances
    reference = Reference(arm, total)
    reference.extend(start[None], np.zeros((1, arm.n_joints)))
    driver, simulation = make_controlled(arm, controller, reference, changes)
    simulation.reset(start)
    sample = _sampler(arm, target, timestep)
    log, targets = Log(simulation, driver, *sources), []
    with QuietWarnings():
        for k in range(total):
            targets.append(sample(k))
            if k % period == 0:
                reference.extend(*lead(targets[-1], simulation))
            driver.act(simulation.data, k, simulation.noise)
            log.step()
    end = (total - 1) * timestep
    rollout = as_rollout(
        arm, log, reference.q, reference.qd, motion_end=end, controller=controller, disturbances=changes
    )
    return rollout, np.array(targets)


def _sampler(arm: Arm, target: Callable[[float], ArrayLike] | ArrayLike, timestep: float) -> Callable[[int], Floats]:
    """The target ``(n,)`` at a simulation step, checked against the position limits."""
    samples = None if callable(target) else as_floats("target", target, ("M", arm.n_joints))

    def sample(k: int) -> Floats:
        value = samples[min(k, len(samples) - 1)] if samples is not None else target(k * timestep)  # type: ignore[operator]
        return arm.check_position(value, f"the target at t = {k * timestep:.3f} s")

    if samples is not None and len(samples) == 0:
        raise InputError("target must hold at least one sample")
    return sample
