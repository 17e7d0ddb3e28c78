"""A joint motion encoded as a start of a certified universal network, with the clock that paces the network.

The network's time z follows the motion's time t by dz/dt = r(t) > 0, so that the network runs along its own orbit,
which the code bends along the motion's path. Let y = e^(-z/3), which falls from 1 to 0, evenly towards the end. Then
y^3 = 1 - w(t) with

    w'(t) = (1 - p) v(t) / length + 3 p (1 - t/T)^2 / T,

where v is the joints' speed in units of `joint_scale`, and p is 1/2, or 1 if nothing moves. The second term keeps the
clock running where the joints turn back.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.lie.se3 import continued
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.motion import joint_scale
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.planning.transition import Transition
from lieednn_sim.synthesis.shaping.encoder import CurveEncoder
from lieednn_sim.values import Floats

# Hermite's cubics, the lowest power first, from values and slopes at both ends of a step; and powers of its quarters.
_HERMITE = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-3.0, -2.0, 3.0, -1.0], [2.0, 1.0, -2.0, 1.0]])
_QUARTERS = np.linspace(0.0, 0.75, 4)[:, None] ** np.arange(4)
_AHEAD = np.array([[-1.5, 2.0, -0.5, 0.0], [2.0, -5.0, 4.0, -1.0]])  # weights of four values in two derivatives


class Clock:
    """The network's time z as a function of the time of a motion [s].

    Args:
        duration: duration of the motion [s].
        speed: ``(K,)`` speed of the joints at even times from 0 to the duration, in any unit.
    """

    def __init__(self, duration: float, speed: Floats) -> None:
        count = len(speed) - 1
        step = duration / count
        length = step * float(np.add.reduce(speed) - 0.5 * (speed[0] + speed[-1]))
        part = 0.5 if length > 0.0 else 1.0
        rate = 3.0 * part / (duration * count**2) * np.arange(count, -1.0, -1.0) ** 2
        rate += (1.0 - part) / max(length, 1e-300) * speed
        # Summed from the end, so that the small values there are exact.
        left = np.zeros(count + 1)
        np.add.accumulate((rate[1:] + rate[:-1])[::-1], out=left[-2::-1])
        y = np.cbrt(left / left[0])
        # The rate stays constant once about a ten-thousandth (0.05^3) of w is left.
        y = y[: len(y) - int(y[::-1].searchsorted(0.05))]
        slope = rate[: len(y)] / (-1.5 * left[0] * y * y)
        ends = np.array([y[:-1], slope[:-1], y[1:], slope[1:]])
        self._cubics, self._step, self._last = _HERMITE @ ends, step, step * (len(y) - 1)
        times = 0.25 * step * np.arange(4.0 * len(y) - 2.0)
        times[-1] = duration
        self._inverse = times, -np.concatenate([(_QUARTERS @ self._cubics).T.ravel(), [y[-1], 0.0]])

    def __call__(self, t: float) -> tuple[float, float]:
        """The network's time z at a time [s] of the motion, and its rate r [1/s]."""
        inside = min(t, self._last)
        k = min(int(inside / self._step), self._cubics.shape[1] - 1)
        part = inside / self._step - k
        a, b, c, d = self._cubics[:, k].tolist()
        y = a + part * (b + part * (c + part * d))
        rate = -3.0 * (b + part * (2.0 * c + part * 3.0 * d)) / (self._step * y)
        return -3.0 * math.log(y) + (t - inside) * rate, rate

    def times(self, left: Floats) -> Floats:
        """Times ``(L,)`` at which e^-z has the values ``left`` ``(L,)``; the duration for values that it never has."""
        t, y = self._inverse
        return np.interp(-np.cbrt(left), y, t)


class TimedPath:
    """A transition encoded in a universal network, which begins at a given visible state.

    Args:
        arm, encoder: the arm, and the encoder for its number of links.
        transition: the motion of the joints.
        visible: ``(N, 6)`` visible state, whose nearest configuration is the transition's first.
        most: largest distance of the network's states from those of the transition that is accepted.

    Attributes:
        state: the network's state, to be advanced.
        clock: z as a function of time.

    Raises:
        InputError: the code exceeds the encoder's range, or its states are further from the transition than ``most``.
    """

    def __init__(
        self, arm: Arm, encoder: CurveEncoder, transition: Transition, visible: Floats, most: float = np.inf
    ) -> None:
        self.transition, duration = transition, transition.duration
        speed = transition.even[1] / joint_scale(arm)
        self.clock = Clock(duration, np.sqrt(np.vecdot(speed, speed)))
        # The step of the finite differences at the start.
        h = 1e-3 * duration
        times = np.concatenate([h * np.arange(4.0), self.clock.times(encoder.levels), [duration]])
        q = transition(times, 1)[0]
        states = continued(np.concatenate([visible[None], arm.joints.twists(q) / arm.twist_units]))[1:]
        # The difference of the visible state from that of the first configuration, a mechanism gap, fades out.
        left = 1.0 - minimum_jerk_law(np.minimum(times / duration, 1.0))[0]
        states += left[:, None, None] * (visible - states[0])
        near, rest, target = states[:4], states[4:-1], states[-1]
        velocity, acceleration = (_AHEAD @ near.reshape(4, -1)).reshape(2, *visible.shape)
        (_, rate), (_, after) = self.clock(0.0), self.clock(h)
        # x'' = r^2 d^2x/dz^2 + r' dx/dz.
        along = velocity / (h * rate)
        bend = (acceleration / h**2 - (after - rate) / h * along) / rate**2
        self._encoder, self._target = encoder, target
        self._code = encoder.code_at(rest, visible, target, along, bend, most)
        self.state = encoder.still.begun(self._code, target, visible)

    @cached_property
    def network(self) -> LieEDNN:
        """The network with the code and the target of the motion."""
        return self._encoder.with_code(self._code, self._target)
