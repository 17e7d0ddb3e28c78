"""A certified network for an arm's joints from demonstrations of them, for example by kinesthetic teaching.

The joint positions are averaged at equal fractions of the path length and encoded by the arm. `synthesis.shape` makes a
network that follows this mean; the motion has the demonstrations' time law.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.learning.demonstrations.alignment import GOALS, PHASES, Indices, at_phases
from lieednn_sim.learning.demonstrations.family import Response, with_response
from lieednn_sim.learning.demonstrations.tables import TIME, TIME_UNITS, Layout, read_tables
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.motion import LIMIT_TOLERANCE, Motion, travelled
from lieednn_sim.planning.network_path import NetworkPath, timed_motion
from lieednn_sim.planning.problem import PlanningProblem, in_time
from lieednn_sim.planning.shaped import lever_units
from lieednn_sim.planning.time_laws import Law, recorded_law
from lieednn_sim.synthesis import Shaping, ShapingOptions, shape
from lieednn_sim.validation import as_choice, as_positive
from lieednn_sim.values import Floats, StrPath, frozen

_LEAST_LENGTH = 1e-6  # below which nothing moves [m]
DEVIATION = 1e-3  # default, relative to the length of the mean


@frozen
class JointDemonstrations:
    """Demonstrations of one motion of an arm's joints, at K equal steps of the phase."""

    arm: Arm
    t: Floats  # ``(K,)`` mean time at which a phase is reached, from 0 to the mean duration [s]
    q: Floats  # ``(m, K, n)`` joint positions [rad, m]
    units: Floats  # ``(N, 6)`` metres for one unit of each network coordinate, `lever_units`
    goals_kept: bool = False  # whether each ends at its own goal; otherwise all end at one

    @classmethod
    def load(
        cls,
        arm: Arm,
        files: Iterable[StrPath],
        *,
        rate: float = 100.0,
        phase: str = "length",
        goals: str = "aligned",
        time_unit: str = "s",
    ) -> JointDemonstrations:
        """Read files as `load_demonstrations` does, but with the arm's joints as columns.

        A table has n columns in the order of `Arm.joint_names`, or the time and these; a text file may name them, in
        any order, and the time t, time or timestamp. Joints without a range may be recorded within half a turn of zero:
        they are unwrapped (`numpy.unwrap`).

        Args:
            arm: the arm.
            files: at least one.
            rate, time_unit: as for `load_demonstrations`.
            phase: a name of `PHASES`; see `align`.
            goals: ``"aligned"``, all end at one goal, or ``"kept"``, each at its own.

        Raises:
            FileError: a file cannot be read, or is not such a table.
            InputError: a file is no motion of the arm within its limits, or its end differs from the mean end by more
                than 2 % of a joint's range and goals are not kept.
        """
        as_choice("phase", phase, PHASES)
        kept = as_choice("goals", goals, GOALS) == "kept"
        as_choice("time_unit", time_unit, TIME_UNITS)
        words = f"{arm.n_joints} columns, the joints {', '.join(arm.joint_names)}, or the time and these"
        layout = Layout([arm.n_joints], words, partial(_joint_columns, arm), as_positive("rate", rate), time_unit)
        tables = read_tables(files, layout)
        shown: list[Floats] = []
        for source, samples, _ in tables:
            shown.append(_within_limits(arm, source, samples, shown[0][-1] if shown else None))
        units = lever_units(arm, np.concatenate(shown))
        fractions, found = np.linspace(0.0, 1.0, 201), []
        for q, (source, _, t) in zip(shown, tables, strict=True):
            states = (arm.encode(q) * units).reshape(len(q), -1)
            if np.ptp(states, axis=0).max() < _LEAST_LENGTH:
                raise InputError(f"{source} does not move")
            found.append(at_phases(fractions, q, t, phase, states, partial(_lengths, states)))
        paths, times = map(np.array, zip(*found, strict=True))
        ends, goal = paths[:, -1], paths[:, -1].mean(axis=0)
        k, joint = map(int, np.unravel_index(np.argmax(np.abs(ends - goal) / arm.ranges), ends.shape))
        max_end_distance = 0.02  # of a demonstration's end from the mean end, in the joints' ranges
        if not kept and np.abs(ends[k, joint] - goal[joint]) > max_end_distance * arm.ranges[joint]:
            raise InputError(
                f"demonstrations must end at one goal: {tables[k][0]} ends with joint {arm.joint_names[joint]!r} at "
                f"{ends[k, joint]:.4g} {arm.unit(joint)}, their mean is {goal[joint]:.4g}; "
                "keep their goals (--goals kept), or learn other goals apart"
            )
        result = cls(arm, times.mean(axis=0), paths, units, kept)
        for configuration, what in ((result.mean[0], "the mean start"), (result.mean[-1], "the mean end")):
            arm.check_reachable(configuration, what)
        return result

    def __len__(self) -> int:
        """Number of demonstrations."""
        return len(self.q)

    @cached_property
    def mean(self) -> Floats:
        """Mean joint positions ``(K, n)``: the motion to reproduce."""
        return self.arm.within_angles(self.q.mean(axis=0))

    @cached_property
    def spread(self) -> Floats:
        """Root mean square ``(K,)`` of the demonstrations' distances from the mean, over all links, in `units` [m]."""
        away = (self.arm.encode(self.q) - self.arm.encode(self.mean)) * self.units
        return np.asarray(np.sqrt(np.mean(np.sum(away**2, axis=(-2, -1)), axis=0)))

    def length_fractions(self, q: Floats) -> Floats:
        """Fractions ``(K,)`` of a path's length, measured in `units`, at its joint positions ``(K, n)``."""
        length = travelled(self.arm.encode(q) * self.units)
        return length / max(length[-1], 1e-300)

    def without(self, index: int) -> JointDemonstrations:
        """The demonstrations without the one at ``index``; the times stay the same."""
        return replace(self, q=np.delete(self.q, index, axis=0))


