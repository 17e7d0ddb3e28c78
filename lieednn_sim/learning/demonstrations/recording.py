"""A demonstration, which is the poses of a frame at increasing times, and the reading of files (`tables`).

A demonstration is a table with a row for each sample and the columns x, y or x, y, z, or x, y, z and a unit quaternion;
an array with three axes holds several demonstrations of the same length.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations.tables import TIME_UNITS, Layout, as_recording, read_tables
from lieednn_sim.lie.se3 import turns_near, twist_of
from lieednn_sim.validation import as_choice, as_count, as_floats, as_positive, as_times
from lieednn_sim.values import Floats, StrPath, frozen

QUATERNIONS = ("wxyz", "xyzw")
_COUNTS = (2, 3, 7)
_WORDS = "2, 3 or 7 columns: x y, x y z, or these and a quaternion; or 4 or 8, the time and x y z or a pose"
_LARGEST = 1e9  # largest entry of a sample, in any unit

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}


def as_dof(dof: int) -> int:
    """Return degrees of freedom that can be recorded: 2, 3 or 6; or raise `InputError`."""
    if as_count("dof", dof) not in (2, 3, 6):
        raise InputError(f"dof must be 2, 3 or 6, got {dof}")
    return dof


@frozen
class Demonstration:
    """A recorded motion of a frame, such as an end effector's.

    Attributes:
        t: ``(K,)`` times, starting at 0 [s].
        position: ``(K, 3)`` in the world [m]; the third entry is zero for a motion in a plane.
        rotation: ``(K, 3, 3)`` from the frame to the world; the identity if not recorded.
        dof: degrees of freedom that were recorded: 2, 3 or 6.
        source: where the demonstration comes from, for messages.

    Raises:
        InputError: an entry is not finite, times do not increase, or shapes do not fit.
    """

    t: Floats
    position: Floats
    rotation: Floats
    dof: int
    source: str = ""

    def __post_init__(self) -> None:
        count = len(as_times(f"times of {self.source or 'a demonstration'}", self.t))
        as_floats("position", self.position, (count, 3))
        as_floats("rotation", self.rotation, (count, 3, 3))
        as_dof(self.dof)

    @classmethod
    def from_samples(
        cls,
        samples: ArrayLike,
        t: ArrayLike | None = None,
        length: float = 1.0,
        quaternion: str = "wxyz",
        rate: float = 100.0,
        source: str = "a demonstration",
    ) -> Demonstration:
        """Make a demonstration from rows x, y; x, y, z; or x, y, z and a quaternion.

        Args:
            samples: ``(K, 2)``, ``(K, 3)`` or ``(K, 7)``, or ``(K, 4)`` or ``(K, 8)`` with times in the first column;
                at least two rows; quaternions whose norm is within 10 % of 1 are normalised.
            t: ``(K,)`` increasing times [s], or None.
            length: length unit of the positions [m].
            quaternion: order of the quaternions' entries, a name of `QUATERNIONS`.
            rate: sampling rate [1/s], needed if there are no times.
            source: name in messages.

        Raises:
            InputError: the samples or times are malformed, or nothing moves.
        """
        length, rate = as_positive("length", length), as_positive("rate", rate)
        as_choice("order of quaternions", quaternion, QUATERNIONS)
        table, times = as_recording(source, samples, t, Layout(_COUNTS, _WORDS, rate=rate))
        row, column = map(int, np.unravel_index(np.abs(table).argmax(), table.shape))
        if abs(table[row, column]) > _LARGEST:
            raise InputError(
                f"{source} must not exceed {_LARGEST:g} in size, got {table[row, column]:.15g} in row {row}, column "
                f"{column}; if it is the time, name the columns in the first line of a text file, such as t x y"
            )
        count, columns = table.shape
        position = np.zeros((count, 3))
        position[:, : min(columns, 3)] = length * table[:, :3]
        rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
        if columns == 7:
            norms = np.linalg.norm(table[:, 3:], axis=1)
            worst = int(np.argmax(np.abs(norms - 1.0)))
            if not 0.9 < norms[worst] < 1.1:
                raise InputError(f"quaternions of {source} must have norm 1, got {norms[worst]:g} in row {worst}")
            rotation = Rotation.from_quat(table[:, 3:], scalar_first=quaternion == "wxyz").as_matrix()
        result = cls(times, position, rotation, 6 if columns == 7 else columns, source)
        if result.steps(lever=1.0).sum() < 1e-9:  # [m]
            raise InputError(f"{source} does not move")
        return result

    @property
    def shown(self) -> str:
        """The quantities that were recorded, in words."""
        return {2: "positions in a plane", 3: "positions", 6: "poses"}[self.dof]

    @cached_property
    def twists(self) -> Floats:
        """Twists ``(K, 6)`` [rad, m]: logarithms of the poses relative to the last one, along the world's axes.

        xi = log (R R_K^T, p - p_K), so the goal is zero. Where the frame turns by more than pi from its goal, the
        rotation vector continues instead of jumping to the other side: the vectors of a rotation differ by full turns
        about its axis, and, going backwards from the goal, the one nearest to the following sample is taken.

        Raises:
            InputError: the frame turns by nearly a full turn or more, where the logarithm is singular.
        """
        return self.twists_from(self.position[-1], self.rotation[-1])

    def twists_from(self, place: Floats, rotation: Floats) -> Floats:
        """As `twists`, relative to another goal of position ``(3,)`` and rotation ``(3, 3)``, which are unchecked."""
        turn = Rotation.from_matrix(self.rotation @ rotation.T).as_rotvec()
        for k in reversed(range(len(turn) - 1)):
            turn[k] = turns_near(turn[k], turn[k + 1])
        # The chart is singular at a full turn.
        if np.linalg.norm(turn, axis=1).max() > 2.0 * np.pi - 0.2:
            raise InputError(f"{self.source} turns by a full turn or more from its goal; cut it into shorter ones")
        return twist_of(np.concatenate([turn, self.position - place], axis=1))

    def steps(self, lever: float, kept: slice | NDArray[np.intp] = slice(None)) -> Floats:
        """Lengths ``(K - 1,)`` from each of the samples kept to the next [m]; a radian counts for ``lever`` metres."""
        position, rotation, lever = self.position[kept], self.rotation[kept], as_positive("lever", lever)
        turns = Rotation.from_matrix(rotation[1:] @ rotation[:-1].swapaxes(1, 2)).magnitude()
        return np.hypot(np.linalg.norm(np.diff(position, axis=0), axis=1), lever * turns)


def load_demonstrations(
    files: Iterable[StrPath], *, unit: str = "m", quaternion: str = "wxyz", rate: float = 100.0, time_unit: str = "s"
) -> tuple[Demonstration, ...]:
    """Read demonstrations of one motion, one or several from each file.

    - ``.npy``: ``(K, D)`` or ``(n, K, D)`` with D = 2, 3 or 7, or 4 or 8 with the times first.
    - ``.npz``: such an array, the only one or named ``poses`` or ``positions``; optionally separate ``quaternions``
      ``(..., K, 4)``, and times ``t`` ``(K,)`` or ``(n, K)`` [s].
    - ``.csv``, ``.txt``, ``.tsv``, ``.tum``: one demonstration, separated by commas, semicolons, blanks or tabs. A
      first line, or a comment, may name the columns x, y, z (or tx, ty, tz), qw, qx, qy, qz and t, time or timestamp in
      any order; others are ignored, unless they may be the time. Without names, a ``.tum`` file is as TUM defines it.
    - ``.mat``: the structures ``demos`` of the LASA data set, with ``pos`` ``(2, K)`` and ``t``.

    Args:
        files: at least one.
        unit: unit of the positions, a name of `UNITS`.
        quaternion: order of the quaternions' entries, a name of `QUATERNIONS`.
        rate: sampling rate of files without times [1/s].
        time_unit: unit of the times, ``s``, ``ms``, ``us`` or ``ns``, unless the name of their column has one.

    Raises:
        FileError: a file cannot be read, or is of another kind.
        InputError: a file's numbers are no demonstration, or demonstrations record different quantities.
    """
    length = UNITS[as_choice("unit", unit, UNITS)]
    as_choice("order of quaternions", quaternion, QUATERNIONS)
    as_choice("time_unit", time_unit, TIME_UNITS)
    layout = Layout(_COUNTS, _WORDS, partial(_pose_columns, quaternion), as_positive("rate", rate), time_unit)
    how = length, quaternion, rate
    shown = tuple(Demonstration.from_samples(q, t, *how, source) for source, q, t in read_tables(files, layout))
    if other := next((each for each in shown if each.dof != shown[0].dof), None):
        each = f"{shown[0].source} has {shown[0].shown}, {other.source} {other.shown}"
        raise InputError(f"demonstrations must all show the same: {each}")
    if (across := max(float(np.ptp(each.position, axis=0).max()) for each in shown)) > 10.0:
        warnings.warn(f"positions span {across:.3g} m, read in {unit}; units: {', '.join(UNITS)}", stacklevel=2)
    return shown


def _pose_columns(quaternion: str, path: Path, names: list[str]) -> Sequence[str]:
    axes = ["x", "y", "z"] if "x" in names else ["tx", "ty", "tz"]  # as in TUM's files
    chosen = [name for name in axes if name in names]
    turns = [f"q{letter}" for letter in quaternion]
    if any(name in names for name in turns):
        chosen = [*axes, *turns]
    if chosen[:2] != axes[:2] or not set(chosen) <= set(names):
        raise InputError(f"{path} must have columns x, y, z and qw, qx, qy, qz, or x, y; it has: {', '.join(names)}")
    return chosen
