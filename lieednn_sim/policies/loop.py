"""A control loop that runs a policy on any arm that gives measured joints and takes references.

The loop keeps time with the system's clock and reports late references. It is as punctual as Python and the operating
system, so nothing here is hard real time. The robot's servos and its emergency stop must be real-time functions below
the loop, which hold the last reference, or stop, when the next one is late.
"""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.planning.monitor import ClearanceMonitor
from lieednn_sim.policies.base import Policy
from lieednn_sim.policies.planned import MotionTracker
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats, frozen

_MAX_PERIODS = 10**7


@frozen
class LoopReport:
    """Report of `control_loop`: its timing, and why it stopped early.

    Attributes:
        lateness: ``(L,)`` time from the end of each period until its reference was sent [s]; negative if in time.
        step_time: ``(L,)`` wall time that the policy took in each period [s].
        message: the policy's last message.
        stopped: when and by which joint the run left the proof of its plan; empty if the loop did not stop there.
    """

    lateness: Floats
    step_time: Floats
    message: str
    stopped: str = ""

    @property
    def missed(self) -> int:
        """Number of periods whose reference was late."""
        return int((self.lateness > 0.0).sum())

    def __str__(self) -> str:
        periods, worst = len(self.lateness), 1e6 * float(self.step_time.max())
        typical = 1e6 * float(np.median(self.step_time))
        late = "none late" if not self.missed else f"{self.missed} late, by up to {1e3 * self.lateness.max():.3g} ms"
        stopped = f"; stopped: {self.stopped}" if self.stopped else ""
        return (
            f"{periods} periods, {late}; the policy took {typical:.0f} us in the median, {worst:.0f} at most{stopped}"
        )


def control_loop(
    policy: Policy,
    read: Callable[[], ArrayLike | None],
    write: Callable[[Floats, Floats], object],
    target: Callable[[float], ArrayLike] | ArrayLike | str,
    duration: float,
    *,
    on_late: Callable[[int, float], object] | None = None,
    stop_outside: bool = False,
) -> LoopReport:
    """Run a policy at its rate: read the joints, ask the policy, write the reference, and wait for the next period.

    The policy is reset where the joints are. After a period that ends late, the next one begins at once, and all keep
    their full length: the loop does not catch up. Python's garbage is collected before the loop, not in it. An
    exception of `read` or `write` ends the loop, as Ctrl-C does.

    Args:
        policy: the policy.
        read: called once a period; returns the measured joints ``(n,)``, or, not at first, None if there are none.
        write: called with the reference q and qd ``(n,)`` for the end of the period.
        target: joint coordinates ``(n,)``, a keyframe's name, or a function of the time since the beginning [s].
        duration: [s], rounded up to a whole number of periods.
        on_late: called with the number of the period and its lateness [s], after each reference that was late.
        stop_outside: whether, from the first period at whose beginning the measured joints are too far from the
            policy's plan for the proof of its clearance, the reference brakes to rest within the limits of
            acceleration, after which the loop ends. What the arm does then is not proved.

    Raises:
        InputError: a value is malformed, or the policy cannot start where the joints are; or the loop is to stop
            outside of a proof, but the policy is no ``tracker`` of a motion, or nothing is proved of this.
    """
    total = math.ceil(as_positive("duration", duration) * policy.rate - 1e-9)
    if total > _MAX_PERIODS:
        raise InputError(f"duration must be at most {_MAX_PERIODS} control periods, got {duration:g} s")
    aim = target if callable(target) else _held(policy.arm.configuration(target, "target"))
    shape = (policy.arm.n_joints,)
    first = read()
    if first is None:
        raise InputError("read must return measured joints the first time: the policy begins there")
    monitor = None
    if stop_outside:
        if not isinstance(policy, MotionTracker) or policy.motion is None:
            raise InputError(f"stop_outside needs a policy that plays a plan, 'tracker', got {type(policy).__name__}")
        monitor = ClearanceMonitor.of(policy.arm, policy.motion)
    # After three steps nothing is done for the first time.
    for _ in range(3):
        policy.reset(first)
        policy.step(first, aim(0.0))
    policy.reset(first)
    lateness, step_time, stopped = list[float](), list[float](), ""
    collects = gc.isenabled()
    gc.collect()
    # Python's search for reference cycles can take longer than a period.
    gc.disable()
    try:
        started = start = time.perf_counter()
        while len(lateness) < total or (stopped and policy.qd.any()):
            k = len(lateness)
            measured, goal = read() if k else first, aim(start - started)
            asked = time.perf_counter()
            if monitor is not None and measured is not None and not stopped:
                stopped = monitor.left(k * policy.period / policy.arm.timestep, as_floats("measured", measured, shape))
                if stopped:
                    policy, total = MotionTracker.stopping(policy.arm, policy.q, policy.qd, policy.rate), 0
            q, qd = policy.step(measured, goal)
            step_time.append(time.perf_counter() - asked)
            write(q, qd)
            end = start + policy.period
            now = time.perf_counter()
            lateness.append(now - end)
            if now > end and on_late is not None:
                on_late(k, now - end)
            time.sleep(max(end - time.perf_counter(), 0.0))
            start = max(end, now)
    finally:
        if collects:
            gc.enable()
    return LoopReport(np.array(lateness), np.array(step_time), policy.message, stopped)


def _held(target: Floats) -> Callable[[float], Floats]:
    return lambda _: target
