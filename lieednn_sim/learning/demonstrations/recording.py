"""One demonstration, the poses of a frame at increasing times, and the files that hold some.

They are NumPy's npy and npz, csv, and the mat files of the LASA handwriting data set. A demonstration is a table with a
row for each sample and the columns x, y or x, y, z, or x, y, z and a unit quaternion; an array with three axes holds
several demonstrations of the same length.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import FileError, InputError
from lieednn_sim.io import Archive, opened, read_array
from lieednn_sim.lie import left_jacobian_so3
from lieednn_sim.validation import as_choice, as_count, as_floats, as_path, as_positive, as_times, quoted
from lieednn_sim.values import Floats, frozen

QUATERNIONS = ("wxyz", "xyzw")
_SHOWN = {2: "positions in a plane", 3: "positions", 7: "poses"}  # what a table shows, by its number of columns
_NORMS = (0.9, 1.1)  # accepted norms of recorded unit quaternions, which may be rounded
_LARGEST_TURN = 2.0 * np.pi - 0.2  # largest angle of a rotation vector [rad]: the chart is singular at a full turn
Table = tuple[NDArray[Any], NDArray[Any] | None]  # samples, and their times if the file has them
# Maps a csv file and the names of its columns to those of the samples, in order.
Columns = Callable[[Path, list[str]], Sequence[str]]

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_COLUMNS = ("x", "y", "z")
TIMES = ("t", "time")  # names of the column of times
_LARGEST_TABLE = 10**8  # bytes of a csv or mat file
_QUATERNION_COLUMNS = tuple(f"q{letter}" for letter in "wxyz")


def as_dof(dof: int) -> int:
    """Return degrees of freedom that can be recorded: 2, 3 or 6; or raise `InputError`."""
    if as_count("dof", dof) not in (2, 3, 6):
        raise InputError(f"dof must be 2, 3 or 6, got {dof}")
    return dof


@frozen
class Demonstration:
    """A recorded motion of a frame, such as of an end effector.

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
        """Make a demonstration of rows x, y; x, y, z; or x, y, z and a quaternion.

        Args:
            samples: ``(K, 2)``, ``(K, 3)`` or ``(K, 7)``, at least two rows; quaternions are normalised if within 10 %.
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
        table = as_floats(source, samples, ("K", "D"), largest=1e9)  # in any unit
        count, columns = table.shape
        if columns not in _SHOWN:
            raise InputError(
                f"{source} must have 2, 3 or 7 columns: x y, x y z, or these and a quaternion; got {columns}"
            )
        if count < 2:
            raise InputError(f"{source} must have at least two samples, got {count}")
        times = np.arange(count) / rate if t is None else as_times(f"times of {source}", t)
        if len(times) != count:
            raise InputError(f"{source} has {count} samples and {len(times)} times")
        position = np.zeros((count, 3))
        position[:, : min(columns, 3)] = length * table[:, :3]
        rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
        if columns == 7:
            norms = np.linalg.norm(table[:, 3:], axis=1)
            if not ((norms > _NORMS[0]) & (norms < _NORMS[1])).all():
                worst = int(np.argmax(np.abs(norms - 1.0)))
                raise InputError(f"quaternions of {source} must be units, got norm {norms[worst]:g} in row {worst}")
            rotation = Rotation.from_quat(table[:, 3:], scalar_first=quaternion == "wxyz").as_matrix()
        result = cls(times - times[0], position, rotation, 6 if columns == 7 else columns, source)
        if result.steps(lever=1.0).sum() < 1e-9:  # [m]
            raise InputError(f"{source} does not move")
        return result

    @property
    def shown(self) -> str:
        """The quantities that were recorded, in words."""
        return _SHOWN[7 if self.dof == 6 else self.dof]

    @cached_property
    def twists(self) -> Floats:
        """Twists ``(K, 6)`` [rad, m]: logarithms of the poses relative to the last one, along the world's axes.

        xi = log (R R_K^T, p - p_K), so the goal is zero. Where the frame turns by more than pi from its goal, the
        rotation vector continues instead of jumping to the other side: going backwards from the goal, of all vectors of
        a rotation, which differ by full turns about its axis, the one nearest to the following sample is taken.

        Raises:
            InputError: the frame turns by nearly a full turn or more, where the logarithm is singular.
        """
        return self.twists_from(self)

    def twists_from(self, other: Demonstration) -> Floats:
        """As `twists`, relative to the last pose of another demonstration."""
        turn = Rotation.from_matrix(self.rotation @ other.rotation[-1].T).as_rotvec()
        for k in reversed(range(len(turn) - 1)):
            angle = np.linalg.norm(turn[k])
            if angle > 0.0:
                axis = turn[k] / angle
                turn[k] += 2.0 * np.pi * np.round((turn[k + 1] - turn[k]) @ axis / (2.0 * np.pi)) * axis
        if np.linalg.norm(turn, axis=1).max() > _LARGEST_TURN:
            raise InputError(f"{self.source} turns by a full turn or more from its goal; cut it into shorter ones")
        shift = np.linalg.solve(left_jacobian_so3(turn), (self.position - other.position[-1])[..., None])[..., 0]
        return np.concatenate([turn, shift], axis=1)

    def steps(self, lever: float) -> Floats:
        """Lengths ``(K - 1,)`` from each sample to the next [m], in which a radian counts for ``lever`` metres."""
        lever = as_positive("lever", lever)
        turns = Rotation.from_matrix(self.rotation[1:] @ self.rotation[:-1].swapaxes(1, 2)).magnitude()
        return np.hypot(np.linalg.norm(np.diff(self.position, axis=0), axis=1), lever * turns)


def load_demonstrations(
    files: Iterable[str | os.PathLike[str]], *, unit: str = "m", quaternion: str = "wxyz", rate: float = 100.0
) -> tuple[Demonstration, ...]:
    """Read demonstrations of one motion, one or several from each file.

    - ``.npy``: ``(K, D)`` or ``(n, K, D)`` with D = 2, 3 or 7.
    - ``.npz``: such an array, the only one or named ``poses`` or ``positions``; optionally separate ``quaternions``
      ``(..., K, 4)``, and times ``t`` ``(K,)`` or ``(n, K)`` [s].
    - ``.csv``: one demonstration, separated by commas. A first line may name the columns x, y, z, qw, qx, qy, qz and t
      or time [s] in any order; others are ignored.
    - ``.mat``: the structures ``demos`` of the LASA data set, with ``pos`` ``(2, K)`` and ``t``.

    Args:
        files: at least one.
        unit: unit of the positions, a name of `UNITS`.
        quaternion: order of the quaternions' entries, a name of `QUATERNIONS`.
        rate: sampling rate of files without times [1/s].

    Raises:
        FileError: a file cannot be read, or is of another kind.
        InputError: a file's numbers are no demonstration, or demonstrations record different quantities.
    """
    length = UNITS[as_choice("unit", unit, UNITS)]
    as_choice("order of quaternions", quaternion, QUATERNIONS)
    as_positive("rate", rate)
    result = [
        Demonstration.from_samples(samples, t, length, quaternion, rate, source)
        for source, samples, t in read_tables(files, partial(_pose_columns, quaternion))
    ]
    for other in result[1:]:
        if other.dof != result[0].dof:
            raise InputError(
                f"demonstrations must all show the same: {result[0].source} has {result[0].shown}, "
                f"{other.source} {other.shown}"
            )
    return tuple(result)


def read_tables(
    files: Iterable[str | os.PathLike[str]], columns: Columns
) -> list[tuple[str, NDArray[Any], NDArray[Any] | None]]:
    """The source of each table in the files, its samples, and its times if it has them.

    Raises:
        FileError: a file cannot be read, or is of another kind.
        InputError: there is no table, or a csv file's columns are not those of ``columns``.
    """
    results = []
    for name in files:
        path = as_path("the name of a file of demonstrations", name)
        tables = list(_tables(path, columns))
        for number, table in enumerate(tables):
            results.append((path.name if len(tables) == 1 else f"{path.name}[{number}]", *table))
    if not results:
        raise InputError("there is no demonstration; name at least one file")
    return results


def _tables(path: Path, columns: Columns) -> Iterator[Table]:
    read = {".npy": _npy, ".npz": _npz, ".csv": _csv, ".mat": _mat}.get(path.suffix.lower())
    if read is None:
        raise FileError(f"{path} is no file of demonstrations; allowed are .npy, .npz, .csv and .mat")
    try:
        yield from read(path, columns)
    except (FileError, InputError):
        raise
    except Exception as error:  # the readers raise all kinds of exceptions on a damaged file
        raise FileError(f"{path} is not a readable file of demonstrations ({type(error).__name__}: {error})") from None


def _several(path: Path, samples: NDArray[Any], t: NDArray[Any] | None = None) -> Iterator[Table]:
    """The demonstrations of an array ``(K, D)`` or ``(n, K, D)``."""
    if samples.ndim not in (2, 3):
        raise InputError(f"{path}: demonstrations must have shape (K, D) or (n, K, D), got {samples.shape}")
    if t is not None and t.shape not in (samples.shape[-2:-1], samples.shape[:-1]):
        raise InputError(f"{path}: times must have shape {samples.shape[-2:-1]}, one for each sample, got {t.shape}")
    if samples.ndim == 2:
        yield samples, t
    else:
        for number, item in enumerate(samples):
            yield item, t if t is None or t.ndim == 1 else t[number]


def _npy(path: Path, _: Columns) -> Iterator[Table]:
    with opened(path) as stream:
        return _several(path, read_array(stream, path.stat().st_size))


def _npz(path: Path, _: Columns) -> Iterator[Table]:
    with opened(path) as stream:
        archive = Archive(stream)
        arrays = {name: archive.read(name) for name in archive.names}
    t, quaternions = arrays.pop("t", None), arrays.pop("quaternions", None)
    named: list[str] = [name for name in ("poses", "positions") if name in arrays] or [*arrays]
    if len(named) != 1:
        raise InputError(f"{path} must hold one array named 'poses' or 'positions'; it holds: {', '.join(arrays)}")
    samples = arrays[named[0]]
    if quaternions is not None:
        samples = np.concatenate([samples, quaternions], axis=-1)
    return _several(path, samples, t)


def _csv(path: Path, columns: Columns) -> Iterator[Table]:
    with opened(path, _LARGEST_TABLE) as stream:
        first = stream.readline().decode("utf-8-sig")
    if ";" in first or "\t" in first:
        raise FileError(
            f"{path} must be separated by commas, with points in its numbers; its first line is {quoted(first.strip())}"
        )
    names = [word.strip().lower() for word in first.split(",")]
    headed = any(name[:1].isalpha() and name not in ("nan", "inf") for name in names)
    table = np.loadtxt(path, delimiter=",", skiprows=int(headed), ndmin=2, encoding="utf-8-sig")
    if not headed:
        return _several(path, table)
    chosen = columns(path, names)
    t = next((table[:, names.index(name)] for name in TIMES if name in names), None)
    return _several(path, table[:, [names.index(name) for name in chosen]], t)


def _pose_columns(quaternion: str, path: Path, names: list[str]) -> Sequence[str]:
    chosen = [name for name in _COLUMNS if name in names]
    if any(name in names for name in _QUATERNION_COLUMNS):
        chosen = [*_COLUMNS, *(f"q{letter}" for letter in quaternion)]
    if chosen[:2] != ["x", "y"] or not set(chosen) <= set(names):
        raise InputError(f"{path} must have columns x, y, z and qw, qx, qy, qz, or x, y; it has: {', '.join(names)}")
    return chosen


def _mat(path: Path, _: Columns) -> Iterator[Table]:
    from scipy.io import loadmat

    with opened(path, _LARGEST_TABLE) as stream:
        demos = loadmat(stream, simplify_cells=True, variable_names=["demos"]).get("demos")
    if demos is None:
        raise InputError(f"{path} has no 'demos', as the files of the LASA data set have")
    for demo in [demos] if isinstance(demos, dict) else demos:
        yield np.asarray(demo["pos"]).T, np.ravel(demo["t"]) if "t" in demo else None
