"""A learned motion of a frame: a certified network with one visible neuron, and the recordings' time law.

The network's state is the frame's displacement (omega, p) from the goal: the pose is Exp(0, p) Exp(omega, 0).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim import io
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.learning.demonstrations.alignment import displacement, from_goal, in_world
from lieednn_sim.learning.demonstrations.models import run_field
from lieednn_sim.learning.demonstrations.recording import as_dof
from lieednn_sim.lie.se3 import transforms, twist_of
from lieednn_sim.network import LieEDNN
from lieednn_sim.synthesis import ShapingOptions
from lieednn_sim.validation import as_floats, as_path, as_times
from lieednn_sim.values import Floats, StrPath, frozen

# Longest time step, and step in the fraction that the clock has left, a tenth of the width of the steepest switch.
_LONGEST_STEP, _FRACTION_STEP = 0.2, 1.0 / 600.0


@frozen
class LearnedMotion:
    """A motion of a frame to a goal, such as `lieednn-sim learn` writes.

    Attributes:
        network: certified network with one visible neuron: rotation and position relative to the goal [rad, m].
        rate: rho of its clock.
        t: ``(K,)`` times of the demonstrations' phases [s].
        tau: ``(K,)`` network times at these phases.
        dof: 2, 3 or 6.
        goal: mean world pose at which the demonstrations end.
        start: ``(6,)`` mean twist at which the demonstrations begin, relative to the goal.
    """

    network: LieEDNN
    rate: float
    t: Floats
    tau: Floats
    dof: int
    goal: RigidTransform
    start: Floats

    def __repr__(self) -> str:
        shown = "poses" if self.dof == 6 else "positions"
        return f"<{type(self).__name__}: {shown} over {self.t[-1]:.3g} s to {self.goal.translation.round(3)} m>"

    @classmethod
    def load(cls, directory: StrPath) -> LearnedMotion:
        """Read a motion, without a spread, from a directory of `lieednn-sim learn`; `FileError` if it holds none."""
        path = as_path("the directory of a learned motion", directory) / "report.json"
        if not io.is_file(path):
            raise FileError(f"{path.parent} holds no learned motion (no report.json), as 'lieednn-sim learn' writes")
        report = io.load_json(path, "report.json of a learned motion of an end effector")
        try:
            goal = transforms(
                Rotation.from_quat(report["goal_quaternion_wxyz"], scalar_first=True).as_matrix(),
                as_floats("goal_position_m", report["goal_position_m"], (3,)),
            )
            t, tau = (as_times(name, report[name]) for name in ("t_s", "tau"))
            start = as_floats("start_twist", report["start_twist"], (6,))
            known = (ShapingOptions(report["clock_rate"]).rate, t, tau, as_dof(report["dof"]))
        except (KeyError, TypeError, ValueError) as error:
            raise FileError(f"{path} is no report of a learned motion of an end effector: {error!r}") from None
        return cls(LieEDNN.load(path.with_name("network.npz")), *known, goal, start)

    def poses(self, start: RigidTransform | None = None, goal: RigidTransform | None = None) -> RigidTransform:
        """World poses ``(K,)`` of the motion at the times `t`.

        Args:
            start: world pose of the frame at the start, by default that of the demonstrations, from which it then turns
                to the goal as they do, also by more than half a turn; its rotation is ignored if none were recorded.
            goal: world pose at the end, by default that of the demonstrations.
        """
        for name, pose in (("start", start), ("goal", goal)):
            if pose is not None:
                as_floats(f"the translation of {name}", pose.translation, (3,))
        end = self.goal if goal is None else goal
        begin = self.start if start is None else from_goal(start, end, self.start[:3])
        if start is not None and self.dof < 6:
            begin = np.append(np.zeros(3), start.translation - end.translation)
        return in_world(self.reproduce(begin, self.t), end)

    def reproduce(self, start: Floats, t: Floats) -> Floats:
        """As `MotionModel.reproduce`: the network runs from ``start``, see `LieEDNN.start`.

        After the demonstrations' duration the network continues at its mean pace, for at most 100 durations.
        `InputError` for times that do not increase from 0, or go on for longer.
        """
        start, tau = as_floats("start", start, (6,), batched=True), self._network_times(t)
        return twist_of(self._run(displacement(start).reshape(-1, 6), tau)).reshape(*start.shape[:-1], len(tau), 6)

    def toward(self, goal: Floats) -> Self:
        """The motion to another goal, a twist ``(6,)`` from the demonstrations' (mean) goal, under the same proof.

        If the demonstrations kept their goals, it depends on the goal as they do; otherwise it is shifted (`retarget`).
        """
        target = displacement(as_floats("goal", goal, (6,)))
        return replace(self, network=self.network.retarget(target[None]))

    def _network_times(self, t: Floats) -> Floats:
        """Network times ``(K,)`` at times [s]."""
        t, latest = as_times("t", t), 100.0 * self.t[-1]  # when the network has long come to rest
        if t[0] < 0.0 or t[-1] > latest:
            raise InputError(f"t must be from 0 to {latest:g} s, got {t[0]:g} to {t[-1]:g} s")
        pace = self.tau[-1] / self.t[-1]
        return np.where(t > self.t[-1], self.tau[-1] + pace * (t - self.t[-1]), np.interp(t, self.t, self.tau))

    def _run(self, start: Floats, tau: Floats) -> Floats:
        """Displacements ``(n, K, 6)`` at network times ``tau``, from displacements ``(n, 6)``."""
        states = np.reshape([self.network.start(item[None]) for item in start], (len(start), self.network.bias.size))
        grid = network_grid(max(tau[-1], _FRACTION_STEP), self.rate)
        return run_field(self.network.flat_vector_field, states, grid, tau, kept=6)


def network_grid(end: float, rate: float) -> Floats:
    """Network times ``(G,)`` from 0 to ``end``, denser while its switches are steep."""
    # dt = d ln(1 / fraction) / rho in equal steps of the fraction, until the longest step.
    fractions = np.arange(1.0, _FRACTION_STEP / (_LONGEST_STEP * rate), -_FRACTION_STEP)
    first = -np.log(fractions) / rate
    first = first[first < end]
    rest = np.linspace(first[-1], end, int(np.ceil((end - first[-1]) / _LONGEST_STEP)) + 1)
    return np.concatenate([first, rest[1:]])
