"""From a run through the filter to a motion: sampled at the model's time step, and ended exactly at the target."""

from __future__ import annotations

import numpy as np

from lieednn_sim.planning.filtering import FilteredRun
from lieednn_sim.planning.laws import minimum_jerk_law
from lieednn_sim.planning.motion import Motion
from lieednn_sim.values import Floats

# The last difference to the target is closed in this time [s].
CLOSING = 0.1


def motion_of(run: FilteredRun, target: Floats, xi_target: Floats, ratio: int) -> Motion:
    """The motion of a run that arrived, and the rest of the way to where its network ends.

    Args:
        run: with control steps of equal length.
        target: ``(n,)`` joint position to end at, near the run's last.
        xi_target: ``(N, 6)`` its network state.
        ratio: samples of the motion in a control step.
    """
    h = float(run.t[1] - run.t[0])
    step = h / ratio
    fraction = (np.arange(ratio) / ratio)[:, None]
    change = np.diff(run.qd, axis=0)[:, None]
    # Between control steps the acceleration is constant.
    qd = (run.qd[:-1, None] + fraction * change).reshape(-1, run.q.shape[1])
    q = (run.q[:-1, None] + h * fraction * run.qd[:-1, None] + 0.5 * h * fraction**2 * change).reshape(qd.shape)
    closing_q, closing_qd = _closing(run.q[-1], run.qd[-1], target, step)
    q, qd = np.concatenate([q, closing_q]), np.concatenate([qd, closing_qd])
    t = step * np.arange(len(q), dtype=np.float64)
    reference = run.reference
    clock = np.interp(t, run.t, run.clock)
    position = np.clip(np.searchsorted(reference.t, clock, side="right") - 1, 0, len(reference.t) - 2)
    share = (clock - reference.t[position]) / np.diff(reference.t)[position]

    def along(values: Floats) -> Floats:
        weight = share.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray((1.0 - weight) * values[position] + weight * values[position + 1])

    names = ("tau", "xi", "gap_translation", "gap_rotation")
    tau, xi, *gaps = (along(getattr(reference, name)) for name in names)
    return Motion(t, tau, xi, xi_target, q, qd, *gaps)


def _closing(q: Floats, qd: Floats, goal: Floats, step: float) -> tuple[Floats, Floats]:
    """From nearly at rest near the goal to rest at the goal, by the quintic whose accelerations vanish at both ends."""
    count = max(round(CLOSING / step), 2)
    s = (np.arange(count + 1) / count)[:, None]
    length = count * step
    ease, slope = minimum_jerk_law(s)
    # Position and slope of the quintic with unit slope at s = 0 and zeros else.
    start, start_slope = s * (1.0 - s) ** 3 * (1.0 + 3.0 * s), (1.0 - s) ** 2 * (1.0 + 2.0 * s - 15.0 * s**2)
    way = goal - q
    positions = q + ease * way + length * start * qd
    rates = slope * way / length + start_slope * qd
    positions[-1], rates[-1] = goal, 0.0
    return positions, rates
