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
from numpy.typing import ArrayLike

from lieednn_sim.budget import cpu_time, one_blas_thread
from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations.alignment import Demonstrations, displacement, shown_part, warp
from lieednn_sim.learning.demonstrations.family import CodeSpread, Response, with_response
from lieednn_sim.learning.demonstrations.learned import LearnedMotion, network_grid
from lieednn_sim.synthesis import Shaping, ShapingOptions, shape
from lieednn_sim.synthesis.shaping.cascade import PAIRS, codes_of, shifts
from lieednn_sim.validation import Seed, as_count, as_floats, as_generator, as_nonnegative, as_positive
from lieednn_sim.values import Floats, frozen

DEVIATION = 2e-3  # default of the requested deviation, in extents of the demonstrations
_NETWORK_TIME = 16.0  # network time, times rho, after which less than a millionth of the path is left


@frozen
class ShapedMotion(LearnedMotion):
    """A model of demonstrations: a certified network that follows their mean, with their time law.

    Attributes:
        shaping: the search that found the network of their mean.
        response: how the motion depends on its start, realised by the hidden neurons' start; None if it does not.
        spread: the distribution of the demonstrations' codes; None without a response, or with one demonstration.
        cpu_time: CPU time of the fit [s].
    """

    shaping: Shaping
    response: Response | None = None
    spread: CodeSpread | None = None
    cpu_time: float = field(default=0.0, compare=False)

    name: ClassVar[str] = "lieednn-shaped"
    durations: ClassVar[float] = 1.0

    @classmethod
    def fit(
        cls,
        demonstrations: Demonstrations,
        deviation: float | None = None,
        options: ShapingOptions | None = None,
        family: bool = True,
    ) -> ShapedMotion:
        """Shape a network to follow the mean of the demonstrations, and each of them from its own start.

        Args:
            deviation: requested deviation from their mean [m], a radian counting for their lever; by default
                `DEVIATION` times their extent. Neurons are added until it is met; see `Shaping.success`.
            family: whether the motion depends on its start, and on its goal if they are kept, as the demonstrations do
                (`family`), which takes a clock rate of 1; else deviations of the start fade as e^-t.
        """
        start = cpu_time()
        chosen = ShapingOptions() if options is None else options
        asked = DEVIATION * demonstrations.extent if deviation is None else as_positive("deviation", deviation)
        curve = displacement(demonstrations.mean)[:, None]
        shaping = shape(curve, asked, units=demonstrations.scale, options=chosen)
        times = np.array([0.0, demonstrations.duration])
        ends = np.array([0.0, _NETWORK_TIME / chosen.rate])
        shown = (demonstrations.dof, demonstrations.goal, demonstrations.mean[0])
        result = cls(shaping.network, chosen.rate, times, ends, *shown, shaping)
        result = replace(result, t=demonstrations.t, tau=result._beside(demonstrations), cpu_time=cpu_time() - start)
        if not family or chosen.rate < 1.0:
            return result
        units, extent, spread = demonstrations.scale, demonstrations.extent, None
        paths, kept = demonstrations.displaced[:, :, None], demonstrations.goals_kept
        network, response, codes = with_response(shaping, curve, paths, units[None], kept)
        if len(demonstrations) > 1 and network.start_gain is not None:
            least = np.zeros(6)
            least[shown_part(demonstrations.dof)] = DEVIATION * extent
            spread = CodeSpread.of(codes[:, 0], response.growth, units, least / units, network.activation)
        if kept:
            # Turns and positions of the mean path end near the mean goal, not at it.
            network = network.retarget(np.zeros((1, 6)))
        return replace(result, network=network, response=response, spread=spread, cpu_time=cpu_time() - start)

    @property
    def n_parameters(self) -> int:
        """The number of parameters of the mean motion's switches that are not zero by construction."""
        # Each switch has a position, a slope, and a vector.
        switches = self.shaping.network.n_hidden - self.shaping.network.n_clock
        return (4 if self.dof == 2 else 5) * switches

    def covariance(self, start: Floats, t: Floats) -> Floats:
        """Predictive covariance ``(..., K, 6, 6)`` [rad, m] of the motion about `reproduce`, in rotation and position.

        It is the covariance of the part of the demonstrations that the response does not explain, and grows with the
        distance of the start from theirs: see `CodeSpread`. It is zero at the start and at the goal.

        Args:
            start: twists ``(..., 6)``.
            t: ``(K,)`` increasing times from 0 [s].

        Raises:
            InputError: as for `reproduce`, or there is no spread.
        """
        (spread, *_), tau = self._family(), self._network_times(t)
        scale = spread.scale(self._inputs(as_floats("start", start, (6,), batched=True)))
        return scale[..., None, None, None] * spread.along(tau)

    def sample(self, start: Floats, count: int, seed: Seed = 0) -> tuple[ShapedMotion, ...]:
        """Motions drawn from the distribution from one start: the same certified network with other codes.

        The start is a twist ``(6,)``. `InputError` if a value is malformed, or there is no spread.
        """
        (spread, *_), rng = self._family(), as_generator("seed", seed)
        root = np.sqrt(spread.scale(self._inputs(as_floats("start", start, (6,))))) * spread.root
        with one_blas_thread():  # and one by one: BLAS's sums depend on its threads and the number of rows
            drawn = np.matvec(root, rng.normal(size=(as_count("count", count), root.shape[1])))
        return tuple(self._coded(code) for code in drawn)

    def condition(self, via: ArrayLike, *, fraction: float, noise: float = 0.0) -> ShapedMotion:
        """The motion through a via point with the most likely code, as a probabilistic primitive is conditioned.

        The change c of the code minimises c^T C^-1 c + |miss|^2 / noise^2, where C is the covariance of the codes. From
        other starts, and to other goals if goals were kept, the motion passes the same point, as far as bumps are
        linear in their codes. It is the same network with another start of its hidden neurons: certificate and goal
        stay, and the spread shrinks, most of all at the via point.

        Args:
            via: position ``(3,)`` relative to the goal [m], or twist ``(6,)`` where poses were recorded.
            fraction: fraction of the demonstrations' path at which it is passed, between 0 and 1.
            noise: standard deviation with which it should be passed [m], a radian counting for the demonstrations'
                lever.

        Raises:
            InputError: a value is malformed, there is no spread, or no code leads so far from the demonstrations.
        """
        spread, start_gain, reference = self._family()
        place, seen = self._via(via)
        miss = as_nonnegative("noise", noise)
        if as_positive("fraction", fraction) >= 1.0:
            raise InputError(f"fraction must be between 0 and 1, got {fraction:g}")
        tau = np.array([0.0, np.interp(fraction, np.linspace(0.0, 1.0, len(self.t)), self.tau)])
        passing: Floats = np.asarray(np.kron(spread.basis(tau[1:]), np.eye(6))[seen], dtype=float)
        deviation = np.asarray(np.linalg.norm(passing @ spread.root, axis=1))
        if not (deviation > 0.0).all():
            raise InputError(f"no code moves the motion at fraction {fraction:g}, when it is at its goal")
        noises = miss / spread.units[seen]
        gain = spread.gain(passing, noises)
        code = np.zeros(len(gain))
        # Iterated, since far from the demonstrations bumps are not linear in their codes.
        for _ in range(50):
            passed = self._coded(code)._run(reference, tau)[0, -1, seen]
            change = gain @ (place - passed + passing @ code) - code
            code = code + change
            if (np.abs(passing @ change) < 1e-4 * deviation).all():
                break
        else:
            away = np.linalg.norm((place - passed) * spread.units[seen])
            raise InputError(f"no code leads to the via point: the motion ends up {away:.3g} m from it")
        # For other starts and goals as well: the gains are changed so that the place does not move with these.
        laws = []
        for law, left in ((start_gain, np.exp(-tau[1])), (self.network.goal_gain, 1.0)):
            if law is not None:
                moved = passing @ codes_of(self.network, law.reshape(-1, 6, 6)).reshape(-1, 6)
                back = gain @ (left * np.eye(6)[seen] + moved)
                laws.append(law - shifts(self.network, back.reshape(1, PAIRS, 6, 6)).reshape(law.shape))
        return self._coded(code, spread.knowing(passing, noises), *laws)

    def _family(self) -> tuple[CodeSpread, Floats, Floats]:
        """The spread, and the network's gain and reference; or `InputError`."""
        gain, reference = self.network.start_gain, self.network.start_reference
        if self.spread is None or gain is None or reference is None:
            raise InputError("the motion has no spread: learn a family from two or more demonstrations that differ")
        return self.spread, gain, reference

    def _inputs(self, start: Floats) -> Floats:
        """Deviations ``(..., E)`` of starts, and of the goal if several were kept, from their means."""
        (spread, _, reference), place = self._family(), displacement(start)
        if len(spread.growth) == 6:
            return np.asarray(place - reference[0])
        goal = self.network.visible(self.network.equilibrium().xi)[0]
        return np.concatenate([place - reference[0] + goal, np.broadcast_to(goal, place.shape)], axis=-1)

    def _via(self, via: ArrayLike) -> tuple[Floats, slice]:
        """The displacement of a via point, and which of its coordinates it is."""
        if np.shape(via) == (6,) and self.dof == 6:
            return displacement(as_floats("via", via, (6,))), slice(0, 6)
        place = as_floats("via", via, (3,))
        # Motions in a plane leave it by the error of their fit.
        if self.dof == 2 and abs(place[2]) > 1e-2 * np.abs(place[:2]).max():
            raise InputError(f"via must be in the demonstrations' plane, with a third entry of 0, got {place[2]:g}")
        return place[: min(self.dof, 3)], slice(3, 3 + min(self.dof, 3))

    def _coded(
        self,
        code: Floats,
        spread: CodeSpread | None = None,
        start_gain: Floats | None = None,
        goal_gain: Floats | None = None,
    ) -> ShapedMotion:
        """The motion with codes ``(6M,)`` added to its own, with another spread, and with other gains if given."""
        network = self.network
        result = network.with_start(
            network.hidden_start + shifts(network, code.reshape(1, PAIRS, 6)),
            network.start_gain if start_gain is None else start_gain,
            network.start_reference,
            network.goal_gain if goal_gain is None else goal_gain,
        )
        return replace(self, network=result, spread=spread)

    def _beside(self, demonstrations: Demonstrations) -> Floats:
        """Network times ``(K,)`` that match the phases of the mean demonstration."""
        tau = network_grid(_NETWORK_TIME / self.rate, self.rate)
        shown = displacement(demonstrations.mean)
        phase, index = warp(*(path * demonstrations.scale for path in (shown, self._run(shown[:1], tau)[0]))).pairs.T
        # The mean of all times matched with a phase; the last is at rest.
        beside = np.bincount(phase, tau[index]) / np.bincount(phase)
        beside[0], beside[-1] = 0.0, tau[-1]
        return beside
