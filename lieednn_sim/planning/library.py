"""A library of motions: one certified network, and a start of its hidden neurons for each motion."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.lie import continued
from lieednn_sim.network import DEFAULT_ACTIVATION, LieEDNN
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.network_path import NetworkPath, require_fit, timed_motion
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.synthesis import CurveEncoder
from lieednn_sim.validation import as_choice, as_floats, quoted
from lieednn_sim.values import Floats, read_only

_KIND = "motion library"
_LONGEST_NAME = 100
# Samples of the straight way of states along which the joints are followed from a motion's start to its target.
_WAY = 65


class MotionLibrary:
    """Many motions of one certified network, stored under their names.

    The network is that of `synthesis.CurveEncoder`; all motions share its weights and its certificate. A motion
    consists of its code, which is the state at which the hidden neurons start, and of the visible neurons' start and
    target.

    Args:
        n_visible: number N of visible neurons, one for each link of an arm.
        activation: a name of `network.ACTIVATIONS`.

    Attributes:
        universal: the certified network with code zero and target zero.
    """

    def __init__(self, n_visible: int, activation: str = DEFAULT_ACTIVATION) -> None:
        self._encoder = CurveEncoder(n_visible, activation)
        self.universal = self._encoder.network
        # By name: the code ``(M, 6)``, and the visible start and target ``(2, N, 6)``.
        self._motions: dict[str, tuple[Floats, Floats]] = {}

    def __repr__(self) -> str:
        return f"<MotionLibrary: {len(self._motions)} motions of {self.universal.n_visible} visible neurons>"

    @property
    def names(self) -> tuple[str, ...]:
        """The motions' names, in the order in which they were added."""
        return tuple(self._motions)

    def add(self, name: str, motion: Motion | ArrayLike, units: ArrayLike = 1.0) -> None:
        """Encode a motion, or a curve ``(K, N, 6)`` of states; one of the same name is replaced.

        Args:
            name: 1 to 100 characters.
            motion: the motion; where it goes is stored, not when.
            units: metres that one unit of each coordinate counts for, as in `CurveEncoder.encode`.

        Raises:
            InputError: a value is malformed, the curve cannot be encoded, or the library was made by a version with
                another universal network.
        """
        if not isinstance(name, str) or not 1 <= len(name) <= _LONGEST_NAME:
            raise InputError(f"name must be a text of 1 to {_LONGEST_NAME} characters, got {quoted(name)}")
        if self.universal is not self._encoder.network:
            raise InputError("this library is of a version with another universal network; add to a new one")
        curve = np.append(motion.xi[:-1], motion.xi_target[None], axis=0) if isinstance(motion, Motion) else motion
        samples = as_floats("curve", curve, ("K", self.universal.n_visible, 6))
        self._motions[name] = self._encoder.codes(samples, units), samples[[0, -1]].copy()

    def start(self, name: str) -> Floats:
        """State ``(N + M, 6)`` of all neurons at the start of a motion.

        Raises:
            InputError: there is no such motion.
        """
        code, (begin, _) = self._named(name)
        return np.concatenate([begin, code])

    def network(self, name: str) -> LieEDNN:
        """The network with a motion's code and target; from another visible start it arrives as well.

        Raises:
            InputError: there is no such motion.
        """
        code, (_, target) = self._named(name)
        return self._coded(code, target)

    def blend(self, first: str, second: str, fraction: float) -> tuple[LieEDNN, Floats]:
        """The network between two motions, and its start ``(N + M, 6)``.

        Code, start and target are those of ``first`` plus a fraction of the way to ``second``. States are nearly
        linear in codes, so at each instant the state is nearly the same blend of both motions' states.

        Args:
            first: name of a motion.
            second: name of a motion.
            fraction: from 0, the first one, to 1, the second one.

        Raises:
            InputError: there is no such motion, or the fraction is out of range.
        """
        share = float(as_floats("fraction", fraction, ()))
        if not 0.0 <= share <= 1.0:
            raise InputError(f"fraction must be from 0 to 1, got {share:g}")
        one, other = self._named(first), self._named(second)
        code, (begin, target) = (a + share * (b - a) for a, b in zip(one, other, strict=True))
        return self._coded(code, target), np.concatenate([begin, code])

    def plan(
        self,
        arm: Arm,
        name: str,
        blend: str | None = None,
        fraction: float = 0.5,
        *,
        duration: float = 4.0,
        max_time_scale: float = 3.0,
    ) -> Plan:
        """The motion of an arm along a stored path, or a blend of two, within the arm's limits and free of contact.

        It goes from rest to rest between the joint positions whose poses are nearest to the path's ends; of several,
        they are those next to the keyframe ``home``.

        Args:
            arm: an arm with as many links as the network has visible neurons.
            name: name of a motion.
            blend: name of a motion to blend with, as in `blend`.
            fraction: from 0, the first motion, to 1, the other one.
            duration: duration of the motion [s].
            max_time_scale: as for `plan`.

        Raises:
            InputError: a value is malformed, there is no such motion, the arm has another number of links, or start or
                target cannot be used.
            PlanError: the motion breaks a limit of the arm, touches something, or does not arrive.
        """
        network, state = self.blend(name, name if blend is None else blend, fraction)
        require_fit(arm, network)
        begin, goal = network.visible(state), network.bias[: network.n_visible]
        way = begin + np.linspace(0.0, 1.0, _WAY)[:, None, None] * (goal - begin)
        q = arm.decode(way, start=arm.configuration("home", "home")).q
        problem = PlanningProblem(arm, q[0], q[-1], duration, max_time_scale=max_time_scale)
        # Blended poses need not be such that the joints can take them.
        reached = continued(np.stack([goal, arm.encode(q[-1])]))[1]
        path = NetworkPath.integrate(arm, network.retarget(reached).with_start(network.hidden_start), problem.start)
        motion = in_time(timed_motion, problem, path)
        return Plan(motion, path.network, target=problem.target, planner="library")

    def switch(self, state: ArrayLike, name: str) -> tuple[LieEDNN, Floats]:
        """Change to another motion while one is running: its network, and the state ``(N + M, 6)`` to go on from.

        The visible neurons stay where they are. The hidden ones jump to where the other motion has them when as much
        of its clock has passed, so that the deviation from its path decays as e^-t. The proof of arrival holds from
        every state, so after finitely many switches the arm arrives at the last target.

        Args:
            state: ``(N + M, 6)`` state of all neurons.
            name: name of the motion to change to.

        Raises:
            InputError: there is no such motion, or the state has another shape.
        """
        network, visible = self.network(name), self.universal.n_visible
        after = as_floats("state", state, network.bias.shape).copy()
        rest = network.bias[visible:]
        # The two of a pair carry (c + delta) g and (-c + delta) g: their difference tells the clock g, whatever delta.
        now, silent = ((one - rest).reshape(visible, 2, -1) for one in (after[visible:], self.universal.hidden_start))
        left = float(np.mean((now[:, 0] - now[:, 1]) / (silent[:, 0] - silent[:, 1])))
        after[visible:] = rest + left * (network.hidden_start - rest)
        return network, after

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the network and all codes to one ``.npz`` file, atomically."""
        arrays, meta = self.universal.stored()
        codes, ends = (
            np.array([entry[k] for entry in self._motions.values()]).reshape(-1, *shape)
            for k, shape in enumerate((self.universal.hidden_start.shape, (2, self.universal.n_visible, 6)))
        )
        io.save_arrays(path, _KIND, {**arrays, "codes": codes, "ends": ends}, {**meta, "names": self.names})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> MotionLibrary:
        """Read a library; the certificate is verified again from the weights.

        Raises:
            FileError: the file cannot be read, is no library, or its certificate does not hold.
        """
        arrays, meta = io.load_arrays(path, _KIND)
        network = LieEDNN.restored(arrays, meta, path)
        codes, ends = io.take(arrays, path, "codes", "ends")
        library = cls(network.n_visible, network.activation)
        if network != library.universal:
            library.universal = network
        names, shape = meta.get("names"), (*network.hidden_start.shape,)
        if (
            not network.certified
            or not isinstance(names, list)
            or len(set(names)) != len(names)
            or codes.shape != (len(names), *shape)
            or ends.shape != (len(names), 2, network.n_visible, 6)
        ):
            raise FileError(f"{path} is not a valid motion library")
        library._motions = {
            str(name): (read_only(code), read_only(end)) for name, code, end in zip(names, codes, ends, strict=True)
        }
        return library

    def _coded(self, code: Floats, target: Floats) -> LieEDNN:
        return self.universal.retarget(target).with_start(code)

    def _named(self, name: str) -> tuple[Floats, Floats]:
        return self._motions[as_choice("name", name, self._motions)]
