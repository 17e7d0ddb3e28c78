"""A simulated arm driven by a policy, which answers requests while it runs; without a page.

One thread runs the control loop (`run`), or the caller steps it (`advance`). Requests may come from any thread; they
are queued, and the loop takes them between control periods. Work that takes longer (inverse kinematics, planning and
compiling another plant) is done by workers, whose results are queued in the same way. With `settle` between the steps,
a session that the caller steps depends only on its requests.
"""

from __future__ import annotations

import copy
import threading
import time
from collections.abc import Callable
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from lieednn_sim.arm import Arm, solve_ik
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError, NoSolutionError, SimulationError
from lieednn_sim.live.engine import Engine, Made, foreseen, make_for
from lieednn_sim.live.settings import Settings
from lieednn_sim.live.worker import Worker
from lieednn_sim.planning.monitor import ClearanceMonitor
from lieednn_sim.planning.motion import usual_rate
from lieednn_sim.policies import Policy
from lieednn_sim.registry import CONTROLLERS, PLANNERS, POLICIES
from lieednn_sim.simulation.disturbances import Push
from lieednn_sim.simulation.following import ClosedLoop
from lieednn_sim.validation import Seed, as_choice, as_count, as_floats, as_positive, as_seed
from lieednn_sim.values import Floats

# Slowest and fastest speed of the simulation, relative to real time.
SPEEDS = (0.1, 4.0)
# Control periods over which the loop measures how fast it runs, its wait while paused [s], and points of a drawn path.
_MEASURED, _PAUSED_WAIT, _DRAWN = 50, 0.02, 60


class Aim(NamedTuple):
    """The latest target that was asked for."""

    position: Floats  # (3,) of the end effector, world [m]
    quaternion: Floats  # (4,) its orientation (w, x, y, z)
    problem: str = ""  # why the arm is not sent there; empty if it is, or if that is not known yet