@frozen
class JointMotion:
    """A shaped network of an arm's joints with the time law of the demonstrations."""

    network: LieEDNN  # certified, with one visible neuron for each link of the arm
    arm: Arm
    units: Floats  # as in `JointDemonstrations`
    goal: Floats  # ``(n,)`` joint position at which the motion ends [rad, m]
    duration: float  # of the demonstrations [s]
    law: Law  # their time law
    shaping: Shaping  # the search that found the network of their mean
    response: Response | None = None  # as in `ShapedMotion`, in `units`

    @classmethod
    def fit(
        cls,
        demonstrations: JointDemonstrations,
        deviation: float | None = None,
        options: ShapingOptions | None = None,
        family: bool = True,
    ) -> JointMotion:
        """Shape a network by the demonstrations' mean, and by their response to the start.

        `InputError` if the mean does not move.

        Args:
            demonstrations: demonstrations to follow.
            deviation: largest deviation from their mean, in their `units` [m]; by default `DEVIATION` times its length.
                Neurons are added until it is met; see `Shaping.success`.
            options: options of the search.
            family: as for `ShapedMotion.fit`.
        """
        arm, mean = demonstrations.arm, demonstrations.mean
        curve, fractions = arm.encode(mean), demonstrations.length_fractions(mean)
        length = travelled(curve * demonstrations.units)[-1]
        if length < _LEAST_LENGTH:
            raise InputError("the mean of the demonstrations does not move")
        asked = DEVIATION * float(length) if deviation is None else as_positive("deviation", deviation)
        shaping = shape(curve, asked, units=demonstrations.units, options=options)
        law = recorded_law(demonstrations.t, fractions)
        duration = float(demonstrations.t[-1])
        network, response = shaping.network, None
        if family and (options is None or options.rate == 1.0):
            paths = arm.encode(demonstrations.q)
            network, response, _ = with_response(shaping, curve, paths, demonstrations.units, demonstrations.goals_kept)
        return cls(network, arm, demonstrations.units, mean[-1], duration, law, shaping, response)

    def toward(self, goal: Floats) -> JointMotion:
        """The motion to another joint position ``(n,)``, as `ShapedMotion.toward`."""
        goal = self.arm.check_position(goal, "goal")
        return replace(self, network=self.network.retarget(self.arm.encode(goal)), goal=goal)

    def run(self, start: Floats, samples: int = 400) -> Motion:
        """The motion from joint position ``(n,)`` in the demonstrations' time, without checks of limits.

        `PlanError` if the network does not arrive.
        """
        return self._path(start).timed(self.duration, self.duration / samples, self.law)

    def planned(self, start: Floats) -> tuple[Motion, str]:
        """The motion at the model's time step, slowed down if limits require it; and the reason if it still breaks one.

        `InputError` if the start cannot be used, or the duration is too long or too short for the time step.
        """
        path, problem = self._path(start), PlanningProblem(self.arm, start, self.goal, self.duration)
        try:
            return in_time(timed_motion, problem, path, self.law), ""
        except PlanError as error:
            return path.timed(self.duration, problem.timestep, self.law), str(error)

    def _path(self, start: Floats) -> NetworkPath:
        return NetworkPath.integrate(self.arm, self.network, start, self.units)


