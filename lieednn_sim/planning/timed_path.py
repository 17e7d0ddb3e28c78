"""A motion of the joints as a code of a certified universal network, with the clock that paces it.

The network's time z follows the motion's time t by dz/dt = r(t) > 0, so that the network runs along its own orbit,
which the code bends along the motion's path. With y = e^(-z/3), which falls from 1 to 0 evenly towards the end,
y^3 = 1 - w(t) and

    w'(t) = (1 - p) v(t) / length + 3 p (1 - t/T)^2 / T,

where v is the joints' speed in their units. The second part keeps the clock running where the joints turn back.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.lie import continued
from lieednn_sim.network.stepping import UndrivenState
from lieednn_sim.planning.joint_space import joint_scale
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.planning.transition import Transition
from lieednn_sim.synthesis.shaping.encoder import CurveEncoder
from lieednn_sim.values import Floats


class Clock:
    """The network's time z as a function of the time of a motion [s].

    Args:
        t: ``(K,)`` even times from 0 to the duration.
        speed: ``(K,)`` speed of the joints at these times, in any unit.
    """

    def __init__(self, t: Floats, speed: Floats) -> None:
        s, duration = t / t[-1], float(t[-1])
        length = float(np.trapezoid(speed, t))
        part = 0.5 if length > 0.0 else 1.0
        rate = 3.0 * part * (1.0 - s) ** 2 / duration + (1.0 - part) * speed / max(length, 1e-300)
        steps = 0.5 * (rate[1:] + rate[:-1]) * (t[1] - t[0])
        # Summed from the end, where what is left is small.
        left = np.append(np.cumsum(steps[::-1])[::-1], 0.0)
        y = np.cbrt(left / left[0])
        # The rate stays as it is where a ten-thousandth of the way is left.
        kept = slice(int(np.flatnonzero(y >= 0.05)[-1]) + 1)
        self._y = CubicHermiteSpline(t[kept], y[kept], -rate[kept] / left[0] / (3.0 * y[kept] ** 2))
        self._rate = self._y.derivative()
        self._last = float(t[kept][-1])
        times = np.linspace(0.0, self._last, 4 * len(t))
        self._inverse = np.append(times, duration), np.append(self._y(times), 0.0)
        self._last_rate = self._rate_at(self._last)

    def _rate_at(self, t: float) -> float:
        return -3.0 * float(self._rate(t)) / float(self._y(t))

    def __call__(self, t: float) -> tuple[float, float]:
        """The network's time z at a time, and its rate r [1/s]."""
        inside = min(t, self._last)
        rate = self._last_rate if t > self._last else self._rate_at(inside)
        return -3.0 * math.log(float(self._y(inside))) + (t - inside) * rate, rate

    def times(self, left: Floats) -> Floats:
        """Times ``(F,)`` at which e^-z is ``(F,)``; the duration where it is never."""
        t, y = self._inverse
        return np.interp(-np.cbrt(left), -y, t)


class TimedPath:
    """A transition that a universal network makes, from its visible state on.

    Args:
        arm, encoder: the arm, and the encoder for its number of links.
        transition: the motion of the joints.
        visible: ``(N, 6)`` visible state, whose nearest configuration is the transition's first.

    Attributes:
        state: the network's state, from now on.
        clock: z as a function of time.

    Raises:
        InputError: the code exceeds the encoder's range.
    """

    def __init__(self, arm: Arm, encoder: CurveEncoder, transition: Transition, visible: Floats) -> None:
        self.transition, duration = transition, transition.duration
        t = np.linspace(0.0, duration, 129)
        _, qd, _ = transition(t)
        self.clock = Clock(t, np.linalg.norm(qd / joint_scale(arm), axis=1))
        # For differences at the start.
        h = 1e-3 * duration
        times = np.concatenate([h * np.arange(4), self.clock.times(encoder.levels), [duration]])
        q, _, _ = transition(times)
        states = continued(np.concatenate([visible[None], arm.encode(q)]))[1:]
        # What the state lacks of a configuration, a mechanism gap, fades.
        left = 1.0 - minimum_jerk_law(np.clip(times / duration, 0.0, 1.0))[0]
        states += left[:, None, None] * (visible - states[0])
        near, rest, target = states[:4], states[4:-1], states[-1]
        velocity = (-1.5 * near[0] + 2.0 * near[1] - 0.5 * near[2]) / h
        acceleration = (2.0 * near[0] - 5.0 * near[1] + 4.0 * near[2] - near[3]) / h**2
        (_, rate), (_, after) = self.clock(0.0), self.clock(h)
        # x'' = r^2 d^2x/dz^2 + r' dx/dz.
        along = velocity / rate
        bend = (acceleration - (after - rate) / h * along) / rate**2
        self.network = encoder.encode_at(rest, visible, target, along, bend)
        self.state = UndrivenState(self.network, visible)