class Session:
    """The live view without a page: a simulated arm that follows a target which may be moved, and yields to pushes.

    `aim` and `aim_at` move the target. The arm rests at first, until a worker has made the policy.

    Args:
        arm: the arm, in its scene.
        settings: policy, controller and disturbances; by default `Settings()`.
        target: ``(n,)`` the first joint target, or a keyframe's name; by default the start.
        start: ``(n,)`` joint coordinates at the beginning and after `reset`, or a keyframe's name.
        rate: control rate [Hz]; by default 100, or the nearest that divides the rate of the model's steps.
        seed: seed of random draws.

    Attributes:
        start: ``(n,)`` joint coordinates at the beginning.
        tick: state after the last control period.
        aimed: the latest target that was asked for.
        path: ``(P, 3)`` positions of the end effector on the way to the target, or None if they are not known.
        way: the proof of clearance on that way, or None if it is not known yet.
        wanted: the latest settings that were asked for.
        failure: the last error, in words; empty after a request that succeeded.
        paused: whether `run` waits.
        speed: speed at which `run` simulates, relative to real time.
        achieved: speed that `run` has reached lately, relative to real time.

    Raises:
        InputError: a value is malformed or beyond the arm's limits, or the controller cannot drive the arm.
    """

    def __init__(
        self,
        arm: Arm,
        *,
        settings: Settings | None = None,
        target: ArrayLike | str | None = None,
        start: ArrayLike | str = "home",
        rate: float | None = None,
        seed: Seed = 0,
    ) -> None:
        rate = usual_rate(arm.timestep) if rate is None else rate
        self.arm, self._rate, self.seed = arm, as_positive("rate", rate), as_seed("seed", seed)
        self.wanted = (settings or Settings()).chosen(arm)
        self.start = arm.check_start(start)
        first = self.start if target is None else arm.check_position(target, "target")
        self._requests: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._closed = threading.Event()
        self.paused, self.speed, self.achieved, self.failure = False, 1.0, 1.0, ""
        self.path: Floats | None = None
        self.way: ClearanceMonitor | None = None
        self._engine = Engine(arm, self.wanted, self.start, first, self._rate)
        # Settings of the running policy, None if another one is wanted; a new policy that waits for the arm to stop.
        self._served: Settings | None = None
        self._waiting: Made | None = None
        self.aimed, self.tick = self._pose_of(first), self._engine.look()
        self._aimer = Worker("inverse kinematics", self._failed)
        self._maker = Worker("planning", self._failed)
        self._foreseer = Worker("path", lambda error: None)
        # Each worker has an arm of its own: finding contacts is not thread-safe.
        self._aimer_arm = copy.deepcopy(arm)
        self._thread: threading.Thread | None = None
        self._remake()

    # Requests, from any thread.

    def aim(self, position: ArrayLike, rotation: Rotation | None = None) -> None:
        """Move the target to a pose of the end effector; the newest of several requests counts.

        Args:
            position: ``(3,)`` world [m].
            rotation: orientation; free when omitted.
        """
        goal = as_floats("position", position, (3,))
        near = self.tick.target

        def search() -> None:
            try:
                q = solve_ik(self._aimer_arm, goal, rotation, start=near)
            except NoSolutionError as error:
                self._requests.put(partial(self._refuse, goal, rotation, str(error)))
            else:
                self._requests.put(partial(self._retarget, q))

        self._aimer.submit(search)

    def aim_at(self, q: ArrayLike | str) -> None:
        """Move the target to joint coordinates ``(n,)``, or a keyframe's; `InputError` if the arm cannot be there."""
        goal = self.arm.check_position(q, "target")
        self._aimer.submit(lambda: self._requests.put(partial(self._retarget, goal)))

    def aim_randomly(self, seed: Seed) -> None:
        """Move the target to a random one of the scene, see `draw_target`."""
        number = as_seed("seed", seed)
        self._aimer.submit(lambda: self._requests.put(partial(self._retarget, draw_target(self._aimer_arm, number))))

    def push(self, link: str, force: ArrayLike, duration: float = 0.2) -> None:
        """Push a link, or another body, by a force ``(3,)`` [N], along the world's axes, for a time [s]."""
        push = self._push(link, force, duration)
        self._requests.put(lambda: self._engine.push(push))

    def pull(self, link: str, force: ArrayLike, point: ArrayLike | None = None) -> None:
        """Pull a link by a force ``(3,)`` [N] until the next pull; without force, let it go.

        Args:
            link: name of a link or another body.
            force: along the world's axes.
            point: ``(3,)`` where it acts, world [m]; by default the body's centre of mass.
        """
        push = self._push(link, force, 1.0)
        where = None if point is None else as_floats("point", point, (3,))
        held = (push, where) if any(push.force) else None
        self._requests.put(lambda: setattr(self._engine, "pull", held))

    def _push(self, link: str, force: ArrayLike, duration: float) -> Push:
        push = Push(link, tuple(as_floats("force", force, (3,))), 0.0, duration)
        push.body_id(self.arm, self.arm.model)
        return push

    def choose(self, **settings: Any) -> None:
        """Change fields of `Settings`; a worker makes the new policy or plant while the arm goes on.

        Raises:
            InputError: a value is malformed or unknown.
        """
        # Paths of code files are accepted only when the session is made, not from whoever sees its page.
        for name, known in (("policy", POLICIES), ("planner", PLANNERS), ("controller", CONTROLLERS)):
            if settings.get(name) is not None:
                as_choice(name, settings[name], known)
        self.wanted = self.wanted.changed(**settings).chosen(self.arm)
        self._requests.put(self._remake)

    def reset(self) -> None:
        """Put the arm back to the start, at rest, with the first target again."""
        self._requests.put(self._reset)

    # The loop.

    def advance(self, periods: int = 1) -> None:
        """Act on the waiting requests and simulate control periods at once, without waiting for real time.

        Raises:
            SimulationError: the simulation failed; `reset` begins again.
        """
        for _ in range(as_count("periods", periods)):
            self._take_requests()
            self.tick = self._engine.advance()
            if self._waiting is not None and not self.policy.qd.any():
                self._requests.put(partial(self._put_in, self._waiting))
                self._waiting = None

    def settle(self) -> None:
        """Wait for all workers, and queue their results; for a session that the caller steps."""
        while True:
            for worker in (self._aimer, self._maker, self._foreseer):
                worker.wait()
            if self._requests.empty():
                return
            self._take_requests()

    @property
    def policy(self) -> Policy:
        """The policy in use; only the loop steps it."""
        return self._engine.policy

    @property
    def busy(self) -> bool:
        """Whether a policy or a plant is being made."""
        return self._maker.busy or self._waiting is not None

    def run(self) -> None:
        """Advance in real time times `speed` until `close`; on a machine that is too slow, so is the simulation."""
        self._thread = threading.Thread(target=self._keep_time, name="control loop", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the loop and the workers."""
        self._closed.set()
        for worker in (self._aimer, self._maker, self._foreseer):
            worker.close()
        if self._thread is not None:
            self._thread.join()

    def _keep_time(self) -> None:
        start = since = time.perf_counter()
        done = 0
        while not self._closed.is_set():
            if self.paused:
                self._take_requests()
                self.tick = self._engine.look()
                self._closed.wait(_PAUSED_WAIT)
                start = since = time.perf_counter()
                done = 0
                continue
            try:
                self.advance()
            except SimulationError as error:
                self.failure, self.paused = f"{error}; reset it", True
                continue
            period = self.policy.period / self.speed
            end = start + period
            time.sleep(max(end - time.perf_counter(), 0.0))
            # One late period is caught up; more are not, so that a slow machine shows a slow arm, not one that jumps.
            start = max(end, time.perf_counter() - period)
            done += 1
            if done == _MEASURED:
                now = time.perf_counter()
                self.achieved, since, done = done * self.policy.period / (now - since), now, 0

    # In the loop's thread.

    def _take_requests(self) -> None:
        while True:
            try:
                request = self._requests.get_nowait()
            except Empty:
                return
            try:
                request()
            except LieEDNNError as error:
                self._failed(error)

    def _reset(self) -> None:
        self._engine.restart()
        self._served = self._waiting = self.path = self.way = None
        self.aimed, self.failure, self.paused = self._pose_of(self._engine.target), "", False
        self._remake()

    def _retarget(self, q: Floats) -> None:
        self._engine.retarget(q)
        self.aimed, self.failure = self._pose_of(q), ""
        # A policy that plays a motion does not look at the target, and one that could not be made may be made for it.
        if self.wanted.policy == "tracker" or (self._served is None and not self.busy):
            self._served = None
            self._remake()
        self._foresee()

    def _refuse(self, position: Floats, rotation: Rotation | None, problem: str) -> None:
        turn = self.aimed.quaternion if rotation is None else rotation.as_quat(scalar_first=True)
        self.aimed = Aim(position, turn, problem)

    def _pose_of(self, q: Floats) -> Aim:
        pose = self.arm.link_poses(q)[-1]
        return Aim(np.asarray(pose.translation), pose.rotation.as_quat(scalar_first=True))

    def _remake(self) -> None:
        """Let the worker make the policy and the plant that the wanted settings need, unless they are there."""
        engine, desired = self._engine, self.wanted
        needs_policy = self._served is None or self._served.of_policy != desired.of_policy
        needs_plant = engine.equipped.of_plant != desired.of_plant
        start = engine.policy.q
        if needs_policy:
            self._served = self._waiting = None
            if desired.policy == "tracker":
                # A planned motion begins at rest.
                start = engine.stop()
        target, policy = engine.target, engine.policy

        def work() -> None:
            arm = copy.deepcopy(self.arm)
            result = make_for(arm, desired, start, target, rate=self._rate, seed=self.seed) if needs_policy else None
            self._maker.check()
            plant = ClosedLoop(policy, desired.controller, desired.disturbances) if needs_plant else None
            self._maker.check()
            self._requests.put(lambda: self._adopt(desired, result, plant))

        if needs_policy or needs_plant:
            self._maker.submit(work)

    def _adopt(self, settings: Settings, result: Made | None, plant: ClosedLoop | None) -> None:
        self.failure = ""
        if plant is not None:
            self._engine.equip(plant, settings)
        if result is not None and settings.policy == "tracker" and self.policy.qd.any():
            self._waiting = result
        elif result is not None:
            self._put_in(result)

    def _put_in(self, result: Made) -> None:
        self._engine.put_in(result)
        self._served = result.settings
        self._foresee()

    def _foresee(self) -> None:
        """Let the worker find the way ahead, to be drawn, and prove its clearance."""
        engine, self.way = self._engine, None
        now = engine.policy, engine.motion, engine.progress, engine.policy.q, engine.target

        def work() -> None:
            ahead, monitor = foreseen(self.arm, *now), None
            self.path = None
            if ahead is not None:
                self.path = self.arm.tip(ahead[1][np.linspace(0, len(ahead[1]) - 1, _DRAWN).astype(int)])
                monitor = ClearanceMonitor(self.arm, *ahead)
            self._foreseer.check()
            self.way = monitor

        self._foreseer.submit(work)

    def _failed(self, error: Exception) -> None:
        self.failure = str(error) if isinstance(error, LieEDNNError) else f"{type(error).__name__}: {error}"
