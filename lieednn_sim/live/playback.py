"""Motions that are played beside the live arm, on one clock: recorded rollouts, or plans made on the spot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.planning import plan
from lieednn_sim.simulation import Rollout
from lieednn_sim.values import Floats, frozen

# Most motions at once, CPU time for planning one [s], and points of the path of the end effector that is drawn.
MOST, _BUDGET, _POINTS = 4, 20.0, 80


@frozen
class Track:
    """One motion.

    Attributes:
        name: what made it, such as a planner.
        t: ``(K,)`` times from 0 [s].
        q: ``(K, n)`` joint coordinates [rad, m].
        rollout: the rollout that it is of; None for a plan that was not simulated.
    """

    name: str
    t: Floats
    q: Floats
    rollout: Rollout | None = None

    @classmethod
    def of(cls, name: str, rollout: Rollout) -> Track:
        """The simulated motion of a rollout."""
        return cls(name, rollout.t - rollout.t[0], rollout.q, rollout)

    def at(self, time: float) -> Floats:
        """Joint coordinates ``(n,)`` at the sample before a time [s]; before the first and after the last it rests."""
        return self.q[max(int(np.searchsorted(self.t, time + 1e-9, side="right")) - 1, 0)]

    def path(self, arm: Arm) -> Floats:
        """Positions of the end effector ``(P, 3)``, to be drawn."""
        rows = np.unique(np.linspace(0, len(self.t) - 1, _POINTS).astype(int))
        return arm.tip(self.q[rows])


class Playback:
    """A clock for up to four motions.

    Attributes:
        tracks: the motions.
        time: present time [s].
        playing: whether the clock runs.
        loop: whether it begins again at the end.
    """

    def __init__(self) -> None:
        self.tracks: tuple[Track, ...] = ()
        self.time, self.playing, self.loop = 0.0, False, True

    def load(self, tracks: Sequence[Track]) -> None:
        """Take other motions, and play them from the beginning.

        Raises:
            InputError: there are more than four.
        """
        if len(tracks) > MOST:
            raise InputError(f"at most {MOST} motions can be played at once, got {len(tracks)}")
        self.tracks, self.time, self.playing = tuple(tracks), 0.0, bool(tracks)

    @property
    def end(self) -> float:
        """Time of the end of the longest motion [s]."""
        return max((float(track.t[-1]) for track in self.tracks), default=0.0)

    def seek(self, time: float) -> None:
        """Go to a time [s], or to the nearest end."""
        self.time = min(max(float(time), 0.0), self.end)

    def step(self, count: int) -> None:
        """Stop, and go by a number of samples of the first motion, forwards or backwards."""
        self.playing = False
        if self.tracks:
            self.seek(self.time + count * float(self.tracks[0].t[1] - self.tracks[0].t[0]))

    def advance(self, elapsed: float) -> bool:
        """Let time pass [s]; returns whether there is anything to show."""
        if self.playing and self.tracks:
            later = self.time + elapsed
            if later > self.end and self.loop:
                later = 0.0
            self.playing = later < self.end or self.loop
            self.seek(later)
        return bool(self.tracks)

    def configurations(self) -> list[Floats]:
        """Joint coordinates ``(n,)`` of each motion at the present time."""
        return [track.at(self.time) for track in self.tracks]


def plan_tracks(
    arm: Arm, names: Sequence[str], start: Floats, target: Floats, *, seed: int, check: Callable[..., None]
) -> tuple[list[Track], Mapping[str, str]]:
    """Plan one motion by each of some planners.

    Args:
        arm: an arm that nothing else uses.
        names: names of `PLANNERS`.
        start: ``(n,)`` joint position at rest.
        target: ``(n,)`` joint target.
        seed: seed of randomised planners.
        check: called before each; an exception of it ends the work.

    Returns:
        The motions, and why a planner made none, by its name.
    """
    tracks, failures = [], dict[str, str]()
    for name in names:
        check()
        try:
            motion = plan(arm, target, planner=name, start=start, seed=seed, time_budget=_BUDGET).motion
        except LieEDNNError as error:
            failures[name] = str(error)
        else:
            tracks.append(Track(name, motion.t, motion.q))
    return tracks, failures
