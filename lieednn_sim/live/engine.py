"""The closed loop of a live view: policy, plant and pushes may change while it goes on; without threads or requests."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.live.making import Made, Progress
from lieednn_sim.live.settings import Settings
from lieednn_sim.planning.motion import Motion
from lieednn_sim.policies import MotionTracker, Policy
from lieednn_sim.simulation.disturbances import Push
from lieednn_sim.simulation.following import ClosedLoop
from lieednn_sim.values import Floats


class Tick(NamedTuple):
    """The state after a control period, with arrays that nobody changes.

    Attributes:
        time: time since the last reset [s].
        q: ``(n,)`` joint coordinates [rad, m].
        q_ref: ``(n,)`` their reference.
        target: ``(n,)`` joint target.
        force: ``(3,)`` force of the last push or pull that acts [N], world.
        pushed: ``(3,)`` the point where it acts, world [m].
        policy: name of the policy in use; empty while the arm only stops.
        message: what the policy does, in words.
        progress: what is proved about the way to the target; None for a policy without a network.
        decision: CPU time of the policy's step [s].
    """

    time: float
    q: Floats
    q_ref: Floats
    target: Floats
    force: Floats
    pushed: Floats
    policy: str
    message: str
    progress: Progress | None
    decision: float


class Engine:
    """A simulated arm behind a policy, both of which may be exchanged between control periods.

    Args:
        arm: the arm.
        settings: controller and plant at the beginning.
        start: ``(n,)`` joint coordinates at the beginning, unchecked.
        target: ``(n,)`` the first joint target, unchecked.
        rate: control rate [Hz].

    Attributes:
        policy: the policy in use.
        target: ``(n,)`` joint target.
        motion: the planned motion that the policy follows or imitates; None if there is none.
        progress: what is proved about the way to the target; None for a policy without a network.
        equipped: the settings for which controller and plant were made.
        pull: a push that acts until it is taken away, with the point where it acts, None for the centre of mass.

    Raises:
        InputError: the controller cannot drive the arm.
    """

    def __init__(self, arm: Arm, settings: Settings, start: Floats, target: Floats, rate: float) -> None:
        self._arm, self._start, self._first, self._rate = arm, start, target, rate
        self.equipped = settings
        self.policy: Policy
        self.begin()
        self._loop = ClosedLoop(self.policy, settings.controller, settings.disturbances)
        self._loop.begin(start)

    def begin(self) -> None:
        """Forget everything but the plant, and stay at the start until there is a policy."""
        self._periods, self._force = 0, (np.zeros(3), np.zeros(3))
        # With the periods in which they end.
        self._pushes: list[tuple[Push, int]] = []
        self.pull: tuple[Push, Floats | None] | None = None
        self.motion: Motion | None = None
        self.progress: Progress | None = None
        self._name, self.target = "", self._first
        self.policy = self._stopping(self._start, np.zeros_like(self._start))
        self.policy.reset(self._start)

    def restart(self) -> None:
        """As `begin`, with the arm back at the start."""
        self.begin()
        self._loop.policy = self.policy
        self._loop.begin(self._start)

    def retarget(self, q: Floats) -> None:
        """Move the target to joint coordinates ``(n,)``."""
        self.target = q
        if self.progress is not None:
            self.progress = self.progress.towards(self.policy, q)

    def push(self, push: Push) -> None:
        """Begin a push now; its own start does not count."""
        self._pushes.append((push, self._periods + max(1, round(push.duration * self._rate))))

    def stop(self) -> Floats:
        """Let the reference stop at the limits of acceleration; returns where it comes to rest ``(n,)``."""
        if not self.policy.qd.any():
            return self.policy.q
        stopping = self._stopping(self.policy.q, self.policy.qd)
        self._go_on_with(stopping)
        return stopping.end

    def put_in(self, result: Made) -> None:
        """Let another policy take over from the reference of the present one.

        Raises:
            InputError: it cannot start there; then the present one goes on.
        """
        self._go_on_with(result.policy)
        self._name, self.motion = result.settings.policy, result.motion
        if result.progress is not None:
            self.progress = result.progress.towards(self.policy, self.target)

    def equip(self, plant: ClosedLoop, settings: Settings) -> None:
        """Let another plant and controller take over from the present state of the arm."""
        before, self._loop, self.equipped = self._loop.simulation, plant, settings
        plant.policy = self.policy
        plant.begin(before.q, before.qd)

    def advance(self) -> Tick:
        """Do a control period.

        Raises:
            SimulationError: the simulation failed; `restart` begins again.
        """
        self._apply_forces()
        spent = self._loop.advance(self.target)
        self._periods += 1
        if self.progress is not None:
            self.progress = self.progress.after(self.policy)
        return self.look(spent)

    def look(self, spent: float = 0.0) -> Tick:
        """The present state, after a step of the policy that took some CPU time [s]."""
        return Tick(
            self._periods * self.policy.period,
            self._loop.simulation.q,
            self.policy.q,
            self.target,
            *self._force,
            self._name,
            self.policy.message,
            self.progress,
            spent,
        )

    def _go_on_with(self, policy: Policy) -> None:
        q, qd = self.policy.q, self.policy.qd
        policy.reset(q)
        policy.qd = qd
        self.policy = self._loop.policy = policy
        self.progress, self.motion, self._name = None, None, ""

    def _stopping(self, q: Floats, qd: Floats) -> MotionTracker:
        """A policy that stops a moving reference, and stays there."""
        needed = max(float((np.abs(qd) / self._arm.acceleration_limits).max()), 2.0 / self._rate)
        low, high = self._arm.position_limits.T
        end = np.clip(self._arm.within_angles(q + 0.5 * needed * qd), low, high)
        rows = CubicHermiteSpline([0.0, needed], [q, end], [qd, np.zeros_like(qd)])
        return MotionTracker(self._arm, rows, self._rate)

    def _apply_forces(self) -> None:
        data, model = self._loop.simulation.data, self._loop.simulation.model
        self._pushes = [push for push in self._pushes if push[1] > self._periods]
        acting: list[tuple[Push, Floats | None]] = [(push, None) for push, _ in self._pushes]
        if self.pull is not None:
            acting.append(self.pull)
        data.xfrc_applied[:], self._force = 0.0, (np.zeros(3), np.zeros(3))
        for push, point in acting:
            body = push.body_id(self._arm, model)
            force, centre = np.array(push.force), data.xipos[body].copy()
            where = centre if point is None else point
            data.xfrc_applied[body] += (*force, *np.cross(where - centre, force))
            self._force = force, where
