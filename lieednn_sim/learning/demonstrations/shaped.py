"""A certified network shaped by demonstrations: one visible neuron, whose state is the frame's displacement.

The state is (omega, p), rotation vector and position relative to the goal: the pose is Exp(0, p) Exp(omega, 0). A
deviation of the start from the mean's start decays as e^-t in every coordinate of the state, so positions return to the
mean whatever the rotations do. With twists (omega, v) as states, where p = J(omega) v, a rotation error would also
shift the position, by about half the error times the distance to the goal.
"""

from __future__ import annotations

from dataclasses import field, replace
from typing import ClassVar

import numpy as np

from lieednn_sim.budget import cpu_time
from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations.alignment import Demonstrations, displacement, twist_of
from lieednn_sim.learning.demonstrations.family import Response, with_response
from lieednn_sim.learning.demonstrations.models import run_field
from lieednn_sim.learning.demonstrations.warping import warp
from lieednn_sim.network import LieEDNN
from lieednn_sim.synthesis import Shaping, ShapingOptions, shape
from lieednn_sim.validation import Seed, as_floats, as_positive, as_times
from lieednn_sim.values import Floats, frozen

# Default of the requested deviation, in extents of the demonstrations.
DEVIATION = 2e-3
# Network time, times rho, after which less than a millionth of the path is left; longest time step; and step in the
# fraction that the clock has left, a tenth of the width of the steepest switch.
_NETWORK_TIME, _LONGEST_STEP, _FRACTION_STEP = 16.0, 0.2, 1.0 / 600.0
# Durations of the demonstrations after which a reproduction ends, when the network has long come to rest.
_MAX_DURATIONS = 100.0
# Parameters of a switch that are not zero by construction, by dof: without rotations, halves and shifts vanish.
_PER_SWITCH = {2: 10, 3: 10, 6: 19}
# The same for a placed switch: its position, its slope, and a vector.
_PER_PLACED = {2: 4, 3: 5, 6: 5}


@frozen
class ShapedMotion:
    """A shaped network with the time law of the demonstrations.

    Attributes:
        network: certified network with one visible neuron: rotation and position relative to the goal [rad, m].
        rate: rho of its clock.
        t: ``(K,)`` times of the demonstrations' phases [s].
        tau: ``(K,)`` network times at these phases.
        dof: 2, 3 or 6.
        shaping: the search that found the network of their mean.
        response: how the motion depends on its start, realised by the hidden neurons' start; None if it does not.
        cpu_time: of the fit [s].
    """

    network: LieEDNN
    rate: float
    t: Floats
    tau: Floats
    dof: int
    shaping: Shaping
    response: Response | None = None
    cpu_time: float = field(default=0.0, compare=False)

    name: ClassVar[str] = "lieednn-shaped"
    durations: ClassVar[float] = 1.0

    @classmethod
    def fit(
        cls,
        demonstrations: Demonstrations,
        deviation: float | None = None,
        options: ShapingOptions | None = None,
        seed: Seed = 0,
        family: bool = True,
    ) -> ShapedMotion:
        """Shape a network to follow the mean of the demonstrations, and each of them from its own start.

        Args:
            demonstrations: the demonstrations.
            deviation: requested deviation from their mean [m], a radian counting for their lever; by default
                `DEVIATION` times their extent. Neurons are added until it is met; see `Shaping.success`.
            options: options of the search.
            seed: seed of its starts.
            family: whether the motion depends on its start as the demonstrations do (`family`), which takes a clock
                rate of 1; else deviations of the start fade as e^-t.
        """
        begun = cpu_time()
        chosen = ShapingOptions() if options is None else options
        asked = DEVIATION * demonstrations.extent if deviation is None else as_positive("deviation", deviation)
        curve = displacement(demonstrations.mean)[:, None]
        shaping = shape(curve, asked, units=demonstrations.scale, options=chosen, seed=seed)
        times = np.array([0.0, demonstrations.duration])
        ends = np.array([0.0, _NETWORK_TIME / chosen.rate])
        made = cls(shaping.network, chosen.rate, times, ends, demonstrations.dof, shaping)
        made = replace(made, t=demonstrations.t, tau=made._beside(demonstrations), cpu_time=cpu_time() - begun)
        if not family or chosen.rate < 1.0:
            return made
        network, response = with_response(
            shaping, curve, demonstrations.displaced[:, :, None], demonstrations.scale[None]
        )
        return replace(made, network=network, response=response, cpu_time=cpu_time() - begun)

    @property
    def n_parameters(self) -> int:
        """The number of parameters of the mean motion's switches that are not zero by construction."""
        each, network = _PER_PLACED if self.shaping.placed else _PER_SWITCH, self.shaping.network
        return each[self.dof] * (network.n_hidden - network.n_clock)

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """As `MotionModel.reproduce`: the network runs from ``start``, see `LieEDNN.start`.

        After the demonstrations' duration the network continues at its mean pace, for at most 100 durations.

        Raises:
            InputError: a value is malformed, or times do not increase from 0 or go on too long.
        """
        start = as_floats("start", start, (6,), batched=True)
        t, latest = as_times("t", t), _MAX_DURATIONS * self.t[-1]
        if t[0] < 0.0 or t[-1] > latest:
            raise InputError(f"t must be from 0 to {latest:g} s, got {t[0]:g} to {t[-1]:g} s")
        pace = self.tau[-1] / self.t[-1]
        tau = np.where(t > self.t[-1], self.tau[-1] + pace * (t - self.t[-1]), np.interp(t, self.t, self.tau))
        return twist_of(self._run(displacement(start).reshape(-1, 6), tau)).reshape(*start.shape[:-1], len(t), 6)

    def _run(self, start: Floats, tau: Floats) -> Floats:
        """Displacements ``(n, K, 6)`` at network times ``tau``, from displacements ``(n, 6)``."""
        network = self.network
        bias = network.bias.ravel()
        # Hidden neurons without inputs are many.
        heard = network.weight.any(axis=1)
        weight = network.weight[heard].T

        def field(x: Floats) -> Floats:
            driven = np.tile(bias, (len(x), 1))
            driven[:, heard] += network.phi(x) @ weight
            return -network.gamma * x + network.mu * driven

        states = np.stack([network.start(one[None]).ravel() for one in start])
        return run_field(field, states, _grid(max(tau[-1], 1.0), self.rate), tau, kept=6)

    def _beside(self, demonstrations: Demonstrations) -> Floats:
        """Network times ``(K,)`` that match the phases of the mean demonstration."""
        tau = _grid(_NETWORK_TIME / self.rate, self.rate)
        shown = displacement(demonstrations.mean)
        phase, index = warp(*(path * demonstrations.scale for path in (shown, self._run(shown[:1], tau)[0]))).pairs.T
        # The mean of all times matched with a phase; the last is at rest.
        beside = np.bincount(phase, tau[index]) / np.bincount(phase)
        beside[0], beside[-1] = 0.0, tau[-1]
        return beside


def _grid(end: float, rate: float) -> Floats:
    """Network times ``(G,)`` from 0 to ``end``, denser while its switches are steep."""
    # dt = d ln(1 / fraction) / rho in equal steps of the fraction, until the longest step.
    fractions = np.arange(1.0, _FRACTION_STEP / (_LONGEST_STEP * rate), -_FRACTION_STEP)
    first = -np.log(fractions) / rate
    first = first[first < end]
    rest = np.linspace(first[-1], end, int(np.ceil((end - first[-1]) / _LONGEST_STEP)) + 1)
    return np.concatenate([first, rest[1:]])
