"""A control loop that runs a policy on any arm that gives measured joints and takes references.

The loop keeps time with the system's clock and reports late references. It is as punctual as Python and the operating
system, so nothing here is hard real time. The robot's servos and its emergency stop must be real-time functions below
the loop, which hold the last reference, or stop, when the next one is late.
"""

from __future__ import annotations

import gc
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.errors import InputError
from lieednn_sim.planning.monitor import ClearanceMonitor
from lieednn_sim.policies.base import Policy
from lieednn_sim.policies.loop_faults import MAX_PERIODS, LoopOptions, LoopRun
from lieednn_sim.policies.planned import MotionTracker
from lieednn_sim.validation import as_floats, as_positive
from lieednn_sim.values import Floats, frozen


@frozen
class LoopReport:
    """Report of `control_loop`: its timing, what went wrong, and how it ended.

    Attributes:
        lateness: ``(L,)`` time from the end of each period until its reference was sent [s]; negative if in time.
        step_time: ``(L,)`` wall time that the policy took in each period [s].
        message: the policy's last message.
        stopped: why the loop stopped, if not because its duration was over; else empty.
        faults: numbers of faults by kind: measurements that were ``missing``, ``malformed``, could not be ``read``, had
            a ``jump`` or were ``stale``; a ``target`` that was refused; failures of ``write``; and exceptions that the
            policy, stop or on_late ``raised``.
        at_rest: whether the last reference sent is at rest; if not, `stopped` says why.
        error: the exception for which the loop stopped, if any; after Ctrl-C a `KeyboardInterrupt`.
    """

    lateness: Floats
    step_time: Floats
    message: str
    stopped: str
    faults: dict[str, int]
    at_rest: bool
    error: BaseException | None

    @property
    def missed(self) -> int:
        """Number of periods whose reference was late."""
        return int((self.lateness > 0.0).sum())

    def __str__(self) -> str:
        periods, worst = len(self.lateness), 1e6 * float(self.step_time.max())
        typical = 1e6 * float(np.median(self.step_time))
        late = "none late" if not self.missed else f"{self.missed} late, by up to {1e3 * self.lateness.max():.3g} ms"
        faults = "".join(f"; {kind}: {count}" for kind, count in self.faults.items() if count)
        ends = f"{faults}; stopped: {self.stopped}" if self.stopped else faults
        return f"{periods} periods, {late}; the policy took {typical:.0f} us in the median, {worst:.0f} at most{ends}"


def control_loop(
    policy: Policy,
    read: Callable[[], ArrayLike | None],
    write: Callable[[Floats, Floats], object],
    target: Callable[[float], ArrayLike] | ArrayLike | str,
    duration: float,
    *,
    on_late: Callable[[int, float], object] | None = None,
    stop_outside: bool = False,
    stop: Callable[[], object] | None = None,
    options: LoopOptions | None = None,
) -> LoopReport:
    """Run a policy at its rate: read the joints, ask the policy, write the reference, and wait for the next period.

    The policy is reset at the measured joints. If its reference for a joint breaks a limit of velocity or acceleration,
    the joint is sent one that lags behind within the limits. After a period that ends late, the next one begins at
    once, and all keep their full length: the loop does not catch up. Python's garbage is collected before the loop.

    At the end the reference brakes to rest, straight ahead, within the acceleration limits. This happens after the
    duration, if more faults occur than the options tolerate, if the policy, `stop` or `on_late` raises, and at Ctrl-C
    in the main thread, unless it has another handler; a second Ctrl-C ends at once. Errors while the loop runs are
    reported, not raised. Only if `write` fails may the last reference not be at rest.

    Args:
        read: called once a period; returns measured joints ``(n,)``, or None if there are none, but not at first.
        write: called with the reference q and qd ``(n,)`` for the end of the period, and again if it raises.
        target: joint coordinates ``(n,)``, a keyframe's name, or a function of the time since the beginning [s]; if
            this raises, or its result is malformed or out of reach, the last target stays.
        duration: [s], rounded up to a whole number of periods.
        on_late: called with the number of the period and its lateness [s], after each reference that was late.
        stop_outside: whether to stop as soon as measured joints, at the beginning of a period, are too far from the
            policy's plan for the proof of its clearance. Nothing is proved about the stop itself.
        stop: called once a period; the loop stops when it returns something true, as `threading.Event.is_set` does.
        options: the faults that the loop tolerates.

    Raises:
        InputError: a value is malformed, or the policy cannot start where the joints are; or ``stop_outside`` is asked
            for, but the policy is no ``tracker`` of a motion, or the motion's clearance is not proved.
    """
    total = math.ceil(as_positive("duration", duration) * policy.rate - 1e-9)
    if total > MAX_PERIODS:
        raise InputError(f"duration must be at most {MAX_PERIODS} control periods, got {duration:g} s")
    arm, options = policy.arm, options or LoopOptions()
    goal = arm.check_position(target(0.0) if callable(target) else target, "target").copy()
    given = read()
    if given is None:
        raise InputError("read must return measured joints the first time: the policy begins there")
    first = as_floats("what read returns", given, (arm.n_joints,)).copy()
    monitor = None
    if stop_outside:
        if not isinstance(policy, MotionTracker) or policy.motion is None:
            raise InputError(f"stop_outside needs a policy that plays a plan, 'tracker', got {type(policy).__name__}")
        monitor = ClearanceMonitor.of(arm, policy.motion)
    # Three steps are made before the loop, since what is done for the first time takes longer.
    for _ in range(3):
        policy.reset(first)
        policy.step(first, goal)
    policy.reset(first)
    run = LoopRun(policy, goal, options, stop, monitor)
    lateness, step_time, late = list[float](), list[float](), 0
    with _undisturbed(run):
        started = start = time.perf_counter()
        while run.goes_on(len(lateness) < total):
            measured = run.measure(read, start - started) if lateness else first
            leads = len(lateness) < total and not run.stopped
            if leads and callable(target):
                run.aim(target, start - started)
            asked = time.perf_counter()
            run.step(measured, leads)
            step_time.append(time.perf_counter() - asked)
            run.write(write)
            end = start + policy.period
            now = time.perf_counter()
            lateness.append(now - end)
            late = late + 1 if now > end else 0
            if late and on_late is not None:
                run.guard(on_late, len(lateness) - 1, lateness[-1])
            if late >= options.late:
                run.halt(f"{late} references in a row were late")
            time.sleep(max(end - time.perf_counter(), 0.0))
            start = max(end, now)
    timing = np.array(lateness), np.array(step_time)
    return LoopReport(*timing, run.message, run.stopped, run.faults, run.at_rest, run.error)


@contextmanager
def _undisturbed(run: LoopRun) -> Iterator[None]:
    """Collect garbage only before and after; stop the run at the first Ctrl-C, unless that has another handler."""
    collects, usual = gc.isenabled(), signal.default_int_handler

    def halt(*_: object) -> None:
        signal.signal(signal.SIGINT, usual)
        run.halt("by Ctrl-C", KeyboardInterrupt())

    ours = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is usual
    if ours:
        signal.signal(signal.SIGINT, halt)
    gc.collect()
    # Python's search for reference cycles can take longer than a period.
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
        if ours:
            signal.signal(signal.SIGINT, usual)
