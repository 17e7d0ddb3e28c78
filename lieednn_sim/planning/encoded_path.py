"""The path of an arm that follows a universal network, in closed form: nothing is integrated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, CubicHermiteSpline, PchipInterpolator, make_interp_spline

from lieednn_sim.arm import Arm
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.network_path import NetworkPath
from lieednn_sim.planning.time_laws import Law, step_lengths
from lieednn_sim.synthesis import CurveEncoder
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats

# Joints are decoded at every third instant of the closed form, and beyond this w, where instants become denser, at all.
_STRIDE, _DENSE = 3, 0.95
# Degree of the spline through them, which is good to a micrometre.
_DEGREE = 5


@dataclass(frozen=True, eq=False)
class EncodedPath(NetworkPath):
    """The path of an arm that follows a universal network (`synthesis.CurveEncoder`) with a code.

    Positions on it are w = 1 - e^-tau, in which it is smooth to its end.

    Attributes:
        trajectory: visible states ``(..., N, 6)`` and the speed along them, both as functions of w.
        joints: joint positions ``(..., n)`` as a function of w, decoded at instants of the closed form.
    """

    trajectory: tuple[CubicHermiteSpline, PchipInterpolator]
    joints: BSpline

    @classmethod
    def follow(
        cls,
        arm: Arm,
        encoder: CurveEncoder,
        network: LieEDNN,
        guide: Motion,
        units: Floats,
    ) -> EncodedPath:
        """The path of a network of ``encoder`` from the start of a motion that it follows.

        Args:
            arm: decodes states to joint positions.
            encoder: the encoder.
            network: its network, with the code of a curve.
            guide: the motion, whose joint positions are the guesses from which the path is decoded.
            units: ``(N, 6)`` units of the visible neurons' coordinates in the path's length, as in
                `NetworkPath.integrate`.

        Raises:
            InputError: the network is none of the encoder's.
        """
        origin = network.start(guide.xi[0])
        visible = encoder.path(network, network.visible(origin))
        w = visible.x
        target = network.goal(network.bias[: network.n_visible])
        speed = PchipInterpolator(w, np.linalg.norm(visible(w, 1) * units, axis=(-2, -1)))
        some = w[(np.arange(len(w)) % _STRIDE == 0) | (w > _DENSE)]
        # Both paths have about the same length.
        passed, length = np.append(0.0, np.cumsum(step_lengths(guide.xi, units))), speed.antiderivative()(some)
        near = np.stack([np.interp(length, passed, joint) for joint in guide.q.T], axis=1)
        joints = make_interp_spline(some, arm.decode(visible(some), start=near).q, _DEGREE)
        return cls(arm, network, guide.q[0], origin, target, (visible, speed), joints)

    def state(self, tau: ArrayLike) -> Floats:
        """States ``(..., N, 6)`` of all neurons at the network's own times ``(...)``, up to the path's end."""
        visible, fading = self.trajectory[0], np.exp(-as_floats("tau", tau, (), batched=True))
        states = self.target + fading[..., None, None] * (self.origin - self.target)
        states[..., : self.network.n_visible, :] = visible(np.minimum(1.0 - fading, visible.x[-1]))
        return states

    def _timed(self, duration: float, timestep: float, law: Law) -> Motion:
        t, w, rate = self._positions(duration, timestep, law)
        xi, q, qd = self.trajectory[0](w), self.joints(w), self.joints(w, 1) * rate[:, None]
        qd[[0, -1]] = 0.0
        return Motion(t, -np.log1p(-w), xi, self.network.visible(self.target), q, qd, *self.arm.gap(xi, q))
