"""A certified network that goes to new targets, and around moving obstacles, at any time; see `coded_policy`.

To a new target it goes straight if that is clear. Where something is in the way, on the path ahead or on the way to a
new target, the arm slows down so as to rest before the first blocked sample, while RRT-Connect searches for a path from
where it can rest. If there is none, the arm waits there, and the search is made again. Obstacles are where they were
last seen, or where they soon will be as they move. A path that is searched for is proved to be clear of them there,
like every planned motion. Straight motions and transitions onto paths are only checked, at samples, to save time.

If an obstacle, going on as it does, will come too near to where the arm rests or can rest, the arm gets out of its way
(`evasion`) by another motion of the same network. It comes back when the way to the target stays free.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.transition import BaseMotion, along, straight
from lieednn_sim.policies.coded_policy import RESTS, SOONEST, CodedPolicy
from lieednn_sim.policies.feedback import FEEDBACK, Feedback
from lieednn_sim.policies.making import PolicyTask
from lieednn_sim.policies.searching import aside, found, get_ready
from lieednn_sim.policies.surroundings import Surroundings, evasion, path_around
from lieednn_sim.validation import Seed, as_seed
from lieednn_sim.values import Floats

_SAME = 1e-6  # of the ranges: configurations that differ by less are one
_NOT_FREE = "the target is not free"


@dataclass(frozen=True)
class ReplanningOptions(PlannerOptions):
    """Options of the policy ``lieednn-replanning``.

    Attributes:
        least_duration: shortest motion to a new target [s].
        margin: distance that new paths keep from moving obstacles where that is possible [m]; a path is blocked where
            one of them is nearer than half of it.
        look_every: control periods from one look at the path ahead to the next.
        search_periods: control periods after which a new path is taken; the policy waits for the search if it is not
            over then, so that results do not depend on the machine.
        at_once: take a new path as soon as it is there, and never wait for it: for real robots.
        evade: get out of the way of obstacles that come nearer than half the margin to where the arm rests.
        search: options of RRT-Connect, which searches for new paths.
    """

    least_duration: float = 0.5
    margin: float = 0.06
    look_every: int = 5
    search_periods: int = 20
    at_once: bool = False
    evade: bool = True
    search: RrtConnectOptions = field(default=RrtConnectOptions(max_collision_checks=(20_000,), fastest=True))


class ReplanningPolicy(CodedPolicy):
    """A policy of one certified network, which plans again whenever the target or the obstacles move.

    It logs ``changes``, how often it took a new code, ``blocked``, 1 while a moving obstacle is in the way, and
    ``evading``, 1 while it evades one, and -1 while it should and cannot.

    Args:
        arm, rate, feedback: as for `JointPolicy`; the arm is in its scene.
        motion: motion for the first target, from start to target; by default, and from elsewhere, it goes straight.
        seed: seed of the searches.

    Raises:
        InputError: the motion is of another arm, or a value is malformed.
    """

    channel_units = MappingProxyType({**CodedPolicy.channel_units, "blocked": "1", "evading": "1"})
    _defaults: type[ReplanningOptions] = ReplanningOptions

    def __init__(
        self,
        arm: Arm,
        rate: float = 100.0,
        *,
        motion: Motion | None = None,
        options: ReplanningOptions | None = None,
        feedback: Feedback | None = FEEDBACK,
        seed: Seed = 0,
    ) -> None:
        super().__init__(arm, rate, feedback=feedback)
        if motion is not None and (n := motion.q.shape[1]) != arm.n_joints:
            raise InputError(f"the motion has {n} joint coordinates, arm {arm.name!r} has {arm.n_joints}")
        self._given, self._seed = motion, as_seed("seed", seed)
        self._options = self._defaults() if options is None else options

    @classmethod
    def of(cls, task: PolicyTask, options: ReplanningOptions) -> Self:
        """The policy that begins with the task's motion."""
        return cls(task.arm, task.rate, motion=task.motion, options=options, feedback=task.feedback, seed=task.seed)

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        super().begin(q)
        self._surroundings = Surroundings(self.arm, 0.5 * self._options.margin)
        self._periods = self._searches = 0
        self._goal: Floats | None = None
        # A search, when it is due, and whether it is for a way out of an obstacle's way.
        self._search: tuple[Future[BaseMotion], int, bool] | None = None
        self._path: BaseMotion | None = None
        # The obstacle that is evaded; `_caught` says that evading it failed.
        self._evaded = ""
        lead = (self._options.search_periods + self._options.look_every) * self.period
        # Time to move each joint by half its range; no obstacle can be foreseen for more than 3 s.
        half = float(straight(self.arm, q, q + 0.5 * self.range, SOONEST).x[-1])
        self._horizon = min(lead + half, 3.0)
        self._clear_way()
        if self.arm.scene != "free":
            get_ready(self.arm)

    def see(self, places: Mapping[str, Floats]) -> None:
        """See `Policy`; raises `InputError` for names of no obstacles."""
        super().see(places)
        # The process of the searches takes a second to start, and memory that arms without obstacles can do without.
        if places and not self._surroundings.places:
            get_ready(self.arm)
        self._surroundings.see(places)

    @property
    def message(self) -> str:
        """See `Policy`."""
        if self._evaded:
            does = "cannot evade" if self._caught else "evades"
            return f"{does} {self._evaded!r}{f': {self._reason}' if self._reason else ''}"
        if math.isinf(min(self._blocked_at, self._ends_at)):
            return super().message
        does = "waits" if self.pace < RESTS else "slows down"
        why = f" for {self._blocker!r}" if self._blocker else " to turn"
        return f"{does}{why}{f'; {self._reason}' if self._reason else ''}"

    def channels(self) -> Floats:
        """See `Policy`."""
        evading = 0.0 if not self._evaded else -1.0 if self._caught else 1.0
        return np.append(super().channels(), [math.isfinite(self._blocked_at), evading])

    def _decide(self, target: Floats) -> None:
        """See `CodedPolicy`."""
        self._surroundings.leave(self.drawn)
        if target is not self._goal:
            self._goal, self._search, self._path, self._reason = target, None, None, ""
            self._turn(target)
        self._take_found(target)
        if self._periods % self._options.look_every == 0:
            self._look(target)
        self._periods += 1
        self.rest_at = min(self._blocked_at, self._ends_at)

    def _clear_way(self) -> None:
        # Times of the present motion before which the arm must rest: where it is blocked, and to turn to another one.
        self._blocked_at = self._ends_at = math.inf
        self._blocker, self._reason, self._caught = "", "", False

    def _turn_to(self, base: BaseMotion) -> None:
        """Take a base motion; raises `PlanError`."""

        def clear(q: Floats) -> str | None:
            result = self._surroundings.blocked(q)
            self._blocker = result[1] if result else self._blocker
            return repr(result[1]) if result else None

        # Stays empty if limits alone, and no obstacle, refuse all transitions.
        self._blocker = ""
        self.take(base, clear)
        self._clear_way()

    def _turn(self, goal: Floats) -> None:
        """Go to the present goal: by the given motion if it leads there, else straight, else by a path searched for."""
        given, base = self._given, straight(self.arm, self.drawn, goal, self._options.least_duration)
        if given is not None and self.changes == 0:
            off = np.stack([given.q[0] - self.drawn, given.q[-1] - goal])
            if (np.abs(off) < _SAME * self.range).all():
                base = along(self.arm, given)
        try:
            self._turn_to(base)
            self._evaded = ""
        except PlanError as error:
            self._reason = str(error)
            self._ends_at = min(self._ends_at, self.time + self.stopping)
            if self._blocker:
                self._seek(goal)

    def _seek(self, goal: Floats) -> None:
        """Search for a path from a place ahead where the arm can rest, if possible one passed after the search."""
        if at_goal := self._surroundings.blocked(goal[None]):
            self._blocker, self._reason = at_goal[1], _NOT_FREE
            return
        lead = self.stopping + self.pace * self.period * self._options.search_periods
        rest = max(self.time + self.stopping, min(self._blocked_at, self.time + lead))
        options = self._options
        ends = self._resting(rest), goal
        self._start(False, path_around, dict(self._surroundings.places), ends, options.margin, options.search)
        self._reason = "a path is searched for"

    def _start(self, evades: bool, search: Callable[..., BaseMotion], *arguments: Any) -> None:
        """Start a search, see `searching.aside`, which also gets a seed of its own."""
        seed, self._searches = self._seed + self._searches, self._searches + 1
        due = self._periods + self._options.search_periods
        self._search = aside(self.arm, search, *arguments, seed), due, evades

    def _resting(self, time: float) -> Floats:
        """Rest at a time of the present motion, unless it turns before; returns where that is ``(n,)``."""
        self._ends_at = time
        return self._within_limits(self._at(np.array([time]))[0])

    def _take_found(self, goal: Floats) -> None:
        """Take the path or evasion that was searched for, if it is there and due."""
        path = self._path
        if self._search is not None:
            search, due, evades = self._search
            if not (search.done() if self._options.at_once else self._periods >= due):
                return
            self._search = None
            try:
                path = found(search)
                self._path = None if evades else path
                if evades:
                    self._turn_to(path)
                    return
            except PlanError as error:
                self._reason, self._caught = str(error), evades
                return
        elif path is None or self._periods % self._options.look_every:
            return
        # An obstacle may have moved into the path meanwhile.
        passable = self._surroundings.blocked(self._sampled(path, 0.0, float(path.x[-1]))[1], only_moving=True) is None
        try:
            if passable:
                self._turn_to(path)
                self._path, self._evaded = None, ""
        except PlanError as error:
            self._reason, passable = str(error), self.pace > RESTS
        # A moving arm slows down, and tries again; otherwise only another path may help.
        if not passable:
            self._path = None
            self._seek(goal)

    def _sampled(self, motion: Callable[[Floats], Floats], begin: float, end: float) -> tuple[Floats, Floats]:
        """Times ``(K,)`` between two ones, and the configurations ``(K, n)`` of a motion there."""
        # The instants are the same in each look, or the first blocked one would change though nothing moves: every 0.04
        # s, or a multiple of that if there would be more than 150.
        step = 0.04 * max(1, math.ceil((end - begin) / (0.04 * 150)))
        times = np.clip(step * np.arange(math.floor(begin / step), math.ceil(end / step) + 1), begin, end)
        return times, np.asarray(motion(times))

    def _look(self, goal: Floats) -> None:
        """Look whether the path ahead is clear, and what to do if it is not, or if the arm waits."""
        course, around, busy = self.course, self._surroundings, self._search is not None or self._path is not None
        if around.places:
            around.look(self._options.look_every * self.period)
            end = max(course.transition.duration, self.time)
            times, q = self._sampled(self._at, self.time, end)
            result = around.blocked(q, only_moving=True) or around.nearing(q, np.full(len(q), 0.3))
            stops = [] if result is None else [(float(times[max(result[0] - 1, 0)]), result[1])]
            # An obstacle may also meet the arm on the way, or come to where the way ends.
            last = min(self._ends_at, end)
            if met := self._foresee(lambda after: self._at(np.minimum(self.time + after, last))):
                stops.append((min(self.time + met[0], end), met[1]))
            if stops:
                self._stop_before(*min(stops))
            if self._options.evade and self._evade(goal, end):
                return
            if stops:
                if not busy and not self._evaded:
                    self._seek(goal)
                return
            if math.isfinite(self._blocked_at):
                # The obstacle went away again.
                self._blocked_at, self._blocker = math.inf, ""
                if self._leads_to(goal):
                    self._ends_at, self._search, self._path, busy = math.inf, None, None, False
        if not busy and (self._may_return(goal) if self._evaded else math.isfinite(self._ends_at)):
            self._turn(goal)

    def _foresee(self, q: Callable[[Floats], Floats]) -> tuple[float, str] | None:
        """How long [s] an arm at ``q(times from now on)`` stays clear of moving obstacles, and which it meets then."""
        fastest = max((float(np.linalg.norm(v)) for v in self._surroundings.velocities.values()), default=0.0)
        if fastest == 0.0:
            return None
        # Obstacles move by at most the margin between two instants.
        count = min(math.ceil(self._horizon * fastest / self._options.margin), 40)
        after = np.linspace(0.0, self._horizon, count + 1)
        result = self._surroundings.nearing(q(after), after)
        return result and (float(after[max(result[0] - 1, 0)]), result[1])

    def _stop_before(self, latest: float, blocker: str) -> None:
        """Rest before a time of the present motion, as late as the arm can rest there clear of moving obstacles."""
        self._blocker = blocker
        for share in (1.0, 0.5, 0.0):
            soon = self.time + max(share * (latest - self.time), self.stopping)
            self._blocked_at = min(soon, latest)
            if self._foresee_at(self._blocked_at) is None:
                break

    def _foresee_at(self, time: float) -> tuple[float, str] | None:
        """As `_foresee`, where the arm rests at a time of the present motion."""
        there = self._at(np.array([time]))
        return self._foresee(lambda after: there.repeat(len(after), axis=0))

    def _evade(self, goal: Floats, end: float) -> bool:
        """Whether the arm must leave the place where it rests or can rest; if so, search for another place."""
        stops, threat = min(self._blocked_at, self._ends_at), ""
        if math.isfinite(stops) or self.time >= end:
            near = self._foresee_at(max(self.time, min(stops, end)))
            threat = near[1] if near else self._surroundings.touching
        searching = self._search is not None and self._search[2]
        if not threat:
            if searching:
                self._search, self._ends_at = None, math.inf
            if self._caught:
                self._caught, self._reason = False, ""
            if self._evaded and self._leads_to(goal):
                self._evaded, self._ends_at = "", math.inf
            return False
        self._evaded = threat
        if not searching:
            around, lead = self._surroundings, self._options.search_periods * self.period
            seen = dict(around.places), around.velocities
            start = self._resting(max(self.time, min(stops, end, self.time + self.stopping)))
            self._start(True, evasion, *seen, start, self._options.margin, lead, self._horizon)
            self._path = None
        return True

    def _leads_to(self, goal: Floats) -> bool:
        return bool(np.abs(self.course.transition.end - goal).max() < _SAME)

    def _may_return(self, goal: Floats) -> bool:
        """Whether the straight way to the goal stays free; only once the arm rests, if obstacles move or are near."""
        near = self._surroundings.velocities or self._surroundings.near
        if near and self.time < self.course.transition.duration and self.pace > RESTS:
            return False
        if self._surroundings.blocked(goal[None], only_moving=True):
            self._reason = _NOT_FREE
            return False
        base = straight(self.arm, self.drawn, goal, self._options.least_duration)
        return self._foresee(lambda after: base(np.minimum(after, base.x[-1]))) is None