def _lengths(points: Floats, kept: Indices) -> Floats:
    """Lengths of the steps between the points ``(K, D)`` with the given indices."""
    return np.asarray(np.linalg.norm(np.diff(points[kept], axis=0), axis=1))


def _joint_columns(arm: Arm, path: Path, names: list[str]) -> Sequence[str]:
    """The names of the joints' columns; a table may have others."""
    joints = [name.lower() for name in arm.joint_names]
    if missing := [name for name in joints if name not in names]:
        strange = [name for name in names if name not in joints and not TIME.fullmatch(name)]
        raise InputError(
            f"{path} must name the joints of {arm.name}: {', '.join(arm.joint_names)}; it lacks {', '.join(missing)}"
            + (f", and names {', '.join(strange)}" if strange else "")
        )
    return joints


def _within_limits(arm: Arm, source: str, table: Floats, end: Floats | None) -> Floats:
    """Recorded joint positions ``(K, n)``, or `InputError` if the arm cannot take them.

    Continuous joints, which are often recorded within half a turn of zero, are unwrapped. Whole turns are added so that
    they end nearest to ``end`` ``(n,)`` or, without it, are within the limits.
    """
    table = np.where(arm.continuous, np.unwrap(table, axis=0), table)
    if end is None:
        beyond = ((table < arm.position_limits[:, 0]) | (table > arm.position_limits[:, 1])).any(axis=0)
        end = table[-1] - beyond * (table.min(axis=0) + table.max(axis=0)) / 2.0
    table = table + (arm.nearest_turn(table[-1], end) - table[-1])
    outside = arm.limit_excess(table)
    k, joint = map(int, np.unravel_index(outside.argmax(), outside.shape))
    if outside[k, joint] > LIMIT_TOLERANCE:
        degrees = "; are these degrees?" if joint < arm.n_joints and np.abs(table[k, joint]) > 4.0 * np.pi else ""
        raise InputError(f"in row {k} of {source} {arm.describe_excess(table[k], joint)}{degrees}")
    jumps = np.abs(np.diff(table, axis=0)) * [arm.unit(j) == "rad" for j in range(arm.n_joints)]
    k, joint = map(int, np.unravel_index(jumps.argmax(), jumps.shape))
    if jumps[k, joint] > np.pi:
        raise InputError(
            f"in row {k + 1} of {source} joint {arm.joint_names[joint]!r}, which has a range, jumps from "
            f"{table[k, joint]:.4g} to {table[k + 1, joint]:.4g} rad, more than half a turn; record it without jumps"
        )
    return arm.within_angles(np.clip(table, *arm.position_limits.T))
