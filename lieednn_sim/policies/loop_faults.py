"""The faults of a `control_loop`: which it tolerates, and how it goes on or stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError
from lieednn_sim.planning.monitor import ClearanceMonitor
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.policies.base import Policy
from lieednn_sim.policies.bounds import JointBounds
from lieednn_sim.policies.planned import MotionTracker
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, read_only

MAX_PERIODS = 10**7


@dataclass(frozen=True)
class LoopOptions(PlannerOptions):
    """The faults that `control_loop` tolerates before it stops, in numbers of consecutive periods.

    Attributes:
        missing: periods without a usable measurement, in which the policy goes on without feedback.
        stale: periods in which all measured joints stay equal while the reference moves by 0.5 % of a joint's range.
        jump: multiple of the velocity limit, or without one of 10 rad/s or m/s, at which a joint may seem to move; a
            measurement is not usable if one moved further than that by more than 1 % of its range.
        late: periods whose reference is late; by default any number.
        attempts: periods in which the same reference cannot be written.
    """

    missing: int = 20
    stale: int = 50
    jump: float = 2.0
    late: int = MAX_PERIODS
    attempts: int = 10


class LimitedReference(JointBounds):
    """A reference ``q`` with rates ``qd``, ``(n,)``, that begins at rest and follows another one within the limits.

    A joint whose other reference breaks a limit of velocity or acceleration lags behind it.
    """

    def __init__(self, arm: Arm, q: Floats, period: float) -> None:
        self.timestep, self.q, self.qd = period, q, np.zeros_like(q)
        # The factors allow for rounding. A limit of 1e6 is none.
        self.velocity_limits = 1.001 * arm.velocity_limits
        self.acceleration_limits = np.minimum(1.001 * arm.acceleration_limits, 1e6)
        self.position_limits, self._mean = arm.position_limits, self.qd

    def towards(self, q: ArrayLike, qd: ArrayLike) -> None:
        """Advance by a period, at the end of which the other reference is at ``q`` with ``qd``, both ``(n,)``."""
        h, change = self.timestep, self.timestep * self.acceleration_limits
        there, rate = as_floats("q", q, self.q.shape), as_floats("qd", qd, self.q.shape)
        lower, upper, _ = self._bounds(self.q, self.qd)
        mean = (there - self.q) / h
        # A robot may use the rates or the differences of positions, so both must keep the limits.
        equal = (lower <= rate) & (rate <= upper)
        equal &= (np.abs(mean - self._mean) <= change) & (np.abs(rate - mean) <= 0.5 * change)
        # A lag is reduced at 8/s, but no faster than half of the acceleration can stop in time.
        lag = there - self.q - 0.5 * h * (self.qd + rate)
        extra = np.minimum(8.0 * np.abs(lag), np.sqrt(self.acceleration_limits * np.abs(lag)))
        rate = np.where(equal, rate, np.clip(rate + np.sign(lag) * extra, lower, upper))
        # At a position limit, rounding would leave tiny rates for ever.
        rate = np.where(np.abs(rate) < 1e-9, 0.0, rate)
        self._mean = np.where(equal, mean, 0.5 * (self.qd + rate))
        self.q, self.qd = read_only(np.where(equal, there, self.q + h * self._mean)), read_only(rate)


class LoopRun:
    """The state of a running loop: its measurements, target and reference, and what its `LoopReport` will say."""

    def __init__(
        self,
        policy: Policy,
        goal: Floats,
        options: LoopOptions,
        stop: Callable[[], object] | None = None,
        monitor: ClearanceMonitor | None = None,
    ) -> None:
        kinds = ("missing", "malformed", "read", "jump", "stale", "target", "write", "raised")
        self.faults, self.stopped, self.message, self.at_rest = dict.fromkeys(kinds, 0), "", "", True
        self.error: BaseException | None = None
        self._policy, self._goal, self._options, self._stop, self._monitor = policy, goal, options, stop, monitor
        self._sent = LimitedReference(policy.arm, policy.q, policy.period)
        self._brake: MotionTracker | None = None
        # The last measurement and its time, and the reference when measurements last changed.
        self._seen, self._time, self._since = policy.q, 0.0, policy.q
        self._steps = self._unusable = self._equal = self._unwritten = 0

    def goes_on(self, in_time: bool) -> bool:
        """Whether there is another period: within the duration, or until a reference at rest is written."""
        moves = bool(self._unwritten or self._sent.qd.any())
        return self._unwritten < self._options.attempts and (moves or (in_time and not self.stopped))

    def halt(self, why: str, error: BaseException | None = None) -> None:
        """Stop, if there is a reason and none before it."""
        if why and not self.stopped:
            self.stopped, self.error = why, error

    def guard(self, function: Callable[..., object], *arguments: object) -> object:
        """The result of a function; if it raises an exception, the loop stops, and the result is None."""
        try:
            return function(*arguments)
        except Exception as error:
            self.faults["raised"] += 1
            self.halt(repr(error), error)
            return None

    def measure(self, read: Callable[[], ArrayLike | None], time: float) -> Floats | None:
        """The joints ``(n,)`` measured at a time [s]; None if they are not usable."""
        arm, measured, error = self._policy.arm, None, None
        kind, why = "missing", "read returned None"
        try:
            given = read()
            if given is not None:
                # Somebody may go on to write into the array.
                measured = arm.nearest_turn(as_floats("what read returns", given, (arm.n_joints,)), self._seen)
        except Exception as failure:
            kind, why = "malformed" if isinstance(failure, InputError) else "read", repr(failure)
            # Its traceback would form a cycle with this frame, and no garbage is collected in the loop.
            error = failure.with_traceback(None)
        if measured is not None:
            beyond = np.maximum(np.abs(measured - self._seen) - 0.01 * arm.ranges, 0.0)
            if (beyond > self._options.jump * (time - self._time) * arm.jump_speeds).any():
                joint = arm.joint_names[int((beyond / arm.ranges).argmax())]
                measured, kind, why = None, "jump", f"joint {joint!r} jumped"
        if measured is None:
            self.faults[kind] += 1
            self._unusable += 1
            if self._unusable > self._options.missing:
                self.halt(f"no usable measurement in {self._unusable} periods, the last time since {why}", error)
            return None
        self._unusable, self._equal = 0, self._equal + 1
        if (measured != self._seen).any():
            self._equal, self._since = 0, self._sent.q
        self._seen, self._time = measured, time
        moved = np.abs(self._sent.q - self._since) > 0.005 * arm.ranges
        if self._equal > self._options.stale and moved.any() and not self.stopped:
            self.faults["stale"] += 1
            self.halt(f"all measured joints stayed equal for {self._equal} periods while the reference moved")
        return measured

    def aim(self, target: Callable[[float], ArrayLike], time: float) -> None:
        """Take the target at a time [s] if it can be reached."""
        try:
            self._goal = self._policy.arm.check_position(target(time), "target").copy()
        except Exception:
            self.faults["target"] += 1

    def step(self, measured: Floats | None, leads: bool) -> None:
        """Find the next reference: the policy's if it still leads and there is no reason to stop, else the brake's."""
        # A reference that could not be written is still the next one: none is left out.
        if self._unwritten or (leads and self.guard(self._lead, measured)):
            return
        sent, policy = self._sent, self._policy
        self._brake = self._brake or MotionTracker.stopping(policy.arm, sent.q, sent.qd, policy.rate)
        sent.towards(*self._brake.act(None, self._brake.end))

    def _lead(self, measured: Floats | None) -> bool:
        policy = self._policy
        if self._stop is not None and self._stop():
            self.halt("as it was told to")
        if self._monitor is not None and measured is not None:
            self.halt(self._monitor.left(self._steps * policy.period / policy.arm.timestep, measured))
        if self.stopped:
            return False
        reference = policy.step(measured, self._goal)
        self.message, self._steps = policy.message, self._steps + 1
        self._sent.towards(*reference)
        return True

    def write(self, write: Callable[[Floats, Floats], object]) -> None:
        """Write the next reference, or stop where that fails too often."""
        try:
            write(self._sent.q, self._sent.qd)
            self._unwritten, self.at_rest = 0, not self._sent.qd.any()
        except Exception as error:
            self.faults["write"] += 1
            self._unwritten += 1
            if self._unwritten >= self._options.attempts:
                # There may have been another reason, but this one is why no reference at rest is sent.
                why = f"write raised {error!r} {self._unwritten} times in a row"
                self.stopped, self.error = f"{self.stopped}; {why}" if self.stopped else why, error
