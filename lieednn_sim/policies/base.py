"""The base class of policies, which map the measured joints and the present target to the next reference.

A policy knows no simulator: `simulation.follow` runs it with a simulated arm, `control_loop` with any other arm.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats, StrPath


class Policy(ABC):
    """Base class of policies; a subclass defines `act`, and `begin` if it has a state of its own.

    Args:
        arm: the arm.
        rate: control rate [Hz].

    Attributes:
        period: control period [s].
        q: ``(n,)`` reference at the end of the last period, where the arm should be now [rad, m].
        qd: ``(n,)`` rates of this reference [rad/s, m/s].
        certified: whether it is proved that the policy's state converges to a target at rest from every state.
        channel_units: units of the quantities in `channels`, by name.
    """

    certified = False
    channel_units: Mapping[str, str] = MappingProxyType({})
    q: Floats
    qd: Floats

    def __init__(self, arm: Arm, rate: float) -> None:
        self.arm, self.rate = arm, as_positive("rate", rate)
        self.period = 1.0 / self.rate
        self._max_gain, self._turns = arm.acceleration_limits * self.period, bool(arm.continuous.any())
        self._target: Floats | None = None

    def __repr__(self) -> str:
        proof = "certified" if self.certified else "not certified"
        return f"<{type(self).__name__} of {self.arm.name} at {self.rate:g} Hz, {proof}>"

    def reset(self, q: ArrayLike | str) -> None:
        """Start again at rest from joint coordinates ``(n,)``, or from a keyframe, given by its name.

        Raises:
            InputError: the coordinates are malformed or beyond the position limits, or the policy cannot start there.
        """
        self.q = self.arm.check_start(q, "q").copy()
        self.qd, self._target = np.zeros_like(self.q), None
        self.q.flags.writeable = self.qd.flags.writeable = False
        self.begin(self.q)

    def step(self, measured: ArrayLike | None, target: ArrayLike) -> tuple[Floats, Floats]:
        """The reference at the end of the control period that begins now; call it once in every period, after `reset`.

        Args:
            measured: ``(n,)`` joint coordinates measured now; None if the arm is taken to be at its reference.
            target: ``(n,)`` joint coordinates wanted now.

        Returns:
            Read-only joint coordinates and rates ``(n,)``; between two periods a controller may interpolate by a cubic.

        Raises:
            InputError: a value is malformed, the target is beyond the position limits, the first measured joints exceed
                them by more than a range, or the policy was never reset and nothing is measured.
        """
        shape = (self.arm.n_joints,)
        seen = None if measured is None else as_floats("measured", measured, shape)
        goal = as_floats("target", target, shape)
        # A target that stays the same is checked against the limits only once.
        if self._target is None or goal.tolist() != self._target.tolist():
            if (self.arm.limit_excess(goal) > 0.0).any():
                goal = self.arm.check_position(goal, "target")  # moves it to the limit, or raises; takes longer
            if "q" not in vars(self):
                if seen is None:
                    raise InputError("it is not known where the arm is: call reset(q), or give measured joints")
                self.reset(seen)
            if seen is not None and self._target is None:
                # No sensor's noise is that large. Later measurements are not checked: one must not end a running loop.
                far = self.arm.limit_excess(seen)[: len(seen)] > self.arm.ranges + self.arm.start_tolerance
                if far.any():
                    raise InputError(f"measured is in other units? {self.arm.describe_excess(seen, int(far.argmax()))}")
            self._target = goal.copy()
        if self._turns and seen is not None:
            seen = self.arm.nearest_turn(seen, self.q)  # encoders may count within one turn only
        parts = [np.asarray(part) for part in self.act(seen, self._target)]
        if (given := [part.shape for part in parts]) != [shape, shape]:
            raise InputError(f"a policy's act must return joints and rates, two arrays of shape {shape}, got {given}")
        q, qd = parts
        q.flags.writeable = qd.flags.writeable = False
        self.q, self.qd = q, qd
        return q, qd

    def see(self, places: Mapping[str, Floats]) -> None:
        """Inform the policy of the places where all moving obstacles are now; most policies ignore them.

        These are positions ``(3,)`` of bodies of the arm's scene, in the frames of their parents [m], by name. `reset`
        puts the obstacles back where the scene has them.

        Raises:
            InputError: the policy was never reset.
        """
        if "q" not in vars(self):
            raise InputError("the policy was never reset, and a reset puts obstacles back: call reset(q) before see")

    def begin(self, q: Floats) -> None:  # noqa: B027 (some have no state of their own)
        """Prepare to start from joint coordinates ``(n,)``; called by `reset`, unchecked."""

    @abstractmethod
    def act(self, measured: Floats | None, target: Floats) -> tuple[Floats, Floats]:
        """The reference at the end of the present period; `step` has checked the arguments."""

    @property
    def state(self) -> Floats:
        """State of the policy: by default the reference ``(n,)``; of a network, its state ``(N, 6)``."""
        return self.q

    @property
    def message(self) -> str:
        """What the policy did in the last period, in words."""
        return "moves"

    def channels(self) -> Floats:
        """Quantities of the last period ``(c,)``, in the order of `channel_units`."""
        return np.empty(0)

    def to_c(self, folder: StrPath) -> Path:
        """Write the policy as C99 into a folder; only a `NetworkPolicy` can, others raise `InputError`."""
        only = "only a NetworkPolicy has, such as 'lieednn-shaped'; run it by control_loop"
        raise InputError(f"a {type(self).__name__} has no C code, {only}")

    def allowed(self) -> Floats:
        """Largest speeds ``(n,)`` at the end of the period that keep the limits of velocity and acceleration."""
        return np.asarray(np.minimum(self.arm.velocity_limits, np.abs(self.qd) + self._max_gain))
